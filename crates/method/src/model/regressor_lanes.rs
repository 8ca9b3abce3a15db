//! Regressor of several instants at once, one per lane. Its equations are those of
//! [`joint_torque_regressor`](super::regressor::joint_torque_regressor), with which the tests compare it.

use super::actuator::coupling_columns;
use crate::lanes::{Kernel, LANES, LaneVector, Lanes, wide};
use armwatch_model::robot::{CouplingTerm, JointKind, MAX_JOINTS, Robot, StandardParameters, Transform};

/// Motion of all joints at each of several instants, `[n]` in rad, rad/s, rad/s² (m for sliding joints).
#[derive(Debug, Clone, Copy)]
pub struct LaneStates {
    /// Positions.
    pub q: [Lanes; MAX_JOINTS],
    /// Velocities.
    pub qd: [Lanes; MAX_JOINTS],
    /// Accelerations.
    pub qdd: [Lanes; MAX_JOINTS],
}

impl Default for LaneStates {
    fn default() -> Self {
        let zero = [Lanes::ZERO; MAX_JOINTS];
        Self { q: zero, qd: zero, qdd: zero }
    }
}

/// Regressor of several instants, `[n x p]` each, like [`Regressor`](super::regressor::Regressor). Reuse it for the
/// next instants.
#[derive(Debug, Clone)]
pub struct RegressorLanes {
    joint_count: usize,
    /// Values column by column; entries that an arm of this structure never shows remain zero.
    values: Vec<Lanes>,
}

impl RegressorLanes {
    /// Creates a zero regressor for `robot`.
    #[must_use]
    pub fn new(robot: &Robot) -> Self {
        let joint_count = robot.joint_count();
        Self { joint_count, values: vec![Lanes::ZERO; robot.parameter_count() * joint_count] }
    }

    /// Torque of `joint` per unit of the parameter at `column`, at each instant.
    #[inline]
    #[must_use]
    pub fn get(&self, joint: usize, column: usize) -> Lanes {
        self.values[column * self.joint_count + joint]
    }

    /// Replaces the torque of `joint` per unit of the parameter at `column`.
    #[inline]
    pub(crate) fn set(&mut self, joint: usize, column: usize, value: Lanes) {
        self.values[column * self.joint_count + joint] = value;
    }
}

/// Joint-torque regressors of several instants: at each of them `tau = y phi` [3.8, 3.9, C].
///
/// # Panics
/// If `y` belongs to another robot, or the chain is longer than [`MAX_JOINTS`].
pub fn joint_torque_regressors(robot: &Robot, states: &LaneStates, y: &mut RegressorLanes) {
    wide(Links { robot, states, turns: &JointTurns::of(robot, &states.q), y });
    write_actuators(robot, states, y);
}

/// Sine and cosine of the positions of rotary joints.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointTurns(pub(super) [(Lanes, Lanes); MAX_JOINTS]);

impl JointTurns {
    pub(super) fn of(robot: &Robot, q: &[Lanes; MAX_JOINTS]) -> Self {
        let mut turns = [(Lanes::ZERO, Lanes::ZERO); MAX_JOINTS];
        for ((turn, joint), q) in turns.iter_mut().zip(&robot.joints).zip(q) {
            if joint.kind == JointKind::Revolute {
                *turn = Self::turn(*q);
            }
        }
        Self(turns)
    }

    pub(super) fn turn(q: Lanes) -> (Lanes, Lanes) {
        let turned = q.0.map(f64::sin_cos);
        (Lanes(turned.map(|(sine, _)| sine)), Lanes(turned.map(|(_, cosine)| cosine)))
    }
}

/// Columns of the links.
struct Links<'a> {
    robot: &'a Robot,
    states: &'a LaneStates,
    turns: &'a JointTurns,
    y: &'a mut RegressorLanes,
}

impl Kernel for Links<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { robot, states, turns, y } = self;
        let n = robot.joints.len();
        let mut motion = LinkMotionLanes::base(robot);
        let mut partials = [PartialVelocityLanes::ZERO; MAX_JOINTS];
        let first_crank = y.values.len() / n.max(1) - StandardParameters::COUNT * robot.parallelograms.len();
        for (i, joint) in robot.joints.iter().enumerate() {
            for (c, of) in robot.parallelograms.iter().enumerate().filter(|(_, of)| of.upper_arm.index() == i)
            {
                let m = of.forearm.index();
                let crank = |of_joints: &[Lanes; MAX_JOINTS]| of_joints[i] + of_joints[m] * of.sense;
                let q = crank(&states.q);
                let transform =
                    JointTransform::of(joint.geometry.placement(), joint.kind, q, JointTurns::turn(q));
                let motion = motion.next(&transform, joint.kind, crank(&states.qd), crank(&states.qdd));
                let first = StandardParameters::COUNT * c + first_crank;
                for j in (0..=i).chain([m]) {
                    let partial = if j < i {
                        partials[j].next(&transform)
                    } else {
                        PartialVelocityLanes::of_own_joint(joint.kind)
                    };
                    let sense = if j == m { of.sense } else { 1.0 };
                    let columns = partial.link_columns(&motion);
                    for (k, column) in columns.into_iter().enumerate() {
                        y.values[(first + k) * n + j] = column * sense;
                    }
                }
            }
            let transform =
                JointTransform::of(joint.geometry.placement(), joint.kind, states.q[i], turns.0[i]);
            motion = motion.next(&transform, joint.kind, states.qd[i], states.qdd[i]);
            for partial in &mut partials[..i] {
                *partial = partial.next(&transform);
            }
            partials[i] = PartialVelocityLanes::of_own_joint(joint.kind);
            let of_link = &mut y.values[StandardParameters::COUNT * i * n..][..StandardParameters::COUNT * n];
            for (j, partial) in partials[..=i].iter().enumerate() {
                let columns = partial.link_columns(&motion);
                for k in 0..StandardParameters::COUNT {
                    of_link[k * n + j] = columns[k];
                }
            }
        }
    }
}

/// Writes the columns between those of the links and those of the cranks: friction, motor inertia, couplings, springs.
fn write_actuators(robot: &Robot, states: &LaneStates, y: &mut RegressorLanes) {
    let n = robot.joint_count();
    let mut next = StandardParameters::COUNT * n;
    for joint in robot.joint_indices() {
        let (i, model) = (joint.index(), robot.friction_of(joint));
        let columns = states.qd[i].0.map(|qd| model.columns(qd));
        for k in 0..model.terms().len() {
            y.set(i, next + k, Lanes(columns.map(|of| of[k])));
        }
        next += model.terms().len() + model.load.terms().len();
    }
    if robot.has_motor_inertia() {
        for i in 0..n {
            y.set(i, next + i, states.qdd[i]);
        }
        next += n;
    }
    for (c, coupling) in robot.couplings.iter().enumerate() {
        let law = robot.friction_of(coupling.motor_joint).law;
        let columns: [_; LANES] = std::array::from_fn(|lane| {
            let at = |of: &[Lanes; MAX_JOINTS]| of.map(|joint| joint.0[lane]);
            coupling_columns(coupling, law, &at(&states.qd), &at(&states.qdd))
        });
        let first = next + CouplingTerm::ALL.len() * c;
        for k in 0..CouplingTerm::ALL.len() {
            y.set(coupling.joint.index(), first + k, Lanes(columns.map(|of| of.joint[k])));
            y.set(coupling.motor_joint.index(), first + k, Lanes(columns.map(|of| of.motor_joint[k])));
        }
    }
    next += CouplingTerm::ALL.len() * robot.couplings.len();
    for spring in &robot.springs {
        let j = spring.joint.index();
        let columns = states.q[j].0.map(|q| spring.columns(q));
        for k in 0..2 {
            y.set(j, next, Lanes(columns.map(|of| of[k])));
            next += 1;
        }
    }
}

/// Frame of a joint in the frame of the link before it [2.1, 2.2].
#[derive(Clone, Copy)]
pub(super) struct JointTransform {
    /// Columns of the rotation.
    rotation: [LaneVector; 3],
    pub(super) translation: LaneVector,
}

impl JointTransform {
    /// Placeholder to be overwritten.
    pub(super) const NONE: Self = Self { rotation: [LaneVector::ZERO; 3], translation: LaneVector::ZERO };

    #[inline(always)]
    pub(super) fn of(
        placement: &Transform,
        kind: JointKind,
        q: Lanes,
        (sine, cosine): (Lanes, Lanes),
    ) -> Self {
        let (r, p) = (&placement.rotation, &placement.translation);
        let [x, y, z] = [
            LaneVector::splat(r.m11, r.m21, r.m31),
            LaneVector::splat(r.m12, r.m22, r.m32),
            LaneVector::splat(r.m13, r.m23, r.m33),
        ];
        let p = LaneVector::splat(p.x, p.y, p.z);
        match kind {
            JointKind::Revolute => {
                Self { rotation: [x * cosine + y * sine, y * cosine - x * sine, z], translation: p }
            }
            JointKind::Prismatic => Self { rotation: [x, y, z], translation: p + z * q },
        }
    }

    #[inline(always)]
    pub(super) fn to_inner(self, v: &LaneVector) -> LaneVector {
        let [x, y, z] = self.rotation;
        LaneVector { x: x.dot(v), y: y.dot(v), z: z.dot(v) }
    }

    #[inline(always)]
    pub(super) fn to_outer(self, v: &LaneVector) -> LaneVector {
        let [x, y, z] = self.rotation;
        x * v.x + y * v.y + z * v.z
    }
}

/// Motion of a link frame, expressed in that frame: angular velocity and acceleration, acceleration of the origin.
#[derive(Clone, Copy)]
pub(super) struct LinkMotionLanes {
    pub(super) omega: LaneVector,
    pub(super) alpha: LaneVector,
    pub(super) a: LaneVector,
}

impl LinkMotionLanes {
    #[inline(always)]
    pub(super) fn base(robot: &Robot) -> Self {
        let a = LaneVector::splat(-robot.gravity.x, -robot.gravity.y, -robot.gravity.z);
        Self { omega: LaneVector::ZERO, alpha: LaneVector::ZERO, a }
    }

    /// Motion of the next link: [3.1-3.3].
    #[inline(always)]
    pub(super) fn next(&self, transform: &JointTransform, kind: JointKind, qd: Lanes, qdd: Lanes) -> Self {
        let p = &transform.translation;
        let carried = transform.to_inner(&self.omega);
        let mut omega = carried;
        let mut alpha = transform.to_inner(&self.alpha);
        let mut a =
            transform.to_inner(&(self.a + self.alpha.cross(p) + self.omega.cross(&self.omega.cross(p))));
        match kind {
            JointKind::Revolute => {
                omega.z += qd;
                alpha = alpha + LaneVector { x: carried.y * qd, y: -carried.x * qd, z: qdd };
            }
            JointKind::Prismatic => {
                let twice = qd + qd;
                a = a + LaneVector { x: carried.y * twice, y: -carried.x * twice, z: qdd };
            }
        }
        Self { omega, alpha, a }
    }
}

/// Velocity of a link frame for unit speed of one joint and zero speed of the others, in the link's frame.
#[derive(Clone, Copy)]
struct PartialVelocityLanes {
    w: LaneVector,
    v: LaneVector,
}

impl PartialVelocityLanes {
    const ZERO: Self = Self { w: LaneVector::ZERO, v: LaneVector::ZERO };

    #[inline(always)]
    fn of_own_joint(kind: JointKind) -> Self {
        let z = LaneVector::splat(0.0, 0.0, 1.0);
        match kind {
            JointKind::Revolute => Self { w: z, v: LaneVector::ZERO },
            JointKind::Prismatic => Self { w: LaneVector::ZERO, v: z },
        }
    }

    /// Partial velocity of the next link for the same joint.
    #[inline(always)]
    fn next(&self, transform: &JointTransform) -> Self {
        Self {
            w: transform.to_inner(&self.w),
            v: transform.to_inner(&(self.v + self.w.cross(&transform.translation))),
        }
    }

    /// Power `v f + w n` of the link's force and moment per unit of each of its ten parameters.
    #[inline(always)]
    fn link_columns(&self, motion: &LinkMotionLanes) -> [Lanes; StandardParameters::COUNT] {
        let Self { w, v } = self;
        let LinkMotionLanes { omega, alpha, a } = motion;
        let moment = v.cross(alpha) + *omega * omega.dot(v) - *v * omega.dot(omega) + a.cross(w);
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
    use crate::model::regressor::{Regressor, joint_torque_regressor};
    use armwatch_testing::arms::{any_arm, numbers};

    /// Rounding of sums of a few products in another order, relative to the largest number of a column.
    const ROUNDING: f64 = 1e-13;

    proptest! {
        /// Reuses the regressor, so that values of earlier instants must not remain.
        #[test]
        fn each_lane_is_the_regressor_of_its_instant(robot in any_arm(), numbers in numbers(), turned in numbers()) {
            let n = robot.joint_count();
            let mut lanes = RegressorLanes::new(&robot);
            for numbers in [&numbers, &turned] {
                let mut states = LaneStates::default();
                let number = |k: usize| numbers[k % numbers.len()];
                for j in 0..n {
                    for lane in 0..LANES {
                        states.q[j].0[lane] = 3.0 * number(31 * lane + j);
                        states.qd[j].0[lane] = 4.0 * number(31 * lane + j + 9);
                        states.qdd[j].0[lane] = 10.0 * number(31 * lane + j + 18);
                    }
                }
                joint_torque_regressors(&robot, &states, &mut lanes);
                for lane in 0..LANES {
                    let of = |of: &[Lanes; MAX_JOINTS]| of[..n].iter().map(|of| of.0[lane]).collect::<Vec<f64>>();
                    let mut y = Regressor::new(&robot);
                    joint_torque_regressor(&robot, &of(&states.q), &of(&states.qd), &of(&states.qdd), &mut y);
                    let largest = (0..y.columns()).flat_map(|c| y.column(c)).fold(0.0_f64, |m, x| m.max(x.abs()));
                    for (column, joint) in (0..y.columns()).flat_map(|c| (0..n).map(move |j| (c, j))) {
                        let (found, expected) = (lanes.get(joint, column).0[lane], y.column(column)[joint]);
                        prop_assert!((found - expected).abs() <= ROUNDING * largest, "{found} {expected}");
                    }
                }
            }
        }
    }
}
