//! Torque against motion: whose joint's it is.

use super::view::{View, finding};
use crate::least_squares::factor::{BLOCK_ROWS, FactorBuilder};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::JointIndex;

/// Most rows of one small fit; more add nothing to a yes or no.
const FIT_ROWS: usize = 3000;
/// Difference in explained torque that makes a torque another joint's.
const EXPLAINED_GAP: f64 = 0.3;

/// What one joint's motion explains of one torque.
#[derive(Debug, Clone, Copy)]
struct Explained {
    /// Part of the torque's variance.
    share: f64,
}

/// `tau_i = c + b cos q_j + s sin q_j + I qdd_j + f sign(qd_j) + v qd_j` for each torque `i`, `[n]`, over the rows in
/// which joint `j` moves.
fn explain(view: &View<'_>, joint: JointIndex) -> Vec<Option<Explained>> {
    const OWN: [usize; 6] = [0, 1, 2, 3, 4, 5];
    let j = joint.index();
    let FilteredSignals { q, qd, qdd, tau, .. } = view.filtered;
    let low = view.joint(joint).low_speed;
    let moving: Vec<usize> = view.rows().filter(|&row| qd[j][row].abs() >= low).collect();
    let stride = moving.len().div_ceil(FIT_ROWS).max(1);
    let rows: Vec<usize> = moving.into_iter().step_by(stride).collect();
    let mut builder = FactorBuilder::new(OWN.len() + tau.len() - 1);
    for rows in rows.chunks(BLOCK_ROWS) {
        let turns: Vec<(f64, f64)> = rows.iter().map(|&row| q[j][row].sin_cos()).collect();
        builder.push_columns(rows.len(), |k, entries| {
            let at_row = entries.iter_mut().zip(rows);
            match k {
                0 => entries.fill(1.0),
                1 => entries.iter_mut().zip(&turns).for_each(|(entry, (_, cosine))| *entry = *cosine),
                2 => entries.iter_mut().zip(&turns).for_each(|(entry, (sine, _))| *entry = *sine),
                3 => at_row.for_each(|(entry, &row)| *entry = qdd[j][row]),
                4 => at_row.for_each(|(entry, &row)| *entry = qd[j][row].signum()),
                5 => at_row.for_each(|(entry, &row)| *entry = qd[j][row]),
                _ => at_row.for_each(|(entry, &row)| *entry = tau[k - OWN.len()][row]),
            }
        });
    }
    let factor = builder.take();
    let count = rows.len() as f64;
    let of_torque = |torque: usize| {
        let solved = factor.selected(&OWN, OWN.len() + torque).solve(1e6, |k| k.to_string()).ok()?;
        let mean = rows.iter().map(|&row| tau[torque][row]).sum::<f64>() / count;
        let variance = rows.iter().map(|&row| (tau[torque][row] - mean).powi(2)).sum::<f64>() / count;
        (variance > 0.0)
            .then(|| Explained { share: 1.0 - solved.residual_sum_of_squares / (count * variance) })
    };
    (0..tau.len()).map(of_torque).collect()
}

/// Torques of another joint.
pub(super) fn torques(view: &View<'_>, joints: &[JointIndex]) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut by_motion = vec![Vec::new(); view.robot.joint_count()];
    joints.iter().for_each(|&joint| by_motion[joint.index()] = explain(view, joint));
    let of = |torque: JointIndex, joint: JointIndex| by_motion[joint.index()][torque.index()];
    let own: Vec<(JointIndex, Explained)> =
        joints.iter().filter_map(|&joint| Some((joint, of(joint, joint)?))).collect();
    for (at, &(a, own_a)) in own.iter().enumerate() {
        for &(b, own_b) in &own[at + 1..] {
            let (Some(a_by_b), Some(b_by_a)) = (of(a, b), of(b, a)) else { continue };
            if a_by_b.share > own_a.share + EXPLAINED_GAP && b_by_a.share > own_b.share + EXPLAINED_GAP {
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
    found
}
