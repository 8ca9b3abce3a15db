//! Findings about the description as a whole: wrong numbers, a wrong mounting, torques out of time.

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

/// From where on a description, or the time of the torques, is doubted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubtSettings {
    /// Part of the residual that changed numbers of the description explain, from which on another
    /// description is looked for.
    pub looked_share: f64,
    /// The same part from which on it is said, and refused, though none is found, where the model leaves more of a
    /// torque than `healthy` unexplained.
    pub description_shares: [f64; 2],
    /// Moving relative RMSD that models of healthy arms stay below (thesis, chapter 5), and above which a contradiction
    /// without a remedy is refused.
    pub healthy: [f64; 2],
    /// Torque error, relative to the joint's RMS torque, that a wrong description must cost some joint to be refused.
    pub cost: f64,
    /// Part of the joint's rated torque, or of the largest RMS torque of the arm, below which no error counts.
    pub least_share: f64,
    /// Weighted residual sum of squares that another description may leave, relative to the given
    /// one's, to be named as the likely one.
    pub alternative: f64,
    /// Cut-off of the low-pass, Hz, below which a contradiction is said and never refused. Excitation moves with up to
    /// some 3 Hz: below, the low-pass takes away part of the motion, and as filtered torques are no function of filtered
    /// positions then, what is left goes with the geometry.
    pub least_cutoff: f64,
    /// Excitation, s, below which the same holds: joints reverse so few times then that friction of a shape nobody thought
    /// of looks like another arm.
    pub least_excitation: f64,
    /// Delay of the torques that is said, and that is refused, s.
    pub delays: [f64; 2],
    /// Residual sum of squares that the best delay must reach, relative to that without one.
    pub delay_residual: f64,
    /// Joints that must agree on a delay, or all of an arm with fewer; more than half of those that move in any case.
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

/// What a cycle's description is judged by.
#[derive(Debug, Clone, Copy)]
pub struct JudgedCycle<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a FactorColumns,
    /// Columns `[b]` of the regressor that were identified.
    pub kept_columns: &'a [usize],
    /// The cycle after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Columns of the description's regressor that jump, low-passed.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
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

/// Torques out of time, whatever else a recording's channels have.
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

/// A delay that friction of the description's law shows, which is the quicker to try, and friction of any shape too; and
/// the former.
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

/// Makes columns of friction of any shape, by joint, once.
type MakeShapes<'a, 's> = &'a dyn Fn() -> &'s Vec<Vec<Vec<f64>>>;

/// What the torques say against the numbers of the description. `shapes` makes columns of friction of any shape.
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
    // too few rows for friction of any shape say nothing of the description
    let test = tested(&judged_rows)?;
    if test.share < settings.looked_share && known.is_empty() {
        return of_law.then(|| perhaps_contradicted(&test));
    }
    let excitation = judged.excitation.len() as f64 / judged.filtered.sample_rate;
    let tells = judged.filtered.cutoff >= settings.least_cutoff && excitation >= settings.least_excitation;
    let Alternatives { tilt, change } = alternatives(judged.robot, &judged_rows, &test);
    let change = change.filter(|change| tells && change.residual_ratio <= settings.alternative);
    if change.as_ref().is_some_and(|change| change.is_gain) && far_joints(known) > 1 {
        // torques of several joints are in another unit: the scale of one of them is a part of that
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

/// Joints that are refused because their inertia is far from the nominal one.
fn far_joints(known: &[Finding]) -> usize {
    let is_far =
        |of: &&Finding| of.kind == FindingKind::FarFromNominal && of.severity == FindingSeverity::Refuse;
    known.iter().filter(is_far).count()
}

/// Whether a tilt is worth telling: it explains a good part of all errors, or most of a joint's that would be refused.
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

/// Excitation of the joints whose torque counts beside the arm's largest or their own rated one.
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

/// The largest relative torque error of a joint, among errors that count.
fn poorest(judged: &JudgedCycle<'_>, settings: &DoubtSettings) -> f64 {
    let counts = weighty(judged, settings).filter(|(_, rmsd, least)| rmsd.value > *least);
    counts.map(|(_, rmsd, _)| rmsd.relative).fold(0.0, f64::max)
}

/// Whether a wrong description costs some joint torque that matters.
fn costs(judged: &JudgedCycle<'_>, better: &DescriptionAlternative, settings: &DoubtSettings) -> bool {
    weighty(judged, settings).any(|(joint, rmsd, least)| {
        let gained = better.gained.get(joint.index()).copied().unwrap_or(0.0);
        gained * rmsd.relative > settings.cost && gained * rmsd.value > least
    })
}

/// A remark where friction of another shape than the description's law explains the torques as well as another
/// description does.
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

/// A remark where most joints, each for itself, explain their torques better some time later, and late torques are not
/// told from friction that turns over late.
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

/// Root mean square of each joint's residual; a hundredth of its torque at least.
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

/// A delay on which the joint fit and enough of the `moving` joints for themselves agree.
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
    // one joint alone cannot tell a delay from friction that it has at no other arm
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

/// The finding: a refusal where the error `matters`, and else a remark.
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
