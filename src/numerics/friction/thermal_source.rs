//! What is known of a joint's thermal state beside its motion: the temperature of its motor, or of the hall.
//!
//! A motor's temperature takes the place of the slow part of coldness: where it is measured, nobody has to guess
//! how the joint heats in motion and cools at rest. What a sensor in a motor does not show (the heat between teeth and
//! housing, the motor's own) stays as a fast part that follows the motion. A hall's temperature is an offset of
//! coldness, as many times a coefficient as it is below the usual.

use super::map::{Fitted, fit_map, hall_coldness};
use super::record::{CycleMotion, MapRun};
use super::record::{JointRecord, RecordPoint};
use crate::numerics::friction::record::Hall;
use crate::numerics::friction::record::Measured;
use crate::numerics::friction::record::MotorScale;
use crate::numerics::friction::record::reading_at;
use crate::numerics::statistics::descriptive::{mean, median, standard_deviation};
use crate::robot::JointIndex;
use crate::run::temperature::ZERO_CELSIUS;

/// Least part of a run's cycles that must have the motor's temperature: between them it is a line.
const LEAST_CYCLES: f64 = 0.5;

/// Least range of a motor's temperature over the history, K. Friction of a gearbox changes by 1 to 3 % a kelvin, so
/// that less shows little, and steps of 1 K would be coarse in it. A stuck sensor has none.
const LEAST_RANGE_K: f64 = 5.0;

/// Parts of the points that are colder and warmer than what the scale goes by: ends of single readings count little.
const TAIL: f64 = 0.05;

/// Fewest runs with the hall's temperature for a coefficient of it, and least standard deviation over them, K: a
/// sensor's own errors are some tenths.
const LEAST_HALLS: usize = 5;
const LEAST_HALL_DEVIATION_K: f64 = 1.0;

/// A motor's temperature is left out if it leaves more than twice what motion leaves, and more than this part of what
/// friction varies by. One that lags leaves less; one that has nothing to do with the joint leaves nearly all.
const MOST_WORSE: f64 = 2.0;
const MOST_LEFT: f64 = 0.4;

/// A coefficient of the hall is used from as many standard errors on.
const LEAST_ERRORS: f64 = 2.0;

/// What is to be used for a joint with these points; and why something recorded is not, as a sentence.
pub(super) fn measured(
    joint: JointIndex,
    runs: &[MapRun],
    starts: &[f64],
    points: &[RecordPoint],
) -> (Measured, Option<String>) {
    match motor_scale(joint, runs, starts, points) {
        Ok(Some(scale)) => (Measured::Motor(scale), None),
        Ok(None) => match hall(runs, points) {
            Ok(Some(hall)) => (Measured::Hall(hall), None),
            Ok(None) => (Measured::Nothing, None),
            Err(reason) => (Measured::Nothing, Some(format!("joint {joint}: {reason}"))),
        },
        Err(reason) => {
            let measured = hall(runs, points).ok().flatten().map_or(Measured::Nothing, Measured::Hall);
            (measured, Some(format!("joint {joint}: {reason}")))
        }
    }
}

/// Fits the map of a record for the first time, and leaves out a measurement that friction contradicts: a motor's
/// temperature that leaves far more than motion alone would, a hall whose coefficient is not told from none.
pub(super) fn first_fit(record: &mut JointRecord, runs: usize) -> Fitted {
    let fit = fit_map(record, None);
    let reason = match &record.measured {
        Measured::Nothing => None,
        Measured::Motor(_) => {
            let by_motion = fit_map(&JointRecord { measured: Measured::Nothing, ..record.clone() }, None);
            (fit.rms > MOST_WORSE * by_motion.rms && fit.rms > MOST_LEFT * variation(record)).then(|| {
                format!(
                    "its motor temperature does not go with its friction (it leaves {:.1} %, motion {:.1} %): the \
                     sensor of another joint? The thermal state follows from motion",
                    100.0 * fit.rms,
                    100.0 * by_motion.rms
                )
            })
        }
        Measured::Hall(_) => hall_coldness(record, &fit, runs)
            .filter(|found| found.value < LEAST_ERRORS * found.std_error)
            .map(|_| {
                "the ambient temperature is not used: friction does not tell that it matters".to_owned()
            }),
    };
    let Some(reason) = reason else { return fit };
    record.measured = Measured::Nothing;
    record.remarks.push(format!("joint {}: {reason}", record.joint));
    fit_map(record, None)
}

/// Root-mean-square by which friction in the map differs from its level's mean, as a fraction of that.
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

/// The scale of the joint's motor temperature, if every run with points has it.
fn motor_scale(
    joint: JointIndex,
    runs: &[MapRun],
    starts: &[f64],
    points: &[RecordPoint],
) -> Result<Option<MotorScale>, String> {
    let readings: Vec<Vec<[f64; 2]>> =
        runs.iter().zip(starts).map(|(run, start)| motor_readings(joint, run, *start)).collect();
    let mut used: Vec<usize> = points.iter().map(|p| p.run).collect();
    used.sort_unstable();
    used.dedup();
    let has = |run: &&usize| {
        readings[**run].len() as f64 >= (LEAST_CYCLES * runs[**run].spans.len() as f64).max(1.0)
    };
    let with = used.iter().filter(has).count();
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
    let at = |share: f64| kelvin[((kelvin.len() - 1) as f64 * share).round() as usize];
    let (cold, warm) = (at(TAIL), at(1.0 - TAIL));
    if warm - cold < LEAST_RANGE_K {
        return Err(format!(
            "its motor temperature moves by {:.1} K only over the runs (about {:.1} degC), which tells nothing of the \
             gearbox; the thermal state follows from motion",
            warm - cold,
            cold - ZERO_CELSIUS
        ));
    }
    Ok(Some(MotorScale { warm, cold, readings }))
}

/// Mean temperatures of the joint's motor by cycle, with the cycle's middle since the epoch, s.
fn motor_readings(joint: JointIndex, run: &MapRun, start: f64) -> Vec<[f64; 2]> {
    let reading = |span: &CycleMotion| {
        let kelvin = span.temperatures.motor.get(joint.index()).copied().flatten()?;
        Some([start + f64::midpoint(span.start, span.end), kelvin])
    };
    run.spans.iter().filter_map(reading).collect()
}

/// The hall in the runs of the points.
fn hall(runs: &[MapRun], points: &[RecordPoint]) -> Result<Option<Hall>, String> {
    let by_run: Vec<Option<f64>> = runs
        .iter()
        .map(|run| {
            let kelvin: Vec<f64> = run.spans.iter().filter_map(|span| span.temperatures.ambient).collect();
            mean(&kelvin)
        })
        .collect();
    let mut used: Vec<usize> = points.iter().filter(|p| p.in_map).map(|p| p.run).collect();
    used.sort_unstable();
    used.dedup();
    let known: Vec<f64> = used.iter().filter_map(|run| by_run[*run]).collect();
    let Some(usual) = median(&known) else { return Ok(None) };
    let deviation = standard_deviation(&known).unwrap_or(0.0);
    if known.len() < LEAST_HALLS || deviation < LEAST_HALL_DEVIATION_K {
        return Err(format!(
            "the ambient temperature is not used: {} runs with a standard deviation of {deviation:.1} K do not tell \
             what it does to friction ({LEAST_HALLS} runs and {LEAST_HALL_DEVIATION_K} K would)",
            known.len()
        ));
    }
    let colder = by_run.iter().map(|kelvin| kelvin.map_or(0.0, |kelvin| usual - kelvin)).collect();
    Ok(Some(Hall { usual, colder }))
}

#[cfg(test)]
mod tests {

    use crate::numerics::friction::record::reading_at;
    #[test]
    fn between_readings_and_half_a_cycle_beyond_them_temperature_is_a_line() {
        let readings = [[150.0, 300.0], [450.0, 306.0], [750.0, 309.0]];
        for (time, kelvin) in [(150.0, 300.0), (300.0, 303.0), (600.0, 307.5), (0.0, 297.0), (900.0, 310.5)] {
            let found = reading_at(&readings, time).expect("readings");
            assert!((found - kelvin).abs() < 1e-9, "{time}: {found}");
        }
        // far away nothing grows without end
        assert_eq!(reading_at(&readings, 1e9), Some(312.0));
        assert_eq!(reading_at(&readings[..1], 7.0), Some(300.0));
        assert_eq!(reading_at(&[], 7.0), None);
    }
}
