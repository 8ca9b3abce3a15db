//! Findings about the description as a whole: wrong numbers, a wrong mounting, delayed torques.

use std::cell::OnceCell;

use super::alternatives::{Alternatives, DescriptionAlternative, alternatives};
use super::channels::Channels;
use super::delay::{JointDelay, TorqueDelay, torque_delays};
use super::description::{DescriptionTest, JudgedRows, test_description};
use super::friction_shapes::friction_shapes;
use super::level::{FLOOR, RESIDUAL_RATIO, TILT};
use crate::identify::filtered_columns::FilteredColumn;
use crate::identify::joint_factors::FactorColumns;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::{Identification, Rmsd, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::Stage;

/// Thresholds for doubt about a description or about the time of the torques.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubtSettings {
    /// Smallest share of the residual explained by changed numbers of the description that starts a search for another
    /// description.
    pub looked_share: f64,
    /// Smallest such share that is reported, and that is refused, even without a better description, if the model
    /// leaves more than `healthy` of a torque unexplained.
    pub description_shares: [f64; 2],
    /// Moving relative RMSD: an upper limit for models of healthy arms (thesis, chapter 5), and the smallest value for
    /// refusing a contradiction without a remedy.
    pub healthy: [f64; 2],
    /// Torque error, relative to a joint's RMS torque, that a wrong description must cause at some joint to be refused.
    pub cost: f64,
    /// Smallest error that counts, as a share of the joint's rated torque or of the largest RMS torque of the arm.
    pub least_share: f64,
    /// Largest weighted residual sum of squares of another description, relative to the given one's, for naming it as
    /// the likely one.
    pub alternative: f64,
    /// Cut-off of the low-pass, Hz, below which a contradiction is reported and never refused. Excitation moves with up
    /// to about 3 Hz. A lower cut-off removes part of the motion; filtered torques are then no function of filtered
    /// positions, and the remainder correlates with the geometry.
    pub least_cutoff: f64,
    /// Duration of excitation, s, below which a contradiction is also never refused. Joints then reverse so rarely that
    /// friction of an unexpected shape resembles another arm.
    pub least_excitation: f64,
    /// Smallest delay of the torques that is reported, and that is refused, s.
    pub delays: [f64; 2],
    /// Largest residual sum of squares with the best delay, relative to that without a delay.
    pub delay_residual: f64,
    /// Number of joints that must agree on a delay, or all joints of an arm with fewer; always more than half of those
    /// that move.
    pub delay_quorum: usize,
}

impl Default for DoubtSettings {
    fn default() -> Self {
        Self {
            looked_share: 0.06,
            description_shares: [0.12, 0.35],
            healthy: [0.13, 0.2],
            cost: 0.03,
            least_share: 0.002,
            alternative: 0.8,
            least_cutoff: 4.0,
            least_excitation: 9.5,
            delays: [0.006, 0.012],
            delay_residual: 0.8,
            delay_quorum: 3,
        }
    }
}

/// Cycle and model for judging a description.
#[derive(Debug, Clone, Copy)]
pub struct JudgedCycle<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a FactorColumns,
    /// Columns `[b]` of the regressor that were identified.
    pub kept_columns: &'a [usize],
    /// Signals of the cycle after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Low-passed columns of the description's regressor that have jumps.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Usable rows of the excitation, in order.
    pub excitation: &'a [usize],
    /// Identified parameters.
    pub identified: &'a Identification,
    /// Verification of the parameters on the same cycle.
    pub verification: &'a [TorqueRmsd],
}

/// Findings about the description: delayed torques, and numbers that the torques contradict.
///
/// `known` are the findings about the same model so far. If there is one, the search for a better description runs in
/// any case, to find a remedy.
#[must_use]
pub fn diagnose_description(
    judged: &JudgedCycle<'_>,
    known: &[Finding],
    settings: &DoubtSettings,
) -> Vec<Finding> {
    let noise = noise(judged);
    let made = OnceCell::new();
    let shapes = || made.get_or_init(|| friction_shapes(judged.filtered));
    let moving = judged
        .verification
        .iter()
        .filter(|of| of.scope == RmsdScope::Stage(Stage::Excitation) && of.moving_rows.samples > 0);
    let (late, first) = late_finding(|shapes| delays(judged, shapes), &shapes, moving.count(), settings);
    if late.is_some() {
        return late.into_iter().collect();
    }
    let mut found: Vec<Finding> =
        first.and_then(|delay| perhaps_late(&delay, settings)).into_iter().collect();
    found.extend(contradicted(judged, known, settings, (noise, &shapes)));
    found
}

/// Finding of delayed torques, independent of the other findings about a recording's channels.
pub(crate) fn late_torques(channels: &Channels<'_>) -> Option<Finding> {
    let Channels { robot, columns, kept_columns, filtered, filtered_coulomb_columns, excitation, .. } =
        *channels;
    let shapes = OnceCell::new();
    let delays = |shapes: &[Vec<Vec<f64>>]| {
        torque_delays(robot, columns, kept_columns, (filtered, filtered_coulomb_columns), excitation, shapes)
    };
    let moving = channels.own_fits().iter().flatten().count();
    let shapes = || shapes.get_or_init(|| friction_shapes(filtered));
    late_finding(delays, &shapes, moving, &DoubtSettings::default()).0
}

/// Finding of a delay that appears both with the description's friction law (faster, so tried first) and with friction
/// of any shape, and the delay found with the law.
fn late_finding<'s>(
    delays: impl Fn(&[Vec<Vec<f64>>]) -> Option<JointDelay>,
    shapes: MakeShapes<'_, 's>,
    moving: usize,
    settings: &DoubtSettings,
) -> (Option<Finding>, Option<JointDelay>) {
    let first = delays(&[]);
    let suspected = first.as_ref().and_then(|delay| late(delay, moving, settings));
    (suspected.and_then(|_| delays(shapes())).and_then(|delay| late(&delay, moving, settings)), first)
}

/// Creates columns of friction of any shape, by joint, once.
type MakeShapes<'a, 's> = &'a dyn Fn() -> &'s Vec<Vec<Vec<f64>>>;

/// Contradiction between the torques and the numbers of the description. `shapes` creates columns of friction of any
/// shape.
fn contradicted<'s>(
    judged: &JudgedCycle<'_>,
    known: &[Finding],
    settings: &DoubtSettings,
    (noise, shapes): (Vec<f64>, MakeShapes<'_, 's>),
) -> Option<Finding> {
    let judged_rows =
        JudgedRows::new(judged.filtered, judged.excitation, noise, &[], judged.filtered_coulomb_columns);
    let tested = |judged_rows: &JudgedRows<'_>| {
        test_description(
            judged.robot,
            judged.kept_columns,
            judged.identified,
            judged_rows,
            judged.filtered_coulomb_columns,
        )
    };
    let test = tested(&judged_rows)?;
    if test.share < settings.looked_share && known.is_empty() {
        return None;
    }
    let of_law = test.share >= settings.description_shares[0];
    let judged_rows = JudgedRows { shapes: shapes(), ..judged_rows };
    // with too few rows for friction of any shape, no statement about the description is possible
    let test = tested(&judged_rows)?;
    if test.share < settings.looked_share && known.is_empty() {
        return of_law.then(|| perhaps_contradicted(&test));
    }
    let excitation = judged.excitation.len() as f64 / judged.filtered.sample_rate;
    let tells = judged.filtered.cutoff >= settings.least_cutoff && excitation >= settings.least_excitation;
    let Alternatives { tilt, change } = alternatives(judged.robot, &judged_rows, &test);
    let change = change.filter(|change| tells && change.residual_ratio <= settings.alternative);
    if change.as_ref().is_some_and(|change| change.is_gain) && far_joints(known) > 1 {
        // torques of several joints are in another unit, so the scale of one of them is no separate cause
        return None;
    }
    if let Some(change) = change {
        let matters = !change.is_number || costs(judged, &change, settings);
        return Some(doubted(&test, Some(change), matters));
    }
    let tilt = tilt.filter(|tilt| is_told(judged, tilt, settings));
    if let Some(tilt) = tilt {
        let matters = tells && tilt.tilt > FLOOR;
        return Some(doubted(&test, Some(tilt), matters));
    }
    let poorest = poorest(judged, settings);
    if !tells || test.share < settings.description_shares[0] || poorest <= settings.healthy[0] {
        return of_law.then(|| perhaps_contradicted(&test));
    }
    let matters = test.share >= settings.description_shares[1] && poorest > settings.healthy[1];
    Some(doubted(&test, None, matters))
}

/// Number of joints that are refused because their inertia is far from the nominal one.
fn far_joints(known: &[Finding]) -> usize {
    let is_far =
        |of: &&Finding| of.kind == FindingKind::FarFromNominal && of.severity == FindingSeverity::Refuse;
    known.iter().filter(is_far).count()
}

/// Returns true if a tilt is worth reporting: it explains a large part of all errors, or most of the error of a joint
/// that would be refused.
fn is_told(judged: &JudgedCycle<'_>, tilt: &DescriptionAlternative, settings: &DoubtSettings) -> bool {
    let of_joint = |of: &TorqueRmsd| {
        let [gained, left] =
            [&tilt.gained, &tilt.left].map(|all| all.get(of.joint.index()).copied().unwrap_or(0.0));
        of.scope == RmsdScope::Stage(Stage::Excitation)
            && of.moving_rows.relative > settings.healthy[0]
            && gained * gained > left * left
    };
    tilt.residual_ratio <= settings.alternative || judged.verification.iter().any(of_joint)
}

/// Excitation results of the joints whose torque is significant relative to the arm's largest or to their own rated
/// torque.
fn weighty<'a>(
    judged: &'a JudgedCycle<'_>,
    settings: &'a DoubtSettings,
) -> impl Iterator<Item = (JointIndex, Rmsd, f64)> + 'a {
    let moving = || {
        let of_excitation =
            judged.verification.iter().filter(|of| of.scope == RmsdScope::Stage(Stage::Excitation));
        of_excitation.filter(|of| of.moving_rows.relative > 0.0).map(|of| (of.joint, of.moving_rows))
    };
    let largest = moving().map(|(_, rmsd)| rmsd.value / rmsd.relative).fold(0.0, f64::max);
    moving().map(move |(joint, rmsd)| {
        let rated = judged.robot.joints[joint.index()].rated_torque.unwrap_or(0.0);
        (joint, rmsd, settings.least_share * rated.max(largest))
    })
}

/// Largest relative torque error of a joint, among errors that count.
fn poorest(judged: &JudgedCycle<'_>, settings: &DoubtSettings) -> f64 {
    let counts = weighty(judged, settings).filter(|(_, rmsd, least)| rmsd.value > *least);
    counts.map(|(_, rmsd, _)| rmsd.relative).fold(0.0, f64::max)
}

/// Returns true if a wrong description causes a significant torque error at some joint.
fn costs(judged: &JudgedCycle<'_>, better: &DescriptionAlternative, settings: &DoubtSettings) -> bool {
    weighty(judged, settings).any(|(joint, rmsd, least)| {
        let gained = better.gained.get(joint.index()).copied().unwrap_or(0.0);
        gained * rmsd.relative > settings.cost && gained * rmsd.value > least
    })
}

/// Remark that friction of another shape than the description's law explains the torques as well as another
/// description.
fn perhaps_contradicted(test: &DescriptionTest) -> Finding {
    Finding {
        kind: FindingKind::Description,
        severity: FindingSeverity::Warn,
        joint: None,
        sentence: "part of the torque error goes with friction of another shape than the description's law, or with its \
                   lengths, angles, mounting or torque scales: where these were never checked, check them"
            .into(),
        evidence: vec![Evidence { name: "share", value: test.share }, Evidence { name: "f", value: test.f }],
    }
}

/// Remark that most joints, each fitted separately, explain their torques better with a delay, while delayed torques
/// are not distinguishable from friction that changes sign late.
fn perhaps_late(found: &JointDelay, settings: &DoubtSettings) -> Option<Finding> {
    let mut sorted: Vec<f64> = found.joints.iter().map(|of| of.delay).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let delay = *sorted.get(sorted.len() / 2)?;
    let gained = |of: &&TorqueDelay| {
        of.residual_ratio <= settings.delay_residual && (of.delay - delay).abs() <= 0.5 * delay.abs()
    };
    let agreeing = found.joints.iter().filter(gained).count();
    if delay.abs() < settings.delays[0] || 2 * agreeing <= found.joints.len() {
        return None;
    }
    let direction = if delay > 0.0 { "after" } else { "before" };
    Some(Finding {
        kind: FindingKind::TorqueDelay,
        severity: FindingSeverity::Warn,
        joint: None,
        sentence: format!(
            "torques may come {:.0} ms {direction} the motion that needs them ({agreeing} of {} joints), or friction turns \
             over late: see whether the logger takes all channels at the same instant",
            1e3 * delay.abs(),
            found.joints.len()
        ),
        evidence: vec![
            Evidence { name: "delay_s", value: delay },
            Evidence { name: "agreeing_joints", value: agreeing as f64 },
        ],
    })
}

/// Root mean square of each joint's residual, at least a hundredth of its torque.
fn noise(judged: &JudgedCycle<'_>) -> Vec<f64> {
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

fn delays(judged: &JudgedCycle<'_>, shapes: &[Vec<Vec<f64>>]) -> Option<JointDelay> {
    let JudgedCycle { robot, columns, kept_columns, filtered, filtered_coulomb_columns, excitation, .. } =
        *judged;
    torque_delays(robot, columns, kept_columns, (filtered, filtered_coulomb_columns), excitation, shapes)
}

/// Finding of a delay that the joint fit shows and enough of the `moving` joints confirm in their own fits.
fn late(found: &JointDelay, moving: usize, settings: &DoubtSettings) -> Option<Finding> {
    let delay = found.delay;
    let gained = |of: &&TorqueDelay| {
        of.residual_ratio <= settings.delay_residual && (of.delay - delay).abs() <= 0.5 * delay.abs()
    };
    let agreeing = found.joints.iter().filter(gained).count();
    let quorum = settings.delay_quorum.min(moving).max(moving / 2 + 1);
    let gains = found.residual_ratio <= settings.delay_residual && agreeing >= quorum;
    if delay.abs() < settings.delays[0] || !gains {
        return None;
    }
    // a single joint cannot distinguish a delay from friction of an unusual shape
    let severity = match delay.abs() >= settings.delays[1] && moving > 1 {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    let direction = if delay > 0.0 { "after" } else { "before" };
    Some(Finding {
        kind: FindingKind::TorqueDelay,
        severity,
        joint: None,
        sentence: format!(
            "the torques come {:.0} ms {direction} the motion that needs them ({agreeing} of {moving} joints agree, the \
             torque error falls to {:.0} %); record all channels at the same instant, or correct the delay of the logger",
            1e3 * delay.abs(),
            100.0 * found.residual_ratio.sqrt()
        ),
        evidence: vec![
            Evidence { name: "delay_s", value: delay },
            Evidence { name: RESIDUAL_RATIO, value: found.residual_ratio },
            Evidence { name: "agreeing_joints", value: agreeing as f64 },
        ],
    })
}

/// Finding: a refusal if the error `matters`, otherwise a remark.
fn doubted(test: &DescriptionTest, better: Option<DescriptionAlternative>, matters: bool) -> Finding {
    let severity = if matters { FindingSeverity::Refuse } else { FindingSeverity::Warn };
    let remedy = match &better {
        Some(better) => format!(
            "with {} the torque error would be {:.0} % of what it is: check that first",
            better.words,
            100.0 * better.residual_ratio.sqrt()
        ),
        None => {
            "no single change explains it: check lengths, angles and mounting, then friction and couplings"
                .into()
        }
    };
    let mut evidence = vec![
        Evidence { name: "share", value: test.share },
        Evidence { name: "f", value: test.f },
        Evidence { name: "freedom", value: test.freedom[1] as f64 },
    ];
    if let Some(better) = better {
        evidence.push(Evidence { name: RESIDUAL_RATIO, value: better.residual_ratio });
        if better.tilt > 0.0 {
            evidence.push(Evidence { name: TILT, value: better.tilt });
        }
    }
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
