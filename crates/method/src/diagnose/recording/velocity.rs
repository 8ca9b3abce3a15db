//! Velocity against the derivative of position: swapped columns, wrong units, signs and time.

use super::view::{BELONGS, ChannelView, DEGREES, DiagnoseSettings, finding};
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{Joint, JointIndex, JointKind, Robot};

/// Largest relative distance between a factor and the exact ratio of two units that still counts as equal.
const UNIT_TOLERANCE: f64 = 0.03;
/// Factor from radians per second to turns per minute.
const RPM: f64 = 30.0 / std::f64::consts::PI;

/// Swapped columns, wrong units and signs between velocity and position.
pub(super) fn velocity_against_position(
    view: &ChannelView<'_>,
    settings: &DiagnoseSettings,
    broken: &[bool],
) -> Vec<Finding> {
    let qd = &view.filtered.qd;
    let n = qd.len();
    let (dq_rms, qd_rms) = (&view.dq_rms, &view.qd_rms);
    let correlated = |i: usize, j: usize, product: f64| {
        let scale = dq_rms[i] * qd_rms[j];
        if scale > 0.0 { product / scale } else { 0.0 }
    };
    let correlation = |i: usize, j: usize| correlated(i, j, view.product(&view.dq[i], &qd[j]));
    let mut found = Vec::new();
    let mut gains: Vec<(JointIndex, f64)> = Vec::new();
    for joint in view.robot.joint_indices() {
        let i = joint.index();
        let still = dq_rms[i] < 0.5 * view.joint(joint).low_speed;
        if broken[i] || still {
            continue;
        }
        let product = view.product(&view.dq[i], &qd[i]);
        let own = correlated(i, i, product);
        if own.abs() > BELONGS[0] {
            gains.push((joint, product / (dq_rms[i] * dq_rms[i])));
            continue;
        }
        let best = (0..n).max_by(|&a, &b| correlation(i, a).abs().total_cmp(&correlation(i, b).abs()));
        let Some(best) = best.filter(|&best| best != i && own.abs() < BELONGS[1]) else {
            found.push(unrelated(joint, own));
            continue;
        };
        let other = correlation(i, best);
        if other.abs() > BELONGS[0] {
            let best = JointIndex::new(best);
            found.push(finding(
                FindingKind::VelocitySwapped,
                FindingSeverity::Refuse,
                Some(joint),
                format!(
                    "joint {joint}: its position belongs to the velocity recorded for joint {best} (correlation \
                     {other:.3}), not to its own ({own:.3}); columns are swapped, check the order of joints in the \
                     export layout"
                ),
                &[("correlation_own", own), ("correlation_other", other), ("other_joint", best.number() as f64)],
            ));
        } else {
            found.push(unrelated(joint, own));
        }
    }
    found.extend(gain_findings(view, &gains, settings));
    found
}

fn unrelated(joint: JointIndex, own: f64) -> Finding {
    finding(
        FindingKind::VelocityUnrelated,
        FindingSeverity::Refuse,
        Some(joint),
        format!(
            "joint {joint}: the velocity does not follow from the position (correlation {own:.3}, should be near 1); \
             check both columns, and that they are recorded at the same time"
        ),
        &[("correlation_own", own)],
    )
}

fn gain_findings(
    view: &ChannelView<'_>,
    gains: &[(JointIndex, f64)],
    settings: &DiagnoseSettings,
) -> Vec<Finding> {
    let off = |gain: f64| (gain.abs() - 1.0).abs() > settings.velocity_gain;
    let mut found: Vec<Finding> = gains
        .iter()
        .filter(|(_, gain)| *gain < 0.0)
        .map(|&(joint, gain)| {
            finding(
                FindingKind::VelocitySign,
                FindingSeverity::Refuse,
                Some(joint),
                format!(
                    "joint {joint}: the velocity runs against the change of position; turn the sign of one of the \
                     two columns in the export layout"
                ),
                &[("velocity_over_derivative", gain)],
            )
        })
        .collect();
    if let Some(common) = common_factor(view.robot, gains).filter(|&gain| off(gain)) {
        found.push(finding(
            FindingKind::TimeAxis,
            FindingSeverity::Refuse,
            None,
            format!(
                "every velocity is {common:.4} times the change of position per second: the time column or the \
                 sample rate is wrong by that factor"
            ),
            &[("velocity_over_derivative", common)],
        ));
        return found;
    }
    for &(joint, gain) in gains.iter().filter(|(_, gain)| off(*gain)) {
        let meaning = unit_of(view.joint(joint), gain.abs());
        let words = meaning.unwrap_or("check the units of both columns");
        found.push(finding(
            FindingKind::VelocityUnit,
            FindingSeverity::Refuse,
            Some(joint),
            format!(
                "joint {joint}: the velocity is {:.4} times the change of position per second; {words}",
                gain.abs()
            ),
            &[("velocity_over_derivative", gain)],
        ));
    }
    found
}

/// Common factor of all joints, if there is one and it is no factor between units.
fn common_factor(robot: &Robot, gains: &[(JointIndex, f64)]) -> Option<f64> {
    let first = gains.first()?.1.abs();
    let alike = gains.len() > 1
        && gains.iter().all(|&(joint, gain)| {
            (gain.abs() / first - 1.0).abs() < UNIT_TOLERANCE
                && unit_of(&robot.joints[joint.index()], gain.abs()).is_none()
        });
    alike.then_some(first)
}

/// Meaning of a factor between velocity and derivative.
fn unit_of(joint: &Joint, gain: f64) -> Option<&'static str> {
    let turning = joint.kind == JointKind::Revolute;
    let gear = joint.gear_ratio.abs();
    let meanings: [(f64, bool, &'static str); 8] = [
        (DEGREES, turning, "it looks like degrees per second read as rad/s"),
        (1.0 / DEGREES, turning, "the position looks like degrees read as radians"),
        (RPM, turning, "it looks like turns per minute read as rad/s"),
        (1.0 / 6.0, turning, "it looks like turns per minute beside a position in degrees"),
        (1000.0, !turning, "it looks like mm/s read as m/s"),
        (0.001, !turning, "the position looks like millimetres read as metres"),
        (gear, gear > 1.0, "it looks like the speed of the motor; divide by the gear ratio"),
        (gear * RPM, gear > 1.0, "it looks like the motor's turns per minute read as rad/s of the joint"),
    ];
    meanings
        .into_iter()
        .find(|(factor, applies, _)| *applies && (gain / factor - 1.0).abs() < UNIT_TOLERANCE)
        .map(|(.., words)| words)
}
