//! Torques of the motors in a motion.

use nalgebra::DMatrix;
use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use armwatch_method::model::base_parameters::{BaseParameters, base_parameters};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_method::pooled::nominal_prior::nominal_torque_base;
use armwatch_model::robot::transmission::joint_per_motor;
use armwatch_model::robot::{Joint, JointIndex, ParameterId, ParameterKind, Robot};

/// The limit of each joint for continuous duty.
pub(super) struct DutyLimits {
    /// Weights `[n x n]` of the joints' torques in the limited torques: that of the joint if it is rated, that of its
    /// motor through its own gear if the motor is rated. They differ if motors turn with several joints.
    pub weights: DMatrix<f64>,
    /// Rated torque, Nm (N), if the description has one.
    pub rated: Vec<Option<f64>>,
}

impl DutyLimits {
    pub fn of(robot: &Robot) -> Self {
        let n = robot.joint_count();
        let rated = |joint: &Joint| {
            joint
                .rated_torque
                .or_else(|| joint.rated_motor_torque.map(|motor| motor * joint.gear_ratio.abs()))
        };
        let mut weights = DMatrix::identity(n, n);
        let inverse = joint_per_motor(&robot.transmission).filter(|_| robot.has_coupled_motors());
        if let Some(joint_per_motor) = inverse {
            // by virtual power, tau = R' tau_motor
            for (j, joint) in
                robot.joints.iter().enumerate().filter(|(_, joint)| joint.rated_torque.is_none())
            {
                (0..n).for_each(|k| weights[(j, k)] = joint.gear_ratio * joint_per_motor[(k, j)]);
            }
        }
        Self { weights, rated: robot.joints.iter().map(rated).collect() }
    }
}

/// Nominal base parameters for torques.
///
/// # Errors
/// Why there are none, as a clause.
pub(super) fn nominal_parameters(robot: &Robot, base: &BaseParameters) -> Result<Vec<f64>, String> {
    nominal_torque_base(robot, base).map_err(|missing| lacking(robot, &missing))
}

/// Why parameters have no nominal values.
fn lacking(robot: &Robot, missing: &[ParameterId]) -> String {
    let bare = |joint: JointIndex| robot.joints[joint.index()].nominal.is_none();
    let mut reasons: Vec<String> = Vec::new();
    for id in missing {
        let joint = id.joint;
        let reason = match id.kind {
            ParameterKind::Spring(_) => {
                format!("the spring or counterbalance of joint {joint} has no numbers")
            }
            ParameterKind::Crank(_) => format!("the crank of joint {joint} has no numbers"),
            _ if bare(joint) => format!("joint {joint} has no [joint.nominal]"),
            ParameterKind::Friction(term) if term.is_of_load() => {
                format!("load-dependent friction of joint {joint} has no nominal value")
            }
            ParameterKind::Friction(_) => {
                format!("the friction model of joint {joint} has no f3 and f4, but [joint.nominal] has them")
            }
            _ => format!("{id} has no nominal value"),
        };
        if !reasons.contains(&reason) {
            reasons.push(reason);
        }
    }
    reasons.join(", ")
}

/// Remark on the torques of an arm with coupled motors.
pub(super) fn without_coupled_motors(robot: &Robot) -> Option<String> {
    (!robot.couplings.is_empty()).then(|| {
        "torques are without inertia and friction of coupled motors: a description has no values for them"
            .to_owned()
    })
}

/// Torque of one joint in a motion, Nm (N).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct TorqueUse {
    /// Root mean square.
    pub root_mean_square: f64,
    /// Root mean square of the rated torque's quantity: of the joint, or of its motor through its own gear.
    pub duty: f64,
    /// Largest magnitude.
    pub peak: f64,
    /// Limit of [`TorqueUse::duty`].
    pub rated: Option<f64>,
    /// Limit of the magnitude.
    pub peak_limit: Option<f64>,
}

/// Torques of each joint `[n]` for evenly spaced states `[position, velocity, acceleration][n]`; the inner error says why
/// the description does not give them.
pub(super) fn torque_use(
    robot: &Robot,
    states: impl Iterator<Item = [Vec<f64>; 3]>,
) -> Result<Result<Vec<TorqueUse>, String>, CliError> {
    let base = base_parameters(robot).map_err(|error| CliError::Usage(error.to_string()))?;
    let values = match nominal_parameters(robot, &base) {
        Ok(values) => values,
        Err(reason) => return Ok(Err(reason)),
    };
    let model = DynamicModel::from_parameters(robot, base.kept.iter().copied().zip(values));
    let n = robot.joint_count();
    let DutyLimits { weights, rated } = DutyLimits::of(robot);
    let (mut squares, mut peaks, mut tau) = (vec![[0.0; 2]; n], vec![0.0_f64; n], vec![0.0; n]);
    let mut instants = 0.0_f64;
    for [q, qd, qdd] in states {
        model.torque(robot, &q, &qd, &qdd, &mut tau);
        instants += 1.0;
        for (j, of_joint) in tau.iter().enumerate() {
            let duty: f64 = weights.row(j).iter().zip(&tau).map(|(weight, tau)| weight * tau).sum();
            squares[j][0] += of_joint * of_joint;
            squares[j][1] += duty * duty;
            peaks[j] = peaks[j].max(of_joint.abs());
        }
    }
    let of_joint = |(j, rated): (usize, Option<f64>)| {
        let [root_mean_square, duty] = squares[j].map(|sum: f64| (sum / instants.max(1.0)).sqrt());
        TorqueUse { root_mean_square, duty, peak: peaks[j], rated, peak_limit: robot.joints[j].peak_torque }
    };
    Ok(Ok(rated.into_iter().enumerate().map(of_joint).collect()))
}

/// Torques above a joint's short-term limit, one sentence each.
pub(super) fn peaks_beyond(joints: &[TorqueUse]) -> Vec<String> {
    let beyond = |(joint, of): (usize, &TorqueUse)| {
        let limit = of.peak_limit.filter(|limit| of.peak > *limit)?;
        Some(format!(
            "joint {joint}: torque {:.2} Nm (N), limit {limit:.2} Nm (N), beyond it by {:.1} %",
            of.peak,
            100.0 * (of.peak / limit - 1.0)
        ))
    };
    (1..).zip(joints).filter_map(beyond).collect()
}

/// Motors that exceed their limit for continuous duty, one sentence each.
pub(super) fn heating(joints: &[TorqueUse]) -> Vec<String> {
    let beyond = |(joint, of): (usize, &TorqueUse)| {
        let rated = of.rated.filter(|rated| of.duty > *rated)?;
        Some(format!(
            "joint {joint}: the root mean square of its torque, {:.1} Nm (N), is above its rated torque, {rated:.1}; let the \
             arm rest between repetitions, or design an excitation with a smaller --torque-share",
            of.duty
        ))
    };
    (1..).zip(joints).filter_map(beyond).collect()
}

/// Prints one row per joint.
pub(super) fn print_torques(joints: &[TorqueUse]) {
    let number = |value: f64| format!("{value:.2}");
    let share = |value: f64, limit: Option<f64>| {
        limit.map_or_else(|| "-".to_owned(), |limit| format!("{:.1} %", 100.0 * value / limit))
    };
    let rows: Vec<Vec<String>> = (1..)
        .zip(joints)
        .map(|(joint, of): (usize, &TorqueUse)| {
            vec![
                joint.to_string(),
                number(of.root_mean_square),
                share(of.duty, of.rated),
                number(of.peak),
                share(of.peak, of.peak_limit),
            ]
        })
        .collect();
    output::print_table(
        &["joint", "torque RMS, Nm (N)", "of rated", "largest, Nm (N)", "of peak"],
        &rows,
        &[],
    );
}

/// The same for scripts.
pub(super) fn as_value(joints: &[TorqueUse]) -> Value {
    let of_joint = |(joint, of): (usize, &TorqueUse)| {
        json!({
            "joint": joint, "torque_rms_nm": of.root_mean_square, "duty_torque_rms_nm": of.duty,
            "torque_peak_nm": of.peak, "rated_torque_nm": of.rated, "peak_torque_nm": of.peak_limit,
        })
    };
    (1..).zip(joints).map(of_joint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a_of;

    /// Motor 2 turns with both joints: `tau_1 = 45 m_1 + 32 m_2`, `tau_2 = 32 m_2`.
    #[test]
    fn rated_motors_are_limited_by_their_own_torque() {
        let mut robot = er3a_of(2);
        robot.transmission = DMatrix::from_row_slice(2, 2, &[45.0, 0.0, 32.0, 32.0]);
        (robot.joints[0].gear_ratio, robot.joints[1].gear_ratio) = (45.0, 32.0);
        for joint in &mut robot.joints {
            (joint.rated_torque, joint.rated_motor_torque) = (None, Some(0.5));
        }
        let motors = [3.0, -2.0];
        let tau = nalgebra::DVector::from_vec(vec![45.0 * motors[0] + 32.0 * motors[1], 32.0 * motors[1]]);
        let DutyLimits { weights, rated } = DutyLimits::of(&robot);
        let through_gears = &weights * &tau;
        assert!(
            (through_gears[0] - 45.0 * motors[0]).abs() < 1e-12
                && (through_gears[1] - 32.0 * motors[1]).abs() < 1e-12
        );
        assert_eq!(rated, [Some(22.5), Some(16.0)]);
        // a rated joint is limited by the torque of the joint
        robot.joints[0].rated_torque = Some(30.0);
        let DutyLimits { weights, rated } = DutyLimits::of(&robot);
        assert_eq!(((&weights * &tau)[0], rated[0]), (tau[0], Some(30.0)));
    }

    #[test]
    fn the_reason_for_unknown_torques_is_the_true_one() {
        let mut robot = er3a_of(2);
        let reason = |robot: &Robot| {
            let base = base_parameters(robot).expect("base parameters");
            nominal_parameters(robot, &base).expect_err("something is missing")
        };
        robot.friction.law = armwatch_model::robot::FrictionLaw::ViscousCoulomb;
        let said = reason(&robot);
        assert!(said.contains("the friction model of joint 1 has no f3 and f4"), "{said}");
        robot.joints[1].nominal = None;
        let said = reason(&robot);
        assert!(
            said.contains("joint 2 has no [joint.nominal]") && !said.contains("model of joint 2"),
            "{said}"
        );
    }
}
