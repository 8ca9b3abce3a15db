//! Findings about the description as a whole: wrong numbers, a wrong mounting, torques out of time.

use super::alternatives::{Alternative, best_alternative, words};
use super::delay::{TorqueDelay, torque_delays};
use super::description::{DescriptionTest, Evidenced, test_description};
use super::numbers::DescribedNumber;
use crate::analysis::{Identification, RmsdScope, TorqueRmsd};
use crate::numerics::diagnose::{Evidence, Finding, FindingKind, FindingSeverity};
use crate::numerics::factors::JointColumns;
use crate::numerics::jumps::Jump;
use crate::numerics::signal::Conditioned;
use crate::robot::Robot;
use crate::run::Stage;

/// From where on a description, or the time of the torques, is doubted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubtSettings {
    /// Part of the residual that changed numbers of the description explain, from which on another
    /// description is looked for.
    pub looked_share: f64,
    /// The same part from which on it is said, and refused, though none is found.
    pub description_shares: [f64; 2],
    /// Weighted residual sum of squares that another description may leave, relative to the given
    /// one's, to be named as the likely one.
    pub alternative: f64,
    /// Delay of the torques that is said, and that is refused, s.
    pub delays: [f64; 2],
    /// Residual sum of squares that the best delay must reach, relative to that without one.
    pub delay_residual: f64,
}

impl Default for DoubtSettings {
    fn default() -> Self {
        Self {
            looked_share: 0.06,
            description_shares: [0.12, 0.35],
            alternative: 0.8,
            delays: [0.006, 0.012],
            delay_residual: 0.8,
        }
    }
}

/// What a cycle's description is judged by.
#[derive(Debug, Clone, Copy)]
pub struct Judged<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a JointColumns,
    /// Columns `[b]` of the regressor that were identified.
    pub kept_columns: &'a [usize],
    /// The cycle after the low-pass.
    pub conditioned: &'a Conditioned,
    /// Columns of the description's regressor that jump, low-passed.
    pub jumps: &'a [Jump],
    /// Usable rows of the excitation, in order.
    pub excitation: &'a [usize],
    /// The parameters.
    pub identified: &'a Identification,
    /// Their self-verification.
    pub verification: &'a [TorqueRmsd],
}

/// Findings about the description: torques out of time, numbers that the torques contradict.
///
/// `known` are the findings about the same model so far; where there is one, the description that
/// explains the torques better is looked for all the same, as the remedy.
#[must_use]
pub fn diagnose_description(
    judged: &Judged<'_>,
    known: &[Finding],
    settings: &DoubtSettings,
) -> Vec<Finding> {
    let noise = noise(judged);
    let late = late(&delays(judged), settings);
    if late.is_some() {
        return late.into_iter().collect();
    }
    let evidenced = Evidenced::new(judged.conditioned, judged.excitation, noise);
    let Some(test) =
        test_description(judged.robot, judged.kept_columns, judged.identified, &evidenced, judged.jumps)
    else {
        return Vec::new();
    };
    if test.share < settings.looked_share && known.is_empty() {
        return Vec::new();
    }
    let better = best_alternative(judged.robot, &evidenced, &test.scores)
        .filter(|alternative| alternative.residual_ratio <= settings.alternative);
    if better.is_none() && test.share < settings.description_shares[0] {
        return Vec::new();
    }
    vec![doubted(judged.robot, &test, better, settings)]
}

/// Root mean square of each joint's residual; a hundredth of its torque at least.
fn noise(judged: &Judged<'_>) -> Vec<f64> {
    let of_joint = |joint| {
        let excitation = judged
            .verification
            .iter()
            .find(|v| v.joint == joint && v.scope == RmsdScope::Stage(Stage::Excitation))
            .map(|v| v.moving_rows);
        excitation.map_or(1.0, |rmsd| match rmsd.relative > 0.0 {
            true => rmsd.value.max(0.01 * rmsd.value / rmsd.relative),
            false => 1.0,
        })
    };
    judged.robot.joint_indices().map(of_joint).collect()
}

fn delays(judged: &Judged<'_>) -> Vec<TorqueDelay> {
    let Judged { robot, columns, kept_columns, conditioned, jumps, excitation, .. } = *judged;
    torque_delays(robot, columns, kept_columns, (conditioned, jumps), excitation)
}

/// The median delay of the joints, if their torques gain by it.
fn late(delays: &[TorqueDelay], settings: &DoubtSettings) -> Option<Finding> {
    let mut sorted: Vec<f64> = delays.iter().map(|of| of.delay).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let delay = *sorted.get(sorted.len() / 2)?;
    let gained = |of: &&TorqueDelay| {
        of.residual_ratio <= settings.delay_residual && (of.delay - delay).abs() <= 0.5 * delay.abs()
    };
    let agreeing: Vec<&TorqueDelay> = delays.iter().filter(gained).collect();
    if delay.abs() < settings.delays[0] || 2 * agreeing.len() <= delays.len() {
        return None;
    }
    let ratio = agreeing.iter().map(|of| of.residual_ratio).sum::<f64>() / agreeing.len() as f64;
    let severity = match delay.abs() >= settings.delays[1] {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    let direction = if delay > 0.0 { "after" } else { "before" };
    Some(Finding {
        kind: FindingKind::TorqueDelay,
        severity,
        joint: None,
        sentence: format!(
            "the torques come {:.0} ms {direction} the motion that needs them ({} of {} joints agree, the torque error falls \
             to {:.0} %); record all channels at the same instant, or correct the delay of the logger",
            1e3 * delay.abs(),
            agreeing.len(),
            delays.len(),
            100.0 * ratio.sqrt()
        ),
        evidence: vec![
            Evidence { name: "delay_s", value: delay },
            Evidence { name: "residual_ratio", value: ratio },
        ],
    })
}

fn doubted(
    robot: &Robot,
    test: &DescriptionTest,
    better: Option<Alternative>,
    settings: &DoubtSettings,
) -> Finding {
    let severity = match better.is_some() || test.share >= settings.description_shares[1] {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    let remedy = match (&better, test.scores.first()) {
        (Some(better), _) => {
            format!(
                "with {} the torque error would be {:.0} % of what it is: check that first",
                better.words,
                100.0 * better.residual_ratio.sqrt()
            )
        }
        (None, Some(score)) => {
            format!("{} tells most, check it first", named(robot, score.number, score.change))
        }
        (None, None) => "check lengths, angles and mounting".into(),
    };
    let mut evidence = vec![
        Evidence { name: "share", value: test.share },
        Evidence { name: "f", value: test.f },
        Evidence { name: "freedom", value: test.freedom[1] as f64 },
    ];
    evidence.extend(better.map(|better| Evidence { name: "residual_ratio", value: better.residual_ratio }));
    Finding {
        kind: FindingKind::Description,
        severity,
        joint: None,
        sentence: format!(
            "the torques contradict the description: {:.0} % of the torque error goes with its lengths, angles, \
             mounting or torque scales, not with noise (F = {:.0}); {remedy}",
            100.0 * test.share,
            test.f
        ),
        evidence,
    }
}

fn named(robot: &Robot, number: DescribedNumber, change: f64) -> String {
    words(robot, number, change)
}
