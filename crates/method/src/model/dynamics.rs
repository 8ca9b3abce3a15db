//! Torque of a motion: recursive Newton-Euler in link frames, friction and motor inertia.
//!
//! Each link's wrench is a function of mass, first moment and inertia about the frame's origin, so it is linear in the
//! parameters and there is no division by a mass.

use nalgebra::Vector3;

use super::actuator::coupling_columns;
use super::carried::add_carried;
use super::kinematics::joint_transform;
use armwatch_model::robot::{
    CouplingTerm, FrictionModel, FrictionTerm, Joint, JointIndex, JointKind, LoadFriction, MAX_JOINTS,
    Parallelogram, ParameterId, ParameterKind, Robot, SpringForm, StandardParameters, Transform,
};

/// Torque of the rigid links: recursive Newton-Euler [3.1-3.9, C].
///
/// Per link, with `a` the acceleration of the frame's origin (base: `-gravity`), `omega` and `alpha` its angular
/// velocity and acceleration, in the link's frame:
/// `f = m a + alpha x mP + omega x (omega x mP)`, `n = I alpha + omega x I omega + mP x a`.
///
/// `parameters` `[n]`; `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m for sliding joints); writes `tau` `[n]` in Nm
/// (N). Parameters may be unphysical. Friction and motor inertia are not included. The function does not allocate.
///
/// # Panics
/// If a slice is shorter than the chain, or the chain longer than [`MAX_JOINTS`].
pub fn inverse_dynamics(
    robot: &Robot,
    parameters: &[StandardParameters],
    q: &[f64],
    qd: &[f64],
    qdd: &[f64],
    tau: &mut [f64],
) {
    let n = robot.joint_count();
    let mut transforms = [Transform::IDENTITY; MAX_JOINTS];
    let mut wrenches = [Wrench::ZERO; MAX_JOINTS];
    let mut motion = LinkMotion::base(&robot.gravity);
    for (i, joint) in robot.joints.iter().enumerate() {
        transforms[i] = joint_transform(joint, q[i]);
        motion = motion.next(&transforms[i], joint.kind, qd[i], qdd[i]);
        wrenches[i] = link_wrench(&parameters[i], &motion);
    }
    let mut carried = Wrench::ZERO;
    for i in (0..n).rev() {
        let force = wrenches[i].force + carried.force;
        let moment = wrenches[i].moment + carried.moment;
        tau[i] = match robot.joints[i].kind {
            JointKind::Revolute => moment.z,
            JointKind::Prismatic => force.z,
        };
        let outer_force = transforms[i].to_outer(&force);
        carried.moment = transforms[i].to_outer(&moment) + transforms[i].translation.cross(&outer_force);
        carried.force = outer_force;
    }
}

/// Adds the torque of the crank `of` with the parameters `phi` to `tau`, like [`inverse_dynamics`]: the body turns with
/// the crank about the axis of the upper arm's joint.
fn add_crank_torque(
    robot: &Robot,
    (of, phi): (&Parallelogram, &StandardParameters),
    [q, qd, qdd]: [&[f64]; 3],
    tau: &mut [f64],
) {
    let mut transforms = [Transform::IDENTITY; MAX_JOINTS];
    let mut motion = LinkMotion::base(&robot.gravity);
    let last = of.upper_arm.index();
    for (i, joint) in robot.joints[..=last].iter().enumerate() {
        let at = |of_joints: &[f64]| if i == last { of.crank(of_joints) } else { of_joints[i] };
        transforms[i] = joint_transform(joint, at(q));
        motion = motion.next(&transforms[i], joint.kind, at(qd), at(qdd));
    }
    let mut carried = link_wrench(phi, &motion);
    tau[of.forearm.index()] += of.sense * carried.moment.z;
    for i in (0..=last).rev() {
        tau[i] += match robot.joints[i].kind {
            JointKind::Revolute => carried.moment.z,
            JointKind::Prismatic => carried.force.z,
        };
        let force = transforms[i].to_outer(&carried.force);
        carried.moment = transforms[i].to_outer(&carried.moment) + transforms[i].translation.cross(&force);
        carried.force = force;
    }
}

/// Torque that holds the arm still at `q` `[n]` (rad; m): [`inverse_dynamics`] without motion. Writes `tau` `[n]` in Nm
/// (N).
///
/// # Panics
/// Like [`inverse_dynamics`].
pub fn gravity_torque(robot: &Robot, parameters: &[StandardParameters], q: &[f64], tau: &mut [f64]) {
    let still = [0.0; MAX_JOINTS];
    inverse_dynamics(robot, parameters, q, &still, &still, tau);
}

/// Mechanical energy of links, cranks and springs, J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct MechanicalEnergy {
    /// Energy of the motion.
    pub kinetic: f64,
    /// Energy in springs and in the gravity field, zero for masses at the base's origin.
    pub potential: f64,
}

/// Energy of links, cranks and springs at the posture `q` and speed `qd` `[n]` (rad, rad/s; m, m/s).
///
/// Checks compare its time derivative with the power of [`DynamicModel::load`]. For independence it has a separate
/// recursion, without accelerations.
#[must_use]
pub(crate) fn mechanical_energy(
    robot: &Robot,
    model: &DynamicModel,
    q: &[f64],
    qd: &[f64],
) -> MechanicalEnergy {
    let mut frame =
        MovingFrame { pose: Transform::IDENTITY, omega: Vector3::zeros(), velocity: Vector3::zeros() };
    let mut energy = MechanicalEnergy { kinetic: 0.0, potential: 0.0 };
    for (i, (joint, phi)) in robot.joints.iter().zip(&model.inertial).enumerate() {
        let cranks = robot.parallelograms.iter().zip(&model.crank);
        for (of, phi) in cranks.filter(|(of, _)| of.upper_arm.index() == i) {
            frame.next(joint, of.crank(q), of.crank(qd)).add_energy(phi, &robot.gravity, &mut energy);
        }
        frame = frame.next(joint, q[i], qd[i]);
        frame.add_energy(phi, &robot.gravity, &mut energy);
    }
    for (spring, [stiffness, preload]) in robot.springs.iter().zip(&model.spring) {
        let q = q[spring.joint.index()];
        let stretch = match spring.form {
            SpringForm::Direct => q,
            SpringForm::Cylinder { pins: [a, b], aligned } => {
                let p = q - aligned;
                (a - b * p.cos()).hypot(b * p.sin()) - (a - b).abs()
            }
        };
        energy.potential += 0.5 * stiffness * stretch * stretch + preload * stretch;
    }
    energy
}

/// Moving link frame, with velocities in its own axes.
struct MovingFrame {
    pose: Transform,
    omega: Vector3<f64>,
    velocity: Vector3<f64>,
}

impl MovingFrame {
    fn next(&self, joint: &Joint, q: f64, qd: f64) -> Self {
        let transform = joint_transform(joint, q);
        let mut velocity = transform.to_inner(&(self.velocity + self.omega.cross(&transform.translation)));
        let mut omega = transform.to_inner(&self.omega);
        match joint.kind {
            JointKind::Revolute => omega.z += qd,
            JointKind::Prismatic => velocity.z += qd,
        }
        Self { pose: self.pose.then(&transform), omega, velocity }
    }

    fn add_energy(&self, phi: &StandardParameters, gravity: &Vector3<f64>, energy: &mut MechanicalEnergy) {
        let Self { pose, omega, velocity } = self;
        let (m, mp) = (phi.mass(), phi.first_moment());
        energy.kinetic += 0.5 * m * velocity.norm_squared()
            + velocity.dot(&omega.cross(&mp))
            + 0.5 * omega.dot(&(phi.inertia() * omega));
        energy.potential -= gravity.dot(&(m * pose.translation + pose.to_outer(&mp)));
    }
}

/// All parameters of an arm's model by joint: links, friction, motor inertia, couplings, springs, cranks.
///
/// It can also hold base parameters: with the dropped parameters at zero, a kept parameter that contains its whole
/// grouping gives the same torque as the full set.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicModel {
    /// Inertial parameters of each link `[n]`.
    pub inertial: Vec<StandardParameters>,
    /// Friction coefficients of each joint `[n]`, in the order of [`FrictionModel::terms`] of [`Robot::friction_of`].
    pub friction: Vec<[f64; FrictionModel::MAX_TERMS]>,
    /// Motor inertia seen at each joint `[n]`, kg m² (kg).
    pub motor_inertia: Vec<f64>,
    /// `Iam`, `fvm`, `fsm` of each of the robot's couplings.
    pub coupling: Vec<[f64; CouplingTerm::ALL.len()]>,
    /// Load coefficients of each joint `[n]`, in the order of [`LoadFriction::terms`].
    pub load: Vec<[f64; LoadFriction::MAX_TERMS]>,
    /// Described inertia of each joint's motor `[n]`, kg m² (kg), if the parameters include it in those of the links;
    /// zero otherwise. The gear does not carry it.
    pub grouped_motor_inertia: Vec<f64>,
    /// Parameters of each of the robot's springs.
    pub spring: Vec<[f64; 2]>,
    /// Inertial parameters of the crank of each of the robot's parallelograms.
    pub crank: Vec<StandardParameters>,
}

impl DynamicModel {
    /// Model of `robot` with the given parameters; all others are zero. Parameters that the robot does not have, by its
    /// joints, friction columns, couplings, springs and parallelograms, are ignored.
    #[must_use]
    pub fn from_parameters(robot: &Robot, parameters: impl Iterator<Item = (ParameterId, f64)>) -> Self {
        let n = robot.joint_count();
        let described = |joint: &Joint| match joint.nominal {
            Some(nominal) if robot.has_motor_inertia() => nominal.motor_inertia,
            _ => 0.0,
        };
        let mut model = Self {
            inertial: vec![StandardParameters::default(); n],
            friction: vec![[0.0; FrictionModel::MAX_TERMS]; n],
            motor_inertia: vec![0.0; n],
            coupling: vec![[0.0; CouplingTerm::ALL.len()]; robot.couplings.len()],
            load: vec![[0.0; LoadFriction::MAX_TERMS]; n],
            grouped_motor_inertia: robot.joints.iter().map(described).collect(),
            spring: vec![[0.0; 2]; robot.springs.len()],
            crank: vec![StandardParameters::default(); robot.parallelograms.len()],
        };
        for (id, value) in parameters.filter(|(id, _)| id.joint.index() < n) {
            if id.kind == ParameterKind::MotorInertia {
                model.grouped_motor_inertia[id.joint.index()] = 0.0;
            }
            if let Some(place) = model.place(robot, id) {
                *place = value;
            }
        }
        model
    }

    fn place(&mut self, robot: &Robot, id: ParameterId) -> Option<&mut f64> {
        let joint = id.joint.index();
        match id.kind {
            ParameterKind::Inertial(k) => self.inertial[joint].0.get_mut(usize::from(k)),
            ParameterKind::Friction(term) => {
                let model = robot.friction_of(id.joint);
                let place = |terms: &[FrictionTerm]| terms.iter().position(|known| *known == term);
                match place(model.terms()) {
                    Some(k) => self.friction[joint].get_mut(k),
                    None => self.load[joint].get_mut(place(model.load.terms())?),
                }
            }
            ParameterKind::MotorInertia => {
                self.motor_inertia.get_mut(joint).filter(|_| robot.has_motor_inertia())
            }
            ParameterKind::Coupling(term) => {
                let coupling = robot.couplings.iter().position(|known| known.motor_joint == id.joint)?;
                let k = CouplingTerm::ALL.iter().position(|known| *known == term)?;
                self.coupling[coupling].get_mut(k)
            }
            ParameterKind::Spring(term) => {
                let mut springs = robot.springs.iter().zip(&mut self.spring);
                springs.find_map(|(known, parameters)| {
                    let k = known.terms().iter().position(|of| *of == term && known.joint == id.joint)?;
                    parameters.get_mut(k)
                })
            }
            ParameterKind::Crank(k) => {
                let crank = robot.parallelograms.iter().position(|known| known.forearm == id.joint)?;
                self.crank[crank].0.get_mut(usize::from(k))
            }
        }
    }

    /// Torque that the gears carry: that of links, cranks, springs and of the body that the arm is known to carry, without the
    /// inertia of the motors.
    ///
    /// `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m); writes `load` `[n]` in Nm (N).
    ///
    /// # Panics
    /// Like [`DynamicModel::torque`].
    pub fn gear_load(&self, robot: &Robot, q: &[f64], qd: &[f64], qdd: &[f64], load: &mut [f64]) {
        self.load(robot, q, qd, qdd, load);
        add_carried(robot, [q, qd, qdd], load);
        for ((load, inertia), qdd) in load.iter_mut().zip(&self.grouped_motor_inertia).zip(qdd) {
            *load -= inertia * qdd;
        }
    }

    /// Friction of a joint due to the torque `load` on its gear at the speed `qd`, Nm (N).
    #[must_use]
    pub fn load_friction(&self, robot: &Robot, joint: JointIndex, load: f64, qd: f64) -> f64 {
        let columns = robot.friction_of(joint).load_columns(load, qd);
        columns.iter().zip(&self.load[joint.index()]).map(|(column, mu)| column * mu).sum()
    }

    /// Torque of links, cranks and springs, without friction and without the motors' own inertia.
    ///
    /// `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m); writes `tau` `[n]` in Nm (N).
    ///
    /// # Panics
    /// Like [`DynamicModel::torque`].
    pub fn load(&self, robot: &Robot, q: &[f64], qd: &[f64], qdd: &[f64], tau: &mut [f64]) {
        inverse_dynamics(robot, &self.inertial, q, qd, qdd, tau);
        self.add_beside_links(robot, [q, qd, qdd], tau);
    }

    /// Adds the torque of cranks and springs to that of the links.
    pub(super) fn add_beside_links(&self, robot: &Robot, state: [&[f64]; 3], tau: &mut [f64]) {
        for (spring, parameters) in robot.springs.iter().zip(&self.spring) {
            let j = spring.joint.index();
            tau[j] += spring.columns(state[0][j]).iter().zip(parameters).map(|(c, p)| c * p).sum::<f64>();
        }
        for crank in robot.parallelograms.iter().zip(&self.crank) {
            add_crank_torque(robot, crank, state, tau);
        }
    }

    /// Motor torque at the joints: rigid links, cranks, springs, friction, `I_m qdd` and couplings.
    ///
    /// `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m); writes `tau` `[n]` in Nm (N).
    ///
    /// # Panics
    /// Like [`inverse_dynamics`], and if the model has fewer joints than the robot.
    pub fn torque(&self, robot: &Robot, q: &[f64], qd: &[f64], qdd: &[f64], tau: &mut [f64]) {
        self.load(robot, q, qd, qdd, tau);
        let mut carried = [0.0; MAX_JOINTS];
        add_carried(robot, [q, qd, qdd], &mut carried);
        for joint in robot.joint_indices() {
            let i = joint.index();
            let friction = robot.friction_of(joint).torque(&self.friction[i], qd[i]);
            let load = tau[i] + carried[i] - self.grouped_motor_inertia[i] * qdd[i];
            let of_load = self.load_friction(robot, joint, load, qd[i]);
            tau[i] += friction + of_load + self.motor_inertia[i] * qdd[i];
        }
        for (coupling, parameters) in robot.couplings.iter().zip(&self.coupling) {
            let columns = coupling_columns(coupling, robot.friction_of(coupling.motor_joint).law, qd, qdd);
            let along =
                |columns: [f64; 3]| -> f64 { columns.iter().zip(parameters).map(|(c, p)| c * p).sum() };
            tau[coupling.joint.index()] += along(columns.joint);
            tau[coupling.motor_joint.index()] += along(columns.motor_joint);
        }
    }
}

/// Motion of a link frame, expressed in that frame. It contains gravity as an acceleration of the base.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinkMotion {
    /// Angular velocity, rad/s.
    pub omega: Vector3<f64>,
    /// Angular acceleration, rad/s².
    pub alpha: Vector3<f64>,
    /// Acceleration of the origin, m/s².
    pub a: Vector3<f64>,
}

impl LinkMotion {
    /// Motion of a base at rest in `gravity` (m/s²), which equals that of a base accelerating against it.
    pub fn base(gravity: &Vector3<f64>) -> Self {
        Self { omega: Vector3::zeros(), alpha: Vector3::zeros(), a: -gravity }
    }

    /// Motion of the next link: [3.1-3.3], the latter with both terms under the rotation.
    #[inline]
    pub fn next(&self, transform: &Transform, kind: JointKind, qd: f64, qdd: f64) -> Self {
        let p = &transform.translation;
        let carried = transform.to_inner(&self.omega);
        let mut omega = carried;
        let mut alpha = transform.to_inner(&self.alpha);
        let mut a =
            transform.to_inner(&(self.a + self.alpha.cross(p) + self.omega.cross(&self.omega.cross(p))));
        // `carried x z` is (y, -x, 0).
        match kind {
            JointKind::Revolute => {
                omega.z += qd;
                alpha += Vector3::new(carried.y * qd, -carried.x * qd, qdd);
            }
            JointKind::Prismatic => {
                a += Vector3::new(2.0 * carried.y * qd, -2.0 * carried.x * qd, qdd);
            }
        }
        Self { omega, alpha, a }
    }
}

/// Force in N and moment about the frame's origin in Nm.
#[derive(Debug, Clone, Copy)]
struct Wrench {
    force: Vector3<f64>,
    moment: Vector3<f64>,
}

impl Wrench {
    const ZERO: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), moment: Vector3::new(0.0, 0.0, 0.0) };
}

/// Wrench that gives a link this motion [3.4-3.7], about the frame's origin.
#[inline]
fn link_wrench(phi: &StandardParameters, motion: &LinkMotion) -> Wrench {
    let LinkMotion { omega, alpha, a } = motion;
    let [m, mpx, mpy, mpz, xx, xy, xz, yy, yz, zz] = phi.0;
    let mp = Vector3::new(mpx, mpy, mpz);
    let inertia_times = |v: &Vector3<f64>| {
        Vector3::new(
            xx * v.x + xy * v.y + xz * v.z,
            xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z,
        )
    };
    Wrench {
        force: m * a + alpha.cross(&mp) + omega.cross(&omega.cross(&mp)),
        moment: inertia_times(alpha) + omega.cross(&inertia_times(omega)) + mp.cross(a),
    }
}

#[cfg(test)]
mod tests;
