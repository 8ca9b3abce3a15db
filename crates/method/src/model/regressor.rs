//! Torque as a linear function of the parameters: `tau = y phi`.

use nalgebra::Vector3;

use super::actuator::coupling_columns;
use super::dynamics::LinkMotion;
use super::kinematics::joint_transform;
use armwatch_model::robot::{
    CouplingTerm, JointIndex, JointKind, MAX_JOINTS, Robot, StandardParameters, Transform,
};

/// Regressor of one sample, `[n x p]`, columns in the order of
/// [`ParameterId::natural_order`](armwatch_model::robot::ParameterId::natural_order). Reuse it for every sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Regressor {
    joint_count: usize,
    column_count: usize,
    /// Values column by column, so that one column of a sample is one copy.
    values: Vec<f64>,
}

impl Regressor {
    /// Creates a zero regressor for `robot`.
    #[must_use]
    pub fn new(robot: &Robot) -> Self {
        let (joint_count, column_count) = (robot.joint_count(), robot.parameter_count());
        Self { joint_count, column_count, values: vec![0.0; column_count * joint_count] }
    }

    /// Number of rows `n`, one per joint.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.joint_count
    }

    /// Number of columns `p`, one per parameter: [`Robot::parameter_count`].
    #[must_use]
    pub fn columns(&self) -> usize {
        self.column_count
    }

    /// Torque of each joint `[n]` per unit of the parameter at `column`.
    #[must_use]
    pub fn column(&self, column: usize) -> &[f64] {
        &self.values[column * self.joint_count..(column + 1) * self.joint_count]
    }

    /// `tau = y phi`: parameters `[p]` in natural order to torques `[n]` in Nm (N).
    pub fn torque(&self, phi: &[f64], tau: &mut [f64]) {
        tau.fill(0.0);
        for (column, phi) in self.values.chunks_exact(self.joint_count.max(1)).zip(phi) {
            for (tau, y) in tau.iter_mut().zip(column) {
                *tau += y * phi;
            }
        }
    }

    /// Replaces the torque of `joint` per unit of the parameter at `column`.
    pub(crate) fn set(&mut self, joint: usize, column: usize, value: f64) {
        self.values[column * self.joint_count + joint] = value;
    }
}

/// Joint-torque regressor of one sample: `tau = y phi` [3.8, 3.9, C].
///
/// By virtual power: the torque of joint `j` due to link `i` is the link's force and moment times the velocity and
/// angular velocity of the link for unit speed of joint `j` alone. Those partial velocities are propagated along the
/// chain. Each is contracted with the link's force and moment per unit of each parameter. Unlike
/// [`inverse_dynamics`](super::dynamics::inverse_dynamics), it propagates no torque, so one checks the other.
///
/// `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m for sliding joints). Writes all of `y` `[n x p]`: links, friction,
/// motor inertia, couplings, springs and cranks, with the gravity of the robot. The columns of friction under load
/// remain zero: [`write_load_columns`] fills them. The function does not allocate if `y` has the robot's size.
///
/// # Panics
/// If a slice is shorter than the chain, or the chain longer than [`MAX_JOINTS`].
pub fn joint_torque_regressor(robot: &Robot, q: &[f64], qd: &[f64], qdd: &[f64], y: &mut Regressor) {
    let n = robot.joint_count();
    if (y.joint_count, y.column_count) != (n, robot.parameter_count()) {
        *y = Regressor::new(robot);
    }
    y.values.fill(0.0);
    let mut motion = LinkMotion::base(&robot.gravity);
    let mut partials = [PartialVelocity::ZERO; MAX_JOINTS];
    let first_crank = robot.parameter_count() - StandardParameters::COUNT * robot.parallelograms.len();
    for (i, joint) in robot.joints.iter().enumerate() {
        let cranks = robot.parallelograms.iter().enumerate().filter(|(_, of)| of.upper_arm.index() == i);
        for (c, of) in cranks {
            let transform = joint_transform(joint, of.crank(q));
            let motion = motion.next(&transform, joint.kind, of.crank(qd), of.crank(qdd));
            let own = PartialVelocity::of_own_joint(joint.kind);
            let outer = partials[..i].iter().map(|partial| partial.next(&transform)).enumerate();
            for (j, partial) in outer.chain([(i, own), (of.forearm.index(), own.times(of.sense))]) {
                for (k, value) in partial.link_columns(&motion).into_iter().enumerate() {
                    y.set(j, first_crank + StandardParameters::COUNT * c + k, value);
                }
            }
        }
        let transform = joint_transform(joint, q[i]);
        motion = motion.next(&transform, joint.kind, qd[i], qdd[i]);
        for partial in &mut partials[..i] {
            *partial = partial.next(&transform);
        }
        partials[i] = PartialVelocity::of_own_joint(joint.kind);
        for (j, partial) in partials[..=i].iter().enumerate() {
            for (k, value) in partial.link_columns(&motion).into_iter().enumerate() {
                y.set(j, StandardParameters::COUNT * i + k, value);
            }
        }
    }
    write_actuators(robot, (q, qd, qdd), y);
}

/// Writes the columns between those of the links and those of the cranks: friction, motor inertia, couplings, springs.
fn write_actuators(robot: &Robot, (q, qd, qdd): (&[f64], &[f64], &[f64]), y: &mut Regressor) {
    let n = robot.joint_count();
    let mut next = StandardParameters::COUNT * n;
    for joint in robot.joint_indices() {
        let (i, model) = (joint.index(), robot.friction_of(joint));
        let terms = model.terms().len();
        for (k, value) in model.columns(qd[i]).into_iter().take(terms).enumerate() {
            y.set(i, next + k, value);
        }
        next += terms + model.load.terms().len();
    }
    if robot.has_motor_inertia() {
        for (i, qdd) in qdd.iter().enumerate().take(n) {
            y.set(i, next + i, *qdd);
        }
        next += n;
    }
    for (c, coupling) in robot.couplings.iter().enumerate() {
        let columns = coupling_columns(coupling, robot.friction_of(coupling.motor_joint).law, qd, qdd);
        let first = next + CouplingTerm::ALL.len() * c;
        for k in 0..CouplingTerm::ALL.len() {
            y.set(coupling.joint.index(), first + k, columns.joint[k]);
            y.set(coupling.motor_joint.index(), first + k, columns.motor_joint[k]);
        }
    }
    next += CouplingTerm::ALL.len() * robot.couplings.len();
    for spring in &robot.springs {
        let j = spring.joint.index();
        for value in spring.columns(q[j]) {
            y.set(j, next, value);
            next += 1;
        }
    }
}

/// Joints with friction under load, and the first column of each.
pub(crate) fn load_places(robot: &Robot) -> impl Iterator<Item = (JointIndex, usize)> {
    let mut next = StandardParameters::COUNT * robot.joint_count();
    robot.joint_indices().filter_map(move |joint| {
        let model = robot.friction_of(joint);
        let first = next + model.terms().len();
        next = first + model.load.terms().len();
        (next > first).then_some((joint, first))
    })
}

/// Writes the columns of friction under load for gears with `load` `[n]`, Nm (N), at the speeds `qd` `[n]`, rad/s
/// (m/s):
/// [`FrictionModel::load_columns`](armwatch_model::robot::FrictionModel::load_columns).
/// The load follows from parameters ([`DynamicModel::gear_load`](super::dynamics::DynamicModel::gear_load)), so these
/// columns are those of a linearisation.
pub fn write_load_columns(robot: &Robot, qd: &[f64], load: &[f64], y: &mut Regressor) {
    for (joint, first) in load_places(robot) {
        let (i, model) = (joint.index(), robot.friction_of(joint));
        for (k, _) in model.load.terms().iter().enumerate() {
            y.set(i, first + k, model.load_columns(load[i], qd[i])[k]);
        }
    }
}

/// Columns of the regressor that an identification keeps, such as
/// [`BaseParameters::kept_columns`](super::base_parameters::BaseParameters::kept_columns). Created once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeptColumns {
    columns: Vec<usize>,
}

impl KeptColumns {
    /// Creates a selection of columns, written in the given order.
    #[must_use]
    pub fn new(columns: &[usize]) -> Self {
        Self { columns: columns.to_vec() }
    }

    /// Number of columns `b`.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Returns true if no column is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Indices of the columns in order.
    #[must_use]
    pub fn columns(&self) -> &[usize] {
        &self.columns
    }

    /// Writes the kept columns of one sample into a block of the observation matrix.
    ///
    /// `block` is column-major with `block_rows` rows and at least `b` columns: the element at `(row, k)` is
    /// `block[k * block_rows + row]`, which is faer's layout (`MatMut::from_column_major_slice_mut`). The sample fills
    /// the rows `row..row + n`, one per joint, of the columns `0..b`; later columns, such as one for the torque, do not
    /// change.
    ///
    /// # Panics
    /// If the rows are not in the block, or a kept column is not one of the regressor.
    pub fn write(&self, y: &Regressor, block: &mut [f64], block_rows: usize, row: usize) {
        let n = y.rows();
        assert!(row + n <= block_rows, "rows {row}..{} of a block of {block_rows}", row + n);
        for (&column, target) in self.columns.iter().zip(block.chunks_exact_mut(block_rows)) {
            target[row..row + n].copy_from_slice(y.column(column));
        }
    }
}

/// Velocity of a link frame for unit speed of one joint and zero speed of the others, in the link's frame.
#[derive(Debug, Clone, Copy)]
struct PartialVelocity {
    /// Angular velocity of the link per joint speed.
    w: Vector3<f64>,
    /// Velocity of the frame's origin per joint speed, m.
    v: Vector3<f64>,
}

impl PartialVelocity {
    const ZERO: Self = Self { w: Vector3::new(0.0, 0.0, 0.0), v: Vector3::new(0.0, 0.0, 0.0) };

    fn of_own_joint(kind: JointKind) -> Self {
        match kind {
            JointKind::Revolute => Self { w: Vector3::z(), v: Vector3::zeros() },
            JointKind::Prismatic => Self { w: Vector3::zeros(), v: Vector3::z() },
        }
    }

    fn times(&self, factor: f64) -> Self {
        Self { w: self.w * factor, v: self.v * factor }
    }

    /// Partial velocity of the next link for the same joint.
    #[inline]
    fn next(&self, transform: &Transform) -> Self {
        Self {
            w: transform.to_inner(&self.w),
            v: transform.to_inner(&(self.v + self.w.cross(&transform.translation))),
        }
    }

    /// Power `v f + w n` of the link's force and moment per unit of each of its ten parameters.
    ///
    /// The first-moment columns are the gradient of `v (alpha x mP + omega x (omega x mP)) +
    /// w (mP x a)`, those of the inertia the gradient of `w I alpha + (w x omega) I omega`.
    #[inline]
    fn link_columns(&self, motion: &LinkMotion) -> [f64; StandardParameters::COUNT] {
        let Self { w, v } = self;
        let LinkMotion { omega, alpha, a } = motion;
        let moment = v.cross(alpha) + omega * omega.dot(v) - v * omega.norm_squared() + a.cross(w);
        let u = w.cross(omega);
        [
            v.dot(a),
            moment.x,
            moment.y,
            moment.z,
            w.x * alpha.x + u.x * omega.x,
            w.x * alpha.y + w.y * alpha.x + u.x * omega.y + u.y * omega.x,
            w.x * alpha.z + w.z * alpha.x + u.x * omega.z + u.z * omega.x,
            w.y * alpha.y + u.y * omega.y,
            w.y * alpha.z + w.z * alpha.y + u.y * omega.z + u.z * omega.y,
            w.z * alpha.z + u.z * omega.z,
        ]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::dynamics::DynamicModel;
    use armwatch_model::robot::{FrictionLaw, FrictionModel, LoadFriction, ParameterId, TorqueSensors};
    use armwatch_testing::arms::{any_arm, numbers};
    use armwatch_testing::er3a;

    /// Rounding of two orders of summation over nine links.
    const ROUNDING: f64 = 1e-10;

    proptest! {
        #[test]
        fn regressor_times_parameters_is_inverse_dynamics(
            robot in any_arm(), phi in numbers(), q in numbers(), qd in numbers(), qdd in numbers(),
            mixed: bool, link_sensors: bool,
        ) {
            let mut robot = robot;
            if mixed {
                let laws = [None, Some(FrictionLaw::None), Some(FrictionLaw::Smooth { speed: 0.2 }),
                    Some(FrictionLaw::ViscousCoulomb), Some(FrictionLaw::Polynomial)];
                for (k, joint) in robot.joints.iter_mut().enumerate() {
                    let load = [LoadFriction::Linear, LoadFriction::Directional, LoadFriction::None][k % 3];
                    joint.friction = laws[k % 5].map(|law| FrictionModel { law, asymmetric: k % 5 == 2, load });
                }
            }
            if link_sensors {
                robot.torque_sensors = TorqueSensors::Link;
                robot.couplings.clear();
            }
            let n = robot.joint_count();
            prop_assert_eq!(ParameterId::natural_order(&robot).len(), robot.parameter_count());
            let model = DynamicModel::from_parameters(
                &robot, ParameterId::natural_order(&robot).into_iter().zip(phi.iter().copied()));
            let (qd, qdd): (Vec<f64>, Vec<f64>) = (
                qd.iter().map(|x| 4.0 * x).collect(), qdd.iter().map(|x| 10.0 * x).collect());
            let (mut expected, mut tau) = (vec![0.0; n], vec![0.0; n]);
            model.torque(&robot, &q, &qd, &qdd, &mut expected);
            let mut y = Regressor::new(&robot);
            joint_torque_regressor(&robot, &q, &qd, &qdd, &mut y);
            let mut load = vec![0.0; n];
            model.gear_load(&robot, &q, &qd, &qdd, &mut load);
            write_load_columns(&robot, &qd, &load, &mut y);
            y.torque(&phi[..robot.parameter_count()], &mut tau);
            let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
            for (tau, expected) in tau.iter().zip(&expected) {
                prop_assert!((tau - expected).abs() <= ROUNDING * norm, "{tau} {expected} {norm}");
            }
        }
    }

    #[test]
    fn a_regressor_used_again_keeps_nothing_of_the_sample_before() {
        let robot = er3a();
        let mut small = er3a();
        small.joints.truncate(2);
        let mut used = Regressor::new(&small);
        joint_torque_regressor(&robot, &[0.3; 6], &[1.0; 6], &[2.0; 6], &mut used);
        let mut fresh = Regressor::new(&robot);
        joint_torque_regressor(&robot, &[0.1; 6], &[0.0; 6], &[-2.0; 6], &mut used);
        joint_torque_regressor(&robot, &[0.1; 6], &[0.0; 6], &[-2.0; 6], &mut fresh);
        assert_eq!(used, fresh);
    }

    #[test]
    fn kept_columns_land_in_the_rows_of_their_sample() {
        let robot = er3a();
        let mut y = Regressor::new(&robot);
        joint_torque_regressor(&robot, &[0.3; 6], &[1.0; 6], &[2.0; 6], &mut y);
        let kept = KeptColumns::new(&[9, 60, 14, 89]);
        let (rows, row) = (20, 7);
        // One more column than is kept, which must not change.
        let mut block = vec![-7.5; rows * (kept.len() + 1)];
        kept.write(&y, &mut block, rows, row);
        for (k, column) in [9, 60, 14, 89].into_iter().enumerate() {
            assert_eq!(block[k * rows + row..k * rows + row + 6], *y.column(column));
            assert!(y.column(column).iter().any(|&x| x != 0.0));
            assert!(block[k * rows..k * rows + row].iter().all(|&x| x == -7.5));
            assert!(block[k * rows + row + 6..(k + 1) * rows].iter().all(|&x| x == -7.5));
        }
        assert!(block[4 * rows..].iter().all(|&x| x == -7.5));
    }
}
