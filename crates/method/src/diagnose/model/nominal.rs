//! Comparison of identified parameters with physical limits and with the description: masses below zero, inertias far
//! from the nominal ones.

use nalgebra::Vector3;

use super::combination::{Combination, PlausibleSettings};
use crate::model::base_parameters::probe_state;
use crate::model::dynamics::{DynamicModel, inverse_dynamics};
use crate::model::kinematics::joint_transform;
use crate::model::regressor::{Regressor, joint_torque_regressor};
use armwatch_model::analysis::Identification;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{
    Joint, JointIndex, JointKind, ParameterId, Robot, StandardParameters, Transform,
};

/// Number of postures for a median.
const POSTURES: usize = 32;
/// Part of gravity along a sliding joint that is necessary for its load to be visible.
const ALONG: f64 = 0.1;
/// Factor on the deviation from nominal inertia for a single joint, compared with several together.
const ALONE_FACTOR: f64 = 2.0;

/// Findings of sliding joints with a negative load mass, as if gravity lifted them.
///
/// At rest the force of such a joint is `-M g z` with `M` the mass of all links it carries and `z` its axis.
pub(super) fn negative_masses(
    robot: &Robot,
    identified: &Identification,
    settings: &PlausibleSettings,
) -> Vec<Finding> {
    let sliding =
        robot.joint_indices().zip(&robot.joints).filter(|(_, joint)| joint.kind == JointKind::Prismatic);
    let negative = |(joint, _): (JointIndex, &Joint)| {
        let mass = carried_mass(robot, identified, joint)?;
        let error = mass.variance.sqrt();
        (mass.value + settings.standard_errors * error < 0.0).then(|| Finding {
            kind: FindingKind::NegativeInertia,
            severity: FindingSeverity::Refuse,
            joint: Some(joint),
            sentence: format!(
                "joint {joint}: the identified mass that it carries is {:.2} kg; no mass is negative: gravity_m_s2 of the \
                 description points the wrong way, or the sign of this joint's force is turned",
                mass.value
            ),
            evidence: vec![
                Evidence { name: "mass_kg", value: mass.value },
                Evidence { name: "std_error_kg", value: error },
            ],
        })
    };
    sliding.filter_map(negative).collect()
}

fn carried_mass(robot: &Robot, identified: &Identification, joint: JointIndex) -> Option<Combination> {
    let order = ParameterId::natural_order(robot);
    let still = vec![0.0; robot.joint_count()];
    let mut y = Regressor::new(robot);
    let mut coefficients = vec![0.0; identified.parameters.len()];
    let mut squares = 0.0;
    for index in 0..POSTURES {
        let q = probe_state(robot, index).q;
        let carried: Vec<(&Joint, f64)> =
            robot.joints.iter().zip(q.iter().copied()).take(joint.index() + 1).collect();
        let frame = carried
            .iter()
            .fold(Transform::IDENTITY, |frame, (joint, q)| frame.then(&joint_transform(joint, *q)));
        let along = -robot.gravity.dot(&frame.to_outer(&Vector3::z()));
        joint_torque_regressor(robot, &q, &still, &still, &mut y);
        for (coefficient, parameter) in coefficients.iter_mut().zip(&identified.parameters) {
            let column = order.iter().position(|id| *id == parameter.id);
            *coefficient += column.map_or(0.0, |column| y.column(column)[joint.index()] * along);
        }
        squares += along * along;
    }
    if squares < POSTURES as f64 * (ALONG * robot.gravity.norm()).powi(2) {
        return None;
    }
    let mut mass = Combination::default();
    for (coefficient, parameter) in coefficients.iter().zip(&identified.parameters) {
        mass.add(coefficient / squares, parameter.value, parameter.std_error);
    }
    Some(mass)
}

/// Ratio of a joint's identified inertia to that of the description's nominal parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InertiaRatio {
    /// The joint.
    pub joint: JointIndex,
    /// Identified over nominal inertia, both medians over postures; below zero for an impossible inertia.
    pub ratio: f64,
}

/// Unit of a joint's inertia in output.
pub(super) fn inertia_unit(robot: &Robot, joint: JointIndex) -> &'static str {
    match robot.joints[joint.index()].kind {
        JointKind::Revolute => "kg m^2",
        JointKind::Prismatic => "kg",
    }
}

/// Identified over nominal inertia of each joint that is not coupled; empty unless all joints have nominal parameters.
#[must_use]
pub fn inertia_ratios(robot: &Robot, identified: &Identification) -> Vec<InertiaRatio> {
    let ratio =
        |(joint, [found, drawn]): (JointIndex, [f64; 2])| InertiaRatio { joint, ratio: found / drawn };
    inertias(robot, identified).into_iter().map(ratio).collect()
}

/// Identified and nominal inertia of each joint that is not coupled.
fn inertias(robot: &Robot, identified: &Identification) -> Vec<(JointIndex, [f64; 2])> {
    let nominal: Option<Vec<(StandardParameters, f64)>> =
        robot.joints.iter().map(|joint| joint.nominal.map(|n| (n.inertial, n.motor_inertia))).collect();
    let Some(nominal) = nominal else { return Vec::new() };
    let model = DynamicModel::from_parameters(robot, identified.parameters.iter().map(|p| (p.id, p.value)));
    let inertial: Vec<StandardParameters> = nominal.iter().map(|(inertial, _)| *inertial).collect();
    let coupled = |joint: JointIndex| {
        robot.couplings.iter().any(|c| c.joint == joint || c.motor_joint == joint)
            || robot.parallelograms.iter().any(|of| of.upper_arm == joint || of.forearm == joint)
    };
    let of_joint = |joint: JointIndex| {
        let j = joint.index();
        let drawn = median_inertia(robot, &inertial, j) + nominal[j].1;
        let found = median_inertia(robot, &model.inertial, j) + model.motor_inertia[j];
        (joint, [found, drawn])
    };
    let judged = robot.joint_indices().filter(|joint| !coupled(*joint)).map(of_joint);
    judged.filter(|(_, [_, drawn])| *drawn > 0.0).collect()
}

/// Findings of joints whose inertia is far from that of the description's nominal parameters, which usually indicates
/// torques in another unit or on the other side of the gear.
pub(super) fn far_from_nominal(
    robot: &Robot,
    identified: &Identification,
    settings: &PlausibleSettings,
) -> Vec<Finding> {
    let off = |[found, drawn]: [f64; 2]| (found / drawn).max(drawn / found);
    let far: Vec<(JointIndex, [f64; 2])> = inertias(robot, identified)
        .into_iter()
        .filter(|(_, felt)| felt[0] > 0.0 && off(*felt) > settings.nominal_factors[0])
        // an inertia hidden by noise is near zero, so its error may explain the difference
        .filter(|(joint, [found, drawn])| {
            let margin = || settings.standard_errors * inertia_error(robot, identified, *joint);
            found > drawn || drawn / (found + margin()) > settings.nominal_factors[0]
        })
        .collect();
    // a wrong unit or side of the gear affects several joints; a single light wrist has a large uncertainty
    let least = match far.len() {
        1 => ALONE_FACTOR * settings.nominal_factors[1],
        _ => settings.nominal_factors[1],
    };
    // a URDF does not describe rotors, which may be most of a wrist's inertia: a larger inertia than that of the links
    // is no evidence
    let rotor_is_known = |joint: JointIndex| {
        let nominal = robot.joints[joint.index()].nominal;
        !robot.has_motor_inertia() || nominal.is_some_and(|nominal| nominal.motor_inertia > 0.0)
    };
    let finding = |(joint, felt): (JointIndex, [f64; 2])| {
        let severity = match off(felt) > least {
            true => FindingSeverity::Refuse,
            false => FindingSeverity::Warn,
        };
        far_finding((joint, inertia_unit(robot, joint)), felt, severity)
    };
    far.into_iter()
        .filter(|(joint, [found, drawn])| found < drawn || rotor_is_known(*joint))
        .map(finding)
        .collect()
}

/// Standard error of a joint's identified inertia, averaged over postures, with independent errors of parameters.
fn inertia_error(robot: &Robot, identified: &Identification, joint: JointIndex) -> f64 {
    let order = ParameterId::natural_order(robot);
    let still = vec![0.0; robot.joint_count()];
    let mut unit = still.clone();
    unit[joint.index()] = 1.0;
    let (mut moving, mut resting) = (Regressor::new(robot), Regressor::new(robot));
    let mut coefficients = vec![0.0; identified.parameters.len()];
    for posture in 0..POSTURES {
        let q = probe_state(robot, posture).q;
        joint_torque_regressor(robot, &q, &still, &unit, &mut moving);
        joint_torque_regressor(robot, &q, &still, &still, &mut resting);
        for (coefficient, parameter) in coefficients.iter_mut().zip(&identified.parameters) {
            let Some(column) = order.iter().position(|id| *id == parameter.id) else { continue };
            *coefficient += moving.column(column)[joint.index()] - resting.column(column)[joint.index()];
        }
    }
    let mut inertia = Combination::default();
    for (coefficient, parameter) in coefficients.iter().zip(&identified.parameters) {
        inertia.add(coefficient / POSTURES as f64, parameter.value, parameter.std_error);
    }
    inertia.variance.sqrt()
}

fn far_finding(
    (joint, unit): (JointIndex, &str),
    [found, drawn]: [f64; 2],
    severity: FindingSeverity,
) -> Finding {
    Finding {
        kind: FindingKind::FarFromNominal,
        severity,
        joint: Some(joint),
        sentence: format!(
            "joint {joint}: the identified inertia is {found:.4} {unit}, {:.2} times the {drawn:.4} of the description's \
             nominal parameters; check the unit of the torque (percent of rated, motor side, current), the gear ratio \
             and the time column",
            found / drawn
        ),
        evidence: vec![
            Evidence { name: "inertia_kg_m2", value: found },
            Evidence { name: "nominal_inertia_kg_m2", value: drawn },
        ],
    }
}

/// Inertia of the links about a joint, median over postures.
pub(super) fn median_inertia(robot: &Robot, inertial: &[StandardParameters], joint: usize) -> f64 {
    median((0..POSTURES).map(|posture| felt(robot, inertial, joint, posture)))
}

/// Inertia of the links about a joint in one of the probe postures.
fn felt(robot: &Robot, inertial: &[StandardParameters], joint: usize, posture: usize) -> f64 {
    let n = robot.joint_count();
    let q = probe_state(robot, posture).q;
    let still = vec![0.0; n];
    let mut unit = still.clone();
    unit[joint] = 1.0;
    let (mut with, mut without) = (still.clone(), still.clone());
    inverse_dynamics(robot, inertial, &q, &still, &unit, &mut with);
    inverse_dynamics(robot, inertial, &q, &still, &still, &mut without);
    with[joint] - without[joint]
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    crate::statistics::descriptive::median(&values.collect::<Vec<f64>>()).unwrap_or(0.0)
}
