//! Torque that neither a sensor nor a drive measured: accelerations, the torque of a controller's own model, and
//! measured torque minus gravity or friction. Models fit all of them well, and none shows wear.

use super::nominal::median_inertia;
use super::weigh::ModelWeights;
use crate::model::dynamics::{DynamicModel, inverse_dynamics};
use crate::signal::filter::FilteredSignals;
use crate::signal::noise::white_noise;
use crate::statistics::descriptive::{mean, standard_deviation};
use armwatch_model::analysis::RmsdScope;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{
    FrictionTerm, JointIndex, JointKind, ParameterKind, Robot, TorqueSensors, Transform,
};
use armwatch_model::run::Stage;

/// Largest share of a torque's squares that remains after its joint's acceleration, if the torque is an acceleration.
const ACCELERATION_LEFT: f64 = 0.05;
/// Largest relative difference between the joints' factors of torque and acceleration.
const ALIKE: f64 = 0.1;
/// Noise of a torque relative to its RMS below which no sensor measured it: a resolution of 12 bits leaves more.
const SENSOR_NOISE: f64 = 2e-4;
/// RMS of friction relative to that of the torque below which a joint shows no friction.
const NO_FRICTION: f64 = 0.02;
/// Power of friction over RMS torque times RMS speed below which a joint shows no friction, if there are noise and
/// ripple.
const NO_POWER: f64 = 0.03;
/// RMS of gravity below which a joint shows none, relative to that of a point mass at the arm's reach with the joint's
/// inertia. A closer mass has more gravity for the same inertia; a rotor may be half of the inertia.
const NO_GRAVITY: f64 = 0.15;
/// Shortest reach, m.
const LEAST_REACH: f64 = 0.1;
/// Part of gravity across a joint's axis that is necessary for its torque to show gravity.
const ACROSS: f64 = 0.3;
/// Number of instants for means.
const INSTANTS: usize = 300;

/// Finding of torques that are the accelerations of their joints, all with one factor.
#[must_use]
pub(crate) fn accelerations(
    robot: &Robot,
    filtered: &FilteredSignals,
    excitation: &[usize],
) -> Option<Finding> {
    let factor = |j: usize| {
        let sum = |a: &[f64], b: &[f64]| excitation.iter().map(|&row| a[row] * b[row]).sum::<f64>();
        let (qdd, tau) = (&filtered.qdd[j], &filtered.tau[j]);
        let [motion, both, torque] = [sum(qdd, qdd), sum(qdd, tau), sum(tau, tau)];
        (motion > 0.0 && torque > 0.0).then(|| (both / motion, 1.0 - both * both / (motion * torque)))
    };
    let factors: Vec<(f64, f64)> = (0..robot.joint_count()).filter_map(factor).collect();
    let first = factors.first()?.0;
    let all = factors.len() > 1
        && factors
            .iter()
            .all(|(factor, left)| *left < ACCELERATION_LEFT && (factor / first - 1.0).abs() < ALIKE);
    all.then(|| {
        finding(
            format!(
                "the torque of every joint is {first:.3} times its acceleration: an acceleration was read as torque; {NAME}"
            ),
            &[("factor", first)],
        )
    })
}

/// Remedy in the findings.
const NAME: &str = "name the columns of the measured torque or of the motor current in the section [torque] of the export \
                    layout";

/// Properties of one joint's torque in the excitation.
struct ExcitationTorque {
    /// RMS of friction relative to that of the torque.
    friction: f64,
    /// Power of friction over RMS torque times RMS speed.
    power: f64,
    /// Noise relative to the RMS torque.
    noise: f64,
    /// RMS of gravity relative to the value expected from the joint's inertia, if gravity can act.
    gravity: Option<f64>,
}

/// Finding of a torque without friction, without the noise of a sensor or without gravity. `weightless` checks if an
/// arm without gravity explains the torques equally well.
#[must_use]
pub(crate) fn unmeasured(weighed: &ModelWeights<'_>, weightless: impl Fn() -> bool) -> Option<Finding> {
    let shown = shown(weighed);
    if shown.is_empty() {
        return None;
    }
    let most = |of: fn(&ExcitationTorque) -> f64| shown.iter().map(of).fold(0.0, f64::max);
    let (friction, noise) = (most(|of| of.friction), most(|of| of.noise));
    if friction < NO_FRICTION && noise < SENSOR_NOISE {
        return Some(finding(
            format!(
                "the torque is computed and not measured: no joint shows friction (at most {:.1} % of its torque) or the \
                 noise of a sensor; the torque of a model never shows wear: {NAME}",
                100.0 * friction
            ),
            &[("friction_share", friction), ("noise_share", noise)],
        ));
    }
    let gravity: Vec<f64> = shown.iter().filter_map(|of| of.gravity).collect();
    let most_gravity = gravity.iter().copied().fold(0.0, f64::max);
    if !gravity.is_empty() && most_gravity < NO_GRAVITY && weightless() {
        let words =
            format!("at most {:.0} % of what the joints' inertias make one expect", 100.0 * most_gravity);
        return Some(without_gravity(&words, ("gravity_share", most_gravity)));
    }
    let powers: Vec<f64> = shown.iter().map(|of| of.power).collect();
    let scatter = standard_deviation(&powers).unwrap_or(0.0) / (powers.len() as f64).sqrt();
    let without =
        powers.iter().all(|power| power.abs() < NO_POWER) && mean(&powers).unwrap_or(0.0) < 2.0 * scatter;
    (without && shown.len() > 1 && weighed.robot.torque_sensors == TorqueSensors::Motor).then(|| {
        finding(
            format!(
                "no joint shows friction (at most {:.1} % of its torque): the controller has subtracted friction, or the \
                 torque is computed; {NAME}",
                100.0 * friction
            ),
            &[("friction_share", friction), ("noise_share", noise)],
        )
    })
}

/// Finding of torques without gravity, because it was subtracted, with the evidence.
pub(super) fn without_gravity(words: &str, evidence: (&'static str, f64)) -> Finding {
    finding(
        format!("the torque has no gravity in it ({words}): the controller has subtracted gravity; {NAME}"),
        &[evidence],
    )
}

fn shown(weighed: &ModelWeights<'_>) -> Vec<ExcitationTorque> {
    let ModelWeights { robot, filtered, samples, excitation, identified, verification, .. } = weighed;
    let model = DynamicModel::from_parameters(robot, identified.parameters.iter().map(|p| (p.id, p.value)));
    let stride = excitation.len().div_ceil(INSTANTS).max(1);
    let rows: Vec<usize> = excitation.iter().copied().step_by(stride).collect();
    let resting = gravity_shares(robot, filtered, &model, &rows);
    let of_joint = |joint: JointIndex| {
        let moving = verification
            .iter()
            .find(|of| of.joint == joint && of.scope == RmsdScope::Stage(Stage::Excitation))?
            .moving_rows;
        if moving.relative <= 0.0 {
            return None;
        }
        let j = joint.index();
        let torque = moving.value / moving.relative;
        let speeds: Vec<f64> = rows
            .iter()
            .map(|&row| filtered.qd[j][row])
            .filter(|qd| qd.abs() >= robot.joints[j].counted_speed())
            .collect();
        let count = speeds.len().max(1) as f64;
        let friction: Vec<f64> = speeds.iter().map(|qd| friction_torque(weighed, joint, *qd)).collect();
        let square = |values: &[f64]| values.iter().map(|x| x * x).sum::<f64>() / count;
        let power = speeds.iter().zip(&friction).map(|(qd, tau)| qd * tau).sum::<f64>() / count;
        let noise = white_noise(&samples.torque[j], &filtered.tau[j], excitation)?;
        Some(ExcitationTorque {
            friction: square(&friction).sqrt() / torque,
            power: power / (torque * square(&speeds).sqrt()),
            noise: noise / torque,
            gravity: resting[j],
        })
    };
    robot.joint_indices().filter_map(of_joint).collect()
}

/// Friction of a joint at a speed, without an offset of the signal, Nm (N).
pub(super) fn friction_torque(weighed: &ModelWeights<'_>, joint: JointIndex, qd: f64) -> f64 {
    let law = weighed.robot.friction_of(joint);
    let of_term = |(term, column): (&FrictionTerm, f64)| {
        let own = weighed.identified.parameters.iter().find(|p| {
            p.id.joint == joint
                && p.id.kind == ParameterKind::Friction(*term)
                && *term != FrictionTerm::Offset
        });
        own.map_or(0.0, |p| p.value * column)
    };
    law.terms().iter().zip(law.columns(qd)).map(of_term).sum()
}

/// RMS of the torque of gravity of each joint over postures of the recording, relative to that of a point mass at the
/// arm's reach; `None` if gravity acts along the axis of a rotary joint.
fn gravity_shares(
    robot: &Robot,
    filtered: &FilteredSignals,
    model: &DynamicModel,
    rows: &[usize],
) -> Vec<Option<f64>> {
    let n = robot.joint_count();
    let still = vec![0.0; n];
    let mut squares = vec![0.0; n];
    let mut across = vec![0.0; n];
    let mut torque = vec![0.0; n];
    let g = robot.gravity.norm();
    for &row in rows {
        let q: Vec<f64> = (0..n).map(|j| filtered.q[j][row]).collect();
        inverse_dynamics(robot, &model.inertial, &q, &still, &still, &mut torque);
        squares.iter_mut().zip(&torque).for_each(|(sum, torque)| *sum += torque * torque);
        let mut frame = Transform::IDENTITY;
        for (j, joint) in robot.joints.iter().enumerate() {
            frame = frame.then(&crate::model::kinematics::joint_transform(joint, q[j]));
            let axis = frame.to_outer(&nalgebra::Vector3::z());
            let acting = match joint.kind {
                JointKind::Revolute => robot.gravity.cross(&axis).norm(),
                JointKind::Prismatic => robot.gravity.dot(&axis).abs(),
            };
            across[j] += acting / g.max(f64::MIN_POSITIVE);
        }
    }
    let count = rows.len().max(1) as f64;
    let of_joint = |j: usize| {
        let inertia = median_inertia(robot, &model.inertial, j) + model.motor_inertia[j];
        let lengths =
            robot.joints.iter().skip(j + 1).map(|next| next.geometry.placement().translation.norm());
        let lever = match robot.joints[j].kind {
            JointKind::Revolute => lengths.sum::<f64>().max(LEAST_REACH),
            JointKind::Prismatic => 1.0,
        };
        let expected = inertia * g / lever;
        (across[j] / count > ACROSS && expected > 0.0).then(|| (squares[j] / count).sqrt() / expected)
    };
    (0..n).map(of_joint).collect()
}

fn finding(sentence: String, evidence: &[(&'static str, f64)]) -> Finding {
    Finding {
        kind: FindingKind::ComputedTorque,
        severity: FindingSeverity::Refuse,
        joint: None,
        sentence,
        evidence: evidence.iter().map(|&(name, value)| Evidence { name, value }).collect(),
    }
}
