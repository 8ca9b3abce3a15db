//! Joint torque from world-frame kinematics and virtual power.
//!
//! Each link is described by its mass, its centre of mass and the inertia about that centre; the joints must supply the
//! power of inertia and weight along each joint's own motion. The identifier uses another method, so that a simulated
//! export can reveal an error in either.

use nalgebra::{Matrix3, Vector3};

use super::balance::{Crank, DrivingSpring};
use super::load::{Body, Load};
use crate::error::SimulateError;
use crate::plan::motion::MotionState;
use armwatch_model::robot::{JointIndex, JointKind, MAX_JOINTS, Robot, StandardParameters, Transform};

/// A chain of rigid links, ready for [`joint_torque`].
#[derive(Debug, Clone)]
pub struct RigidChain {
    links: Vec<ArmLink>,
    springs: Vec<DrivingSpring>,
    cranks: Vec<Crank>,
    gravity: Vector3<f64>,
}

#[derive(Debug, Clone)]
struct ArmLink {
    kind: JointKind,
    /// Pose on the link before, at position 0.
    placement: Transform,
    mass: f64,
    /// Centre of mass in the link frame, m.
    centre: Vector3<f64>,
    /// Inertia about the centre of mass, axes of the link frame, kg m².
    inertia: Matrix3<f64>,
    motor_inertia: f64,
}

/// Converts a description into centre-of-mass quantities.
///
/// # Errors
/// [`SimulateError::NoNominal`] for a joint without nominal parameters, [`SimulateError::NoSpring`] for a spring or
/// crank without them, [`SimulateError::FirstMomentWithoutMass`] if no centre of mass exists.
pub fn rigid_chain(robot: &Robot) -> Result<RigidChain, SimulateError> {
    let links = robot
        .joints
        .iter()
        .zip(robot.joint_indices())
        .map(|(joint, index)| {
            let nominal = joint.nominal.ok_or(SimulateError::NoNominal { joint: index })?;
            let (centre, inertia) = about_centre_of_mass(&nominal.inertial, index)?;
            Ok(ArmLink {
                kind: joint.kind,
                placement: *joint.geometry.placement(),
                mass: nominal.inertial.mass(),
                centre,
                inertia,
                motor_inertia: nominal.motor_inertia,
            })
        })
        .collect::<Result<_, SimulateError>>()?;
    let springs = robot.springs.iter().map(DrivingSpring::new).collect::<Result<_, _>>()?;
    let cranks = robot.parallelograms.iter().map(Crank::new).collect::<Result<_, _>>()?;
    Ok(RigidChain { links, springs, cranks, gravity: robot.gravity })
}

impl RigidChain {
    /// Inertia of a joint's motor seen at the joint, kg m² (kg for a prismatic joint); zero for a joint that does not
    /// exist.
    pub fn motor_inertia(&self, joint: JointIndex) -> f64 {
        self.links.get(joint.index()).map_or(0.0, |link| link.motor_inertia)
    }

    /// The chain with `load` at the tool frame, which has the pose `tool` in the frame of the last link.
    #[must_use]
    pub fn carrying(mut self, load: &Load, tool: &Transform) -> Self {
        if let Some(last) = self.links.last_mut() {
            let own = Body { mass: last.mass, centre: last.centre, inertia: last.inertia };
            let both = own.and(&Body::of_load(load, tool));
            (last.mass, last.centre, last.inertia) = (both.mass, both.centre, both.inertia);
        }
        self
    }
}

/// Torque of the rigid links, cranks, springs and the motors' inertia, without friction.
///
/// `tau_j = sum_i [ Jv_ij . m_i (a_ci - g) + Jw_ij . (I_i alpha_i + w_i x I_i w_i) ] + I_m,j qdd_j`,
/// where `Jv_ij` is the velocity of the centre of mass of link `i` per unit speed of joint `j`, and
/// `Jw_ij` the angular one.
///
/// `state`: `[n]` in rad, rad/s, rad/s². Returns `[n]` in Nm (N for a prismatic joint), zero beyond `n`.
///
/// Reference: Siciliano, Sciavicco, Villani, Oriolo, Robotics (2009), section 7.1, in the form of
/// d'Alembert's principle.
pub fn joint_torque(chain: &RigidChain, state: &MotionState) -> [f64; MAX_JOINTS] {
    let mut torque = [0.0; MAX_JOINTS];
    let mut axes = [(Vector3::zeros(), Vector3::zeros()); MAX_JOINTS];
    let mut frame = LinkFrame::base();
    let motion = [&state.position, &state.velocity, &state.acceleration];
    for (i, link) in chain.links.iter().enumerate() {
        let own = motion.map(|of| of[i]);
        let next = frame.next(link, own);
        axes[i] = (next.rotation.column(2).into_owned(), next.origin);
        let felt = |drive: &BodyForce, j: usize| match chain.links[j].kind {
            JointKind::Revolute => {
                axes[j].0.dot(&((drive.centre - axes[j].1).cross(&drive.force) + drive.moment))
            }
            JointKind::Prismatic => axes[j].0.dot(&drive.force),
        };
        for crank in chain.cranks.iter().filter(|crank| crank.upper_arm == i) {
            let turning = frame.next(link, motion.map(|of| crank.angle(of)));
            let drive = turning.drive(&crank.body, &chain.gravity);
            (0..=i).for_each(|j| torque[j] += felt(&drive, j));
            torque[crank.forearm] += crank.sense * felt(&drive, i);
        }
        frame = next;
        let body = Body { mass: link.mass, centre: link.centre, inertia: link.inertia };
        let drive = frame.drive(&body, &chain.gravity);
        (0..=i).for_each(|j| torque[j] += felt(&drive, j));
        torque[i] += link.motor_inertia * state.acceleration[i];
    }
    for spring in &chain.springs {
        torque[spring.joint] += spring.torque(state.position[spring.joint]);
    }
    torque
}

/// Force through a body's centre of mass and moment about it, for a given motion.
struct BodyForce {
    centre: Vector3<f64>,
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

/// Torque of the links alone, which the gears carry, without the motors' inertia. Otherwise like [`joint_torque`].
pub fn link_torque(chain: &RigidChain, state: &MotionState) -> [f64; MAX_JOINTS] {
    let mut torque = joint_torque(chain, state);
    for (j, link) in chain.links.iter().enumerate() {
        torque[j] -= link.motor_inertia * state.acceleration[j];
    }
    torque
}

/// Motion of a link frame, all in base axes.
#[derive(Debug, Clone)]
struct LinkFrame {
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    angular_acceleration: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl LinkFrame {
    fn base() -> Self {
        Self {
            rotation: Matrix3::identity(),
            origin: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            angular_acceleration: Vector3::zeros(),
            acceleration: Vector3::zeros(),
        }
    }

    /// Force and moment that move a body with this frame.
    fn drive(&self, body: &Body, gravity: &Vector3<f64>) -> BodyForce {
        let lever = self.rotation * body.centre;
        let centre_acceleration = self.acceleration
            + self.angular_acceleration.cross(&lever)
            + self.angular_velocity.cross(&self.angular_velocity.cross(&lever));
        // Turning two vectors into the link is cheaper than turning its inertia into the world.
        let spin = body.inertia * self.rotation.tr_mul(&self.angular_velocity);
        BodyForce {
            centre: self.origin + lever,
            force: body.mass * (centre_acceleration - gravity),
            moment: self.rotation * (body.inertia * self.rotation.tr_mul(&self.angular_acceleration))
                + self.angular_velocity.cross(&(self.rotation * spin)),
        }
    }

    /// The frame after a joint at the position `q` with the motion `qd`, `qdd`.
    fn next(&self, link: &ArmLink, [q, qd, qdd]: [f64; 3]) -> Self {
        let place = &link.placement;
        let mut rotation = self.rotation * place.rotation;
        let axis = rotation.column(2).into_owned();
        let mut step = self.rotation * place.translation;
        match link.kind {
            JointKind::Revolute => {
                let (sin, cos) = q.sin_cos();
                rotation *= Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
            }
            JointKind::Prismatic => step += axis * q,
        }
        let carried = self.acceleration
            + self.angular_acceleration.cross(&step)
            + self.angular_velocity.cross(&self.angular_velocity.cross(&step));
        let coriolis = self.angular_velocity.cross(&axis) * qd;
        match link.kind {
            JointKind::Revolute => Self {
                rotation,
                origin: self.origin + step,
                angular_velocity: self.angular_velocity + axis * qd,
                angular_acceleration: self.angular_acceleration + axis * qdd + coriolis,
                acceleration: carried,
            },
            JointKind::Prismatic => Self {
                rotation,
                origin: self.origin + step,
                angular_velocity: self.angular_velocity,
                angular_acceleration: self.angular_acceleration,
                acceleration: carried + axis * qdd + coriolis * 2.0,
            },
        }
    }
}

/// Centre of mass, and the inertia about it, by the parallel-axis theorem.
pub(super) fn about_centre_of_mass(
    link: &StandardParameters,
    joint: JointIndex,
) -> Result<(Vector3<f64>, Matrix3<f64>), SimulateError> {
    let (mass, first_moment) = (link.mass(), link.first_moment());
    if mass <= 0.0 {
        // A frame without a body, as in a wrist of two joints, is allowed; a moment without mass is not.
        return if first_moment == Vector3::zeros() {
            Ok((Vector3::zeros(), link.inertia()))
        } else {
            Err(SimulateError::FirstMomentWithoutMass { joint })
        };
    }
    let centre = first_moment / mass;
    let shift = Matrix3::identity() * centre.norm_squared() - centre * centre.transpose();
    Ok((centre, link.inertia() - shift * mass))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_arms::er3a;
    use crate::test_arms::nine_joints;

    /// The reference prints 12 significant digits of torques below 200 Nm.
    const REFERENCE_TOLERANCE_NM: f64 = 1e-9;
    /// Central differences with a step of 1e-5 of powers of about 1 kW.
    const POWER_TOLERANCE: f64 = 1e-6;

    fn state(q: &[f64], qd: &[f64], qdd: &[f64]) -> MotionState {
        let mut state = MotionState::default();
        state.position[..q.len()].copy_from_slice(q);
        state.velocity[..q.len()].copy_from_slice(qd);
        state.acceleration[..q.len()].copy_from_slice(qdd);
        state
    }

    #[test]
    fn torque_equals_the_reference() {
        let mut robot = er3a();
        for joint in &mut robot.joints {
            joint.nominal.as_mut().unwrap().motor_inertia = 0.0;
        }
        let chain = rigid_chain(&robot).unwrap();
        let text = include_str!("../../../../tests/reference/er3a_inverse_dynamics.csv");
        let mut worst: f64 = 0.0;
        for line in text.lines().skip(1) {
            let row: Vec<f64> = line.split(',').map(|c| c.parse().unwrap()).collect();
            let torque = joint_torque(&chain, &state(&row[..6], &row[6..12], &row[12..18]));
            for j in 0..6 {
                worst = worst.max((torque[j] - row[18 + j]).abs());
            }
        }
        assert!(worst < REFERENCE_TOLERANCE_NM, "largest deviation {worst} Nm");
    }

    #[test]
    fn motor_inertia_acts_on_its_own_joint_only() {
        let robot = er3a();
        let mut without = robot.clone();
        without.joints[3].nominal.as_mut().unwrap().motor_inertia = 0.0;
        let s = state(&[0.1; 6], &[0.2; 6], &[3.0; 6]);
        let with = joint_torque(&rigid_chain(&robot).unwrap(), &s);
        let without = joint_torque(&rigid_chain(&without).unwrap(), &s);
        for j in 0..6 {
            let expected = if j == 3 { 3.0 * robot.joints[3].nominal.unwrap().motor_inertia } else { 0.0 };
            assert!((with[j] - without[j] - expected).abs() < 1e-12);
        }
    }

    /// Kinetic and potential energy from the velocities of the frames alone.
    fn energy(chain: &RigidChain, s: &MotionState) -> f64 {
        let mut total = 0.0;
        let mut frame = LinkFrame::base();
        let mut velocity = Vector3::zeros();
        for (i, link) in chain.links.iter().enumerate() {
            let next = frame.next(link, [s.position[i], s.velocity[i], s.acceleration[i]]);
            velocity += frame.angular_velocity.cross(&(next.origin - frame.origin));
            if link.kind == JointKind::Prismatic {
                velocity += next.rotation.column(2) * s.velocity[i];
            }
            let lever = next.rotation * link.centre;
            let v = velocity + next.angular_velocity.cross(&lever);
            let w = next.rotation.transpose() * next.angular_velocity;
            total += 0.5 * link.mass * v.norm_squared() + 0.5 * w.dot(&(link.inertia * w));
            total -= link.mass * chain.gravity.dot(&(next.origin + lever));
            total += 0.5 * link.motor_inertia * s.velocity[i].powi(2);
            frame = next;
        }
        total
    }

    #[test]
    fn joint_power_is_the_rate_of_energy_of_an_arm_with_a_slide() {
        let robot = nine_joints();
        let chain = rigid_chain(&robot).unwrap();
        assert!(chain.links.iter().any(|l| l.kind == JointKind::Prismatic));
        let q: Vec<f64> = (0..9).map(|j| 0.3 * f64::from(j) - 1.0).collect();
        let qd: Vec<f64> = (0..9).map(|j| 1.0 - 0.35 * f64::from(j)).collect();
        let qdd: Vec<f64> = (0..9).map(|j| 2.0 * f64::from(j) - 7.0).collect();
        let power: f64 =
            joint_torque(&chain, &state(&q, &qd, &qdd)).iter().zip(&qd).map(|(t, v)| t * v).sum();
        let at = |h: f64| {
            let q: Vec<f64> = (0..9).map(|j| q[j] + qd[j] * h + 0.5 * qdd[j] * h * h).collect();
            let qd: Vec<f64> = (0..9).map(|j| qd[j] + qdd[j] * h).collect();
            energy(&chain, &state(&q, &qd, &qdd))
        };
        let h = 1e-5;
        let rate = (at(h) - at(-h)) / (2.0 * h);
        assert!(power.abs() > 10.0, "the state must move enough to show an error: {power} W");
        assert!((power - rate).abs() < POWER_TOLERANCE * power.abs(), "{power} W against {rate} W");
    }

    #[test]
    fn missing_parameters_are_refused_with_the_joint() {
        let mut robot = er3a();
        robot.joints[4].nominal = None;
        let message = rigid_chain(&robot).unwrap_err().to_string();
        assert!(message.contains("joint 5") && message.contains("nominal"), "{message}");

        let mut robot = er3a();
        robot.joints[1].nominal.as_mut().unwrap().inertial.0[0] = 0.0;
        let message = rigid_chain(&robot).unwrap_err().to_string();
        assert!(message.contains("link 2"), "{message}");
    }

    #[test]
    fn a_load_is_a_body_of_its_own_on_the_last_link() {
        let mut robot = er3a();
        robot.tool = Transform::from_xyz_rpy([0.02, -0.03, 0.11], [0.4, -0.2, 0.9]);
        let inertia = Matrix3::new(0.03, 0.002, -0.001, 0.002, 0.02, 0.003, -0.001, 0.003, 0.04);
        let load = Load { mass: 4.0, centre: Vector3::new(0.05, -0.02, 0.1), inertia };
        let s = state(&[0.3, -0.4, 0.5, 0.6, -0.7, 0.8], &[1.0, -0.8, 0.6, 1.2, -1.4, 1.6], &[3.0; 6]);
        let chain = rigid_chain(&robot).unwrap();
        let loaded = joint_torque(&chain.clone().carrying(&load, &robot.tool), &s);
        // the same through the ten parameters about the frame of the last link
        let body = StandardParameters::from_centre_of_mass(load.mass, &load.centre, &load.inertia);
        let last = robot.joints[5].nominal.as_mut().unwrap();
        last.inertial = last.inertial.joined(&body.seen_from(&robot.tool));
        let expected = joint_torque(&rigid_chain(&robot).unwrap(), &s);
        let without = joint_torque(&chain, &s);
        for j in 0..6 {
            assert!((loaded[j] - expected[j]).abs() < 1e-11 * (1.0 + expected[j].abs()));
        }
        assert!((loaded[1] - without[1]).abs() > 10.0, "{loaded:?} {without:?}");
    }
}
