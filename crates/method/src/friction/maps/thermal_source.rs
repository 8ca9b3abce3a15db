//! Choice of the temperature that determines the thermal state of a joint, in addition to its motion: that of its
//! motor, the ambient one, or none.
//!
//! A motor's temperature replaces the slow part of the thermal deficit, so neither heating in motion nor cooling at
//! rest needs a model. It does not contain the heat between teeth and housing or the losses of the motor itself; a fast
//! part that follows the motion represents these. An ambient temperature below the usual one adds to the thermal
//! deficit in proportion, with a fitted coefficient.

use super::map::{FittedMap, fit_map};
use super::published_map::ambient_effect;
use super::record::{
    AmbientTemperatures, JointRecord, MotorTemperatures, RecordPoint, ThermalSensor, reading_at, runs_of,
};
use crate::statistics::descriptive::{mean, median, standard_deviation};
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::temperature::ZERO_CELSIUS;

/// Smallest fraction of a run's cycles that must have the motor's temperature; it is interpolated between them.
const MIN_CYCLES: f64 = 0.5;

/// Smallest range of a motor's temperature over the history, K. Friction of a gearbox changes by 1 to 3 % per kelvin,
/// so a smaller range shows little of it, and drives that report steps of 1 K resolve it badly. The temperature of a
/// stuck sensor has no range.
const MIN_RANGE_K: f64 = 5.0;

/// Fraction of the points below the cold end of a motor's scale, and above its warm end: single extreme readings
/// must not define the scale.
const TAIL: f64 = 0.05;

/// Smallest number of runs with an ambient temperature for a fit of its coefficient.
const MIN_AMBIENT_RUNS: usize = 5;
/// Smallest standard deviation of the ambient temperature over these runs, K; errors of a sensor are some tenths.
const MIN_AMBIENT_DEVIATION_K: f64 = 1.0;

/// Largest residual with a motor's temperature, as a multiple of the residual with motion alone. If a residual exceeds
/// this and [`MAX_RESIDUAL`], the temperature is rejected. A temperature that lags behind the gears leaves a smaller
/// residual; one of another part leaves nearly all of the variation.
const MAX_RESIDUAL_RATIO: f64 = 2.0;
/// Largest residual with a motor's temperature, as a fraction of the variation of friction.
const MAX_RESIDUAL: f64 = 0.4;

/// Smallest effect of an ambient temperature on friction, in standard errors, with which it is used.
const MIN_STANDARD_ERRORS: f64 = 2.0;

/// Temperature to use for a joint with these points, and the reason if a recorded one is not used.
pub(in crate::friction) fn thermal_sensor(
    joint: JointIndex,
    runs: &[&MapRun],
    starts: &[f64],
    points: &[RecordPoint],
) -> (ThermalSensor, Option<String>) {
    let remark = |reason: String| Some(format!("joint {joint}: {reason}"));
    match motor_temperatures(joint, runs, starts, points) {
        Ok(Some(motor)) => (ThermalSensor::Motor(motor), None),
        Ok(None) => match ambient_temperatures(runs, points) {
            Ok(Some(ambient)) => (ThermalSensor::Ambient(ambient), None),
            Ok(None) => (ThermalSensor::None, None),
            Err(reason) => (ThermalSensor::None, remark(reason)),
        },
        Err(reason) => {
            let ambient = ambient_temperatures(runs, points).ok().flatten();
            (ambient.map_or(ThermalSensor::None, ThermalSensor::Ambient), remark(reason))
        }
    }
}

/// Sensor of a held map, with the readings of `runs`; `None` if the map needs the motor's temperature and a run lacks
/// it.
pub(in crate::friction) fn held_sensor(
    held: &ThermalSensor,
    joint: JointIndex,
    runs: &[&MapRun],
    starts: &[f64],
) -> Option<ThermalSensor> {
    Some(match held {
        ThermalSensor::None => ThermalSensor::None,
        ThermalSensor::Motor(motor) => {
            let of_run = |(run, start): (&&MapRun, &f64)| {
                let readings = motor_readings(joint, run, *start);
                has_readings(&readings, run).then_some(readings)
            };
            let readings: Option<Vec<Vec<[f64; 2]>>> = runs.iter().zip(starts).map(of_run).collect();
            ThermalSensor::Motor(MotorTemperatures { readings: readings?, ..*motor })
        }
        ThermalSensor::Ambient(ambient) => {
            let below_usual = runs.iter().map(|run| below(ambient.usual, mean_ambient(run))).collect();
            ThermalSensor::Ambient(AmbientTemperatures { below_usual, ..*ambient })
        }
    })
}

/// Fits the map of a record for the first time, and again without its sensor if friction contradicts the sensor.
///
/// A motor's temperature is rejected if it leaves a far larger residual than motion alone. An ambient temperature is
/// rejected if its effect on friction is not significantly above zero.
pub(in crate::friction) fn first_fit(record: &mut JointRecord, runs: usize) -> FittedMap {
    let fit = fit_map(record, None);
    let reason = match &record.sensor {
        ThermalSensor::None => None,
        ThermalSensor::Motor(_) => motor_rejection(record, &fit),
        ThermalSensor::Ambient(_) => ambient_rejection(record, &fit, runs),
    };
    let Some(reason) = reason else { return fit };
    record.sensor = ThermalSensor::None;
    record.remarks.push(format!("joint {}: {reason}", record.joint));
    fit_map(record, None)
}

/// Reason for rejecting the motor's temperature of a record.
fn motor_rejection(record: &JointRecord, fit: &FittedMap) -> Option<String> {
    let by_motion = fit_map(&JointRecord { sensor: ThermalSensor::None, ..record.clone() }, None);
    let rejected = fit.rms > MAX_RESIDUAL_RATIO * by_motion.rms && fit.rms > MAX_RESIDUAL * variation(record);
    rejected.then(|| {
        format!(
            "its motor temperature does not go with its friction (it leaves {:.1} %, motion {:.1} %): the \
             sensor of another joint? The thermal state follows from motion",
            100.0 * fit.rms,
            100.0 * by_motion.rms
        )
    })
}

/// Reason for rejecting the ambient temperature of a record.
fn ambient_rejection(record: &JointRecord, fit: &FittedMap, runs: usize) -> Option<String> {
    let effect = ambient_effect(record, fit, runs)?;
    let rejected = effect.value < MIN_STANDARD_ERRORS * effect.std_error;
    rejected.then(|| "the ambient temperature is not used: friction does not tell that it matters".to_owned())
}

/// Root-mean-square deviation of the friction in the map from its level's mean, as a fraction of that mean.
fn variation(record: &JointRecord) -> f64 {
    let of_level = |level: usize| {
        let torques: Vec<f64> =
            record.points.iter().filter(|p| p.in_map && p.level == level).map(|p| p.torque).collect();
        let mean = mean(&torques).unwrap_or(1.0);
        torques.into_iter().map(move |torque| (torque / mean - 1.0).powi(2))
    };
    let squares: Vec<f64> = (0..record.levels.len()).flat_map(of_level).collect();
    mean(&squares).unwrap_or(0.0).sqrt()
}

/// Temperatures of the joint's motor; `None` if no run with points has them.
///
/// # Errors
///
/// A reason if only some of the runs have them, or if their range is too small.
fn motor_temperatures(
    joint: JointIndex,
    runs: &[&MapRun],
    starts: &[f64],
    points: &[RecordPoint],
) -> Result<Option<MotorTemperatures>, String> {
    let readings: Vec<Vec<[f64; 2]>> =
        runs.iter().zip(starts).map(|(run, start)| motor_readings(joint, run, *start)).collect();
    let used = runs_of(points.iter());
    let with = used.iter().filter(|run| has_readings(&readings[**run], runs[**run])).count();
    if with == 0 {
        return Ok(None);
    }
    if with < used.len() {
        return Err(format!(
            "its motor temperature is recorded in {with} of {} runs; the thermal state follows from motion in all, so \
             that all are held against one scale",
            used.len()
        ));
    }
    let mut kelvin: Vec<f64> =
        points.iter().filter(|p| p.in_map).filter_map(|p| reading_at(&readings[p.run], p.time)).collect();
    kelvin.sort_by(f64::total_cmp);
    let quantile = |share: f64| kelvin[((kelvin.len() - 1) as f64 * share).round() as usize];
    let (cold, warm) = (quantile(TAIL), quantile(1.0 - TAIL));
    if warm - cold < MIN_RANGE_K {
        return Err(format!(
            "its motor temperature moves by {:.1} K only over the runs (about {:.1} degC), which tells nothing of the \
             gearbox; the thermal state follows from motion",
            warm - cold,
            cold - ZERO_CELSIUS
        ));
    }
    Ok(Some(MotorTemperatures { warm, cold, readings }))
}

/// Returns true if enough cycles of a run have the motor's temperature.
fn has_readings(readings: &[[f64; 2]], run: &MapRun) -> bool {
    readings.len() as f64 >= (MIN_CYCLES * run.spans.len() as f64).max(1.0)
}

/// Mean temperature of the joint's motor in each cycle of a run that has it, with the middle of the cycle since the
/// epoch, s.
fn motor_readings(joint: JointIndex, run: &MapRun, start: f64) -> Vec<[f64; 2]> {
    let reading = |span: &CycleMotion| {
        let kelvin = span.temperatures.motor.get(joint.index()).copied().flatten()?;
        Some([start + f64::midpoint(span.start, span.end), kelvin])
    };
    run.spans.iter().filter_map(reading).collect()
}

/// Ambient temperatures of the runs, relative to their median over the runs in the map; `None` if no run in the map has
/// one.
///
/// # Errors
///
/// A reason if too few runs have one, or if it varies too little over the runs.
fn ambient_temperatures(
    runs: &[&MapRun],
    points: &[RecordPoint],
) -> Result<Option<AmbientTemperatures>, String> {
    let by_run: Vec<Option<f64>> = runs.iter().map(|run| mean_ambient(run)).collect();
    let used = runs_of(points.iter().filter(|p| p.in_map));
    let known: Vec<f64> = used.iter().filter_map(|run| by_run[*run]).collect();
    let Some(usual) = median(&known) else { return Ok(None) };
    let deviation = standard_deviation(&known).unwrap_or(0.0);
    if known.len() < MIN_AMBIENT_RUNS || deviation < MIN_AMBIENT_DEVIATION_K {
        return Err(format!(
            "the ambient temperature is not used: {} runs with a standard deviation of {deviation:.1} K do not tell \
             what it does to friction ({MIN_AMBIENT_RUNS} runs and {MIN_AMBIENT_DEVIATION_K} K would)",
            known.len()
        ));
    }
    let below_usual = by_run.into_iter().map(|kelvin| below(usual, kelvin)).collect();
    Ok(Some(AmbientTemperatures { usual, below_usual }))
}

/// Mean ambient temperature of a run, K.
fn mean_ambient(run: &MapRun) -> Option<f64> {
    let kelvin: Vec<f64> = run.spans.iter().filter_map(|span| span.temperatures.ambient).collect();
    mean(&kelvin)
}

/// Usual temperature minus that of a run, K; an unknown one counts as the usual one.
fn below(usual: f64, kelvin: Option<f64>) -> f64 {
    kelvin.map_or(0.0, |kelvin| usual - kelvin)
}

#[cfg(test)]
mod tests {
    use crate::friction::maps::record::reading_at;

    #[test]
    fn between_readings_and_half_a_cycle_beyond_them_temperature_is_a_line() {
        let readings = [[150.0, 300.0], [450.0, 306.0], [750.0, 309.0]];
        for (time, kelvin) in [(150.0, 300.0), (300.0, 303.0), (600.0, 307.5), (0.0, 297.0), (900.0, 310.5)] {
            let found = reading_at(&readings, time).expect("readings");
            assert!((found - kelvin).abs() < 1e-9, "{time}: {found}");
        }
        // extrapolation by at most one distance of readings
        assert_eq!(reading_at(&readings, 1e9), Some(312.0));
        assert_eq!(reading_at(&readings[..1], 7.0), Some(300.0));
        assert_eq!(reading_at(&[], 7.0), None);
    }
}
