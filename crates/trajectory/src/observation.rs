//! The observation matrix of a trajectory, several instants at once: its product with itself, its triangular factor,
//! and the slope of a function of that product along the motion.

use faer::{Mat, MatRef};

use super::series::Basis;
use armwatch_method::lanes::{Kernel, Lanes, wide};
use armwatch_method::least_squares::factor::{FactorBuilder, TriangularFactor};
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes, joint_torque_regressors};
use armwatch_model::robot::{CouplingTerm, FourierExcitation, MAX_JOINTS, ParameterId, ParameterKind, Robot};

/// Steps of differences along position and velocity, rad and rad/s (m, m/s): half the digits of a number. The regressor
/// is linear in the accelerations, so that any step is exact there.
const STEP: f64 = 1e-6;
const ACCELERATION_STEP: f64 = 1.0;

/// Columns of the regressor that form the observation matrix, and the entries of each joint's row that may be nonzero.
#[derive(Debug, Clone)]
pub struct ObservationColumns<'a> {
    robot: &'a Robot,
    /// Columns of the observation matrix `[b]`, as columns of the regressor.
    columns: Vec<usize>,
    /// Entries of each joint's row that are not always zero, as indices into `columns`.
    entries: Vec<Vec<usize>>,
}

/// A row of the observation matrix for each joint at a group of instants, without entries that are always zero.
pub type JointRows = Vec<Vec<Lanes>>;

/// Derivative of a function of the motion at a group of instants: by positions, velocities, accelerations.
#[derive(Debug, Clone, Copy)]
pub struct MotionSlope {
    /// Per rad (m).
    pub q: [Lanes; MAX_JOINTS],
    /// Per rad/s (m/s).
    pub qd: [Lanes; MAX_JOINTS],
    /// Per rad/s² (m/s²).
    pub qdd: [Lanes; MAX_JOINTS],
}

impl MotionSlope {
    /// Zero derivative.
    pub const ZERO: Self =
        Self { q: [Lanes::ZERO; MAX_JOINTS], qd: [Lanes::ZERO; MAX_JOINTS], qdd: [Lanes::ZERO; MAX_JOINTS] };
}

impl<'a> ObservationColumns<'a> {
    /// The columns `chosen` of the base parameters, by their indices in [`BaseParameters::kept`].
    ///
    /// # Panics
    /// If an index is beyond the last parameter.
    pub fn new(robot: &'a Robot, base: &BaseParameters, chosen: &[usize]) -> Self {
        let kept: Vec<ParameterId> = chosen.iter().map(|&k| base.kept[k]).collect();
        let entries = robot
            .joint_indices()
            .map(|joint| (0..kept.len()).filter(|&k| shows_in(robot, kept[k], joint.index())).collect())
            .collect();
        Self { robot, columns: chosen.iter().map(|&k| base.kept_columns[k]).collect(), entries }
    }

    /// Number of columns `b`.
    pub fn columns(&self) -> usize {
        self.columns.len()
    }

    /// Indices of a joint's entries among the columns.
    pub fn entries(&self, joint: usize) -> &[usize] {
        &self.entries[joint]
    }

    /// Rows of all joints at a group of instants.
    pub fn rows(&self, states: &LaneStates, regressors: &mut RegressorLanes) -> JointRows {
        joint_torque_regressors(self.robot, states, regressors);
        let row = |(joint, entries): (usize, &Vec<usize>)| {
            entries.iter().map(|&k| regressors.get(joint, self.columns[k])).collect()
        };
        self.entries.iter().enumerate().map(row).collect()
    }

    /// The product `w' W w` of rows weighted by `weights` `[n]`, each the square of the joint's row scale; `[b x b]`.
    pub fn product(&self, rows: &[JointRows], weights: &[f64]) -> Mat<f64> {
        let b = self.columns();
        let mut product = Mat::<f64>::zeros(b, b);
        for (joint, entries) in self.entries.iter().enumerate() {
            let m = entries.len();
            let mut sums = vec![Lanes::ZERO; m * (m + 1) / 2];
            wide(Products { rows, joint, sums: &mut sums });
            let mut at = 0;
            for (i, &a) in entries.iter().enumerate() {
                for &c in &entries[i..] {
                    let sum = weights[joint] * sums[at].sum();
                    product[(a, c)] += sum;
                    if a != c {
                        product[(c, a)] += sum;
                    }
                    at += 1;
                }
            }
        }
        product
    }

    /// Triangular factor of each joint's rows over one period, `[n]`; the torque is zero.
    pub fn joint_factors(&self, series: &FourierExcitation, basis: &Basis) -> Vec<TriangularFactor> {
        let b = self.columns();
        let mut regressors = RegressorLanes::new(self.robot);
        let mut builders: Vec<FactorBuilder> = self.entries.iter().map(|_| FactorBuilder::new(b)).collect();
        for group in 0..basis.groups() {
            joint_torque_regressors(self.robot, &basis.states(series, group), &mut regressors);
            let present = basis.present(group).0.map(|present| present > 0.0);
            for (joint, builder) in builders.iter_mut().enumerate() {
                let row = self.columns.iter().map(|&column| regressors.get(joint, column));
                builder.push_lanes(row.chain([Lanes::ZERO]), present);
            }
        }
        builders.iter_mut().map(FactorBuilder::take).collect()
    }

    /// Derivative of a function of the rows at a group of instants with respect to the motion, given its derivative
    /// with respect to each entry, `slopes` of the shape of the rows.
    pub fn motion_slope(
        &self,
        states: &LaneStates,
        slopes: &JointRows,
        regressors: &mut RegressorLanes,
    ) -> MotionSlope {
        let mut along = MotionSlope::ZERO;
        let at = self.along(states, slopes, regressors);
        for joint in 0..self.robot.joint_count() {
            let mut moved = *states;
            moved.q[joint] += Lanes::splat(STEP);
            along.q[joint] = (self.along(&moved, slopes, regressors) - at) * (1.0 / STEP);

            // away from rest, where friction jumps
            let mut moved = *states;
            let steps = Lanes(states.qd[joint].0.map(|qd| STEP.copysign(qd)));
            moved.qd[joint] += steps;
            let change = self.along(&moved, slopes, regressors) - at;
            along.qd[joint] = Lanes(std::array::from_fn(|lane| change.0[lane] / steps.0[lane]));

            let mut moved = *states;
            moved.qdd[joint] += Lanes::splat(ACCELERATION_STEP);
            along.qdd[joint] = (self.along(&moved, slopes, regressors) - at) * (1.0 / ACCELERATION_STEP);
        }
        along
    }

    /// Sum of all entries, each times its slope.
    fn along(&self, states: &LaneStates, slopes: &JointRows, regressors: &mut RegressorLanes) -> Lanes {
        joint_torque_regressors(self.robot, states, regressors);
        let mut sum = Lanes::ZERO;
        for (joint, (entries, slopes)) in self.entries.iter().zip(slopes).enumerate() {
            for (&k, slope) in entries.iter().zip(slopes) {
                sum += regressors.get(joint, self.columns[k]) * *slope;
            }
        }
        sum
    }

    /// Derivative of `tr(S G)` of the product `G` of [`ObservationColumns::product`] with respect to each entry of a
    /// group's rows: `2 W w S`.
    pub fn product_slope(&self, rows: &JointRows, slope: MatRef<'_, f64>, weights: &[f64]) -> JointRows {
        let of_joint = |(joint, entries): (usize, &Vec<usize>)| {
            let row = &rows[joint];
            entries
                .iter()
                .map(|&a| {
                    let column = slope.col(a);
                    let sum = entries.iter().zip(row).fold(Lanes::ZERO, |sum, (&c, x)| sum + *x * column[c]);
                    sum * (2.0 * weights[joint])
                })
                .collect()
        };
        self.entries.iter().enumerate().map(of_joint).collect()
    }
}

/// Returns true if a parameter can change the torque of a joint. The inertia of a link or crank changes that of the
/// joints before it; every other parameter changes that of its own joint or of the two that turn a motor.
fn shows_in(robot: &Robot, id: ParameterId, joint: usize) -> bool {
    match id.kind {
        ParameterKind::Inertial(_) => joint <= id.joint.index(),
        ParameterKind::Crank(_) => joint <= id.joint.index(),
        ParameterKind::Friction(_) | ParameterKind::MotorInertia | ParameterKind::Spring(_) => {
            joint == id.joint.index()
        }
        ParameterKind::Coupling(CouplingTerm::Inertia | CouplingTerm::Viscous | CouplingTerm::Coulomb) => {
            robot
                .couplings
                .iter()
                .filter(|coupling| coupling.motor_joint == id.joint)
                .any(|coupling| [coupling.joint.index(), coupling.motor_joint.index()].contains(&joint))
        }
    }
}

/// Sums of products of a joint's entries, pair by pair.
struct Products<'a> {
    rows: &'a [JointRows],
    joint: usize,
    sums: &'a mut [Lanes],
}

impl Kernel for Products<'_> {
    #[inline(always)]
    fn run(self) {
        for rows in self.rows {
            let row = &rows[self.joint][..];
            let mut at = 0;
            for i in 0..row.len() {
                let (x, others) = (row[i], &row[i..]);
                let sums = &mut self.sums[at..at + others.len()];
                for (sum, y) in sums.iter_mut().zip(others) {
                    *sum += x * *y;
                }
                at += others.len();
            }
        }
    }
}
