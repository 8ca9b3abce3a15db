//! A drawn design of an arm: geometry, bodies and the information of its test motion about its parameters.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::draws::Draws;
use armwatch_method::NumericsError;
use armwatch_method::model::base_parameters::{BaseParameters, base_parameters, probe_state};
use armwatch_method::model::regressor::{Regressor, joint_torque_regressor};
use armwatch_model::robot::{
    ArmShape, DhParameters, FrictionLaw, FrictionModel, FrictionTerm, Joint, JointGeometry, JointKind,
    JointLimits, ParameterId, ParameterKind, Robot, StandardParameters, TorqueSensors, Transform,
};

/// States of a test motion that count as independent rows of a cycle: a cycle has thousands of rows, filtered to
/// some ten hertz.
pub(super) const STATES: usize = 240;
/// Designs that may be drawn before one has a clear rank.
const ATTEMPTS: usize = 20;

/// A design.
#[derive(Debug)]
pub(super) struct Design {
    pub(super) robot: Robot,
    pub(super) base: BaseParameters,
    /// Parameters in natural order.
    pub(super) phi: Vec<f64>,
    /// `W_i' W_i` of the rows of each joint, `[b x b]`.
    pub(super) gram: Vec<DMatrix<f64>>,
    /// `W_i' 1` of the rows of each joint, `[b]`.
    pub(super) sums: Vec<DVector<f64>>,
}

impl Design {
    /// Draws a design of four to seven joints.
    ///
    /// # Errors
    /// [`NumericsError`] of the last one, if none of [`ATTEMPTS`] has base parameters.
    pub(super) fn draw(draws: &mut Draws) -> Result<Self, NumericsError> {
        let mut last = NumericsError::TooShort { what: "the chain of joints", rows: 0, needed: 1 };
        for _ in 0..ATTEMPTS {
            let robot = robot(draws);
            match base_parameters(&robot) {
                Ok(base) => return Ok(Self::with(robot, base, draws)),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn with(robot: Robot, base: BaseParameters, draws: &mut Draws) -> Self {
        let phi = parameters(&robot, draws);
        let rows = rows(&robot, &base, None);
        let gram = rows.iter().map(|w| w.transpose() * w).collect();
        let sums = rows.iter().map(|w| w.row_sum().transpose()).collect();
        Self { robot, base, phi, gram, sums }
    }

    /// Torque of each joint `[n][STATES]`, Nm, beyond that of the recorded positions, if the true position of `joint`
    /// is `error` rad larger than the recorded one.
    pub(super) fn misread(&self, theta: &DVector<f64>, joint: usize, error: f64) -> Vec<DVector<f64>> {
        let right = rows(&self.robot, &self.base, None);
        let wrong = rows(&self.robot, &self.base, Some((joint, error)));
        wrong.iter().zip(&right).map(|(wrong, right)| (wrong - right) * theta).collect()
    }

    /// Rows of each joint of the test motion, `[STATES x b]`.
    pub(super) fn rows(&self) -> Vec<DMatrix<f64>> {
        rows(&self.robot, &self.base, None)
    }
}

fn rows(robot: &Robot, base: &BaseParameters, shift: Option<(usize, f64)>) -> Vec<DMatrix<f64>> {
    let n = robot.joint_count();
    let mut found = vec![DMatrix::zeros(STATES, base.kept_columns.len()); n];
    let mut y = Regressor::new(robot);
    for index in 0..STATES {
        let mut state = probe_state(robot, index);
        if let Some((joint, error)) = shift {
            state.q[joint] += error;
        }
        joint_torque_regressor(robot, &state.q, &state.qd, &state.qdd, &mut y);
        for (k, &column) in base.kept_columns.iter().enumerate() {
            for (j, value) in y.column(column).iter().enumerate() {
                found[j][(index, k)] = *value;
            }
        }
    }
    found
}

fn robot(draws: &mut Draws) -> Robot {
    let n = draws.whole(4, 7);
    let joints: Vec<Joint> = (0..n).map(|j| joint(draws, j)).collect();
    let law = if draws.happens(0.6) { FrictionLaw::Polynomial } else { FrictionLaw::ViscousCoulomb };
    Robot {
        model: "drawn".into(),
        transmission: Robot::uncoupled_transmission(&joints),
        joints,
        gravity: Vector3::new(0.0, 0.0, -9.81),
        tool: Transform::IDENTITY,
        carried: StandardParameters::default(),
        friction: FrictionModel { law, ..FrictionModel::POLYNOMIAL },
        torque_sensors: TorqueSensors::Motor,
        couplings: Vec::new(),
        springs: Vec::new(),
        parallelograms: Vec::new(),
        speed_levels: vec![0.2, 0.4, 0.6, 0.8],
        excitation: None,
        shape: ArmShape::default(),
        remarks: Vec::new(),
    }
}

fn joint(draws: &mut Draws, j: usize) -> Joint {
    let turned = if draws.happens(0.75) { draws.sign(0.5) * FRAC_PI_2 } else { 0.0 };
    let row = DhParameters {
        a: if j == 0 || draws.happens(0.4) { 0.0 } else { draws.between(0.05, 0.7) },
        alpha: if j == 0 { 0.0 } else { turned },
        d: if draws.happens(0.5) { 0.0 } else { draws.between(0.05, 0.6) },
        theta_offset: 0.0,
    };
    let range = draws.between(1.2, 2.8);
    Joint {
        name: None,
        kind: JointKind::Revolute,
        geometry: JointGeometry::modified_dh(row),
        limits: JointLimits {
            position_min: -range,
            position_max: range,
            velocity: draws.between(1.0, 3.5),
            acceleration: draws.between(2.0, 10.0),
            jerk: None,
        },
        gear_ratio: 100.0,
        position_offset: 0.0,
        drive_gain: None,
        motor_torque_constant: None,
        rated_motor_torque: None,
        rated_torque: None,
        peak_torque: None,
        low_speed: 0.01,
        has_torque: true,
        friction: None,
        nominal: None,
    }
}

/// Bodies of links that grow lighter towards the tool, friction and motor inertias.
fn parameters(robot: &Robot, draws: &mut Draws) -> Vec<f64> {
    let n = robot.joint_count();
    let mut mass = draws.between(6.0, 40.0);
    let mut bodies = Vec::with_capacity(n);
    for _ in 0..n {
        mass *= draws.between(0.5, 0.9);
        bodies.push(body(mass, draws));
    }
    let level: Vec<f64> = (0..n).map(|j| draws.log_between(3.0, 20.0) * 0.7_f64.powf(j as f64)).collect();
    let motor: Vec<f64> = level.iter().map(|level| level * draws.between(0.02, 0.1)).collect();
    ParameterId::natural_order(robot)
        .iter()
        .map(|id| {
            let j = id.joint.index();
            match id.kind {
                ParameterKind::Inertial(k) => bodies[j].0[usize::from(k)],
                ParameterKind::MotorInertia => motor[j],
                ParameterKind::Friction(FrictionTerm::F1 | FrictionTerm::Coulomb) => level[j],
                ParameterKind::Friction(FrictionTerm::F2 | FrictionTerm::Viscous) => 0.4 * level[j],
                ParameterKind::Friction(_)
                | ParameterKind::Coupling(_)
                | ParameterKind::Spring(_)
                | ParameterKind::Crank(_) => 0.0,
            }
        })
        .collect()
}

/// A body of this mass, kg, with its centre within some 0.2 m and matching radii of gyration.
pub(super) fn body(mass: f64, draws: &mut Draws) -> StandardParameters {
    let centre =
        Vector3::new(draws.between(-0.2, 0.2), draws.between(-0.15, 0.15), draws.between(-0.15, 0.15));
    let of = [0; 3].map(|_| draws.between(0.03, 0.12).powi(2));
    // sums of two, so that the triangle inequality holds
    let inertia = Matrix3::from_diagonal(&Vector3::new(of[1] + of[2], of[0] + of[2], of[0] + of[1])) * mass;
    StandardParameters::from_centre_of_mass(mass, &centre, &inertia)
}
