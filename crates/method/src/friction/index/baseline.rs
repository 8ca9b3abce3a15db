//! Friction maps for the computation of indices: fitted once and held.
//!
//! A map and the thermal effects of its runs (`run_effects.rs`) are fitted alternately, since each needs the other.
//! Wear is then relative to the mean of the baseline's runs, which has the index one. A map may be learnt from more
//! runs than the baseline, which contain more information about warm-up and ambient temperature. This does not change
//! the reference for wear.
//!
//! After maintenance of one joint, only that joint has a new baseline. The maps of the other joints remain held. As
//! *companions* they show the ambient temperature of each run, and the ambient effect of the new map has the same
//! reference as theirs.

use super::held_map::{HeldMap, Zero, held_record};
use super::run_record::{
    SpeedLevel, activities, known_speed, level_mean, level_points, mean_load, speed_fractions, timeline,
};
use crate::friction::maps::map::{FittedMap, fit_map};
use crate::friction::maps::published_map::published;
use crate::friction::maps::record::{JointRecord, RecordPoint, ThermalSensor, runs_of};
use crate::friction::maps::run_effects::{JointScales, PriorScales, RunEffect, run_effects};
use crate::friction::maps::run_points::start_decay;
use crate::friction::maps::thermal_source::{first_fit, thermal_sensor};
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};
use armwatch_model::anomaly::baseline_runs::FULL_RUN_POINTS;
use armwatch_model::robot::JointIndex;

/// Number of alternate fits of run effects and maps; the third changes the index by less than 0.1 %.
const OUTER_ROUNDS: usize = 3;

/// Maps of joints with one baseline.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FormedMaps {
    /// Maps of the joints that have one.
    pub maps: Vec<HeldMap>,
    /// Reasons why joints have no map, in sentences.
    pub remarks: Vec<(JointIndex, String)>,
}

/// Fits the maps of `joints`, which have one baseline.
///
/// `runs` are all runs whose motion matters, oldest first. Maps are learnt from those at the positions `learnt`. The
/// first `baseline_runs` of these are the baseline and need friction at [`FULL_RUN_POINTS`] times or more. Only the
/// motion of the other runs is used. `companions` are maps of other joints that are held over all learnt runs.
#[must_use]
pub fn fit_maps(
    joints: &[JointIndex],
    companions: &[&HeldMap],
    runs: &[MapRun],
    learnt: &[usize],
    baseline_runs: usize,
) -> FormedMaps {
    let mut found = FormedMaps::default();
    let all: Vec<&MapRun> = runs.iter().collect();
    let (spans, all_starts) = timeline(&all);
    let starts: Vec<f64> = learnt.iter().map(|run| all_starts[*run]).collect();
    let runs: Vec<&MapRun> = learnt.iter().map(|run| &runs[*run]).collect();
    let first_runs = &runs[..baseline_runs.min(runs.len())];
    let mut records = Vec::new();
    for joint in joints {
        match record(*joint, &runs, &spans, &starts, baseline_runs) {
            Ok(record) => records.push(record),
            Err(reason) => found.remarks.push((*joint, reason)),
        }
    }
    let mut fits: Vec<FittedMap> = records.iter_mut().map(|record| first_fit(record, runs.len())).collect();
    drop_flat(&mut records, &mut fits, &mut found.remarks);
    let own = records.len();
    let mut held = vec![None; own];
    for companion in companions {
        if let Some(record) = held_record(companion, &runs, &spans, &starts) {
            records.push(record);
            fits.push(companion.fit.clone());
            held.push(Some(&companion.scales));
        }
    }
    let (zeros, scales) =
        fit_in_turn(&mut records, &mut fits, &starts, &BaselineFit { own, baseline_runs, held });
    for (at, record) in records.iter().take(own).enumerate() {
        let Some(map) = published(record, &fits[at], runs.len()) else {
            let words = "has no friction map: the runs of its baseline do not determine one";
            found.remarks.push((record.joint, format!("joint {} {words}", record.joint)));
            continue;
        };
        found.maps.push(HeldMap {
            map,
            fit: fits[at].clone(),
            sensor: record.sensor.without_readings(),
            usual_speed: usual_speed(record.joint, &spans),
            scales: scales.of_joint(at),
            ambient_scale: scales.ambient(),
            zero: zeros[at].clone(),
            usual: usual_friction(record, baseline_runs),
            loads: record.levels.iter().map(|level| mean_load(first_runs, record.joint, *level)).collect(),
        });
    }
    found
}

/// Effects of the runs of a baseline on one joint, and their reference.
struct JointEffects {
    effects: Vec<RunEffect>,
    zero: Zero,
}

/// Records in a fit and their reference.
struct BaselineFit<'a> {
    /// Number of the joints' own records, which are the first; the others are companions with held maps and scales.
    own: usize,
    /// Number of runs in the baseline, which are the first.
    baseline_runs: usize,
    /// Scales of companions by record.
    held: Vec<Option<&'a JointScales>>,
}

/// Fits run effects and maps alternately. Returns the reference of each own joint's effects, and the scales.
fn fit_in_turn(
    records: &mut [JointRecord],
    fits: &mut [FittedMap],
    starts: &[f64],
    turn: &BaselineFit<'_>,
) -> (Vec<Zero>, PriorScales) {
    let BaselineFit { own, baseline_runs, held } = turn;
    let (own, alone) = (*own, *own == records.len());
    let of_joint = |effects: Vec<RunEffect>| {
        let zero = Zero::of(&effects[..(*baseline_runs).min(effects.len())]);
        // with companions, they determine the reference of the ambient effect
        let zero = if alone { zero } else { zero.with_ambient(0.0) };
        JointEffects { effects, zero }
    };
    let mut scales = None;
    for _ in 1..OUTER_ROUNDS {
        let (effects, estimated) = run_effects(records, fits, starts, scales.take(), held);
        scales = Some(estimated);
        let of_own = records.iter_mut().zip(&mut *fits).zip(effects).take(own);
        for ((record, fit), effects) in of_own {
            apply_effects(record, fit, &of_joint(effects), starts);
            *fit = fit_map(record, Some(fit.law));
        }
    }
    let (effects, scales) = run_effects(records, fits, starts, scales, held);
    (effects.into_iter().take(own).map(|effects| of_joint(effects).zero).collect(), scales)
}

/// Record of a joint.
///
/// # Errors
///
/// A sentence if not all runs of the baseline have points that enter the map.
fn record(
    joint: JointIndex,
    runs: &[&MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
    baseline_runs: usize,
) -> Result<JointRecord, String> {
    let (levels, points) = points_by_level(joint, runs, starts, baseline_runs);
    let mut full = runs_of(points.iter().filter(|p| p.in_map));
    full.retain(|run| *run < baseline_runs);
    if full.is_empty() || full.len() < baseline_runs {
        return Err(format!(
            "joint {joint} has no friction map: {} runs with friction at {FULL_RUN_POINTS} times or more, \
             {baseline_runs} are needed",
            full.len()
        ));
    }
    let (sensor, remark) = thermal_sensor(joint, runs, starts, &points);
    let remarks = remark.into_iter().collect();
    let spans = activities(joint, spans, usual_speed(joint, spans));
    Ok(JointRecord { joint, spans, levels, points, sensor, remarks })
}

/// Speed levels of a joint with points that enter the map, and all points at these levels in the order of time.
fn points_by_level(
    joint: JointIndex,
    runs: &[&MapRun],
    starts: &[f64],
    baseline_runs: usize,
) -> (Vec<f64>, Vec<RecordPoint>) {
    let first_runs = &runs[..baseline_runs.min(runs.len())];
    let of_joint = runs.iter().flat_map(|run| &run.points).filter(|p| p.joint == joint);
    let (mut levels, mut points) = (Vec::new(), Vec::new());
    for speed_fraction in speed_fractions(of_joint.map(|p| p.speed_fraction)) {
        let load = mean_load(first_runs, joint, speed_fraction);
        let of_level =
            level_points(joint, SpeedLevel { place: levels.len(), speed_fraction, load }, runs, starts);
        if of_level.iter().any(|p| p.in_map) {
            levels.push(speed_fraction);
            points.extend(of_level);
        }
    }
    points.sort_by(|a: &RecordPoint, b| a.time.total_cmp(&b.time));
    (levels, points)
}

/// Median of the mean speed of a joint over the cycles with motion of this joint.
fn usual_speed(joint: JointIndex, spans: &[CycleMotion]) -> Option<f64> {
    let known = spans.iter().filter_map(|span| known_speed(joint, span));
    median(&known.filter(|speed| *speed > 0.0).collect::<Vec<f64>>())
}

/// Removes joints whose friction does not fall while they warm, because a thermal deficit has no effect on them.
fn drop_flat(
    records: &mut Vec<JointRecord>,
    fits: &mut Vec<FittedMap>,
    remarks: &mut Vec<(JointIndex, String)>,
) {
    let flat = |fit: &FittedMap| {
        fit.cold.iter().all(|cold| *cold <= 0.0) || fit.warm.iter().any(|warm| *warm <= 0.0)
    };
    for at in (0..records.len()).rev().filter(|&at| flat(&fits[at])).collect::<Vec<_>>() {
        let joint = records.remove(at).joint;
        fits.remove(at);
        let words = "has no friction map: its friction does not fall from cold to warm in these runs";
        remarks.push((joint, format!("joint {joint} {words}")));
    }
}

/// Assigns each point the offset and the factor of its run, for the next fit of the map.
///
/// The offset remains zero if there is a sensor. The ambient coefficient, or the fast part in addition to a motor's
/// temperature, must explain such offsets; otherwise the run effects would absorb them round by round.
fn apply_effects(record: &mut JointRecord, fit: &FittedMap, of: &JointEffects, starts: &[f64]) {
    let with_offset = f64::from(u8::from(record.sensor == ThermalSensor::None));
    for p in &mut record.points {
        let effect = &of.effects[p.run];
        let relative = of.zero.relative(effect, true);
        let [slow, fast] = start_decay(fit, p.time - starts[p.run]);
        p.offset = with_offset * (relative.ambient.value + slow * effect.start[0] + fast * effect.start[1]);
        p.factor = of.zero.factor(effect, p.level);
    }
}

/// Mean over the first `runs` runs of the measured mean friction at each level, Nm.
fn usual_friction(record: &JointRecord, runs: usize) -> Vec<Option<f64>> {
    let of_level = |level: usize| {
        let found: Vec<f64> = (0..runs).filter_map(|run| level_mean(record, run, level)).collect();
        mean(&found)
    };
    (0..record.levels.len()).map(of_level).collect()
}
