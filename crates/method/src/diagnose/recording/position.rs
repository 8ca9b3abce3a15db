//! Positions and speeds compared with the description: limits, units, too little motion.

use super::view::{ChannelView, DEGREES, DiagnoseSettings, finding};
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{JointIndex, JointKind};

/// Findings of positions and speeds beyond the description's limits.
pub(super) fn positions(view: &ChannelView<'_>, settings: &DiagnoseSettings) -> Vec<Finding> {
    let mut found: Vec<Finding> =
        view.robot.joint_indices().filter_map(|joint| outside_limits(view, joint, settings)).collect();
    for joint in view.robot.joint_indices() {
        let limit = view.joint(joint).limits.velocity;
        let [low, high] = view.extent(&view.dq[joint.index()]);
        let speed = high.max(-low);
        let known = found.iter().any(|f| f.joint == Some(joint));
        if speed > 1.2 * limit && !known {
            found.push(finding(
                FindingKind::TooFast,
                FindingSeverity::Warn,
                Some(joint),
                format!(
                    "joint {joint}: it moves at up to {speed:.3} rad/s (m/s), {:.1} times the description's limit; \
                     check the unit of position, the time column and the description",
                    speed / limit
                ),
                &[("speed_si", speed), ("limit_si", limit)],
            ));
        }
    }
    found
}

/// Finding that all rotary joints hardly move: degrees were divided once too often, or the motion is unsuitable.
pub(super) fn small_motion(view: &ChannelView<'_>, settings: &DiagnoseSettings) -> Option<Finding> {
    let share = |joint: JointIndex| {
        let limits = &view.joint(joint).limits;
        let [min, max] = view.q_extents[joint.index()];
        (max - min) / (limits.position_max - limits.position_min)
    };
    let turning = view.robot.joint_indices().filter(|&joint| view.joint(joint).kind == JointKind::Revolute);
    let largest = turning.map(share).max_by(f64::total_cmp)?;
    // a plateau may be short; only the identification needs the range
    let severity = if view.has_excitation { FindingSeverity::Refuse } else { FindingSeverity::Warn };
    (largest < settings.range_share).then(|| {
        finding(
            FindingKind::SmallMotion,
            severity,
            None,
            format!(
                "no turning joint moves over more than {:.1} % of its range: radians read as degrees, or a motion too small \
                 to identify anything; check the unit of position in the export layout, then the motion",
                100.0 * largest
            ),
            &[("largest_range_share", largest)],
        )
    })
}

fn outside_limits(view: &ChannelView<'_>, joint: JointIndex, settings: &DiagnoseSettings) -> Option<Finding> {
    let described = view.joint(joint);
    let (low, high) = (described.limits.position_min, described.limits.position_max);
    let range = high - low;
    let [min, max] = view.q_extents[joint.index()];
    let excess = (low - min).max(max - high);
    if excess <= settings.limit_margins[0] * range {
        return None;
    }
    let margin = settings.limit_margins[0] * range;
    let (factor, words) = match described.kind {
        JointKind::Revolute => (DEGREES, "degrees read as radians"),
        JointKind::Prismatic => (1000.0, "millimetres read as metres"),
    };
    let fits = min / factor >= low - margin && max / factor <= high + margin;
    if fits && max - min > 2.0 * range {
        return Some(finding(
            FindingKind::PositionUnit,
            FindingSeverity::Refuse,
            Some(joint),
            format!(
                "joint {joint}: positions from {min:.1} to {max:.1} are far outside the limits {low:.3} to {high:.3} and \
                 look like {words}; correct the unit in the export layout"
            ),
            &[
                ("position_min_si", min),
                ("position_max_si", max),
                ("limit_min_si", low),
                ("limit_max_si", high),
            ],
        ));
    }
    let severity = match excess > settings.limit_margins[1] * range {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    let words = match max - min <= range {
        true => "the zero or the sign of this joint differs from the description's, or it is another robot",
        false => "it moves further than it can: another robot, another unit, or limits that are too narrow",
    };
    Some(finding(
        FindingKind::OutsideLimits,
        severity,
        Some(joint),
        format!(
            "joint {joint}: positions from {min:.3} to {max:.3} leave the limits {low:.3} to {high:.3} by {excess:.3}; \
             {words}"
        ),
        &[("position_min_si", min), ("position_max_si", max), ("excess_si", excess)],
    ))
}
