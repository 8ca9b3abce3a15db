//! Effect of a wrong torque or position channel on identified parameters.
//!
//! A fault adds a torque `f` to the torque that the model explains: `g tau_j` for a gain of joint `j`, a constant
//! for an offset, `-delta d tau/d q_j` for a position that is `delta` too large. Weighted least squares put
//! `A⁻¹ sum_i w_i W_iᵀ f_i` of it into the parameters, with `A = sum_i w_i W_iᵀ W_i` over the joints' rows `W_i`
//! and weights `w_i`, and leave the rest unexplained. So stored parameters of later tests can be compared with each
//! fault without any row. The weights are the inverse variances of the joints' residuals. A fault adds to this
//! variance, so the response is computed for some strengths of the fault ([`STRENGTHS`]), each with its own
//! weights. A change of weights alone also moves the parameters if the joints' rows disagree about them.

use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, MatRef, Side};

use super::filtered_columns::FilteredColumn;
use super::row_lanes::RowLanes;
use crate::model::dynamics::DynamicModel;
use crate::model::dynamics_lanes::torque_slopes;
use crate::model::regressor::KeptColumns;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse, STRENGTHS};
use armwatch_model::analysis::{Estimator, Identification, Motion};
use armwatch_model::robot::{JointIndex, ParameterId, Robot};
use armwatch_model::run::{Samples, Stage};

/// Number of instants for the response: far more than parameters, and few relative to a cycle.
const INSTANTS: usize = 1000;
/// Upper limit of the size of a fault, relative to the torque or in Nm or rad.
const MOST_SIZE: f64 = 1e6;
/// Iterations of the weights and the unexplained torque of a strong fault.
const ROUNDS: usize = 6;
/// Step of the derivative with respect to a position, rad (m).
const STEP: f64 = 1e-4;

/// The rows of a cycle.
#[derive(Debug, Clone, Copy)]
pub struct ObservedCycle<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// Columns of the kept parameters, `[b]`.
    pub columns: &'a KeptColumns,
    /// Signals after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Columns with jumps.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Recorded rows with their stages.
    pub samples: &'a Samples,
}

/// Response of the parameters `found` of a cycle, from a thousand evenly spaced instants of its excitation. `None` if
/// these instants do not show every parameter.
#[must_use]
pub fn channel_response(
    cycle: &ObservedCycle<'_>,
    found: &Identification,
    estimator: Estimator,
) -> Option<ChannelResponse> {
    let n = cycle.robot.joint_count();
    let deviations: Vec<f64> = found.residuals.iter().map(|of| of.std.max(f64::MIN_POSITIVE)).collect();
    let deviations = (estimator != Estimator::Ordinary && deviations.len() == n).then_some(&deviations[..]);
    let responses = ResponseSums::over(cycle, found).solve(deviations)?;
    let parameters: Vec<ParameterId> = found.parameters.iter().map(|of| of.id).collect();
    Some(ChannelResponse { parameters, faults: responses })
}

/// Rows of one joint at the instants of the response, row by row.
#[derive(Default)]
struct ResponseRows {
    /// `[b]` per row.
    w: Vec<f64>,
    /// Torque of each fault at this joint, `[2 + n]` per row: its gain, its offset, all positions.
    faults: Vec<f64>,
    torque_squares: f64,
    rows: usize,
}

/// Sums over the rows of one joint.
struct JointResponseSums {
    /// Columns that are not zero: a joint depends on its link and the outer links.
    columns: Vec<usize>,
    /// `W_iᵀ W_i` of these columns, `[k x k]`.
    gram: Mat<f64>,
    /// `W_iᵀ f`, `[k x (2 + n)]`: faults in the order of [`ResponseRows::faults`].
    with_fault: Mat<f64>,
    /// `fᵀ f`, `[2 + n]`.
    fault_squares: Vec<f64>,
    torque_squares: f64,
    rows: usize,
}

impl JointResponseSums {
    fn of(rows: &ResponseRows, b: usize, n: usize) -> Self {
        let all = MatRef::from_row_major_slice(&rows.w, rows.rows, b);
        let columns: Vec<usize> = (0..b).filter(|&k| all.col(k).iter().any(|w| *w != 0.0)).collect();
        let w = Mat::from_fn(rows.rows, columns.len(), |i, k| all[(i, columns[k])]);
        let faults = MatRef::from_row_major_slice(&rows.faults, rows.rows, 2 + n).to_owned();
        Self {
            gram: w.transpose() * &w,
            with_fault: w.transpose() * &faults,
            fault_squares: (0..2 + n).map(|k| faults.col(k).squared_norm_l2()).collect(),
            columns,
            torque_squares: rows.torque_squares,
            rows: rows.rows,
        }
    }

    /// Entries of the parameters' `change` at this joint's columns.
    fn felt(&self, change: &[f64]) -> Mat<f64> {
        Mat::from_fn(self.columns.len(), 1, |k, _| change[self.columns[k]])
    }

    fn mean_square(&self, squares: f64) -> f64 {
        squares / self.rows.max(1) as f64
    }
}

/// Sums over the rows of all joints.
struct ResponseSums {
    /// Number of parameters.
    b: usize,
    joints: Vec<JointResponseSums>,
}

/// Solved normal equations for some weights.
struct Normal {
    factor: Llt<f64>,
    /// Scale that gives columns the length one, for the best conditioning of the factor.
    scale: Vec<f64>,
}

/// Effect of a fault of size 1.
struct UnitFaultEffect {
    /// Change of the parameters, `[b]`.
    change: Vec<f64>,
    /// Change of the parameters from the weights alone, `[b]`; empty with the usual weights.
    shift: Vec<f64>,
    /// Root mean square of the unexplained torque of each joint, Nm (N), `[n]`.
    left: Vec<f64>,
}

impl ResponseSums {
    fn over(cycle: &ObservedCycle<'_>, found: &Identification) -> Self {
        let ObservedCycle { robot, columns, filtered, filtered_coulomb_columns, samples } = *cycle;
        let (n, b) = (robot.joint_count(), columns.len());
        let parameters = found.parameters.iter().map(|of| (of.id, of.value));
        let model = DynamicModel::from_parameters(robot, parameters);
        let excitation = |row: &usize| samples.stage[*row] == Stage::Excitation;
        let observed: Vec<usize> = filtered.observed_rows().filter(excitation).collect();
        let chosen = observed.iter().copied().step_by(observed.len().div_ceil(INSTANTS).max(1));
        let mut of_joints: Vec<ResponseRows> = (0..n).map(|_| ResponseRows::default()).collect();
        let mut lanes = RowLanes::new(robot);
        lanes.each(robot, filtered, filtered_coulomb_columns, chosen, |at, taken| {
            let slopes = torque_slopes(robot, &model, &at.states, STEP);
            for lane in 0..taken.len() {
                for (i, (joint, rows)) in robot.joints.iter().zip(&mut of_joints).enumerate() {
                    if Motion::of(at.states.qd[i].0[lane], joint.counted_speed()) != Motion::Moving {
                        continue;
                    }
                    let torque = at.tau[i].0[lane];
                    rows.w.extend(columns.columns().iter().map(|&column| at.y.get(i, column).0[lane]));
                    rows.faults.extend([torque, 1.0]);
                    rows.faults.extend(slopes[..n].iter().map(|of| -of[i].0[lane]));
                    rows.torque_squares += torque * torque;
                    rows.rows += 1;
                }
            }
        });
        Self { b, joints: of_joints.iter().map(|rows| JointResponseSums::of(rows, b, n)).collect() }
    }

    /// Solves for all faults. `deviations` `[n]` are the standard deviations of the joints' residuals, Nm (N); `None`
    /// if rows have no weights.
    fn solve(&self, deviations: Option<&[f64]>) -> Option<Vec<FaultResponse>> {
        let first = match deviations {
            Some(usual) => weights(usual, 0.0, &vec![0.0; usual.len()]),
            None => vec![1.0; self.joints.len()],
        };
        let usual = self.normal(&first)?;
        let mut all = Vec::new();
        for fault in ChannelFault::ALL {
            for (strength, times) in STRENGTHS.into_iter().enumerate() {
                for joint in 0..self.joints.len() {
                    let answer = self.answer(&usual, &first, (fault, joint), deviations, times)?;
                    let relative = |(of, left): (&JointResponseSums, &f64)| {
                        left / of.mean_square(of.torque_squares).sqrt().max(f64::MIN_POSITIVE)
                    };
                    all.push(FaultResponse {
                        joint: JointIndex::new(joint),
                        fault,
                        strength,
                        unexplained: self.joints.iter().zip(&answer.left).map(relative).collect(),
                        shift: answer.shift,
                        change: answer.change,
                    });
                }
            }
        }
        let is_finite = |of: &FaultResponse| of.change.iter().chain(&of.unexplained).all(|x| x.is_finite());
        all.iter().all(is_finite).then_some(all)
    }

    /// Effect of a fault so large that it leaves, at some joint, `times` the usual residual. `first` are the weights
    /// without the fault.
    fn answer(
        &self,
        usual: &Normal,
        first: &[f64],
        of: (ChannelFault, usize),
        deviations: Option<&[f64]>,
        times: f64,
    ) -> Option<UnitFaultEffect> {
        let mut answer = self.solved(usual, first, of);
        let Some(deviations) = deviations.filter(|_| times > 0.0) else { return Some(answer) };
        let mut settled = None;
        for _ in 0..ROUNDS {
            let most =
                answer.left.iter().zip(deviations).map(|(left, usual)| left / usual).fold(0.0, f64::max);
            // stops if the parameters absorb a fault of any size, or if weights are too unequal to solve
            let size = times / most;
            let next = weights(deviations, size, &answer.left);
            let Some(normal) = self.normal(&next).filter(|_| size < MOST_SIZE) else { break };
            answer = self.solved(&normal, &next, of);
            settled = Some((normal, next));
        }
        // the other faults are known only by their direction
        if let Some((normal, next)) = settled.filter(|_| of.0 == ChannelFault::TorqueOffset) {
            let [now, before] = [self.fitted(&normal, &next), self.fitted(usual, first)];
            answer.shift = now.iter().zip(before).map(|(now, before)| now - before).collect();
        }
        Some(answer)
    }

    /// Sum of the joints' normal equations times their weights; `None` if they cannot be solved.
    fn normal(&self, weights: &[f64]) -> Option<Normal> {
        let b = self.b;
        let mut normal = Mat::<f64>::zeros(b, b);
        for (of, weight) in self.joints.iter().zip(weights) {
            for (k, &column) in of.columns.iter().enumerate() {
                for (i, &row) in of.columns.iter().enumerate().skip(k) {
                    normal[(row, column)] += of.gram[(i, k)] * weight;
                }
            }
        }
        let scale: Vec<f64> = (0..b).map(|k| normal[(k, k)].max(f64::MIN_POSITIVE).sqrt().recip()).collect();
        for k in 0..b {
            (k..b).for_each(|i| normal[(i, k)] *= scale[i] * scale[k]);
        }
        Some(Normal { factor: normal.llt(Side::Lower).ok()?, scale })
    }

    /// Parameters that fit the torque with these weights, `[b]`.
    fn fitted(&self, normal: &Normal, weights: &[f64]) -> Vec<f64> {
        // the fault of a joint's gain is its torque
        let all = (0..self.joints.len()).map(|joint| (joint, 0));
        self.parameters(normal, &self.right(weights, all))
    }

    /// Products of the weighted rows of these joints with the torque of one fault each.
    fn right(&self, weights: &[f64], faults: impl Iterator<Item = (usize, usize)>) -> Mat<f64> {
        let mut right = Mat::<f64>::zeros(self.b, 1);
        for (i, fault) in faults {
            let of = &self.joints[i];
            for (k, &column) in of.columns.iter().enumerate() {
                right[(column, 0)] += weights[i] * of.with_fault[(k, fault)];
            }
        }
        right
    }

    /// Solves the normal equations, `[b]`.
    fn parameters(&self, normal: &Normal, right: &Mat<f64>) -> Vec<f64> {
        let scaled = Mat::from_fn(self.b, 1, |k, _| right[(k, 0)] * normal.scale[k]);
        let solved = normal.factor.solve(scaled);
        (0..self.b).map(|k| solved[(k, 0)] * normal.scale[k]).collect()
    }

    fn solved(
        &self,
        normal: &Normal,
        weights: &[f64],
        (fault, joint): (ChannelFault, usize),
    ) -> UnitFaultEffect {
        let place = |i: usize| match fault {
            ChannelFault::TorqueGain => (i == joint).then_some(0),
            ChannelFault::TorqueOffset => (i == joint).then_some(1),
            ChannelFault::PositionOffset => Some(2 + joint),
        };
        let faults = (0..self.joints.len()).filter_map(|i| Some((i, place(i)?)));
        let change = self.parameters(normal, &self.right(weights, faults));
        let left = |(i, of): (usize, &JointResponseSums)| {
            let felt = of.felt(&change);
            let taken = &of.gram * &felt;
            let squares = felt.col(0).transpose() * taken.col(0);
            let fault = place(i).map_or(0.0, |fault| {
                of.fault_squares[fault] - 2.0 * (felt.col(0).transpose() * of.with_fault.col(fault))
            });
            of.mean_square((fault + squares).max(0.0)).sqrt()
        };
        let left = self.joints.iter().enumerate().map(left).collect();
        UnitFaultEffect { change, shift: Vec::new(), left }
    }
}

/// Weights of the joints' rows with a fault of size `size` that leaves `left` per unit; `usual` and `left` are `[n]`.
fn weights(usual: &[f64], size: f64, left: &[f64]) -> Vec<f64> {
    usual.iter().zip(left).map(|(usual, left)| usual.hypot(size * left).powi(-2)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::{Method, analyse_cycle};
    use armwatch_model::analysis::IdentifiedParameter;
    use armwatch_model::analysis::settings::AnalysisSettings;
    use armwatch_model::run::Cycle;
    use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
    use armwatch_testing::er3a;

    /// Parameters and response from the whole analysis.
    fn analysed(samples: &Samples) -> (Vec<IdentifiedParameter>, Option<ChannelResponse>) {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let analysis = analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() });
        let found = analysis.identification.expect("parameters");
        (found.parameters, analysis.response)
    }

    /// Changes a recording, identifies it again by the whole analysis, and compares with the response of the original.
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

    /// The torque of joint 3 is 5 % too large throughout, so the joints disagree about the same masses. An offset of
    /// joint 2 reduces that joint's weight.
    #[test]
    fn weights_move_parameters_by_what_joints_say_otherwise() {
        let mut original = record_excitation(&er3a(), &ExactSettings::default()).expect("a recording");
        original.torque[2].iter_mut().for_each(|of| *of *= 1.05);
        let (before, response) = analysed(&original);
        let mut changed = original.clone();
        let size = 6.0;
        changed.torque[1].iter_mut().for_each(|of| *of += size);
        let (after, _) = analysed(&changed);
        let missed = |of: &FaultResponse, part: f64| {
            let (mut error, mut all) = (0.0, 0.0);
            for (k, (after, before)) in after.iter().zip(&before).enumerate() {
                let change = (after.value - before.value) / before.std_error;
                let predicted = size * of.change[k] + part * of.shift.get(k).copied().unwrap_or(0.0);
                error += (change - predicted / before.std_error).powi(2);
                all += change * change;
            }
            (error / all).sqrt()
        };
        let own = |of: &&FaultResponse| of.fault == ChannelFault::TorqueOffset && of.joint.index() == 1;
        let response = response.expect("a response");
        let of_part = |part: f64| response.faults.iter().filter(own).map(|of| missed(of, part)).collect();
        let [without, with]: [Vec<f64>; 2] = [0.0, 1.0].map(of_part);
        println!("missed of the change: {without:.3?} without the shift, {with:.3?} with it");
        let least = |of: &[f64]| of.iter().copied().fold(1.0, f64::min);
        assert!(least(&with) < 0.5 * least(&without), "{with:?} {without:?}");
        // the other faults and the weakest offset have only a direction
        let has_shift = |of: &&FaultResponse| !of.shift.is_empty();
        assert!(response.faults.iter().filter(has_shift).all(|of| of.strength > 0));
    }
}
