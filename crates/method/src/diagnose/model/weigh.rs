//! Comparison of findings about a model with alternative explanations: a refusal needs evidence that excludes them.

use super::unmeasured::friction_torque;
use crate::least_squares::factor::TriangularFactor;
use crate::model::base_parameters::BaseParameters;
use crate::physical::fit::{ConstraintCost, physical_fit};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::{Identification, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{Samples, Stage};

/// Thresholds of the evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeighSettings {
    /// Smallest relative growth of the torque error over all joints, if bodies must be physical, that makes an
    /// unphysical inertia doubtful, and that refuses it. Real arms reach 0.11.
    pub physics_costs: [f64; 2],
    /// Torque error, as a part of a joint's rated torque, below which it is no evidence against a description.
    pub rated_share: f64,
    /// The same as a part of the largest RMS torque of the arm's joints.
    pub arm_share: f64,
    /// Torque error, in standard deviations of the channel's noise after the low-pass, below which it is noise.
    pub noise_deviations: f64,
    /// Torque error, as a part of the joint's own friction, below which it may be friction of another shape than the
    /// description's law.
    pub friction_share: f64,
}

impl Default for WeighSettings {
    fn default() -> Self {
        Self {
            physics_costs: [0.15, 0.3],
            rated_share: 0.01,
            arm_share: 0.01,
            noise_deviations: 3.0,
            friction_share: 0.6,
        }
    }
}

/// Data for the comparison.
#[derive(Debug, Clone, Copy)]
pub struct ModelWeights<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Base parameters of the description.
    pub base: &'a BaseParameters,
    /// Factor of each joint `[n]` over the rows of the identification, `b` columns each.
    pub factors: &'a [TriangularFactor],
    /// The recording.
    pub samples: &'a Samples,
    /// Signals after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Usable rows of the excitation.
    pub excitation: &'a [usize],
    /// Identified parameters.
    pub identified: &'a Identification,
    /// Verification of the parameters on the same cycle.
    pub verification: &'a [TorqueRmsd],
}

/// Remaining findings, some of them as a doubt or a remark.
#[must_use]
pub fn weigh(findings: Vec<Finding>, weighed: &ModelWeights<'_>, settings: &WeighSettings) -> Vec<Finding> {
    let (inertias, others): (Vec<Finding>, Vec<Finding>) =
        findings.into_iter().partition(|finding| finding.kind == FindingKind::NegativeInertia);
    let mut kept = priced(inertias, weighed, settings);
    let unexplained = |finding: Finding| match finding.kind {
        FindingKind::Unexplained => of_friction(finding, weighed, settings),
        _ => Some(finding),
    };
    kept.extend(others.into_iter().filter_map(unexplained));
    kept.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    kept
}

/// Negative inertias, weighed by the cost of physical bodies.
fn priced(findings: Vec<Finding>, weighed: &ModelWeights<'_>, settings: &WeighSettings) -> Vec<Finding> {
    if findings.is_empty() {
        return findings;
    }
    let fraction = weighed.filtered.independent_fraction();
    let Ok(fit) = physical_fit(weighed.robot, weighed.base, weighed.factors, fraction) else {
        return findings;
    };
    let cost = cost_of_physics(&fit.price);
    let joints: Vec<JointIndex> = findings.iter().filter_map(|finding| finding.joint).collect();
    let severity = match cost {
        cost if cost > settings.physics_costs[1] => {
            return findings
                .into_iter()
                .map(|finding| Finding {
                    sentence: format!(
                        "{}; bodies that can exist leave {:.0} % more of the torque unexplained",
                        finding.sentence,
                        100.0 * cost
                    ),
                    ..finding
                })
                .collect();
        }
        cost if cost > settings.physics_costs[0] => FindingSeverity::Doubt,
        _ => FindingSeverity::Warn,
    };
    vec![Finding {
        kind: FindingKind::NegativeInertia,
        severity,
        joint: joints.first().copied().filter(|_| joints.len() == 1),
        sentence: format!(
            "{}: least squares alone gives an inertia below zero, while bodies that can exist leave only {:.0} % more of \
             the torque unexplained; this motion hardly shows that inertia (armwatch robot urdf gives bodies)",
            super::causes::named(&joints),
            100.0 * cost
        ),
        evidence: vec![Evidence { name: "cost_of_physics", value: cost }],
    }]
}

/// Relative growth of the torque error: root mean over the rows, each joint in its own unit.
fn cost_of_physics(price: &[ConstraintCost]) -> f64 {
    let rows: f64 = price.iter().map(|of| of.samples as f64).sum();
    let square = |of: &ConstraintCost| {
        // without noise, any difference would be infinite
        let own = of.unconstrained_rmsd.max(1e-3 * of.torque_rms).max(f64::MIN_POSITIVE);
        of.samples as f64 * (of.consistent_rmsd.max(own) / own).powi(2)
    };
    (price.iter().map(square).sum::<f64>() / rows.max(1.0)).sqrt() - 1.0
}

/// Unexplained torque by its size: no finding if it is noise or negligible torque, a doubt if it is within the joint's
/// friction.
fn of_friction(finding: Finding, weighed: &ModelWeights<'_>, settings: &WeighSettings) -> Option<Finding> {
    let Some(joint) = finding.joint else { return Some(finding) };
    let of_excitation = |of: &&TorqueRmsd| of.scope == RmsdScope::Stage(Stage::Excitation);
    let error = weighed.verification.iter().filter(of_excitation).find(|of| of.joint == joint)?.moving_rows;
    let rms = |of: &TorqueRmsd| match of.moving_rows.relative > 0.0 {
        true => of.moving_rows.value / of.moving_rows.relative,
        false => 0.0,
    };
    let largest = weighed.verification.iter().filter(of_excitation).map(rms).fold(0.0, f64::max);
    let rated = weighed.robot.joints[joint.index()].rated_torque.unwrap_or(0.0);
    let floor = (settings.rated_share * rated)
        .max(settings.arm_share * largest)
        .max(settings.noise_deviations * noise(weighed, joint));
    if error.value <= floor {
        return None;
    }
    let friction = friction_rms(weighed, joint);
    if finding.severity == FindingSeverity::Refuse && error.value <= settings.friction_share * friction {
        return Some(Finding {
            severity: FindingSeverity::Warn,
            sentence: format!(
                "joint {joint}: the model leaves {:.0} % of the torque unexplained while the joint moves; that is {:.2} \
                 times its friction of {friction:.2} Nm (N), whose shape may be another than the description's friction_model",
                100.0 * error.relative,
                error.value / friction
            ),
            ..finding
        });
    }
    Some(finding)
}

/// RMS of a joint's identified friction over the moving rows of the excitation, Nm (N).
fn friction_rms(weighed: &ModelWeights<'_>, joint: JointIndex) -> f64 {
    let ModelWeights { robot, filtered, excitation, .. } = weighed;
    let low = robot.joints[joint.index()].counted_speed();
    let torque = |qd: f64| friction_torque(weighed, joint, qd);
    let speeds = excitation.iter().map(|&row| filtered.qd[joint.index()][row]);
    let (rows, squares) = speeds
        .filter(|qd| qd.abs() >= low)
        .fold((0_usize, 0.0), |(rows, sum), qd| (rows + 1, sum + torque(qd).powi(2)));
    (squares / rows.max(1) as f64).sqrt()
}

/// Standard deviation of white noise of the torque channel after the low-pass, from the part that the low-pass removed,
/// Nm.
fn noise(weighed: &ModelWeights<'_>, joint: JointIndex) -> f64 {
    let (raw, smooth) = (&weighed.samples.torque[joint.index()], &weighed.filtered.tau[joint.index()]);
    let squares: f64 = weighed.excitation.iter().map(|&row| (raw[row] - smooth[row]).powi(2)).sum();
    let passed = (2.0 * weighed.filtered.cutoff / weighed.filtered.sample_rate).min(0.9);
    (squares / weighed.excitation.len().max(1) as f64 * passed / (1.0 - passed)).sqrt()
}
