//! Findings about a model held against what else would explain them: a refusal needs evidence that survives.

use super::unmeasured::friction_torque;
use crate::least_squares::factor::TriangularFactor;
use crate::model::base_parameters::BaseParameters;
use crate::physical::fit::{ConstraintCost, physical_fit};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::{Identification, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{Samples, Stage};

/// From where on evidence counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WeighSettings {
    /// Relative growth of the torque error with bodies that can exist, over all joints, from which on an inertia that no
    /// body has is doubtful, and refused. Real arms cost up to 0.11.
    pub physics_costs: [f64; 2],
    /// Part of a joint's rated torque below which a torque error says nothing of a description.
    pub rated_share: f64,
    /// The same as part of the largest RMS torque of the arm's joints.
    pub arm_share: f64,
    /// Standard deviations of a torque channel's noise, as far as the low-pass lets it through, below which an error
    /// is noise.
    pub noise_deviations: f64,
    /// A torque error below this part of the joint's own friction may be friction of another shape than the
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

/// What findings about a model are weighed by.
#[derive(Debug, Clone, Copy)]
pub struct ModelWeights<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Its base parameters.
    pub base: &'a BaseParameters,
    /// Factor of each joint `[n]` over the rows that were identified on, `b` columns each.
    pub factors: &'a [TriangularFactor],
    /// The recording.
    pub samples: &'a Samples,
    /// The same after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Usable rows of the excitation.
    pub excitation: &'a [usize],
    /// The parameters.
    pub identified: &'a Identification,
    /// Their self-verification.
    pub verification: &'a [TorqueRmsd],
}

/// The findings that survive, some of them as a doubt or a remark.
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

/// Negative inertias by what bodies that can exist would cost.
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

/// Relative growth of the torque error, each joint in units of its own: root mean over the rows.
fn cost_of_physics(price: &[ConstraintCost]) -> f64 {
    let rows: f64 = price.iter().map(|of| of.samples as f64).sum();
    let square = |of: &ConstraintCost| {
        // without noise, any difference would be endless
        let own = of.unconstrained_rmsd.max(1e-3 * of.torque_rms).max(f64::MIN_POSITIVE);
        of.samples as f64 * (of.consistent_rmsd.max(own) / own).powi(2)
    };
    (price.iter().map(square).sum::<f64>() / rows.max(1.0)).sqrt() - 1.0
}

/// An unexplained torque by its size: nothing where it is noise or next to no torque, a doubt where it is within the
/// joint's friction.
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

/// Standard deviation of white noise of the torque channel after the low-pass, from what the low-pass took away, Nm.
fn noise(weighed: &ModelWeights<'_>, joint: JointIndex) -> f64 {
    let (raw, smooth) = (&weighed.samples.torque[joint.index()], &weighed.filtered.tau[joint.index()]);
    let squares: f64 = weighed.excitation.iter().map(|&row| (raw[row] - smooth[row]).powi(2)).sum();
    let passed = (2.0 * weighed.filtered.cutoff / weighed.filtered.sample_rate).min(0.9);
    (squares / weighed.excitation.len().max(1) as f64 * passed / (1.0 - passed)).sqrt()
}
