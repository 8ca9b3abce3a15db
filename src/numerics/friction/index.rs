//! The warm friction index: friction of each run against the robot's own baseline, at equal speed and equal
//! thermal state.
//!
//! In a run, friction of joint `j` at level `l` differs from the map's by the factor `1 + w_j` and by a thermal
//! deficit that the map does not predict. The wear `w_j` is the same at all speeds. The deficit has a part `ambient_j`
//! that is constant through the run, and a part that was there at the start and decays. A deficit adds to each level
//! in proportion to the map's cold part, which distinguishes it from wear inside one joint. All joints are in the same
//! surroundings, which distinguishes the two between joints. For each run, all of them are the solution of one
//! least-squares problem with weak priors, see `run_effects.rs`; its covariance gives the intervals.

use super::level_means::friction_means;
use super::map::{FittedMap, fit_map, moment_deficits, published};
use super::record::{CycleMotion, JointRecord, MapRun, RecordPoint, ThermalSensor, runs_of};
use super::run_effects::{RunEffect, run_effects, start_decay};
use super::thermal_source::{first_fit, thermal_sensor};
use super::thermal_state::MotionSpan;
use crate::analysis::Estimate;
use crate::analysis::friction::{FrictionIndex, FrictionMap};
use crate::numerics::statistics::descriptive::{mean, median};
use crate::robot::JointIndex;

/// Rounds in which run effects and maps are fitted in turn; the third changes the index by less than 0.1 %.
const OUTER_ROUNDS: usize = 3;
/// Fewest points of a level in a run that enter the map. A run with fewer cycles shows too little of its own warm-up
/// to determine its thermal state.
const MIN_POINTS_BY_RUN: usize = 6;

/// Fewest points of a level in a run that has an index. Once the map is fitted, the motion before the run predicts
/// its thermal state well enough, and the interval contains the error of that prediction.
const MIN_POINTS_OF_INDEX: usize = 2;

/// Fewest runs of a baseline.
const MIN_BASELINE_RUNS: usize = 2;

/// Largest activity of a cycle: for motion much faster than usual, speed predicts heat badly.
const MAX_ACTIVITY: f64 = 2.0;

/// Friction of a robot over its history.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RobotFriction {
    /// One map for each joint that has one.
    pub maps: Vec<FrictionMap>,
    /// For each run, in the given order: one index for each joint with a map and points in that run.
    pub indices: Vec<Vec<FrictionIndex>>,
    /// Why a joint has no map, in sentences.
    pub remarks: Vec<String>,
}

/// Fits the maps of all joints over all runs, oldest first, and the index of each run against the first
/// `baseline_runs` runs of its joint.
///
/// A joint needs `baseline_runs` runs (two at least) with six points or more at a level, and friction that falls
/// while it warms. Runs of two to five points do not enter the map; they still get an index, with a wider interval.
/// Of shorter runs only the motion is used.
/// A run that overlaps the one before it counts as beginning when that ends.
#[must_use]
pub fn robot_friction(runs: &[MapRun], baseline_runs: usize) -> RobotFriction {
    let baseline_runs = baseline_runs.max(MIN_BASELINE_RUNS);
    let mut found = RobotFriction { indices: vec![Vec::new(); runs.len()], ..RobotFriction::default() };
    let (spans, starts) = timeline(runs);
    let mut records = Vec::new();
    for joint in joints_of(runs) {
        match record(joint, runs, &spans, &starts, baseline_runs) {
            Ok(record) => records.push(record),
            Err(reason) => found.remarks.push(reason),
        }
    }
    let mut fits: Vec<FittedMap> = records.iter_mut().map(|record| first_fit(record, runs.len())).collect();
    drop_flat(&mut records, &mut fits, &mut found.remarks);
    let effects = fit_in_turn(&mut records, &mut fits, &starts, baseline_runs);
    for ((record, fit), effects) in records.iter().zip(&fits).zip(&effects) {
        found.maps.extend(published(record, fit, runs.len()));
        for (run, index) in joint_indices(record, fit, effects, &starts, baseline_runs) {
            found.indices[run].push(index);
        }
    }
    found
}

/// Joints with friction points, rising and each once.
fn joints_of(runs: &[MapRun]) -> Vec<JointIndex> {
    let mut joints: Vec<JointIndex> =
        runs.iter().flat_map(|run| run.points.iter().map(|p| p.joint)).collect();
    joints.sort_unstable();
    joints.dedup();
    joints
}

/// Fits run effects and maps in turn, since each needs the other; run effects relative to the baseline, by joint.
fn fit_in_turn(
    records: &mut [JointRecord],
    fits: &mut [FittedMap],
    starts: &[f64],
    baseline_runs: usize,
) -> Vec<Vec<RunEffect>> {
    let (mut effects, mut scales) = (Vec::new(), None);
    for round in 0..OUTER_ROUNDS {
        let (of_joints, estimated) = run_effects(records, fits, starts, scales.take());
        (effects, scales) = (of_joints, Some(estimated));
        for ((record, fit), effects) in records.iter_mut().zip(&mut *fits).zip(&mut effects) {
            subtract_baseline(effects, baseline_runs);
            apply_effects(record, fit, effects, starts);
            if round + 1 < OUTER_ROUNDS {
                *fit = fit_map(record, Some(fit.law));
            }
        }
    }
    effects
}

/// Indices of a joint, each with its run: runs with points whose wear the data determine.
fn joint_indices(
    record: &JointRecord,
    fit: &FittedMap,
    effects: &[RunEffect],
    starts: &[f64],
    baseline_runs: usize,
) -> Vec<(usize, FrictionIndex)> {
    let moments: Vec<(usize, f64)> = starts.iter().copied().enumerate().collect();
    let at_start = moment_deficits(record, &fit.law, &moments);
    let raw = raw_indices(record, &baseline(effects, baseline_runs), starts.len());
    let index = |run: usize, effect: &RunEffect| FrictionIndex {
        joint: record.joint,
        index: Estimate { value: 1.0 + effect.wear, std_error: effect.variance.sqrt() },
        raw: raw[run],
        ambient: effect.ambient,
        coldness_at_start: fit.law.mixed(at_start[run]),
        points: effect.points,
        short: !effect.in_map,
    };
    let with_index = |(_, effect): &(usize, &RunEffect)| effect.points > 0 && effect.identified;
    effects.iter().enumerate().filter(with_index).map(|(run, effect)| (run, index(run, effect))).collect()
}

/// Motion of the whole history and the start of each run, in seconds since the first run. Motion that overlaps the
/// motion before it is cut.
fn timeline(runs: &[MapRun]) -> (Vec<CycleMotion>, Vec<f64>) {
    let epoch = runs.first().map_or(0.0, |run| run.started_at);
    let (mut spans, mut end) = (Vec::new(), f64::NEG_INFINITY);
    for run in runs {
        let from = run.started_at - epoch;
        for span in &run.spans {
            let (start, stop) = ((span.start + from).max(end), span.end + from);
            if stop > start {
                spans.push(CycleMotion { start, end: stop, ..span.clone() });
                end = stop;
            }
        }
    }
    (spans, runs.iter().map(|run| run.started_at - epoch).collect())
}

/// Record of a joint.
///
/// # Errors
///
/// A sentence if fewer than `needed` runs have points that enter the map.
fn record(
    joint: JointIndex,
    runs: &[MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
    needed: usize,
) -> Result<JointRecord, String> {
    let (levels, points) = points_by_level(joint, runs, starts);
    let in_map = runs_of(points.iter().filter(|p| p.in_map));
    if in_map.len() < needed {
        return Err(format!(
            "joint {joint} has no friction map: {} runs with friction at {MIN_POINTS_BY_RUN} times or more, {needed} \
             are needed",
            in_map.len()
        ));
    }
    let (sensor, remark) = thermal_sensor(joint, runs, starts, &points);
    let remarks = remark.into_iter().collect();
    Ok(JointRecord { joint, spans: activities(joint, spans), levels, points, sensor, remarks })
}

/// Speed levels of a joint with points that enter the map, and all points at these levels in the order of time.
fn points_by_level(joint: JointIndex, runs: &[MapRun], starts: &[f64]) -> (Vec<f64>, Vec<RecordPoint>) {
    let of_joint = runs.iter().flat_map(|run| &run.points).filter(|p| p.joint == joint);
    let mut recorded: Vec<f64> = of_joint.map(|p| p.speed_fraction).collect();
    recorded.sort_by(f64::total_cmp);
    recorded.dedup();
    let (mut levels, mut points) = (Vec::new(), Vec::new());
    for speed_fraction in recorded {
        let of_level = level_points(joint, speed_fraction, levels.len(), runs, starts);
        if of_level.iter().any(|p| p.in_map) {
            levels.push(speed_fraction);
            points.extend(of_level);
        }
    }
    points.sort_by(|a: &RecordPoint, b| a.time.total_cmp(&b.time));
    (levels, points)
}

/// Points of a joint at one speed, which has the index `level`, from the runs with enough of them.
fn level_points(
    joint: JointIndex,
    speed_fraction: f64,
    level: usize,
    runs: &[MapRun],
    starts: &[f64],
) -> Vec<RecordPoint> {
    let mut points = Vec::new();
    for (run, (of_run, start)) in runs.iter().zip(starts).enumerate() {
        let mut means = friction_means(&of_run.points, joint, speed_fraction);
        means.retain(|mean| mean.torque.is_finite() && mean.torque > 0.0);
        if means.len() < MIN_POINTS_OF_INDEX {
            continue;
        }
        let in_map = means.len() >= MIN_POINTS_BY_RUN;
        points.extend(means.into_iter().map(|mean| RecordPoint {
            run,
            time: start + mean.time,
            level,
            torque: mean.torque,
            in_map,
            offset: 0.0,
            factor: 1.0,
        }));
    }
    points
}

/// Motion of one joint with its activity.
///
/// Heat is friction times speed. To first order it is proportional to the mean speed of a cycle, and the activity is
/// that speed as a multiple of the median one. A cycle of unknown speed has the activity one.
fn activities(joint: JointIndex, spans: &[CycleMotion]) -> Vec<MotionSpan> {
    let speed =
        |span: &CycleMotion| span.speeds.get(joint.index()).copied().filter(|speed| speed.is_finite());
    let known: Vec<f64> = spans.iter().filter_map(speed).filter(|speed| *speed > 0.0).collect();
    let usual = median(&known);
    let activity = |span: &CycleMotion| match (speed(span), usual) {
        (Some(speed), Some(usual)) => (speed / usual).min(MAX_ACTIVITY),
        _ => 1.0,
    };
    spans
        .iter()
        .map(|span| MotionSpan { start: span.start, end: span.end, activity: activity(span) })
        .collect()
}

/// Removes joints whose friction does not fall while they warm: a thermal deficit has no effect on them.
fn drop_flat(records: &mut Vec<JointRecord>, fits: &mut Vec<FittedMap>, remarks: &mut Vec<String>) {
    let flat = |fit: &FittedMap| {
        fit.cold.iter().all(|cold| *cold <= 0.0) || fit.warm.iter().any(|warm| *warm <= 0.0)
    };
    for at in (0..records.len()).rev().filter(|&at| flat(&fits[at])).collect::<Vec<_>>() {
        let record = records.remove(at);
        fits.remove(at);
        remarks.push(format!(
            "joint {} has no friction map: its friction does not fall from cold to warm in these runs",
            record.joint
        ));
    }
}

/// The joint's first runs that enter the map and whose wear is identified; if there is none, the first that enter
/// the map.
fn baseline(effects: &[RunEffect], baseline_runs: usize) -> Vec<usize> {
    let first = |belongs: &dyn Fn(&RunEffect) -> bool| {
        (0..effects.len()).filter(|&run| belongs(&effects[run])).take(baseline_runs).collect::<Vec<usize>>()
    };
    let identified = first(&|effect| effect.in_map && effect.identified);
    if identified.is_empty() { first(&|effect| effect.in_map) } else { identified }
}

/// Makes wear and ambient effect relative to their means over the baseline: `(1 + w) / (1 + mean w) - 1`.
///
/// The variance `v` becomes `v + mean v / n` for a baseline of `n` runs, and `(1 - 2 / n) v + mean v / n` for a run
/// that is one of them, because its own effect is the `n`th part of the mean.
fn subtract_baseline(effects: &mut [RunEffect], baseline_runs: usize) {
    let baseline = baseline(effects, baseline_runs);
    let n = baseline.len() as f64;
    let mean =
        |of: &dyn Fn(&RunEffect) -> f64| baseline.iter().map(|&run| of(&effects[run])).sum::<f64>() / n;
    let (wear, ambient) = (mean(&|e| e.wear), mean(&|e| e.ambient.value));
    let variance = mean(&|e| e.variance) / n;
    for (run, effect) in effects.iter_mut().enumerate() {
        let own = if baseline.contains(&run) { 1.0 - 2.0 / n } else { 1.0 };
        effect.wear = (1.0 + effect.wear) / (1.0 + wear) - 1.0;
        effect.variance = own * effect.variance + variance;
        effect.ambient.value -= ambient;
    }
}

/// Gives each point the offset and the factor of its run, for the next fit of the map.
///
/// With a sensor the offset stays zero: the ambient coefficient and the fast part beside a motor's temperature have
/// to explain such offsets, and would lose them to the run effects round by round.
fn apply_effects(record: &mut JointRecord, fit: &FittedMap, effects: &[RunEffect], starts: &[f64]) {
    let with_offset = f64::from(u8::from(record.sensor == ThermalSensor::None));
    for p in &mut record.points {
        let effect = &effects[p.run];
        let [slow, fast] = start_decay(fit, p.time - starts[p.run]);
        p.offset = with_offset * (effect.ambient.value + slow * effect.start[0] + fast * effect.start[1]);
        p.factor = 1.0 + effect.wear;
    }
}

/// Measured friction of each run as a multiple of that of the baseline: the mean over the levels of the ratio of mean
/// friction. The thermal state is not taken into account. NaN for a run without a level of the baseline.
fn raw_indices(record: &JointRecord, baseline: &[usize], runs: usize) -> Vec<f64> {
    let levels = record.levels.len();
    let mut sums = vec![[0.0; 2]; runs * levels];
    for p in &record.points {
        let sum = &mut sums[p.run * levels + p.level];
        *sum = [sum[0] + p.torque, sum[1] + 1.0];
    }
    let of_run = |run: usize, level: usize| {
        let [torque, count] = sums[run * levels + level];
        (count > 0.0).then(|| torque / count)
    };
    let usual: Vec<Option<f64>> = (0..levels)
        .map(|level| {
            let found: Vec<f64> = baseline.iter().filter_map(|&run| of_run(run, level)).collect();
            mean(&found)
        })
        .collect();
    let raw = |run: usize| {
        let ratios: Vec<f64> =
            (0..levels).filter_map(|level| Some(of_run(run, level)? / usual[level]?)).collect();
        mean(&ratios).unwrap_or(f64::NAN)
    };
    (0..runs).map(raw).collect()
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod coverage_tests;

#[cfg(test)]
mod alarm_tests;

#[cfg(test)]
mod temperature_tests;
