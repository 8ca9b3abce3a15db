//! Rows of `[w | tau]` that can be gone through again and again, a sample at a time, so that
//! estimators with several passes never hold the observation matrix.

use faer::MatRef;

use super::identify::state;
use super::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use super::signal::Conditioned;
use super::triangular::{BLOCK_ROWS, TriangularFactor};
use crate::robot::Robot;

/// All joints' rows of one sample.
#[derive(Debug, Clone, Copy)]
pub struct SampleRows<'a> {
    /// Row of the recording; neighbours in time differ by one.
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

/// The rows of a cycle.
#[derive(Debug)]
pub struct CycleRows<'a> {
    robot: &'a Robot,
    columns: &'a KeptColumns,
    conditioned: &'a Conditioned,
    rows: Vec<usize>,
    /// `[n][rows of the recording]`.
    used: Vec<Vec<bool>>,
}

impl<'a> CycleRows<'a> {
    /// The given rows of a cycle, rising.
    ///
    /// A joint's row takes part if the joint is faster than its low-speed threshold, and has been and
    /// stays so for `guard` seconds. Coulomb friction jumps where the motion turns round; the low-pass
    /// smears the jump in the torque, but not the sign in the regressor, and the rows beside the jump
    /// would pull friction towards zero. [`reversal_guard`] gives the guard for a low-pass.
    #[must_use]
    pub fn new(
        robot: &'a Robot,
        columns: &'a KeptColumns,
        conditioned: &'a Conditioned,
        rows: impl Iterator<Item = usize>,
        guard: f64,
    ) -> Self {
        let guard_rows = (guard * conditioned.sample_rate).round().max(0.0) as usize;
        let used = robot
            .joints
            .iter()
            .zip(&conditioned.qd)
            .map(|(joint, qd)| far_from_turns(qd, joint.low_speed, guard_rows))
            .collect();
        Self { robot, columns, conditioned, rows: rows.collect(), used }
    }
}

/// Seconds beside a turn of the motion in which a low-pass at `cutoff` Hz smears the torque: half a
/// period of the cut-off takes the slope and the first overshoot of the step response.
#[must_use]
pub fn reversal_guard(cutoff: f64) -> f64 {
    0.5 / cutoff
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
            self.columns.write(&y, &mut block, n, 0);
            for j in 0..n {
                used[j] = self.used[j][row];
                for k in 0..b {
                    w[j * b + k] = block[k * n + j];
                }
            }
            visit(&SampleRows { row, w: &w, tau: &tau[..n], used: &used });
        }
    }
}

/// Rows further than `guard` rows from any that is slow or changes direction.
fn far_from_turns(qd: &[f64], low_speed: f64, guard: usize) -> Vec<bool> {
    let turns = |row: usize| qd[row].abs() < low_speed || (row > 0 && qd[row] * qd[row - 1] < 0.0);
    let mut used = vec![true; qd.len()];
    for row in (0..qd.len()).filter(|&row| turns(row)) {
        let (first, last) = (row.saturating_sub(guard), (row + guard).min(qd.len() - 1));
        used[first..=last].fill(false);
    }
    used
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_beside_a_turn_are_left_out() {
        let qd: Vec<f64> = (0..41).map(|i| 0.1 * f64::from(i - 20)).collect();
        let used = far_from_turns(&qd, 0.05, 3);
        let left_out: Vec<usize> = (0..41).filter(|&row| !used[row]).collect();
        assert_eq!(left_out, (17..=23).collect::<Vec<_>>());
        let jump: Vec<f64> = (0..20).map(|i| if i < 10 { -1.0 } else { 1.0 }).collect();
        let used = far_from_turns(&jump, 0.05, 1);
        assert_eq!((0..20).filter(|&row| !used[row]).collect::<Vec<_>>(), vec![9, 10, 11]);
    }
}
