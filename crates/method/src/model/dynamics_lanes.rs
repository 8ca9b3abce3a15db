//! Torque of the links, and its derivatives with respect to the joints' positions, for several instants at once.
//!
//! The equations of the torque are those of [`inverse_dynamics`](super::dynamics::inverse_dynamics), with which the
//! tests compare it.

use super::dynamics::DynamicModel;
use super::regressor_lanes::{JointTransform, JointTurns, LaneStates, LinkMotionLanes};
use crate::lanes::{Kernel, LANES, LaneVector, Lanes, wide};
use armwatch_model::robot::{JointKind, MAX_JOINTS, Robot, StandardParameters};

/// Number for each joint, `[n]`, at each of several instants.
pub type JointLanes = [Lanes; MAX_JOINTS];

/// Derivative of the torque of links, cranks and springs with respect to each joint's position, Nm/rad (N/m): central
/// differences over twice `step`, rad (m). Friction and motor inertia do not depend on positions.
///
/// Returns the torques `[n]` for each joint whose position changes.
///
/// # Panics
/// If the chain is longer than [`MAX_JOINTS`].
#[must_use]
pub fn torque_slopes(
    robot: &Robot,
    model: &DynamicModel,
    states: &LaneStates,
    step: f64,
) -> [JointLanes; MAX_JOINTS] {
    let turns = JointTurns::of(robot, &states.q);
    let mut slopes = [[Lanes::ZERO; MAX_JOINTS]; MAX_JOINTS];
    for (j, slopes) in slopes.iter_mut().enumerate().take(robot.joint_count()) {
        let torque = |change: f64| {
            let (mut states, mut turns) = (*states, turns);
            states.q[j] += Lanes::splat(change);
            turns.0[j] = JointTurns::turn(states.q[j]);
            let mut torques = torques(robot, &model.inertial, &states, &turns);
            add_beside_links(robot, model, &states, &mut torques);
            torques
        };
        let (above, below) = (torque(step), torque(-step));
        for i in 0..robot.joint_count() {
            slopes[i] = (above[i] - below[i]) * (0.5 / step);
        }
    }
    slopes
}

/// Adds the torque of cranks and springs, one instant at a time, since few arms have them.
fn add_beside_links(robot: &Robot, model: &DynamicModel, states: &LaneStates, torques: &mut JointLanes) {
    if robot.springs.is_empty() && robot.parallelograms.is_empty() {
        return;
    }
    for lane in 0..LANES {
        let at = |of: &JointLanes| of.map(|of| of.0[lane]);
        let (q, qd, qdd) = (at(&states.q), at(&states.qd), at(&states.qdd));
        let mut torque = [0.0; MAX_JOINTS];
        model.add_beside_links(robot, [&q, &qd, &qdd], &mut torque);
        torques.iter_mut().zip(torque).for_each(|(torques, torque)| torques.0[lane] += torque);
    }
}

/// Torque of the rigid links of each of `robots`, whose joints have the same kinds and the same motion. It has the same
/// bits as that of [`inverse_dynamics`](super::dynamics::inverse_dynamics).
///
/// `parameters` `[n]`; returns for each robot the torques `[n]`, Nm (N).
///
/// # Panics
/// If the chain is longer than [`MAX_JOINTS`].
pub fn torques_of<'r>(
    robots: impl IntoIterator<Item = &'r Robot>,
    parameters: &[StandardParameters],
    states: &LaneStates,
) -> impl Iterator<Item = JointLanes> {
    let mut turns = None;
    robots.into_iter().map(move |robot| {
        let turns = turns.get_or_insert_with(|| JointTurns::of(robot, &states.q));
        torques(robot, parameters, states, turns)
    })
}

fn torques(
    robot: &Robot,
    parameters: &[StandardParameters],
    states: &LaneStates,
    turns: &JointTurns,
) -> JointLanes {
    let mut tau = [Lanes::ZERO; MAX_JOINTS];
    wide(NewtonEuler { robot, parameters, states, turns, tau: &mut tau });
    tau
}

/// Recursive Newton-Euler algorithm [3.1-3.9].
struct NewtonEuler<'a> {
    robot: &'a Robot,
    parameters: &'a [StandardParameters],
    states: &'a LaneStates,
    turns: &'a JointTurns,
    tau: &'a mut JointLanes,
}

impl Kernel for NewtonEuler<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { robot, parameters, states, turns, tau } = self;
        let n = robot.joints.len();
        let mut transforms = [JointTransform::NONE; MAX_JOINTS];
        let mut wrenches = [WrenchLanes::ZERO; MAX_JOINTS];
        let mut motion = LinkMotionLanes::base(robot);
        for (i, joint) in robot.joints.iter().enumerate() {
            let placement = joint.geometry.placement();
            transforms[i] = JointTransform::of(placement, joint.kind, states.q[i], turns.0[i]);
            motion = motion.next(&transforms[i], joint.kind, states.qd[i], states.qdd[i]);
            wrenches[i] = WrenchLanes::of_link(&parameters[i], &motion);
        }
        let mut carried = WrenchLanes::ZERO;
        for i in (0..n).rev() {
            let force = wrenches[i].force + carried.force;
            let moment = wrenches[i].moment + carried.moment;
            tau[i] = match robot.joints[i].kind {
                JointKind::Revolute => moment.z,
                JointKind::Prismatic => force.z,
            };
            let transform = &transforms[i];
            carried.force = transform.to_outer(&force);
            carried.moment = transform.to_outer(&moment) + transform.translation.cross(&carried.force);
        }
    }
}

/// Force in N and moment about the frame's origin in Nm.
#[derive(Clone, Copy)]
struct WrenchLanes {
    force: LaneVector,
    moment: LaneVector,
}

impl WrenchLanes {
    const ZERO: Self = Self { force: LaneVector::ZERO, moment: LaneVector::ZERO };

    /// Wrench that gives a link this motion [3.4-3.7], about the frame's origin.
    #[inline(always)]
    fn of_link(phi: &StandardParameters, motion: &LinkMotionLanes) -> Self {
        let LinkMotionLanes { omega, alpha, a } = motion;
        let [m, mpx, mpy, mpz, xx, xy, xz, yy, yz, zz] = phi.0;
        let mp = LaneVector::splat(mpx, mpy, mpz);
        let inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        Self {
            force: *a * Lanes::splat(m) + alpha.cross(&mp) + omega.cross(&omega.cross(&mp)),
            moment: turned(&inertia, alpha) + omega.cross(&turned(&inertia, omega)) + mp.cross(a),
        }
    }
}

/// Product of a matrix, row by row, and a vector.
#[inline(always)]
fn turned([x, y, z]: &[[f64; 3]; 3], v: &LaneVector) -> LaneVector {
    LaneVector {
        x: v.x * x[0] + v.y * x[1] + v.z * x[2],
        y: v.x * y[0] + v.y * y[1] + v.z * y[2],
        z: v.x * z[0] + v.y * z[1] + v.z * z[2],
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::model::dynamics::inverse_dynamics;
    use armwatch_testing::arms::{any_arm, numbers};

    proptest! {
        #[test]
        fn each_lane_has_the_torque_of_its_instant(
            robot in any_arm(),
            state in numbers(),
            phi in numbers(),
        ) {
            let n = robot.joint_count();
            let parameters: Vec<StandardParameters> =
                (0..n).map(|i| StandardParameters(std::array::from_fn(|k| phi[10 * i + k]))).collect();
            let lanes = |first: usize| -> JointLanes {
                std::array::from_fn(|j| Lanes(std::array::from_fn(|k| state[first + LANES * j + k])))
            };
            let size = LANES * MAX_JOINTS;
            let states = LaneStates { q: lanes(0), qd: lanes(size), qdd: lanes(2 * size) };
            let found = torques_of([&robot], &parameters, &states).next().expect("one robot");
            for lane in 0..LANES {
                let of = |lanes: &JointLanes| lanes.map(|lanes| lanes.0[lane]);
                let (q, qd, qdd) = (of(&states.q), of(&states.qd), of(&states.qdd));
                let mut expected = [0.0; MAX_JOINTS];
                inverse_dynamics(&robot, &parameters, &q[..n], &qd[..n], &qdd[..n], &mut expected[..n]);
                prop_assert_eq!(of(&found), expected, "to the last bit");
            }
        }
    }
}
