//! Rows of a cycle for the identification of its parameters.

use super::filtered_columns::FilteredColumn;
use super::row_lanes::RowLanes;
use crate::least_squares::rows::{RowSource, SampleRows};
use crate::model::regressor::KeptColumns;
use crate::signal::filter::{FilteredSignals, row_step};
use armwatch_model::analysis::Motion;
use armwatch_model::robot::Robot;
use armwatch_model::run::{Samples, Stage};

/// Rows of a cycle for the identification of parameters: the observed rows of the excitation stage, for each joint only
/// while it moves. Columns with jumps are low-passed like the torque. The factors that
/// [`used_for_identification`](super::joint_factors::used_for_identification) chooses contain the same rows.
#[derive(Debug)]
pub struct CycleRows<'a> {
    robot: &'a Robot,
    columns: &'a KeptColumns,
    filtered: &'a FilteredSignals,
    filtered_coulomb_columns: &'a [FilteredColumn],
    rows: Vec<usize>,
    /// Distance between observed rows, in rows of the recording.
    step: usize,
}

impl<'a> CycleRows<'a> {
    /// Creates the rows of `samples`, whose signals are `filtered` and whose columns with jumps are
    /// `filtered_coulomb_columns`; `columns` `[b]` are those of the kept parameters.
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

    fn record_length(&self) -> usize {
        match (self.rows.first(), self.rows.last()) {
            (Some(first), Some(last)) => last / self.step - first / self.step + 1,
            _ => 0,
        }
    }

    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>)) {
        let (n, b) = (self.joint_count(), self.columns());
        let (mut w, mut tau, mut used) = (vec![0.0; n * b], vec![0.0; n], vec![false; n]);
        let rows = self.rows.iter().copied();
        let mut lanes = RowLanes::new(self.robot);
        lanes.each(self.robot, self.filtered, self.filtered_coulomb_columns, rows, |at, taken| {
            for (lane, row) in taken.iter().enumerate() {
                for (j, joint) in self.robot.joints.iter().enumerate() {
                    tau[j] = at.tau[j].0[lane];
                    used[j] = Motion::of(at.states.qd[j].0[lane], joint.counted_speed()) == Motion::Moving;
                    for (w, &column) in w[j * b..][..b].iter_mut().zip(self.columns.columns()) {
                        *w = at.y.get(j, column).0[lane];
                    }
                }
                visit(&SampleRows { row: row / self.step, w: &w, tau: &tau, used: &used });
            }
        });
    }
}
