//! Estimated against measured torque: RMSD per joint and stage [5.1].

use super::dynamics::DynamicModel;
use super::identify::state;
use super::signal::Conditioned;
use crate::analysis::{Rmsd, RmsdScope, TorqueRmsd};
use crate::robot::{MAX_JOINTS, Robot};
use crate::run::Stage;

/// Sums over rows of one joint.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    deviation: f64,
    measured: f64,
    rows: usize,
}

impl Sums {
    fn add(&mut self, estimated: f64, measured: f64) {
        self.deviation += (estimated - measured).powi(2);
        self.measured += measured.powi(2);
        self.rows += 1;
    }

    fn joined(self, other: Self) -> Self {
        Self {
            deviation: self.deviation + other.deviation,
            measured: self.measured + other.measured,
            rows: self.rows + other.rows,
        }
    }

    fn rmsd(self) -> Rmsd {
        if self.rows == 0 {
            return Rmsd::default();
        }
        let value = (self.deviation / self.rows as f64).sqrt();
        let measured = (self.measured / self.rows as f64).sqrt();
        let relative = if measured > 0.0 { value / measured } else { 0.0 };
        Rmsd { value, relative, samples: self.rows }
    }
}

/// Sums of one joint in one stage: resting rows and moving rows.
type StageSums = [[[Sums; 2]; 4]; MAX_JOINTS];

/// RMSD of `model` against the low-passed torque of a cycle: for every joint over the excitation,
/// friction and warming stages, as far as they have rows, and over the whole cycle; each over all
/// rows and over the rows in which the joint moves faster than its low-speed threshold.
#[must_use]
pub fn torque_rmsd(
    robot: &Robot,
    model: &DynamicModel,
    conditioned: &Conditioned,
    stages: &[Stage],
) -> Vec<TorqueRmsd> {
    let n = robot.joint_count();
    let mut sums: StageSums = Default::default();
    let (mut q, mut qd, mut qdd, mut tau) = state();
    let mut estimated = [0.0; MAX_JOINTS];
    for row in conditioned.usable.iter().flat_map(Clone::clone) {
        conditioned.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        model.torque(robot, &q[..n], &qd[..n], &qdd[..n], &mut estimated[..n]);
        let stage = stages[row] as usize;
        for j in 0..n {
            let moves = usize::from(qd[j].abs() >= robot.joints[j].low_speed);
            sums[j][stage][moves].add(estimated[j], tau[j]);
        }
    }
    robot
        .joint_indices()
        .flat_map(|joint| {
            let of_joint = sums[joint.index()];
            let whole = of_joint.iter().fold([Sums::default(); 2], |whole, stage| {
                [whole[0].joined(stage[0]), whole[1].joined(stage[1])]
            });
            let by_stage = Stage::ANALYSED.map(|stage| (RmsdScope::Stage(stage), of_joint[stage as usize]));
            by_stage.into_iter().chain([(RmsdScope::WholeCycle, whole)]).map(
                move |(scope, [resting, moving])| TorqueRmsd {
                    joint,
                    scope,
                    all_rows: resting.joined(moving).rmsd(),
                    moving_rows: moving.rmsd(),
                },
            )
        })
        .filter(|rmsd| rmsd.all_rows.samples > 0)
        .collect()
}
