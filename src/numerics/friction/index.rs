//! The warm friction index: friction of each run against the robot's own baseline, at equal speed and equal
//! thermal state.
//!
//! In a run, friction of joint `j` at level `l` differs from the map's by the factor `1 + w_j` and by a thermal
//! deficit that the map does not predict. The wear `w_j` is the same at all speeds. The deficit has a part `ambient_j`
//! that is constant through the run, and a part that was there at the start and decays. A deficit adds to each level
//! in proportion to the map's cold part, which distinguishes it from wear inside one joint. All joints are in the same
//! surroundings, which distinguishes the two between joints. For each run, all of them are the solution of one
//! least-squares problem with weak priors, see `run_effects.rs`; its covariance gives the intervals.
//!
//! Maps and priors are held ([`super::baseline`]). The index of a run therefore follows from the map, the run and the
//! motion of the [`REMEMBERED_S`] before it, and from no later run.

use super::baseline::HeldMap;
use super::level_means::friction_means;
use super::map::{FittedMap, moment_deficits};
use super::record::{CycleMotion, JointRecord, MapRun, RecordPoint};
use super::run_effects::{PriorScales, RunEffect, held_effects};
use super::thermal_source::held_sensor;
use super::thermal_state::MotionSpan;
use crate::analysis::Estimate;
use crate::analysis::friction::FrictionIndex;
use crate::numerics::statistics::descriptive::mean;
use crate::robot::JointIndex;

/// Motion longer ago than this, s, has no effect on the thermal state: a week. The slowest gearboxes cool within half
/// a day.
pub const REMEMBERED_S: f64 = 7.0 * 86_400.0;

/// Most runs of a baseline.
pub const MOST_BASELINE_RUNS: usize = 40;

/// Most runs that a map is learnt from unless the baseline has more, which bounds the work of a fit.
const MOST_LEARNT: usize = 36;

/// Fewest points of a level in a run that may be one of the baseline. A run with fewer cycles shows too little of its
/// own warm-up to determine its thermal state.
pub const FULL_RUN_POINTS: usize = 6;

/// Fewest points of a level in a run that has an index. Once the map is fitted, the motion before the run predicts
/// its thermal state well enough, and the interval contains the error of that prediction.
pub const SHORT_RUN_POINTS: usize = 2;

/// Largest activity of a cycle: for motion much faster than usual, speed predicts heat badly.
const MAX_ACTIVITY: f64 = 2.0;

/// How many full runs of a joint there are when its map is fitted: with the baseline, and again each time their number
/// has doubled. `full` is their number by now.
pub fn stages(baseline_runs: usize, full: usize) -> impl Iterator<Item = usize> {
    std::iter::successors(Some(baseline_runs.max(1)), |runs| runs.checked_mul(2))
        .take_while(move |runs| *runs <= full)
}

/// The runs that a map is learnt from when there are the full runs `full`, rising: those of the baseline, the first
/// `baseline_runs`, and as many others as the work allows, evenly spread and with the latest.
#[must_use]
pub fn learnt_runs(full: &[usize], baseline_runs: usize) -> Vec<usize> {
    let (baseline, later) = full.split_at(baseline_runs.min(full.len()));
    let room = MOST_LEARNT.saturating_sub(baseline.len()).min(later.len());
    let spread = (1..=room).map(|k| later[k * later.len() / room - 1]);
    baseline.iter().copied().chain(spread).collect()
}

/// A map that a run is compared with.
#[derive(Debug, Clone, Copy)]
pub struct Reference<'a> {
    /// The map.
    pub held: &'a HeldMap,
    /// Whether the run is one of its baseline, whose mean contains it.
    pub in_baseline: bool,
}

/// Index of each joint that has points in the run `run` and a map among `references`, which has one of each joint at
/// most. `before` are the runs that began within [`REMEMBERED_S`] before it, oldest first; of these only the motion is
/// used. A run that overlaps the one before it counts as beginning when that ends.
#[must_use]
pub fn run_indices(references: &[Reference<'_>], before: &[MapRun], run: &MapRun) -> Vec<FrictionIndex> {
    let all: Vec<&MapRun> = before.iter().chain([run]).collect();
    let (spans, starts) = timeline(&all);
    let start = [starts[before.len()]];
    let (references, records): (Vec<Reference<'_>>, Vec<JointRecord>) =
        references.iter().filter_map(|of| Some((*of, held_record(of.held, &[run], &spans, &start)?))).unzip();
    let fits: Vec<FittedMap> = references.iter().map(|of| of.held.fit.clone()).collect();
    let scales = PriorScales::held(references.iter().map(|of| (&of.held.scales, of.held.ambient_scale)));
    let effects = held_effects(&records, &fits, &start, &scales);
    let of_joint = |((of, record), effects): ((&Reference<'_>, &JointRecord), &Vec<RunEffect>)| {
        let effect = effects.first().filter(|effect| effect.points > 0 && effect.identified)?;
        Some(joint_index(*of, record, effect, start[0]))
    };
    references.iter().zip(&records).zip(&effects).filter_map(of_joint).collect()
}

/// The index of one joint, from the effects of its run.
fn joint_index(of: Reference<'_>, record: &JointRecord, effect: &RunEffect, start: f64) -> FrictionIndex {
    let Reference { held, in_baseline } = of;
    let relative = held.zero.relative(effect, in_baseline);
    let at_start = moment_deficits(record, &held.fit.law, &[(0, start)]);
    FrictionIndex {
        joint: record.joint,
        index: Estimate { value: 1.0 + relative.wear, std_error: relative.variance.sqrt() },
        raw: raw_index(record, &held.usual),
        ambient: relative.ambient,
        coldness_at_start: at_start.first().map_or(f64::NAN, |deficit| held.fit.law.mixed(*deficit)),
        points: effect.points,
        short: !effect.in_map,
    }
}

/// Record of a joint over `runs`, at the levels of its map and with the sensor that the map stands on; `None` where a
/// run lacks the temperature that the map needs.
pub(super) fn held_record(
    held: &HeldMap,
    runs: &[&MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
) -> Option<JointRecord> {
    let joint = held.map.joint;
    let levels: Vec<f64> = held.map.levels.iter().map(|level| level.speed_fraction).collect();
    let of_level =
        |(level, speed_fraction): (usize, &f64)| level_points(joint, *speed_fraction, level, runs, starts);
    let mut points: Vec<RecordPoint> = levels.iter().enumerate().flat_map(of_level).collect();
    points.sort_by(|a, b| a.time.total_cmp(&b.time));
    Some(JointRecord {
        joint,
        spans: activities(joint, spans, held.usual_speed),
        levels,
        points,
        sensor: held_sensor(&held.sensor, joint, runs, starts)?,
        remarks: Vec::new(),
    })
}

/// Motion of all runs and the start of each, in seconds since the start of the first. Motion that overlaps the motion
/// before it is cut.
pub(super) fn timeline(runs: &[&MapRun]) -> (Vec<CycleMotion>, Vec<f64>) {
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

/// Points of a joint at one speed, which has the index `level`, from the runs with enough of them.
pub(super) fn level_points(
    joint: JointIndex,
    speed_fraction: f64,
    level: usize,
    runs: &[&MapRun],
    starts: &[f64],
) -> Vec<RecordPoint> {
    let mut points = Vec::new();
    for (run, (of_run, start)) in runs.iter().zip(starts).enumerate() {
        let means = usable_means(of_run, joint, speed_fraction);
        if means.len() < SHORT_RUN_POINTS {
            continue;
        }
        let in_map = means.len() >= FULL_RUN_POINTS;
        points.extend(means.into_iter().map(|(time, torque)| RecordPoint {
            run,
            time: start + time,
            level,
            torque,
            in_map,
            offset: 0.0,
            factor: 1.0,
        }));
    }
    points
}

/// Time since the start, s, and friction, Nm, of each pass of a joint at one speed of a run.
fn usable_means(run: &MapRun, joint: JointIndex, speed_fraction: f64) -> Vec<(f64, f64)> {
    let means = friction_means(&run.points, joint, speed_fraction);
    let usable = means.into_iter().filter(|mean| mean.torque.is_finite() && mean.torque > 0.0);
    usable.map(|mean| (mean.time, mean.torque)).collect()
}

/// For each joint with friction points in a run: how many usable ones its best level has. From
/// [`FULL_RUN_POINTS`] on the run may be one of the joint's baseline, from [`SHORT_RUN_POINTS`] on it has an index.
#[must_use]
pub fn coverage(run: &MapRun) -> Vec<(JointIndex, usize)> {
    let of_joint = |joint: JointIndex| {
        let levels =
            speed_fractions(run.points.iter().filter(|p| p.joint == joint).map(|p| p.speed_fraction));
        let counts = levels.into_iter().map(|level| usable_means(run, joint, level).len());
        (joint, counts.max().unwrap_or(0))
    };
    let mut joints: Vec<JointIndex> = run.points.iter().map(|p| p.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    joints.into_iter().map(of_joint).collect()
}

/// Speeds, rising and each once.
pub(super) fn speed_fractions(recorded: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut levels: Vec<f64> = recorded.collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    levels
}

/// Motion of one joint with its activity, where `usual` is its usual mean speed in a cycle.
///
/// Heat is friction times speed. To first order it is proportional to the mean speed of a cycle, and the activity is
/// that speed as a multiple of the usual one. A cycle of unknown speed has the activity one.
pub(super) fn activities(joint: JointIndex, spans: &[CycleMotion], usual: Option<f64>) -> Vec<MotionSpan> {
    let activity = |span: &CycleMotion| match (known_speed(joint, span), usual) {
        (Some(speed), Some(usual)) => (speed / usual).min(MAX_ACTIVITY),
        _ => 1.0,
    };
    spans
        .iter()
        .map(|span| MotionSpan { start: span.start, end: span.end, activity: activity(span) })
        .collect()
}

/// Mean speed of a joint in a cycle, where it is known.
pub(super) fn known_speed(joint: JointIndex, span: &CycleMotion) -> Option<f64> {
    span.speeds.get(joint.index()).copied().filter(|speed| speed.is_finite())
}

/// Measured friction of the record's one run as a multiple of the usual friction by level: the mean over the levels of
/// the ratio of mean friction. The thermal state is not taken into account. NaN without a level in common.
fn raw_index(record: &JointRecord, usual: &[Option<f64>]) -> f64 {
    let ratios: Vec<f64> = (0..record.levels.len())
        .filter_map(|level| Some(level_mean(record, 0, level)? / usual[level]?))
        .collect();
    mean(&ratios).unwrap_or(f64::NAN)
}

/// Mean friction of a level in one run of a record, Nm; `None` without points.
pub(super) fn level_mean(record: &JointRecord, run: usize, level: usize) -> Option<f64> {
    let of_level = record.points.iter().filter(|p| p.run == run && p.level == level);
    mean(&of_level.map(|p| p.torque).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod companion_tests;

#[cfg(test)]
mod coverage_tests;

#[cfg(test)]
mod alarm_tests;

#[cfg(test)]
mod temperature_tests;
