//! Rows of `[w | tau]` that can be gone through again and again, a sample at a time, so that
//! estimators with several passes never hold the observation matrix.

use faer::MatRef;

use super::identify::state;
use super::jumps::{Jump, smear};
use super::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use super::signal::{Conditioned, row_step};
use super::triangular::{BLOCK_ROWS, TriangularFactor};
use crate::analysis::Motion;
use crate::robot::Robot;
use crate::run::{Samples, Stage};

/// All joints' rows of one sample.
#[derive(Debug, Clone, Copy)]
pub struct SampleRows<'a> {
    /// Number of the observation; neighbours in time differ by one, more where rows are left out.
    pub row: usize,
    /// Rows of `w`, joint after joint, `[n * b]`.
    pub w: &'a [f64],
    /// Torque, `[n]`.
    pub tau: &'a [f64],
    /// Whether a joint's row takes part, `[n]`.
    pub used: &'a [bool],
}

impl SampleRows<'_> {
    /// The row of `w` that belongs to `joint`, `[b]`.
    #[must_use]
    pub fn of_joint(&self, joint: usize) -> &[f64] {
        let b = self.w.len() / self.tau.len().max(1);
        &self.w[joint * b..(joint + 1) * b]
    }

    /// `tau - w theta` of `joint`, Nm.
    #[must_use]
    pub fn residual(&self, joint: usize, theta: &[f64]) -> f64 {
        self.tau[joint] - self.of_joint(joint).iter().zip(theta).map(|(w, theta)| w * theta).sum::<f64>()
    }
}

/// A least-squares problem whose rows come in order of time, as often as asked.
pub trait RowSource {
    /// Columns `b` of `w`.
    fn columns(&self) -> usize;
    /// Rows of a sample, `n`.
    fn joint_count(&self) -> usize;
    /// Hands every sample to `visit`, in order of time.
    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>));
}

/// The rows of a cycle that parameters are identified on: those observed of the excitation stage, of
/// each joint those in which it moves, columns that jump smeared as the low-pass smears the torque. The
/// same rows are in the factors that [`identifies`](super::factors::identifies) chooses.
#[derive(Debug)]
pub struct CycleRows<'a> {
    robot: &'a Robot,
    columns: &'a KeptColumns,
    conditioned: &'a Conditioned,
    jumps: &'a [Jump],
    rows: Vec<usize>,
    /// Rows of the recording from one observed row to the next.
    step: usize,
}

impl<'a> CycleRows<'a> {
    /// Rows of `samples`, whose channels are `conditioned` and whose columns that jump are `jumps`;
    /// `columns` `[b]` are those of the kept parameters.
    #[must_use]
    pub fn new(
        robot: &'a Robot,
        columns: &'a KeptColumns,
        conditioned: &'a Conditioned,
        jumps: &'a [Jump],
        samples: &Samples,
    ) -> Self {
        let excitation = |row: &usize| samples.stage[*row] == Stage::Excitation;
        let rows = conditioned.observed_rows().filter(excitation).collect();
        let step = row_step(conditioned.cutoff, conditioned.sample_rate);
        Self { robot, columns, conditioned, jumps, rows, step }
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
            self.conditioned.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
            joint_torque_regressor(self.robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
            smear(self.jumps, row, &mut y);
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

/// Folds single rows into a triangular factor, block by block.
pub(super) struct RowFolder {
    factor: TriangularFactor,
    block: Vec<f64>,
    filled: usize,
}

impl RowFolder {
    /// For `columns` columns of `w`.
    pub fn new(columns: usize) -> Self {
        Self {
            factor: TriangularFactor::new(columns),
            block: vec![0.0; BLOCK_ROWS * (columns + 1)],
            filled: 0,
        }
    }

    /// Adds the row `factor * [w | tau]`.
    pub fn push(&mut self, w: &[f64], tau: f64, factor: f64) {
        for (column, w) in self.block.chunks_exact_mut(BLOCK_ROWS).zip(w.iter().chain([&tau])) {
            column[self.filled] = factor * w;
        }
        self.filled += 1;
        if self.filled == BLOCK_ROWS {
            self.fold();
        }
    }

    /// The factor of all rows.
    pub fn finish(mut self) -> TriangularFactor {
        if self.filled > 0 {
            self.fold();
        }
        self.factor
    }

    fn fold(&mut self) {
        let width = self.factor.columns() + 1;
        let block = MatRef::from_column_major_slice(&self.block, BLOCK_ROWS, width);
        self.factor.fold(block.subrows(0, self.filled));
        self.filled = 0;
    }
}

/// Triangular factor of each joint's rows, `[n]`.
#[must_use]
pub fn joint_factors(source: &dyn RowSource) -> Vec<TriangularFactor> {
    let n = source.joint_count();
    let mut folders: Vec<RowFolder> = (0..n).map(|_| RowFolder::new(source.columns())).collect();
    source.each(&mut |sample| {
        for (j, folder) in folders.iter_mut().enumerate().filter(|(j, _)| sample.used[*j]) {
            folder.push(sample.of_joint(j), sample.tau[j], 1.0);
        }
    });
    folders.into_iter().map(RowFolder::finish).collect()
}
