//! The warm friction index: friction of each run against the robot's own baseline, at equal speed and equal
//! thermal state.
//!
//! In a run, friction of joint `j` at level `l` differs from the map's by the factor `1 + w_j` (wear: at all
//! speeds alike) and by coldness that the map does not know: `ambient_j` all through the run, and what the
//! start had beyond the predicted state, which decays. Cold adds to each level by the map's own cold part,
//! wear does not: that tells them apart inside one joint. All joints stand in one hall: that tells them apart
//! between joints. Both are one least-squares problem with weak priors, solved for each run; its
//! covariance gives the intervals.

use super::level_means::friction_means;
use super::map::{Fitted, fit_map, mixed, moment_coldness, published};
use super::record::Measured;
use super::record::{JointRecord, RecordPoint};
use super::run_effects::{Effect, run_effects, start_decay};
use super::thermal_source::{first_fit, measured};
use super::thermal_state::MotionSpan;
use crate::analysis::Estimate;
use crate::analysis::friction::{FrictionIndex, FrictionMap};
use crate::numerics::friction::record::CycleMotion;
use crate::numerics::friction::record::MapRun;
use crate::numerics::statistics::descriptive::median;
use crate::robot::JointIndex;

/// Map and run effects are fitted in turn this often; the third time changes the index by less than 0.1 %.
const OUTER_ROUNDS: usize = 3;
/// Fewest points of a level in a run that count for the map: a run of fewer cycles shows too little of its own
/// warm-up for its thermal state to be told.
const MIN_POINTS_BY_RUN: usize = 6;

/// Fewest points of a level in a run that has an index: with the map given, the motion before the run tells its
/// thermal state nearly enough, and what it does not tell is in the interval.
const MIN_POINTS_OF_INDEX: usize = 2;

/// No cycle counts for more heat than this, in usual cycles: beyond it speed says little of heat.
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
/// while it warms. Runs of two to five points have no part in the map but an index by it, with a wider interval;
/// of shorter ones only the motion counts.
/// A run that overlaps the one before it counts as beginning when that ends.
#[must_use]
pub fn robot_friction(runs: &[MapRun], baseline_runs: usize) -> RobotFriction {
    let mut found = RobotFriction { indices: vec![Vec::new(); runs.len()], ..RobotFriction::default() };
    let mut joints: Vec<JointIndex> =
        runs.iter().flat_map(|run| run.points.iter().map(|p| p.joint)).collect();
    joints.sort_unstable();
    joints.dedup();
    let (spans, starts) = timeline(runs);
    let mut records = Vec::new();
    for joint in joints {
        match record(joint, runs, &spans, &starts, baseline_runs.max(2)) {
            Ok(record) => records.push(record),
            Err(reason) => found.remarks.push(reason),
        }
    }
    let mut fits: Vec<Fitted> = records.iter_mut().map(|record| first_fit(record, runs.len())).collect();
    drop_flat(&mut records, &mut fits, &mut found.remarks);
    let (mut effects, mut scales) = (Vec::new(), None);
    for round in 0..OUTER_ROUNDS {
        let (of_joints, shown) = run_effects(&records, &fits, &starts, scales.take());
        (effects, scales) = (of_joints, Some(shown));
        for (j, record) in records.iter_mut().enumerate() {
            settle(record, &fits[j], &mut effects[j], &starts, baseline_runs.max(2));
            if round + 1 < OUTER_ROUNDS {
                fits[j] = fit_map(record, Some(fits[j].law));
            }
        }
    }
    for ((record, fit), effects) in records.iter().zip(&fits).zip(&effects) {
        found.maps.extend(published(record, fit, runs.len()));
        let moments: Vec<(usize, f64)> = starts.iter().copied().enumerate().collect();
        let cold = moment_coldness(record, &fit.law, &moments);
        let raw = raw_indices(record, &baseline(effects, baseline_runs.max(2)), runs.len());
        for (run, effect) in effects.iter().enumerate().filter(|(_, effect)| effect.points > 0 && effect.told)
        {
            found.indices[run].push(FrictionIndex {
                joint: record.joint,
                index: Estimate { value: 1.0 + effect.wear, std_error: effect.variance.sqrt() },
                raw: raw[run],
                ambient: effect.ambient,
                coldness_at_start: mixed(&fit.law, cold[run]),
                points: effect.points,
                short: !effect.full,
            });
        }
    }
    found
}

/// Motion of the whole history and the start of each run, in seconds since the first run.
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

fn record(
    joint: JointIndex,
    runs: &[MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
    needed: usize,
) -> Result<JointRecord, String> {
    let mut levels: Vec<f64> = runs
        .iter()
        .flat_map(|run| &run.points)
        .filter(|p| p.joint == joint)
        .map(|p| p.speed_fraction)
        .collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    let by_level: Vec<(f64, Vec<RecordPoint>)> = levels
        .into_iter()
        .map(|level| {
            let points = runs.iter().zip(starts).enumerate().flat_map(|(run, (of_run, start))| {
                let mut means = friction_means(&of_run.points, joint, level);
                means.retain(|mean| mean.torque.is_finite() && mean.torque > 0.0);
                if means.len() < MIN_POINTS_OF_INDEX {
                    means.clear();
                }
                let in_map = means.len() >= MIN_POINTS_BY_RUN;
                means.into_iter().map(move |mean| RecordPoint {
                    run,
                    time: start + mean.time,
                    level: 0,
                    torque: mean.torque,
                    in_map,
                    offset: 0.0,
                    factor: 1.0,
                })
            });
            (level, points.collect())
        })
        .filter(|(_, points): &(f64, Vec<RecordPoint>)| points.iter().any(|p| p.in_map))
        .collect();
    let levels: Vec<f64> = by_level.iter().map(|(level, _)| *level).collect();
    let mut points: Vec<RecordPoint> = by_level
        .into_iter()
        .enumerate()
        .flat_map(|(level, (_, points))| points.into_iter().map(move |p| RecordPoint { level, ..p }))
        .collect();
    points.sort_by(|a, b| a.time.total_cmp(&b.time));
    let mut with_points: Vec<usize> = points.iter().filter(|p| p.in_map).map(|p| p.run).collect();
    with_points.sort_unstable();
    with_points.dedup();
    if with_points.len() < needed {
        return Err(format!(
            "joint {joint} has no friction map: {} runs with friction at {MIN_POINTS_BY_RUN} times or more, {needed} \
             are needed",
            with_points.len()
        ));
    }
    let (measured, remark) = measured(joint, runs, starts, &points);
    let remarks = remark.into_iter().collect();
    Ok(JointRecord { joint, spans: activities(joint, spans), levels, points, measured, remarks })
}

/// Motion of one joint: its heat is friction times speed, so to first order as many times that of its usual cycle
/// as it is faster on average. A cycle of unknown speed counts as usual.
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

/// Leaves out joints whose friction does not fall while they warm: coldness means nothing there.
fn drop_flat(records: &mut Vec<JointRecord>, fits: &mut Vec<Fitted>, remarks: &mut Vec<String>) {
    let flat =
        |fit: &Fitted| fit.cold.iter().all(|cold| *cold <= 0.0) || fit.warm.iter().any(|warm| *warm <= 0.0);
    for at in (0..records.len()).rev().filter(|&at| flat(&fits[at])).collect::<Vec<_>>() {
        let record = records.remove(at);
        fits.remove(at);
        remarks.push(format!(
            "joint {} has no friction map: its friction does not fall from cold to warm in these runs",
            record.joint
        ));
    }
}

/// The joint's first runs that are in the map and tell of wear; where none does, the first in the map.
fn baseline(effects: &[Effect], baseline_runs: usize) -> Vec<usize> {
    let first = |is_of_it: &dyn Fn(&Effect) -> bool| {
        (0..effects.len()).filter(|&run| is_of_it(&effects[run])).take(baseline_runs).collect::<Vec<usize>>()
    };
    let telling = first(&|effect| effect.full && effect.told);
    if telling.is_empty() { first(&|effect| effect.full) } else { telling }
}

/// Takes the baseline out of the effects and gives each point its run's offset and factor.
fn settle(
    record: &mut JointRecord,
    fit: &Fitted,
    effects: &mut [Effect],
    starts: &[f64],
    baseline_runs: usize,
) {
    let baseline = baseline(effects, baseline_runs);
    let n = baseline.len() as f64;
    let mean = |of: &dyn Fn(&Effect) -> f64| baseline.iter().map(|&run| of(&effects[run])).sum::<f64>() / n;
    let (wear, ambient) = (mean(&|e| e.wear), mean(&|e| e.ambient.value));
    let variance = mean(&|e| e.variance) / n;
    for (run, effect) in effects.iter_mut().enumerate() {
        // a run of the baseline is the nth part of what it is held against
        let own = if baseline.contains(&run) { 1.0 - 2.0 / n } else { 1.0 };
        effect.wear = (1.0 + effect.wear) / (1.0 + wear) - 1.0;
        effect.variance = own * effect.variance + variance;
        effect.ambient.value -= ambient;
    }
    // what a measurement does not explain stays with the points: a coefficient of the hall, or a motor's lag, has
    // nothing else to stand on, and runs would take it over in turn
    let taken = f64::from(u8::from(record.measured == Measured::Nothing));
    for p in &mut record.points {
        let effect = &effects[p.run];
        let [slow, fast] = start_decay(fit, p.time - starts[p.run]);
        p.offset = taken * (effect.ambient.value + slow * effect.start[0] + fast * effect.start[1]);
        p.factor = 1.0 + effect.wear;
    }
}

/// Friction of each run as measured, against that of the baseline: mean over levels of the ratio of mean
/// friction. What runs of equal length differ by before warmth is taken into account.
fn raw_indices(record: &JointRecord, baseline: &[usize], runs: usize) -> Vec<f64> {
    let levels = record.levels.len();
    let mut sums = vec![[0.0; 2]; runs * levels];
    for p in &record.points {
        let sum = &mut sums[p.run * levels + p.level];
        *sum = [sum[0] + p.torque, sum[1] + 1.0];
    }
    let mean = |run: usize, level: usize| {
        let [torque, count] = sums[run * levels + level];
        (count > 0.0).then(|| torque / count)
    };
    let usual: Vec<Option<f64>> = (0..levels)
        .map(|level| {
            let found: Vec<f64> = baseline.iter().filter_map(|&run| mean(run, level)).collect();
            crate::numerics::statistics::descriptive::mean(&found)
        })
        .collect();
    let raw = |run: usize| {
        let ratios: Vec<f64> =
            (0..levels).filter_map(|level| Some(mean(run, level)? / usual[level]?)).collect();
        crate::numerics::statistics::descriptive::mean(&ratios).unwrap_or(f64::NAN)
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
