//! Findings about an identified model that no arm can have, which indicate a wrong geometry, unit or sign.

mod alternatives;
pub(crate) mod assignment;
pub(crate) mod causes;
mod change;
pub(crate) mod channels;
pub(crate) mod combination;
mod delay;
mod description;
pub mod doubt;
mod friction_shapes;
pub(crate) mod nominal;
pub(crate) mod level;
mod numbers;
mod readings;
mod joint_fit;
pub(crate) mod unmeasured;
pub(crate) mod weigh;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod sound_tests;

use crate::diagnose::model::combination::{Combination, PlausibleSettings};
use crate::model::base_parameters::{PROBE_STATES, probe_state};
use crate::model::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::{Identification, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{FrictionTerm, JointIndex, ParameterId, ParameterKind, Robot};
use armwatch_model::run::Stage;

/// Findings about an identified model: negative inertia of a joint in some posture, friction that drives, torque that
/// is not explained.
///
/// `verification` is that of the same cycle. `top_speeds` `[n]` is the largest speed of each joint in the rows of the
/// identification, rad/s (m/s); friction is judged only up to it.
#[must_use]
pub(crate) fn diagnose_model(
    robot: &Robot,
    identified: &Identification,
    verification: &[TorqueRmsd],
    top_speeds: &[f64],
    settings: &PlausibleSettings,
) -> Vec<Finding> {
    let mut found: Vec<Finding> = robot
        .joint_indices()
        .filter_map(|joint| negative_friction(robot, identified, joint, top_speeds[joint.index()], settings))
        .collect();
    found.extend(negative_inertias(robot, identified, settings));
    found.extend(nominal::negative_masses(robot, identified, settings));
    found.extend(nominal::far_from_nominal(robot, identified, settings));
    found.extend(verification.iter().filter_map(|rmsd| unexplained(rmsd, settings)));
    found.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    found
}

/// Largest speed of each joint in the given rows, `[n]`, from their velocities `[n][rows]`.
#[must_use]
pub(crate) fn top_speeds(velocities: &[Vec<f64>], rows: &[usize]) -> Vec<f64> {
    velocities.iter().map(|qd| rows.iter().map(|&row| qd[row].abs()).fold(0.0, f64::max)).collect()
}

fn negative_friction(
    robot: &Robot,
    identified: &Identification,
    joint: JointIndex,
    top_speed: f64,
    settings: &PlausibleSettings,
) -> Option<Finding> {
    /// Number of speeds: tenths of the largest.
    const STEPS: u32 = 10;
    let mut worst = (Combination { value: f64::INFINITY, variance: 0.0 }, 0.0);
    let mut mean = 0.0;
    for step in 1..=STEPS {
        let speed = top_speed * f64::from(step) / f64::from(STEPS);
        let columns = robot.friction_of(joint).columns(speed);
        let mut torque = Combination::default();
        for parameter in identified.parameters.iter().filter(|p| p.id.joint == joint) {
            let ParameterKind::Friction(term) = parameter.id.kind else { continue };
            // an offset of the torque signal is no friction, whatever its sign
            let place = robot
                .friction_of(joint)
                .terms()
                .iter()
                .position(|of| *of == term && term != FrictionTerm::Offset);
            if let Some(place) = place {
                torque.add(columns[place], parameter.value, parameter.std_error);
            }
        }
        mean += torque.value / f64::from(STEPS);
        if torque.value + settings.standard_errors * torque.variance.sqrt()
            < worst.0.value + settings.standard_errors * worst.0.variance.sqrt()
        {
            worst = (torque, speed);
        }
    }
    let (torque, speed) = worst;
    if torque.value + settings.standard_errors * torque.variance.sqrt() >= 0.0 {
        return None;
    }
    let (severity, words) = match mean < 0.0 {
        true => (
            FindingSeverity::Refuse,
            "friction would drive the joint: the sign of the torque or of the velocity is wrong, or columns are swapped",
        ),
        false => (
            FindingSeverity::Warn,
            "the friction curve dips below zero there: too few speeds in the recording, or a wrong geometry",
        ),
    };
    Some(Finding {
        kind: FindingKind::NegativeFriction,
        severity,
        joint: Some(joint),
        sentence: format!(
            "joint {joint}: the identified friction is {:.3} Nm (N) at {speed:.3} rad/s (m/s) in the direction of motion; {words}",
            torque.value
        ),
        evidence: vec![
            Evidence { name: "friction_nm", value: torque.value },
            Evidence { name: "std_error_nm", value: torque.variance.sqrt() },
            Evidence { name: "speed_rad_s", value: speed },
            Evidence { name: "mean_friction_nm", value: mean },
        ],
    })
}

/// Findings of negative inertia. The inertia at a joint, motor included, is a diagonal entry of the mass matrix: linear
/// in the base parameters and positive in every posture of every arm.
fn negative_inertias(
    robot: &Robot,
    identified: &Identification,
    settings: &PlausibleSettings,
) -> Vec<Finding> {
    let n = robot.joint_count();
    let order = ParameterId::natural_order(robot);
    let columns: Vec<usize> =
        identified.parameters.iter().filter_map(|p| order.iter().position(|id| *id == p.id)).collect();
    let kept = KeptColumns::new(&columns);
    let mut moving = Regressor::new(robot);
    let mut resting = Regressor::new(robot);
    let (mut with, mut without) = (vec![0.0; n * kept.len()], vec![0.0; n * kept.len()]);
    let still = vec![0.0; n];
    let mut worst: Vec<Option<(Combination, Vec<f64>)>> = vec![None; n];
    for index in 0..PROBE_STATES {
        let q = probe_state(robot, index).q;
        joint_torque_regressor(robot, &q, &still, &still, &mut resting);
        kept.write(&resting, &mut without, n, 0);
        for j in 0..n {
            let mut unit = still.clone();
            unit[j] = 1.0;
            joint_torque_regressor(robot, &q, &still, &unit, &mut moving);
            kept.write(&moving, &mut with, n, 0);
            let mut felt = Combination::default();
            for (k, parameter) in identified.parameters.iter().enumerate().take(kept.len()) {
                felt.add(with[k * n + j] - without[k * n + j], parameter.value, parameter.std_error);
            }
            if worst[j].as_ref().is_none_or(|(before, _)| felt.value < before.value) {
                worst[j] = Some((felt, q.clone()));
            }
        }
    }
    let mut found = Vec::new();
    for (joint, worst) in robot.joint_indices().zip(worst) {
        let Some((felt, q)) = worst else { continue };
        if felt.value + settings.standard_errors * felt.variance.sqrt() >= 0.0 {
            continue;
        }
        let posture: Vec<String> = q.iter().map(|q| format!("{q:.2}")).collect();
        found.push(Finding {
            kind: FindingKind::NegativeInertia,
            severity: FindingSeverity::Refuse,
            joint: Some(joint),
            sentence: format!(
                "joint {joint}: the identified model gives it a negative inertia ({:.4} {}) in the posture \
                 ({}); no arm is so: check the description's geometry (which Denavit-Hartenberg convention, twists, \
                 offsets), units and signs",
                felt.value,
                nominal::inertia_unit(robot, joint),
                posture.join(", ")
            ),
            evidence: vec![
                Evidence { name: "inertia_kg_m2", value: felt.value },
                Evidence { name: "std_error_kg_m2", value: felt.variance.sqrt() },
            ],
        });
    }
    found
}

fn unexplained(rmsd: &TorqueRmsd, settings: &PlausibleSettings) -> Option<Finding> {
    let relative = rmsd.moving_rows.relative;
    let excitation = rmsd.scope == RmsdScope::Stage(Stage::Excitation);
    if !excitation || relative <= settings.relative_rmsd[0] {
        return None;
    }
    let severity = match relative > settings.relative_rmsd[1] {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    let joint = rmsd.joint;
    Some(Finding {
        kind: FindingKind::Unexplained,
        severity,
        joint: Some(joint),
        sentence: format!(
            "joint {joint}: the model leaves {:.0} % of the torque unexplained while the joint moves (healthy arms: below \
             13 %); check the description's geometry, columns, units and signs, then the joint itself",
            100.0 * relative
        ),
        evidence: vec![
            Evidence { name: "moving_relative_rmsd", value: relative },
            Evidence { name: "moving_rmsd_nm", value: rmsd.moving_rows.value },
        ],
    })
}
