//! The rows of a cycle that its parameters are identified on.

use super::filtered_columns::{FilteredColumn, write_filtered_columns};
use crate::analysis::Motion;
use crate::numerics::least_squares::rows::{RowSource, SampleRows};
use crate::numerics::model::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use crate::numerics::signal::filter::{FilteredSignals, row_step, state};
use crate::robot::Robot;
use crate::run::{Samples, Stage};

/// The rows of a cycle that parameters are identified on: those observed of the excitation stage, of
/// each joint those in which it moves, columns that jump smeared as the low-pass smears the torque. The
/// same rows are in the factors that [`used_for_identification`](super::joint_factors::used_for_identification) chooses.
#[derive(Debug)]
pub struct CycleRows<'a> {
    robot: &'a Robot,
    columns: &'a KeptColumns,
    filtered: &'a FilteredSignals,
    filtered_coulomb_columns: &'a [FilteredColumn],
    rows: Vec<usize>,
    /// Rows of the recording from one observed row to the next.
    step: usize,
}

impl<'a> CycleRows<'a> {
    /// Rows of `samples`, whose channels are `filtered` and whose columns that jump are `filtered_coulomb_columns`;
    /// `columns` `[b]` are those of the kept parameters.
    #[must_use]
    pub fn new(
        robot: &'a Robot,
        columns: &'a KeptColumns,
        filtered: &'a FilteredSignals,
        filtered_coulomb_columns: &'a [FilteredColumn],
        samples: &Samples,
    ) -> Self {
        let excitation = |row: &usize| samples.stage[*row] == Stage::Excitation;
        let rows = filtered.observed_rows().filter(excitation).collect();
        let step = row_step(filtered.cutoff, filtered.sample_rate);
        Self { robot, columns, filtered, filtered_coulomb_columns, rows, step }
    }
}

impl RowSource for CycleRows<'_> {
    fn columns(&self) -> usize {
        self.columns.len()
    }

    fn joint_count(&self) -> usize {
        self.robot.joint_count()
    }

    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>)) {
        let (n, b) = (self.joint_count(), self.columns());
        let mut y = Regressor::new(self.robot);
        let (mut q, mut qd, mut qdd, mut tau) = state();
        let (mut block, mut w) = (vec![0.0; n * b], vec![0.0; n * b]);
        let mut used = vec![false; n];
        for &row in &self.rows {
            self.filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
            joint_torque_regressor(self.robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
            write_filtered_columns(self.filtered_coulomb_columns, row, &mut y);
            self.columns.write(&y, &mut block, n, 0);
            for (j, joint) in self.robot.joints.iter().enumerate() {
                used[j] = Motion::of(qd[j], joint.low_speed) == Motion::Moving;
                for k in 0..b {
                    w[j * b + k] = block[k * n + j];
                }
            }
            visit(&SampleRows { row: row / self.step, w: &w, tau: &tau[..n], used: &used });
        }
    }
}
