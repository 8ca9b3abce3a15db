//! Rows of single joints with the torques of all joints, and fits of single joints.

use super::joint_fit::JointFit;
use crate::identify::filtered_columns::{FilteredColumn, write_filtered_columns};
use crate::identify::joint_factors::{FactorColumns, Factored, used_for_identification};
use crate::least_squares::factor::{FactorBuilder, TriangularFactor};
use crate::model::regressor::{Regressor, joint_torque_regressor};
use crate::signal::filter::FilteredSignals;
use armwatch_model::robot::{FrictionTerm, JointIndex, MAX_JOINTS, ParameterId, ParameterKind, Robot};

/// Smallest standard deviation of a torque's error, relative to its RMS: no model is more accurate.
const LEAST_ERROR: f64 = 0.02;
/// The same for a joint with too few rows for a separate fit.
const UNKNOWN_ERROR: f64 = 0.1;
/// Instants for the search of directions and changes.
pub(super) const COARSE_INSTANTS: usize = 100;
/// Number of postures for mean inertias.
const POSTURES: usize = 6;
/// Smallest number of rows per column in a fit of one joint.
const ROWS_PER_COLUMN: usize = 2;

/// Data of a cycle for the assignment of torques to joints.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channels<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a FactorColumns,
    /// Columns `[b]` of the regressor to be identified.
    pub kept_columns: &'a [usize],
    /// Signals of the cycle after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Low-passed columns of the regressor with jumps.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Factors of the cycle.
    pub factored: &'a Factored,
    /// Usable rows of the excitation, in order.
    pub excitation: &'a [usize],
}

/// Fit of one joint to one torque.
#[derive(Debug, Clone, Copy)]
pub(super) struct OwnFit {
    /// Standard deviation of the error, Nm (N).
    pub(super) sigma: f64,
    /// Standard deviation relative to the RMS torque.
    pub(super) relative: f64,
    /// Weighted squares that remain.
    pub(super) misfit: f64,
}

/// Fit of one joint: `left` squares of `rows` rows remain after `columns` columns, of `all` squares of the torque.
fn own_fit(left: f64, all: f64, rows: f64, columns: usize) -> Option<OwnFit> {
    let rms = (all / rows).sqrt();
    let judged = rows >= (ROWS_PER_COLUMN * columns) as f64;
    let error = if judged { (left / (rows - columns as f64)).sqrt() } else { UNKNOWN_ERROR * rms };
    let sigma = error.max(LEAST_ERROR * rms);
    let relative = if judged { error / rms } else { 0.0 };
    (rms > 0.0 && sigma.is_finite()).then(|| OwnFit {
        sigma,
        relative,
        misfit: rows.min(left.max(0.0) / sigma.powi(2)),
    })
}

/// Rows of one joint in a fit of all.
struct JointFitRows<'a> {
    factor: &'a TriangularFactor,
    /// Column of the joint's torque.
    torque: usize,
    /// Standard deviation of the torque's error, Nm (N), as recorded.
    sigma: f64,
    /// Ratio of the recorded to the true torque.
    scale: f64,
}

/// Fits of each joint to each torque over rows with a moving joint, `[joints][torques]`.
pub(super) struct FitErrors(Vec<Vec<Option<OwnFit>>>);

impl FitErrors {
    /// Error of each torque in the fit of the joint that explains it best.
    pub(super) fn least(&self) -> Vec<f64> {
        let n = self.0.len();
        let sigma = |of: &Vec<Option<OwnFit>>, torque: usize| of[torque].map_or(f64::INFINITY, |of| of.sigma);
        let least = |torque| self.0.iter().map(|of| sigma(of, torque)).fold(f64::INFINITY, f64::min);
        (0..n).map(least).collect()
    }

    /// Fit of each joint to its own torque; `None` if one is not possible.
    pub(super) fn own(&self) -> Option<Vec<OwnFit>> {
        self.0.iter().enumerate().map(|(joint, of)| of[joint]).collect()
    }

    /// Returns true if each of two joints explains the torque of the other better.
    pub(super) fn are_swapped(&self, a: usize, b: usize) -> bool {
        let of = |joint: usize, torque: usize| self.0[joint][torque].map_or(f64::INFINITY, |of| of.sigma);
        of(a, b) * of(b, a) < of(a, a) * of(b, b)
    }
}

impl Channels<'_> {
    fn factor(&self, joint: JointIndex) -> Option<&TriangularFactor> {
        let of = |of: &&crate::identify::joint_factors::JointFactor| {
            of.joint == joint && used_for_identification(of.stage, of.motion)
        };
        self.factored
            .factors
            .iter()
            .find(of)
            .map(|of| &of.factor)
            .filter(|of| of.is_finite() && of.rows() > 0)
    }

    pub(super) fn own_fits(&self) -> Vec<Option<OwnFit>> {
        let fit = |joint: JointIndex| {
            let factor = self.factor(joint)?;
            let b = factor.columns();
            let left = factor.upper()[(b, b)].powi(2);
            own_fit(left, factor.torque_sum_of_squares(), factor.rows() as f64, b)
        };
        self.robot.joint_indices().map(fit).collect()
    }

    /// Fit of all joints to their own torques, from stored factors.
    pub(super) fn stored_fit(&self, fits: &[Option<OwnFit>], bounds: &[Vec<f64>]) -> JointFit {
        let own = |joint: JointIndex| {
            let factor = self.factor(joint)?;
            Some(JointFitRows {
                factor,
                torque: factor.columns(),
                sigma: fits[joint.index()]?.sigma,
                scale: 1.0,
            })
        };
        self.stacked(&self.robot.joint_indices().map(own).collect::<Vec<_>>(), bounds)
    }

    /// Fit of all joints to the torques that `order` assigns to them. `scales` are the ratios of the recorded to the
    /// true torques.
    pub(super) fn ordered_fit(
        &self,
        factors: &[TriangularFactor],
        sigma: &[f64],
        order: &[usize],
        scales: &[f64],
        bounds: &[Vec<f64>],
    ) -> JointFit {
        let n = order.len();
        let parts: Vec<Option<JointFitRows<'_>>> = factors
            .iter()
            .zip(order)
            .zip(scales)
            .map(|((factor, &torque), &scale)| {
                let column = factor.columns() + 1 - n + torque;
                Some(JointFitRows { factor, torque: column, sigma: sigma[torque], scale })
            })
            .collect();
        self.stacked(&parts, bounds)
    }

    /// Fit of all joints from factors of single joints, each with the column of its torque and the standard deviation
    /// of the error.
    fn stacked(&self, parts: &[Option<JointFitRows<'_>>], bounds: &[Vec<f64>]) -> JointFit {
        let (b, n) = (self.kept_columns.len(), parts.len());
        let mut builder = FactorBuilder::new(b + n - 1);
        let mut row = vec![0.0; b + n];
        for (joint, part) in self.robot.joint_indices().zip(parts) {
            let Some(JointFitRows { factor, torque, sigma, scale }) = part else { continue };
            let (upper, places) = (factor.upper(), self.columns.places(joint));
            for i in 0..upper.nrows() {
                row.fill(0.0);
                places.iter().enumerate().for_each(|(k, &place)| row[place] = upper[(i, k)] * scale / sigma);
                row[b + joint.index()] = upper[(i, *torque)] / sigma;
                builder.push(row.iter().copied());
            }
        }
        JointFit::new(&builder.take(), b, n, bounds)
    }

    /// Rows of the excitation, at most `instants`.
    pub(super) fn rows(&self, instants: usize) -> Vec<usize> {
        let apart = (self.filtered.sample_rate / (2.0 * self.filtered.cutoff)).ceil().max(1.0) as usize;
        let stride = apart.max(self.excitation.len().div_ceil(instants));
        self.excitation.iter().copied().step_by(stride).collect()
    }

    /// Mean power of friction and mean inertia of each joint as sums of the parameters of `columns`, which are never
    /// negative.
    pub(super) fn bounds(&self, robot: &Robot, columns: &[usize]) -> Vec<Vec<f64>> {
        [self.friction_bounds(columns), self.inertia_bounds(robot, columns)].concat()
    }

    /// Mean power of friction of each joint, which does not depend on the description of the arm.
    pub(super) fn friction_bounds(&self, columns: &[usize]) -> Vec<Vec<f64>> {
        let robot = self.robot;
        let order = ParameterId::natural_order(robot);
        let place = |column: usize| match order[column].kind {
            // an offset of the torque signal is no friction, whatever its sign
            ParameterKind::Friction(term) if term != FrictionTerm::Offset => {
                Some(order[column].joint.index())
            }
            _ => None,
        };
        let mut bounds = vec![vec![0.0; columns.len()]; robot.joint_count()];
        let mut y = Regressor::new(robot);
        let mut state = ChannelInstant::default();
        for &row in &self.rows(COARSE_INSTANTS) {
            self.regressor(robot, row, &mut state, &mut y);
            for (k, &column) in columns.iter().enumerate() {
                let Some(j) = place(column) else { continue };
                if state.qd[j].abs() >= robot.joints[j].counted_speed() {
                    bounds[j][k] += state.qd[j] * y.column(column)[j];
                }
            }
        }
        bounds
    }

    /// Mean inertia of each joint of a robot.
    pub(super) fn inertia_bounds(&self, robot: &Robot, columns: &[usize]) -> Vec<Vec<f64>> {
        let n = robot.joint_count();
        let mut bounds = vec![vec![0.0; columns.len()]; n];
        let (mut y, mut resting) = (Regressor::new(robot), Regressor::new(robot));
        let mut state = ChannelInstant::default();
        let still = [0.0; MAX_JOINTS];
        for &row in &self.rows(POSTURES) {
            self.filtered.row(row, &mut state.q, &mut state.qd, &mut state.qdd, &mut state.tau);
            let q = &state.q[..n];
            joint_torque_regressor(robot, q, &still[..n], &still[..n], &mut resting);
            for j in 0..n {
                let mut unit = still;
                unit[j] = 1.0;
                joint_torque_regressor(robot, q, &still[..n], &unit[..n], &mut y);
                for (sum, &column) in bounds[j].iter_mut().zip(columns) {
                    *sum += y.column(column)[j] - resting.column(column)[j];
                }
            }
        }
        bounds
    }

    pub(super) fn regressor(&self, robot: &Robot, row: usize, state: &mut ChannelInstant, y: &mut Regressor) {
        let n = robot.joint_count();
        state.row = row;
        let ChannelInstant { q, qd, qdd, tau, .. } = state;
        self.filtered.row(row, q, qd, qdd, tau);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], y);
        write_filtered_columns(self.filtered_coulomb_columns, row, y);
    }

    /// Factor of each joint's columns with the torques of all joints, over its moving rows.
    pub(super) fn factors(&self, rows: &[usize]) -> Vec<TriangularFactor> {
        let n = self.robot.joint_count();
        let mut y = Regressor::new(self.robot);
        let mut state = ChannelInstant::default();
        let mut builders: Vec<(Vec<usize>, FactorBuilder)> = self
            .robot
            .joint_indices()
            .map(|joint| {
                let columns: Vec<usize> =
                    self.columns.places(joint).iter().map(|&place| self.kept_columns[place]).collect();
                let builder = FactorBuilder::new(columns.len() + n - 1);
                (columns, builder)
            })
            .collect();
        for &row in rows {
            self.regressor(self.robot, row, &mut state, &mut y);
            for (j, (columns, builder)) in builders.iter_mut().enumerate() {
                if state.qd[j].abs() >= self.robot.joints[j].counted_speed() {
                    let entries = columns.iter().map(|&column| y.column(column)[j]);
                    builder.push(entries.chain(state.tau[..n].iter().copied()));
                }
            }
        }
        builders.iter_mut().map(|(_, builder)| builder.take()).collect()
    }

    pub(super) fn errors(&self, factors: &[TriangularFactor]) -> FitErrors {
        let n = factors.len();
        let of_joint = |factor: &TriangularFactor| -> Vec<Option<OwnFit>> {
            let (upper, b) = (factor.upper(), factor.columns() + 1 - n);
            let squares = |torque: usize, from: usize| -> f64 {
                (from..=b + torque).map(|i| upper[(i, b + torque)].powi(2)).sum()
            };
            let error = |torque| own_fit(squares(torque, b), squares(torque, 0), factor.rows() as f64, b);
            (0..n).map(error).collect()
        };
        FitErrors(factors.iter().map(of_joint).collect())
    }
}

/// State of all joints at one instant.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ChannelInstant {
    pub(super) row: usize,
    pub(super) q: [f64; MAX_JOINTS],
    pub(super) qd: [f64; MAX_JOINTS],
    pub(super) qdd: [f64; MAX_JOINTS],
    pub(super) tau: [f64; MAX_JOINTS],
}
