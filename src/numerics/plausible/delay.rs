//! Whether torques are late against positions: the model is fitted to torques of earlier and later rows.

use crate::numerics::factors::JointColumns;
use crate::numerics::jumps::{Jump, smear};
use crate::numerics::regressor::{Regressor, joint_torque_regressor};
use crate::numerics::signal::Conditioned;
use crate::numerics::triangular::RowFolder;
use crate::robot::{JointIndex, MAX_JOINTS, Robot};

/// Largest delay looked for, s. Beyond it torque and motion have nothing to do with each other, which
/// other checks see.
const LONGEST_S: f64 = 0.16;
/// Distance between the delays tried, s; a parabola finds what is between them.
const STEP_S: f64 = 0.01;

/// When the torque of a joint fits its motion best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueDelay {
    /// The joint.
    pub joint: JointIndex,
    /// Time by which the torque is late, s; negative where it is early.
    pub delay: f64,
    /// Residual sum of squares at that delay, relative to that of the torque as recorded.
    pub residual_ratio: f64,
}

/// The delay of each joint's torque at which its own columns explain it best.
///
/// `jumps` are the low-passed columns of the robot that jump, `excitation` usable rows in their order. Joints for which no shift fits better than the outermost
/// ones are left out: nothing can be said of them.
#[must_use]
pub fn torque_delays(
    robot: &Robot,
    columns: &JointColumns,
    kept_columns: &[usize],
    (conditioned, jumps): (&Conditioned, &[Jump]),
    excitation: &[usize],
) -> Vec<TorqueDelay> {
    let step = (STEP_S * conditioned.sample_rate).round().max(1.0) as usize;
    let shifts = (LONGEST_S * conditioned.sample_rate / step as f64).floor() as usize;
    let reach = shifts * step;
    let apart = (conditioned.sample_rate / (2.0 * conditioned.cutoff)).ceil().max(1.0) as usize;
    let inside = |row: usize| {
        conditioned
            .usable
            .iter()
            .any(|s| s.contains(&(row.saturating_sub(reach))) && s.contains(&(row + reach)))
    };
    let rows: Vec<usize> =
        excitation.iter().copied().step_by(apart).filter(|&row| row >= reach && inside(row)).collect();
    let step_s = step as f64 / conditioned.sample_rate;
    let profiles = profiles(robot, columns, kept_columns, (conditioned, jumps), &rows, [step, shifts]);
    robot
        .joint_indices()
        .zip(profiles)
        .filter_map(|(joint, profile)| best(joint, &profile?, step_s))
        .collect()
}

/// Residual sums of squares of each joint over the shifts, earliest first.
fn profiles(
    robot: &Robot,
    columns: &JointColumns,
    kept_columns: &[usize],
    (conditioned, jumps): (&Conditioned, &[Jump]),
    rows: &[usize],
    [step, shifts]: [usize; 2],
) -> Vec<Option<Vec<f64>>> {
    let n = robot.joint_count();
    let mut y = Regressor::new(robot);
    let of_joint: Vec<Vec<usize>> = robot
        .joint_indices()
        .map(|joint| columns.places(joint).iter().map(|&place| kept_columns[place]).collect())
        .collect();
    let targets = 2 * shifts + 1;
    let mut folders: Vec<RowFolder> =
        of_joint.iter().map(|columns| RowFolder::new(columns.len() + targets - 1)).collect();
    let (mut q, mut qd, mut qdd, mut tau) =
        ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for &row in rows {
        conditioned.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
        smear(jumps, row, &mut y);
        let moving = (0..n).filter(|&j| qd[j].abs() >= robot.joints[j].low_speed);
        for j in moving {
            let w = of_joint[j].iter().map(|&column| y.column(column)[j]);
            let torques = (0..targets).map(|k| conditioned.tau[j][row + k * step - shifts * step]);
            folders[j].push(w.chain(torques));
        }
    }
    let profile = |(folder, columns): (&mut RowFolder, &Vec<usize>)| {
        let factor = folder.take();
        let b = columns.len();
        let upper = factor.upper();
        let residual = |k: usize| (b..=b + k).map(|i| upper[(i, b + k)].powi(2)).sum::<f64>();
        (factor.rows() > 2 * (b + targets)).then(|| (0..targets).map(residual).collect())
    };
    folders.iter_mut().zip(&of_joint).map(profile).collect()
}

/// The lowest point of the parabola through the least residual and its neighbours.
fn best(joint: JointIndex, profile: &[f64], step_s: f64) -> Option<TorqueDelay> {
    let middle = profile.len() / 2;
    let least = (0..profile.len()).min_by(|&a, &b| profile[a].total_cmp(&profile[b]))?;
    if least == 0 || least + 1 == profile.len() {
        return None;
    }
    let [before, at, after] = [profile[least - 1], profile[least], profile[least + 1]];
    let bend = before - 2.0 * at + after;
    let part = if bend > 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    let lowest = at - 0.25 * (before - after) * part;
    let delay = (least as f64 - middle as f64 + part) * step_s;
    Some(TorqueDelay { joint, delay, residual_ratio: (lowest / profile[middle]).clamp(0.0, 1.0) })
}
