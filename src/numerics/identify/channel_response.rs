//! What a torque or position channel that reads wrong does to identified parameters.
//!
//! A fault adds a torque `f` to that which the model explains: `g tau_j` for a gain of joint `j`, a constant for an
//! offset, `-delta d tau/d q_j` for a position that reads `delta` too much. Weighted least squares take of it
//! `A⁻¹ sum_i w_i W_iᵀ f_i` into the parameters, with `A = sum_i w_i W_iᵀ W_i` over the joints' rows `W_i` and weights
//! `w_i`, and leave the rest unexplained. Stored parameters of later tests can so be compared with each fault without any
//! row. The weights are one over the variance of a joint's residuals. A fault adds to it, so the answer is computed for
//! some strengths of the fault ([`STRENGTHS`]), with the weights that go with each.

use nalgebra::{DMatrix, DVector};

use super::filtered_columns::{FilteredColumn, write_filtered_columns};
use crate::analysis::response::{ChannelFault, ChannelResponse, FaultResponse, STRENGTHS};
use crate::analysis::{Estimator, Identification, Motion};
use crate::numerics::model::dynamics::DynamicModel;
use crate::numerics::model::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use crate::numerics::signal::filter::{FilteredSignals, state};
use crate::robot::{JointIndex, ParameterId, Robot};
use crate::run::{Samples, Stage};

/// Instants that the response is taken from: many more than parameters, and few against a cycle.
const INSTANTS: usize = 1000;
/// A fault of this size, a million times the torque or in Nm or rad, is none.
const MOST_SIZE: f64 = 1e6;
/// Rounds in which weights and unexplained torque of a strong fault settle.
const ROUNDS: usize = 6;
/// Step of the derivative by a position, rad (m).
const STEP: f64 = 1e-4;

/// The rows of a cycle.
#[derive(Debug, Clone, Copy)]
pub struct ObservedCycle<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// Columns of the kept parameters, `[b]`.
    pub columns: &'a KeptColumns,
    /// Channels.
    pub filtered: &'a FilteredSignals,
    /// Columns that jump.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Stages.
    pub samples: &'a Samples,
}

/// The response of the parameters `found` of a cycle, from a thousand instants of its excitation, evenly spaced.
/// `None` where these instants do not show every parameter.
#[must_use]
pub fn channel_response(
    cycle: &ObservedCycle<'_>,
    found: &Identification,
    estimator: Estimator,
) -> Option<ChannelResponse> {
    let n = cycle.robot.joint_count();
    let deviations: Vec<f64> = found.residuals.iter().map(|of| of.std.max(f64::MIN_POSITIVE)).collect();
    let deviations = (estimator != Estimator::Ordinary && deviations.len() == n).then_some(&deviations[..]);
    let mut sums = Sums::new(n, found.parameters.len());
    sums.add_rows(cycle, found);
    let responses = sums.solve(deviations)?;
    let parameters: Vec<ParameterId> = found.parameters.iter().map(|of| of.id).collect();
    Some(ChannelResponse { parameters, faults: responses })
}

/// Sums over the rows of each joint.
struct Sums {
    n: usize,
    /// `W_iᵀ W_i`, `[n]` of `[b x b]`.
    gram: Vec<DMatrix<f64>>,
    /// `W_iᵀ f`, `[n]` of `[b x 3 n]`: faults in the order of [`ChannelFault::ALL`], of each the joints.
    with_fault: Vec<DMatrix<f64>>,
    /// `fᵀ f`, `[n x 3 n]`.
    fault_squares: DMatrix<f64>,
    torque_squares: Vec<f64>,
    rows: Vec<usize>,
}

impl Sums {
    fn new(n: usize, b: usize) -> Self {
        let faults = ChannelFault::ALL.len() * n;
        Self {
            n,
            gram: vec![DMatrix::zeros(b, b); n],
            with_fault: vec![DMatrix::zeros(b, faults); n],
            fault_squares: DMatrix::zeros(n, faults),
            torque_squares: vec![0.0; n],
            rows: vec![0; n],
        }
    }

    fn add_rows(&mut self, cycle: &ObservedCycle<'_>, found: &Identification) {
        let ObservedCycle { robot, columns, filtered, filtered_coulomb_columns, samples } = *cycle;
        let (n, b) = (self.n, columns.len());
        let parameters = found.parameters.iter().map(|of| (of.id, of.value));
        let model = DynamicModel::from_parameters(robot, parameters);
        let excitation = |row: &usize| samples.stage[*row] == Stage::Excitation;
        let rows: Vec<usize> = filtered.observed_rows().filter(excitation).collect();
        let mut y = Regressor::new(robot);
        let (mut q, mut qd, mut qdd, mut tau) = state();
        let mut block = vec![0.0; n * b];
        let mut row_of_joint = DVector::zeros(b);
        let (mut above, mut below) = (vec![0.0; n], vec![0.0; n]);
        let mut by_position = DMatrix::zeros(n, n);
        for &row in rows.iter().step_by(rows.len().div_ceil(INSTANTS).max(1)) {
            filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
            joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
            write_filtered_columns(filtered_coulomb_columns, row, &mut y);
            columns.write(&y, &mut block, n, 0);
            for j in 0..n {
                let read = q[j];
                q[j] = read + STEP;
                model.torque(robot, &q[..n], &qd[..n], &qdd[..n], &mut above);
                q[j] = read - STEP;
                model.torque(robot, &q[..n], &qd[..n], &qdd[..n], &mut below);
                q[j] = read;
                for i in 0..n {
                    by_position[(i, j)] = (above[i] - below[i]) / (2.0 * STEP);
                }
            }
            for (i, joint) in robot.joints.iter().enumerate() {
                if Motion::of(qd[i], joint.low_speed) != Motion::Moving {
                    continue;
                }
                (0..b).for_each(|k| row_of_joint[k] = block[k * n + i]);
                self.gram[i].ger(1.0, &row_of_joint, &row_of_joint, 1.0);
                self.torque_squares[i] += tau[i] * tau[i];
                self.rows[i] += 1;
                let own = [(i, tau[i]), (n + i, 1.0)].into_iter();
                for (fault, torque) in own.chain((0..n).map(|j| (2 * n + j, -by_position[(i, j)]))) {
                    self.with_fault[i].column_mut(fault).axpy(torque, &row_of_joint, 1.0);
                    self.fault_squares[(i, fault)] += torque * torque;
                }
            }
        }
    }

    /// `deviations` `[n]` are those of the joints' residuals, Nm (N); `None` where rows are not weighed.
    fn solve(&self, deviations: Option<&[f64]>) -> Option<Vec<FaultResponse>> {
        let mut all = Vec::new();
        for (place, fault) in ChannelFault::ALL.into_iter().enumerate() {
            for (strength, times) in STRENGTHS.into_iter().enumerate() {
                for joint in 0..self.n {
                    let (change, left) = self.answer(place * self.n + joint, deviations, times)?;
                    let relative = |i: usize| left[i] / self.torque_rms(i);
                    all.push(FaultResponse {
                        joint: JointIndex::new(joint),
                        fault,
                        strength,
                        unexplained: (0..self.n).map(relative).collect(),
                        change: change.iter().copied().collect(),
                    });
                }
            }
        }
        let is_finite = |of: &FaultResponse| of.change.iter().chain(&of.unexplained).all(|x| x.is_finite());
        all.iter().all(is_finite).then_some(all)
    }

    /// Change of the parameters and torque of each joint that is left unexplained, root mean square, Nm (N), for a fault of
    /// size 1, where the fault is so large that it leaves of some joint `times` what is usual.
    fn answer(
        &self,
        column: usize,
        deviations: Option<&[f64]>,
        times: f64,
    ) -> Option<(DVector<f64>, Vec<f64>)> {
        let Some(usual) = deviations else { return self.weighed(column, &vec![1.0; self.n]) };
        let weights = |size: f64, left: &[f64]| -> Vec<f64> {
            usual.iter().zip(left).map(|(usual, left)| usual.hypot(size * left).powi(-2)).collect()
        };
        let (mut change, mut left) = self.weighed(column, &weights(0.0, &vec![0.0; self.n]))?;
        for _ in 0..if times > 0.0 { ROUNDS } else { 0 } {
            let most = left.iter().zip(usual).map(|(left, usual)| left / usual).fold(0.0, f64::max);
            // parameters that take up a fault of any size, and weights so unequal that nothing can be solved
            let size = times / most;
            let Some(next) = self.weighed(column, &weights(size, &left)).filter(|_| size < MOST_SIZE) else {
                break;
            };
            (change, left) = next;
        }
        Some((change, left))
    }

    fn weighed(&self, column: usize, weights: &[f64]) -> Option<(DVector<f64>, Vec<f64>)> {
        let b = self.gram.first()?.nrows();
        let (mut normal, mut right) = (DMatrix::zeros(b, b), DVector::zeros(b));
        for ((gram, with_fault), weight) in self.gram.iter().zip(&self.with_fault).zip(weights) {
            normal += gram * *weight;
            right.axpy(*weight, &with_fault.column(column), 1.0);
        }
        // columns of length one, so that the factor is as well conditioned as it can be
        let scale = normal.diagonal().map(|of| of.max(f64::MIN_POSITIVE).sqrt().recip());
        let scaled = DMatrix::from_fn(b, b, |i, k| normal[(i, k)] * scale[i] * scale[k]);
        let change = scaled.cholesky()?.solve(&right.component_mul(&scale)).component_mul(&scale);
        let left = |i: usize| {
            let squares = self.fault_squares[(i, column)]
                - 2.0 * change.dot(&self.with_fault[i].column(column))
                + change.dot(&(&self.gram[i] * &change));
            (squares.max(0.0) / self.rows[i].max(1) as f64).sqrt()
        };
        let left = (0..self.n).map(left).collect();
        Some((change, left))
    }

    fn torque_rms(&self, joint: usize) -> f64 {
        (self.torque_squares[joint] / self.rows[joint].max(1) as f64).sqrt().max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::IdentifiedParameter;
    use crate::numerics::analyse::{AnalysisSettings, Method, analyse_cycle};
    use crate::run::Cycle;
    use crate::simulate::matched_model::{ExactSettings, record_excitation};
    use crate::testing::er3a;

    /// Parameters and response by the whole analysis.
    fn analysed(samples: &Samples) -> (Vec<IdentifiedParameter>, Option<ChannelResponse>) {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let analysis = analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() });
        let found = analysis.identification.expect("parameters");
        (found.parameters, analysis.response)
    }

    /// A recording is changed, identified anew by the whole analysis, and compared with the response of the first one.
    #[test]
    fn a_response_is_what_identification_of_the_changed_recording_gives() {
        let original = record_excitation(&er3a(), &ExactSettings::default()).expect("a recording");
        let (before, response) = analysed(&original);
        let response = response.expect("a response");
        let mut worst = 0.0_f64;
        for (fault, joint, size) in [
            (ChannelFault::TorqueGain, 2, 0.02),
            (ChannelFault::TorqueGain, 4, 0.1),
            (ChannelFault::TorqueOffset, 1, 0.3),
            (ChannelFault::TorqueOffset, 1, 6.0),
            (ChannelFault::PositionOffset, 1, 0.004),
            (ChannelFault::PositionOffset, 3, 0.01),
        ] {
            let mut changed = original.clone();
            let add = |channel: &mut Vec<f64>| channel.iter_mut().for_each(|of| *of += size);
            match fault {
                ChannelFault::TorqueGain => {
                    changed.torque[joint].iter_mut().for_each(|of| *of *= 1.0 + size);
                }
                ChannelFault::TorqueOffset => add(&mut changed.torque[joint]),
                ChannelFault::PositionOffset => add(&mut changed.position[joint]),
            }
            let (after, _) = analysed(&changed);
            let missed = |of: &FaultResponse| {
                let (mut error, mut all) = (0.0, 0.0);
                for ((after, before), predicted) in after.iter().zip(&before).zip(&of.change) {
                    let change = (after.value - before.value) / before.std_error;
                    error += (change - size * predicted / before.std_error).powi(2);
                    all += change * change;
                }
                (error / all).sqrt()
            };
            let of = |of: &&FaultResponse| of.fault == fault && of.joint.index() == joint;
            let missed: Vec<f64> = response.faults.iter().filter(of).map(missed).collect();
            println!("{fault:?} of joint {joint}, {size}: {missed:.3?} of the change missed");
            worst = missed.iter().copied().fold(1.0, f64::min).max(worst);
        }
        assert!(worst < 0.15, "{worst}");
    }
}
