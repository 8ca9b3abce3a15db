//! Whether torques are late against positions: the model is fitted to torques of earlier and later rows, all joints
//! at once, with friction of any shape.

use super::friction_shapes::SHAPES;
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

/// When the torques of all joints together fit the motion best.
#[derive(Debug, Clone, PartialEq)]
pub struct JointDelay {
    /// Each joint for itself, where a delay inside the range fits best.
    pub joints: Vec<TorqueDelay>,
    /// Joints with rows enough to judge.
    pub judged: usize,
    /// Time by which all torques are late, s; negative where they are early.
    pub delay: f64,
    /// Geometric mean over the judged joints, weighted by rows, of the residual sum of squares at that delay,
    /// relative to that of the torques as recorded.
    pub residual_ratio: f64,
}

/// The delay of all torques together at which the joints' own columns explain them best, by the likelihood of
/// each joint's residual with a variance of its own.
///
/// `jumps` are the low-passed columns of the robot that jump, `excitation` usable rows in their order,
/// `shapes` `[n][SHAPES][rows]` more columns of each joint, or nothing. `None` where no joint has rows enough, or
/// the outermost delay is the best.
#[must_use]
pub fn torque_delays(
    robot: &Robot,
    columns: &JointColumns,
    kept_columns: &[usize],
    (conditioned, jumps): (&Conditioned, &[Jump]),
    excitation: &[usize],
    shapes: &[Vec<Vec<f64>>],
) -> Option<JointDelay> {
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
    let profiles =
        profiles(robot, columns, kept_columns, (conditioned, jumps), &rows, [step, shifts], shapes);
    let judged: Vec<(JointIndex, Profile)> =
        robot.joint_indices().zip(profiles).filter_map(|(joint, profile)| Some((joint, profile?))).collect();
    let weight: f64 = judged.iter().map(|(_, profile)| profile.freedom).sum();
    let together = |k: usize| {
        let of_joint = |(_, profile): &(JointIndex, Profile)| profile.freedom * profile.squares[k].ln();
        (judged.iter().map(of_joint).sum::<f64>() / weight).exp()
    };
    let all: Vec<f64> = (0..=2 * shifts).map(together).collect();
    let [delay, residual_ratio] = best(&all, step_s)?;
    let of_joint = |(joint, profile): &(JointIndex, Profile)| {
        let [delay, residual_ratio] = best(&profile.squares, step_s)?;
        Some(TorqueDelay { joint: *joint, delay, residual_ratio })
    };
    let joints = judged.iter().filter_map(of_joint).collect();
    Some(JointDelay { joints, judged: judged.len(), delay, residual_ratio })
}

/// Residual sums of squares of a joint over the shifts, earliest first, and the rows that stand behind them.
struct Profile {
    squares: Vec<f64>,
    freedom: f64,
}

/// Profiles of the joints that have twice as many rows as columns.
fn profiles(
    robot: &Robot,
    columns: &JointColumns,
    kept_columns: &[usize],
    (conditioned, jumps): (&Conditioned, &[Jump]),
    rows: &[usize],
    [step, shifts]: [usize; 2],
    shapes: &[Vec<Vec<f64>>],
) -> Vec<Option<Profile>> {
    let n = robot.joint_count();
    let mut y = Regressor::new(robot);
    let of_joint: Vec<Vec<usize>> = robot
        .joint_indices()
        .map(|joint| columns.places(joint).iter().map(|&place| kept_columns[place]).collect())
        .collect();
    let targets = 2 * shifts + 1;
    let more = if shapes.is_empty() { 0 } else { SHAPES };
    let mut folders: Vec<RowFolder> =
        of_joint.iter().map(|columns| RowFolder::new(columns.len() + more + targets - 1)).collect();
    let (mut q, mut qd, mut qdd, mut tau) =
        ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for &row in rows {
        conditioned.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
        smear(jumps, row, &mut y);
        let moving = (0..n).filter(|&j| qd[j].abs() >= robot.joints[j].low_speed);
        for j in moving {
            let w = of_joint[j].iter().map(|&column| y.column(column)[j]);
            let shaped = shapes.get(j).into_iter().flatten().map(|shape| shape[row]);
            let torques = (0..targets).map(|k| conditioned.tau[j][row + k * step - shifts * step]);
            folders[j].push(w.chain(shaped).chain(torques));
        }
    }
    let profile = |(folder, columns): (&mut RowFolder, &Vec<usize>)| {
        let factor = folder.take();
        let b = columns.len() + more;
        let upper = factor.upper();
        let residual = |k: usize| (b..=b + k).map(|i| upper[(i, b + k)].powi(2)).sum::<f64>();
        (factor.rows() > 2 * b).then(|| Profile {
            squares: (0..targets).map(residual).collect(),
            freedom: (factor.rows() - b) as f64,
        })
    };
    folders.iter_mut().zip(&of_joint).map(profile).collect()
}

/// Delay, s, and residual relative to that without a delay at the lowest point of the parabola through the least
/// residual and its neighbours; `None` where the least is at either end.
fn best(profile: &[f64], step_s: f64) -> Option<[f64; 2]> {
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
    let ratio = (lowest / profile[middle]).clamp(0.0, 1.0);
    ratio.is_finite().then_some([delay, ratio])
}
