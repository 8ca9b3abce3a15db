//! Torque against motion: whose joint's it is, and whether friction brakes.

use super::{Finding, FindingKind, FindingSeverity, View, finding};
use crate::numerics::signal::Conditioned;
use crate::numerics::triangular::TriangularFactor;
use crate::robot::JointIndex;

/// Most rows of one small fit; more add nothing to a yes or no.
const FIT_ROWS: usize = 3000;
/// Difference in explained torque that makes a torque another joint's.
const EXPLAINED_GAP: f64 = 0.3;
/// Friction power over torque times speed below which a torque's sign is wrong.
const DRIVEN: f64 = -0.1;
/// Part of a torque that its joint's own motion must explain before friction is read from it.
const OWN_SHARE: f64 = 0.5;

/// What one joint's motion explains of one torque.
#[derive(Debug, Clone, Copy)]
struct Explained {
    /// Part of the torque's variance.
    share: f64,
    /// Mean power of the friction part over RMS torque times RMS speed.
    friction_power: f64,
}

/// `tau_i = c + b cos q_j + s sin q_j + I qdd_j + f sign(qd_j) + v qd_j` for each torque `i`, `[n]`, over the rows in
/// which joint `j` moves.
fn explain(view: &View<'_>, joint: JointIndex) -> Vec<Option<Explained>> {
    const OWN: [usize; 6] = [0, 1, 2, 3, 4, 5];
    let j = joint.index();
    let Conditioned { q, qd, qdd, tau, .. } = view.conditioned;
    let low = view.joint(joint).low_speed;
    let moving: Vec<usize> = view.rows.iter().copied().filter(|&row| qd[j][row].abs() >= low).collect();
    let stride = moving.len().div_ceil(FIT_ROWS).max(1);
    let rows: Vec<usize> = moving.into_iter().step_by(stride).collect();
    let column = |row: usize, k: usize| match k {
        0 => 1.0,
        1 => q[j][row].cos(),
        2 => q[j][row].sin(),
        3 => qdd[j][row],
        4 => qd[j][row].signum(),
        5 => qd[j][row],
        _ => tau[k - OWN.len()][row],
    };
    let mut factor = TriangularFactor::new(OWN.len() + tau.len() - 1);
    factor.fold(faer::Mat::from_fn(rows.len(), OWN.len() + tau.len(), |i, k| column(rows[i], k)).as_ref());
    let count = rows.len() as f64;
    let speed = (rows.iter().map(|&row| qd[j][row].powi(2)).sum::<f64>() / count).sqrt();
    let of_torque = |torque: usize| {
        let solved = factor.selected(&OWN, OWN.len() + torque).solve(1e6, |k| k.to_string()).ok()?;
        let mean = rows.iter().map(|&row| tau[torque][row]).sum::<f64>() / count;
        let variance = rows.iter().map(|&row| (tau[torque][row] - mean).powi(2)).sum::<f64>() / count;
        let friction = |speed: f64| speed * (solved.theta[4] + solved.theta[5] * speed);
        let power = rows.iter().map(|&row| friction(qd[j][row].abs())).sum::<f64>();
        let scale = variance.sqrt() * speed;
        (scale > 0.0).then(|| Explained {
            share: 1.0 - solved.residual_sum_of_squares / (count * variance),
            friction_power: power / count / scale,
        })
    };
    (0..tau.len()).map(of_torque).collect()
}

/// Torques with the wrong sign or of another joint.
pub(super) fn torques(view: &View<'_>, joints: &[JointIndex], known: &[Finding]) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut by_motion = vec![Vec::new(); view.robot.joint_count()];
    joints.iter().for_each(|&joint| by_motion[joint.index()] = explain(view, joint));
    let of = |torque: JointIndex, joint: JointIndex| by_motion[joint.index()][torque.index()];
    let own: Vec<(JointIndex, Explained)> =
        joints.iter().filter_map(|&joint| Some((joint, of(joint, joint)?))).collect();
    let mut swapped = Vec::new();
    for (at, &(a, own_a)) in own.iter().enumerate() {
        for &(b, own_b) in &own[at + 1..] {
            let (Some(a_by_b), Some(b_by_a)) = (of(a, b), of(b, a)) else { continue };
            if a_by_b.share > own_a.share + EXPLAINED_GAP && b_by_a.share > own_b.share + EXPLAINED_GAP {
                swapped.extend([a, b]);
                found.push(finding(
                    FindingKind::TorqueSwapped,
                    FindingSeverity::Refuse,
                    Some(a),
                    format!(
                        "joints {a} and {b}: the torque of each follows the motion of the other ({:.0} and {:.0} % of it \
                         explained, by its own motion {:.0} and {:.0} %); the torque columns, or position and velocity \
                         together, are swapped",
                        100.0 * a_by_b.share,
                        100.0 * b_by_a.share,
                        100.0 * own_a.share,
                        100.0 * own_b.share
                    ),
                    &[("explained_by_other", a_by_b.share), ("explained_by_own", own_a.share)],
                ));
            }
        }
    }
    let turned = |joint: JointIndex| {
        known.iter().any(|f| f.joint == Some(joint) && f.kind == FindingKind::VelocitySign)
    };
    for (joint, explained) in own {
        if explained.share > OWN_SHARE
            && explained.friction_power < DRIVEN
            && !swapped.contains(&joint)
            && !turned(joint)
        {
            found.push(finding(
                FindingKind::TorqueSign,
                FindingSeverity::Refuse,
                Some(joint),
                format!(
                    "joint {joint}: friction would drive the joint instead of braking it (its power is {:.2} of torque times \
                     speed, it must be positive); turn the sign of the torque in the export layout",
                    explained.friction_power
                ),
                &[("friction_power_share", explained.friction_power)],
            ));
        }
    }
    found
}
