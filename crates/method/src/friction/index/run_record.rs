//! Friction of one joint in a run: points by level, motion with its activity, and coverage for a baseline or an index.

use super::jump::jump;
use crate::friction::maps::record::{JointRecord, RecordPoint};
use crate::friction::maps::thermal_state::MotionSpan;
use crate::friction::points::level_means::{at_level, friction_means};
use crate::statistics::descriptive::mean;
use armwatch_model::analysis::CarriedLoad;
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};
use armwatch_model::anomaly::baseline_runs::FULL_RUN_POINTS;
use armwatch_model::robot::JointIndex;

/// Smallest number of points of a level in a run that has an index. Once the map is fitted, the motion before the run
/// predicts its thermal state well enough, and the interval contains the error of that prediction.
pub const SHORT_RUN_POINTS: usize = 2;

/// Largest activity of a cycle: for motion much faster than usual, speed is a poor measure of heat.
const MAX_ACTIVITY: f64 = 2.0;

/// Motion of all runs and the start of each, in seconds since the start of the first. Motion that overlaps earlier
/// motion is cut.
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

/// Speed level of a map.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpeedLevel {
    /// Index among the levels of the map.
    pub place: usize,
    /// Nominal speed as a fraction of the joint's largest speed.
    pub speed_fraction: f64,
    /// Load for comparisons of friction, Nm (N), if friction depends on it.
    pub load: Option<f64>,
}

/// Points of a joint at one speed, at the load of the level, from the runs with enough of them. Points before a jump
/// within a run are scaled to the friction after it.
pub(super) fn level_points(
    joint: JointIndex,
    level: SpeedLevel,
    runs: &[&MapRun],
    starts: &[f64],
) -> Vec<RecordPoint> {
    let speed_fraction = level.speed_fraction;
    let mut points = Vec::new();
    for (run, (of_run, start)) in runs.iter().zip(starts).enumerate() {
        let means = usable_means(of_run, joint, speed_fraction);
        if means.len() < SHORT_RUN_POINTS {
            continue;
        }
        let in_map = means.len() >= FULL_RUN_POINTS;
        let to_load = level.load.map_or(0.0, |load| load_difference(of_run, joint, speed_fraction, load));
        let jump = jump(of_run, joint, &run_levels(of_run, joint));
        points.extend(means.into_iter().map(|(time, torque)| {
            let jump = jump.map_or(1.0, |jump| jump.factor(time));
            RecordPoint {
                run,
                time: start + time,
                level: level.place,
                torque: (torque + to_load) * jump,
                jump,
                in_map,
                offset: 0.0,
                factor: 1.0,
            }
        }));
    }
    points
}

/// Mean load, Nm (N), of the gear of a joint at one speed over the points of these runs; `None` if friction does not
/// depend on it.
pub(super) fn mean_load(runs: &[&MapRun], joint: JointIndex, speed_fraction: f64) -> Option<f64> {
    let points = runs.iter().flat_map(|run| at_level(&run.points, joint, speed_fraction));
    mean(&points.filter_map(|point| Some(point.load?.torque)).collect::<Vec<f64>>())
}

/// Additional loss of the gear if it carried `load`, Nm (N), in this run.
///
/// It is `m (load - L)`. The load torque `L` and the friction `m` per load torque are means over the points of the
/// level, since a single cycle determines neither as well. Exact if friction is proportional to the load.
fn load_difference(run: &MapRun, joint: JointIndex, speed_fraction: f64, load: f64) -> f64 {
    let of = |what: fn(&CarriedLoad) -> f64| {
        let points = at_level(&run.points, joint, speed_fraction);
        mean(&points.filter_map(|point| point.load.as_ref().map(what)).collect::<Vec<f64>>())
    };
    match (of(|of| of.torque), of(|of| of.friction)) {
        (Some(carried), Some(friction)) => friction * (load - carried),
        _ => 0.0,
    }
}

/// Time since the start, s, and friction, Nm, of each pass of a joint at one speed of a run.
fn usable_means(run: &MapRun, joint: JointIndex, speed_fraction: f64) -> Vec<(f64, f64)> {
    let means = friction_means(&run.points, joint, speed_fraction);
    let usable = means.into_iter().filter(|mean| mean.torque.is_finite() && mean.torque > 0.0);
    usable.map(|mean| (mean.time, mean.torque)).collect()
}

/// Number of usable points at the best level of each joint with friction points in a run. From [`FULL_RUN_POINTS`] on
/// the run may be part of the joint's baseline, from [`SHORT_RUN_POINTS`] on it has an index.
#[must_use]
pub fn coverage(run: &MapRun) -> Vec<(JointIndex, usize)> {
    let of_joint = |joint: JointIndex| {
        let counts = run_levels(run, joint).into_iter().map(|level| usable_means(run, joint, level).len());
        (joint, counts.max().unwrap_or(0))
    };
    let mut joints: Vec<JointIndex> = run.points.iter().map(|p| p.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    joints.into_iter().map(of_joint).collect()
}

/// Speeds of a joint in a run, ascending, as fractions of its largest.
fn run_levels(run: &MapRun, joint: JointIndex) -> Vec<f64> {
    speed_fractions(run.points.iter().filter(|p| p.joint == joint).map(|p| p.speed_fraction))
}

/// Sorts speeds in ascending order and removes duplicates.
pub(super) fn speed_fractions(recorded: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut levels: Vec<f64> = recorded.collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    levels
}

/// Motion of one joint with its activity; `usual` is its usual mean speed in a cycle.
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

/// Mean speed of a joint in a cycle, if known.
pub(super) fn known_speed(joint: JointIndex, span: &CycleMotion) -> Option<f64> {
    span.speeds.get(joint.index()).copied().filter(|speed| speed.is_finite())
}

/// Measured mean friction of a level in one run of a record, Nm; `None` without points.
pub(super) fn level_mean(record: &JointRecord, run: usize, level: usize) -> Option<f64> {
    let of_level = record.points.iter().filter(|p| p.run == run && p.level == level);
    mean(&of_level.map(|p| p.torque / p.jump).collect::<Vec<f64>>())
}
