//! Rows invented by the logger: single absurd values, and rows written twice.

use super::view::{ChannelView, finding};
use crate::lanes::largest_step;
use crate::signal::fold::LEAP;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{JointIndex, JointKind};

/// Smallest distance from the channel's usual range, in multiples of the range, that no motion of an arm reaches. Peaks
/// of healthy torques stay within one range.
const BEYOND: f64 = 4.0;
/// Share of the sorted values at each end that is excluded from the usual range.
const TAIL: f64 = 0.005;
/// Number of rows for the usual range; more would not change it.
const RANGE_ROWS: usize = 4000;
/// Smallest number of copies of each row for reporting the number.
const WHOLE_TIMES: f64 = 2.5;
/// Largest share of the moving rows that may repeat the previous row in every channel.
const REPEATED: f64 = 0.01;

/// Step, as a part of the range that a joint moved over, below which it is resolution and no leap.
const RESOLUTION: f64 = 0.01;
/// Largest share of the rows that may leap. If more do, the position is in another unit, which other checks find.
const LEAPING: f64 = 0.002;

/// Values far outside the channel's usual range: markers such as -9999, lost digits.
pub(super) fn spikes(view: &ChannelView<'_>) -> Vec<Finding> {
    let mut found = Vec::new();
    for joint in view.robot.joint_indices() {
        let j = joint.index();
        let limits = &view.joint(joint).limits;
        let velocity = view.samples.velocity.as_ref().map(|velocity| &velocity[j]);
        let channels = [
            (
                "position",
                Some(&view.samples.position[j]),
                limits.position_max - limits.position_min,
                view.position_extents[j],
            ),
            (
                "velocity",
                velocity,
                limits.velocity,
                velocity.map_or([0.0; 2], |velocity| view.extent(velocity)),
            ),
            ("torque", Some(&view.samples.torque[j]), 0.0, view.torque_extents[j]),
        ];
        let channels = channels
            .into_iter()
            .filter_map(|(name, channel, least, extent)| Some((name, channel?, least, extent)));
        found.extend(
            channels.filter_map(|(name, channel, least, extent)| {
                spike(view, joint, (name, channel, extent), least)
            }),
        );
    }
    found
}

/// Worst value of one channel with its name and extent, if it is absurd. `least` is a range that the channel may always
/// have.
fn spike(
    view: &ChannelView<'_>,
    joint: JointIndex,
    (name, channel, [lowest, highest]): (&'static str, &[f64], [f64; 2]),
    least: f64,
) -> Option<Finding> {
    let stride = view.row_count.div_ceil(RANGE_ROWS).max(1);
    let mut some: Vec<f64> = view.rows().step_by(stride).map(|row| channel[row]).collect();
    let last = (some.len() - 1) as f64;
    let mut at = |part: f64| *some.select_nth_unstable_by((last * part) as usize, f64::total_cmp).1;
    let (low, high) = (at(TAIL), at(1.0 - TAIL));
    let reach = BEYOND * (high - low).max(least);
    let beyond = |value: f64| (low - value).max(value - high);
    if reach <= 0.0 || beyond(lowest).max(beyond(highest)) <= reach {
        return None;
    }
    let worst = view.rows().max_by(|&a, &b| beyond(channel[a]).total_cmp(&beyond(channel[b])))?;
    let rows = view.rows().filter(|&row| beyond(channel[row]) > reach).count();
    let unit = match (name, view.joint(joint).kind) {
        ("position", JointKind::Revolute) => "rad",
        ("position", JointKind::Prismatic) => "m",
        ("velocity", JointKind::Revolute) => "rad/s",
        ("velocity", JointKind::Prismatic) => "m/s",
        (_, JointKind::Revolute) => "Nm",
        (_, JointKind::Prismatic) => "N",
    };
    let (value, time) = (channel[worst], view.samples.time[worst]);
    Some(finding(
        FindingKind::Spike,
        FindingSeverity::Refuse,
        Some(joint),
        format!(
            "joint {joint}: the {name} is {value} {unit} at {time:.3} s ({rows} such rows), all others lie around {low:.3} \
             to {high:.3} {unit}; a fault of the sensor or a marker of the logger: remove these rows or record again"
        ),
        &[("value_si", value), ("time_s", time), ("rows", rows as f64), (name, value)],
    ))
}

/// Positions that the joint cannot reach from the previous row: folded angles, lost digits, deleted rows. Joints with
/// `known` findings are skipped. If rows are `repeated`, the first row of the next value contains the motion of all of
/// them.
pub(super) fn leaps(view: &ChannelView<'_>, known: &[Finding], repeated: Option<&Finding>) -> Vec<Finding> {
    let judged = |joint: &JointIndex| known.iter().all(|finding| finding.joint != Some(*joint));
    let times = repeated.map_or(1.0, |repeated| times_there(repeated).ceil());
    view.robot.joint_indices().filter(judged).filter_map(|joint| leap(view, joint, times)).collect()
}

/// Mean number of copies of each row.
fn times_there(repeated: &Finding) -> f64 {
    let share = repeated.evidence.first().map_or(0.0, |evidence| evidence.value);
    1.0 / (1.0 - share.min(0.99))
}

fn leap(view: &ChannelView<'_>, joint: JointIndex, times: f64) -> Option<Finding> {
    let channel = &view.samples.position[joint.index()];
    let [low, high] = view.position_extents[joint.index()];
    let time = &view.samples.time;
    // time stamps jitter and arrive in bunches while the joint moves
    let reach = times * LEAP * view.joint(joint).limits.velocity;
    let reached = |row: usize| reach * (time[row] - time[row - 1]).max(view.mean_step);
    let resolution = RESOLUTION * (high - low);
    // if no step is longer than the shortest time between two rows allows, single rows need no check
    let least = reach * view.shortest_step.max(view.mean_step);
    if view.pieces(channel).map(largest_step).all(|step| step <= least.max(resolution)) {
        return None;
    }
    let steps = view.filtered.usable.iter().flat_map(|stretch| stretch.clone().skip(1));
    let leaps: Vec<(usize, f64)> = steps
        .map(|row| (row, channel[row] - channel[row - 1]))
        .filter(|&(row, step)| step.abs() > reached(row).max(resolution))
        .collect();
    let few = leaps.len() as f64 <= (LEAPING * view.row_count as f64).max(2.0);
    let &(row, step) = leaps.iter().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).filter(|_| few)?;
    let (time, turn) = (view.samples.time[row], std::f64::consts::TAU);
    let folded = |(row, step): &(usize, f64)| {
        ((step / turn).round() * turn - step).abs() <= reached(*row) && step.abs() > 0.5 * turn
    };
    let turning = view.joint(joint).kind == JointKind::Revolute;
    let (unit, words) = match turning {
        true if leaps.iter().all(folded) => {
            ("rad", "it is folded into one turn: export positions that go on counting beyond it")
        }
        true => {
            ("rad", "no drive does that: lost digits, or rows were cut out; remove the row or record again")
        }
        false => {
            ("m", "no drive does that: lost digits, or rows were cut out; remove the row or record again")
        }
    };
    Some(finding(
        FindingKind::Spike,
        FindingSeverity::Refuse,
        Some(joint),
        format!(
            "joint {joint}: the position jumps by {step:.3} {unit} from one row to the next at {time:.3} s ({} such rows); \
             {words}",
            leaps.len()
        ),
        &[("step_si", step), ("time_s", time), ("rows", leaps.len() as f64), ("position", step)],
    ))
}

/// Rows that repeat the previous row in every channel while the arm moves.
pub(super) fn repeats(view: &ChannelView<'_>) -> Option<Finding> {
    let joints = || view.robot.joint_indices().map(JointIndex::index);
    let moves = |row: usize| joints().any(|j| view.dq[j][row].abs() > 2.0 * view.robot.joints[j].low_speed);
    let same = |row: &usize| {
        let equal = |channel: &[f64]| (channel[*row] - channel[row - 1]).abs() <= 0.0;
        // torques first, because they differ in most rows
        joints().all(|j| {
            equal(&view.samples.torque[j])
                && equal(&view.samples.position[j])
                && view.samples.velocity.as_ref().is_none_or(|velocity| equal(&velocity[j]))
        })
    };
    let rows = || view.rows().filter(|row| *row > 0);
    let repeated = rows().filter(same).filter(|row| moves(*row)).count();
    if repeated == 0 {
        return None;
    }
    let moving = rows().filter(|row| moves(*row)).count();
    let share = repeated as f64 / moving as f64;
    let times = 1.0 / (1.0 - share.min(0.99));
    let words = match times {
        times if times >= WHOLE_TIMES && (times - times.round()).abs() < 0.1 * times => {
            format!("each row is there {:.0} times", times)
        }
        _ => format!("{:.0} % of the rows repeat the row before in every channel", 100.0 * share),
    };
    (share > REPEATED).then(|| {
        finding(
            FindingKind::Repeated,
            FindingSeverity::Warn,
            None,
            format!(
                "{words} while the arm moves; the logger is faster than the controller, or wrote rows twice: check its \
                 sample rate"
            ),
            &[("repeated_share", share), ("rows", repeated as f64)],
        )
    })
}
