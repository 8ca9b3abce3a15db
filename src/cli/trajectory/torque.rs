//! Torques of the motors in a motion.

use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_method::pooled::nominal_prior::nominal_base;
use armwatch_model::robot::{Joint, Robot};

/// Rated torque of each joint, Nm (N), if the description has one: its own, or the motor's through the gear.
pub(super) fn rated_torques(robot: &Robot) -> Vec<Option<f64>> {
    let of = |joint: &Joint| {
        joint.rated_torque.or_else(|| joint.rated_motor_torque.map(|motor| motor * joint.gear_ratio.abs()))
    };
    robot.joints.iter().map(of).collect()
}

/// Torque of one joint in a motion, Nm (N).
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct TorqueUse {
    /// Root mean square.
    pub root_mean_square: f64,
    /// Largest magnitude.
    pub peak: f64,
    /// Limit of the root mean square.
    pub rated: Option<f64>,
    /// Limit of the magnitude.
    pub peak_limit: Option<f64>,
}

/// Torques of each joint `[n]` for evenly spaced states `[position, velocity, acceleration][n]`; `None` if the
/// description lacks nominal parameters.
pub(super) fn torque_use(
    robot: &Robot,
    states: impl Iterator<Item = [Vec<f64>; 3]>,
) -> Result<Option<Vec<TorqueUse>>, CliError> {
    let base = base_parameters(robot).map_err(|error| CliError::Usage(error.to_string()))?;
    let nominal: Option<Vec<f64>> = nominal_base(robot, &base).into_iter().collect();
    let Some(values) = nominal else { return Ok(None) };
    let model = DynamicModel::from_parameters(robot, base.kept.iter().copied().zip(values));
    let n = robot.joint_count();
    let (mut squares, mut peaks, mut tau) = (vec![0.0; n], vec![0.0_f64; n], vec![0.0; n]);
    let mut instants = 0.0_f64;
    for [q, qd, qdd] in states {
        model.torque(robot, &q, &qd, &qdd, &mut tau);
        instants += 1.0;
        for (j, tau) in tau.iter().enumerate() {
            squares[j] += tau * tau;
            peaks[j] = peaks[j].max(tau.abs());
        }
    }
    let of_joint = |(j, rated): (usize, Option<f64>)| TorqueUse {
        root_mean_square: (squares[j] / instants.max(1.0)).sqrt(),
        peak: peaks[j],
        rated,
        peak_limit: robot.joints[j].peak_torque,
    };
    Ok(Some(rated_torques(robot).into_iter().enumerate().map(of_joint).collect()))
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
        let rated = of.rated.filter(|rated| of.root_mean_square > *rated)?;
        Some(format!(
            "joint {joint}: the root mean square of its torque, {:.1} Nm (N), is above its rated torque, {rated:.1}; let the \
             arm rest between repetitions, or design an excitation with a smaller --torque-share",
            of.root_mean_square
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
                share(of.root_mean_square, of.rated),
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
            "joint": joint, "torque_rms_nm": of.root_mean_square, "torque_peak_nm": of.peak,
            "rated_torque_nm": of.rated, "peak_torque_nm": of.peak_limit,
        })
    };
    (1..).zip(joints).map(of_joint).collect()
}
