//! Evidence of a run about the whole arm. It compares inertial parameters and torque signals with the robot's first
//! runs, and finds the cause that explains the differences.
//!
//! Inertial parameters do not depend on temperature. A body at the last link changes them along known directions,
//! mainly its mass and first moments. A torque channel that reads wrong changes the parameters of its joint, makes
//! friction asymmetric or increases the residual. A residual that is not noise of the channel is due to the joint's
//! mechanics, such as play of its gear. The test motion determines the effect on the parameters of a gain or offset
//! of a torque and of an offset of a position ([`armwatch_model::analysis::response::ChannelResponse`]). Each of
//! these faults therefore has one unknown, its size. Every cause has a price for its parameters. The cause with the
//! smallest residual, price included, wins (likelihood ratio with the Schwarz price).

pub(super) mod cause;
pub(super) mod baseline;
mod change;
mod channel;
mod price;
mod signal;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use self::baseline::Baseline;
use self::cause::{ArmCause, Load, SignalFault};
use self::change::{Change, MOST_TOGETHER};
use self::channel::{Shown, offset_rest};
use self::price::{
    ARM_MARGIN, CHANNEL_PRICE, MOST_FOR_OFFSETS, PARAMETER_PRICE, PATTERN_ERROR, SECOND_FAULT_PRICE,
    SILENT_SIGNAL_PRICE, UNKNOWN_PRICE,
};
use self::signal::{Signal, own_causes, signal};
use super::history::like_length::{has_parameters, of_like_length};
use crate::detect::rate::budget::advantage;
use crate::pooled::payload::LOAD_PRIOR;
use armwatch_model::analysis::response::ChannelResponse;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::JointIndex;

/// Least mass that is a load, in standard errors.
const MASS_ERRORS: f64 = 5.0;
/// The same if the run before had a load.
const MASS_ERRORS_STILL: f64 = 3.0;
/// Least change of a gain.
pub(super) const LEAST_GAIN: f64 = 0.02;
/// Least offset of a position, rad (m).
pub(super) const LEAST_POSITION_OFFSET: f64 = 0.003;

/// Least part of an offset in the friction stage that counts as nearly all of it.
const NEARLY_ALL: f64 = 0.75;
/// Largest part of an offset that the friction stage may show with the opposite sign. A larger part is a true offset
/// of that sign.
const MOST_TURNED: f64 = 0.2;

/// Least part of a run's change that a fault of the run before must explain to continue although another cause is
/// likelier now.
const MOST_EXPLAINED: f64 = 0.5;

/// The causes of a run, each with its cost in units of chi², the smallest cost first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmEvidence {
    /// Least advantage of a clear cause over no cause, in units of chi².
    pub(super) least_advantage: f64,
    pub(super) causes: Vec<(ArmCause, f64)>,
}

impl ArmEvidence {
    /// The cause, if it is clear.
    pub(super) fn clear(&self) -> ArmCause {
        self.at_least(self.least_advantage, MASS_ERRORS)
    }

    /// The cause, if it is still the likeliest after a run that had it.
    pub(super) fn still(&self) -> ArmCause {
        self.at_least(0.5 * self.least_advantage, MASS_ERRORS_STILL)
    }

    /// The fault of a run after a run with the fault `before`: a clear one, or still the same. If an unknown change
    /// is added, a known fault continues as long as it explains most of the change. So does a mechanical fault if an
    /// offset of the torque signal is now likelier.
    fn after(&self, before: ArmCause) -> ArmCause {
        let still = self.still();
        if still.is_same_fault(&before) {
            return still;
        }
        let none = self.cost_of(&ArmCause::None);
        let known =
            self.causes.iter().find(|(cause, _)| *cause != ArmCause::Unknown && cause.is_same_fault(&before));
        match (known, none) {
            (Some((cause, cost)), Some(none))
                if (still == ArmCause::Unknown || still.is_offset_of_rest(&before))
                    && none - cost >= self.least_advantage.max(MOST_EXPLAINED * none) =>
            {
                *cause
            }
            _ => self.clear(),
        }
    }

    fn cost_of(&self, cause: &ArmCause) -> Option<f64> {
        self.causes.iter().find(|(of, _)| of == cause).map(|(_, cost)| *cost)
    }

    fn at_least(&self, advantage: f64, mass_errors: f64) -> ArmCause {
        let is_clear = |cause: &ArmCause| match cause {
            ArmCause::Load(load) => load.is_at_least(mass_errors),
            ArmCause::TorqueSignal { fault: SignalFault::Gain(part), .. } => part.abs() >= LEAST_GAIN,
            ArmCause::PositionSignal { offset, .. } => offset.abs() >= LEAST_POSITION_OFFSET,
            _ => true,
        };
        match self.causes.first().filter(|_| self.advantage() >= advantage) {
            Some((cause, _)) if is_clear(cause) => *cause,
            _ => ArmCause::None,
        }
    }

    /// Decrease of the residual compared with no cause, in units of chi².
    pub(super) fn advantage(&self) -> f64 {
        advantage_of(&self.causes)
    }

    /// Odds of each cause against all others together, the likeliest first, for a run with this `fault`. They omit the
    /// offset that a mechanical fault does not become.
    pub(super) fn odds(&self, fault: &ArmCause) -> Vec<(ArmCause, f64)> {
        let causes = || self.causes.iter().filter(|(cause, _)| !cause.is_offset_of_rest(fault));
        let least = causes().next().map_or(0.0, |(_, cost)| *cost);
        let weight = |cost: f64| (-0.5 * (cost - least)).exp();
        let all: f64 = causes().map(|(_, cost)| weight(*cost)).sum();
        let odds = |cost: f64| weight(cost) / (all - weight(cost)).max(f64::MIN_POSITIVE);
        causes().map(|(cause, cost)| (*cause, odds(*cost))).collect()
    }
}

/// The fault of each run, as alarms report it; `None` for runs without evidence.
pub(super) fn faults(evidence: &[Option<ArmEvidence>]) -> Vec<Option<ArmCause>> {
    let mut before = ArmCause::None;
    let one = |of: &Option<ArmEvidence>| {
        let fault = of.as_ref()?.after(before);
        before = fault;
        Some(fault)
    };
    evidence.iter().map(one).collect()
}

fn advantage_of(causes: &[(ArmCause, f64)]) -> f64 {
    let none = causes.iter().find(|(cause, _)| *cause == ArmCause::None);
    match (causes.first(), none) {
        (Some((_, cost)), Some((_, none))) => none - cost,
        _ => 0.0,
    }
}

/// Least advantage of a clear cause over no cause at the required rate of false alarms, in units of chi².
pub(super) fn least_advantage(history: &[RunSummary], settings: &DetectSettings) -> f64 {
    2.0 * (ARM_MARGIN + advantage(settings, history))
}

/// The evidence of each run; `None` before there is a baseline and for runs without figures. The baseline of a run
/// consists of the first runs of similar length. `least` is the [`least_advantage`] of a clear cause.
pub(super) fn arm_evidence(
    history: &[RunSummary],
    joints: usize,
    baseline_runs: usize,
    least: f64,
) -> Vec<Option<ArmEvidence>> {
    let mut found = vec![None; history.len()];
    let response = response_of(history);
    for places in of_like_length(history) {
        let runs: Vec<&RunSummary> = places.iter().map(|&place| &history[place]).collect();
        let usual = UsualArm::of(&runs, response, joints, baseline_runs);
        let changes: Vec<Option<DVector<f64>>> = runs.iter().map(|run| usual.change(run)).collect();
        for (at, run) in runs.iter().enumerate() {
            let together = together(&runs, at).into_iter().map(|at| changes[at].as_ref()).collect();
            found[places[at]] = usual.judge(run, together).at_least(least);
        }
    }
    found
}

/// Response of the parameters to channels that read wrong. The first test with a response supplies it. Those of the
/// other tests differ only by the scatter of the motion.
pub(super) fn response_of(history: &[RunSummary]) -> Option<&ChannelResponse> {
    history.iter().find_map(|run| run.response.as_deref())
}

/// Places of the latest tests of similar length up to and including the one at `at`. The search for a change uses
/// their mean. Empty if that test has no parameters.
pub(super) fn together(runs: &[&RunSummary], at: usize) -> Vec<usize> {
    let has_parameters = |place: &usize| has_parameters(runs[*place]);
    if !has_parameters(&at) {
        return Vec::new();
    }
    let mut found: Vec<usize> = (0..=at).rev().filter(has_parameters).take(MOST_TOGETHER).collect();
    found.reverse();
    found
}

/// Usual values of an arm in tests of similar length.
#[derive(Debug)]
pub(super) struct UsualArm {
    baseline: Baseline,
    joints: usize,
}

impl UsualArm {
    /// Usual values from these tests, oldest first. Only the first [`Self::tests`] contribute.
    pub(super) fn of(
        history: &[&RunSummary],
        response: Option<&ChannelResponse>,
        joints: usize,
        baseline_runs: usize,
    ) -> Self {
        Self { baseline: Baseline::of(history, response, joints, baseline_runs), joints }
    }

    /// Number of these tests, from the first on, that define the usual values.
    pub(super) fn tests(history: &[&RunSummary], joints: usize, baseline_runs: usize) -> usize {
        Baseline::tests(history, joints, baseline_runs)
    }

    /// Difference of the parameters of a test from the usual ones; `None` if the test lacks a parameter.
    pub(super) fn change(&self, run: &RunSummary) -> Option<DVector<f64>> {
        self.baseline.change(run)
    }

    /// Judges a test. `changes` are those of the latest tests up to this one; the last is the change of this test.
    pub(super) fn judge(&self, run: &RunSummary, changes: Vec<Option<&DVector<f64>>>) -> ArmJudgement {
        let widened = self.baseline.widened(run);
        let (baseline, changes): (&Baseline, Vec<Option<DVector<f64>>>) = match &widened {
            Some((baseline, by)) => {
                (baseline, changes.iter().map(|of| of.map(|of| of.component_div(by))).collect())
            }
            None => (&self.baseline, changes.into_iter().map(Option::<&_>::cloned).collect()),
        };
        let changes: Vec<Option<&DVector<f64>>> = changes.iter().map(Option::as_ref).collect();
        let (plain, together) = Change::of(&changes, &baseline.directions, baseline.own_variance());
        let costs = |change: Option<&Change>| costs(run, change, baseline, self.joints);
        let together = together.into_iter();
        ArmJudgement {
            plain: costs(plain.as_ref()),
            together: together.filter_map(|(ratio, change)| Some((ratio, costs(Some(&change))?))).collect(),
        }
    }
}

/// Judgement of the arm from one test, at any rate of false alarms.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct ArmJudgement {
    /// Causes from the evidence of this test alone, with their costs, the smallest first. Empty if no cause can be
    /// clear, `None` without figures.
    pub(super) plain: Option<Vec<(ArmCause, f64)>>,
    /// The same for means of this test and earlier ones, if one fault explains their changes together. Each entry has
    /// the advantage over separate changes, and the causes. Means of the fewest tests are first.
    pub(super) together: Vec<(f64, Vec<(ArmCause, f64)>)>,
}

impl ArmJudgement {
    /// The evidence, if a clear cause needs the advantage `least`.
    pub(super) fn at_least(self, least: f64) -> Option<ArmEvidence> {
        let counts = |ratio: f64| ratio >= least + CHANNEL_PRICE + PARAMETER_PRICE;
        let together = self.together.into_iter().find(|(ratio, _)| counts(*ratio));
        let causes = together.map(|(_, causes)| causes).or(self.plain)?;
        Some(ArmEvidence { least_advantage: least, causes })
    }
}

/// Causes with their costs, the smallest first; empty if no cause can be clear.
fn costs(
    run: &RunSummary,
    change: Option<&Change>,
    baseline: &Baseline,
    joints: usize,
) -> Option<Vec<(ArmCause, f64)>> {
    let signals: Vec<Signal> = (0..joints).map(|j| signal(run, baseline, JointIndex::new(j))).collect();
    // a residual alone has many causes
    if change.is_none() && run.cycle_friction.is_empty() {
        return None;
    }
    let inertial = change.map_or(0.0, |change| change.square);
    let all_signals: f64 = signals.iter().map(Signal::cost).sum();
    let mut causes = vec![(ArmCause::None, inertial + all_signals)];
    if let Some(change) = change.filter(|_| inertial > 0.0)
        && let Some((load, left)) = load(change, baseline)
        && load.is_at_least(MASS_ERRORS_STILL)
    {
        let rest = (left - PATTERN_ERROR).max(0.0) * inertial;
        let signals = signals.iter().map(|of| of.cost() - (of.offset.1 - SECOND_FAULT_PRICE).max(0.0));
        causes.push((ArmCause::Load(load), rest + signals.sum::<f64>() + 10.0 * PARAMETER_PRICE));
    }
    for joint in (0..joints).map(JointIndex::new) {
        let elsewhere = change.map_or(0.0, |Change { deviations, .. }| {
            let all = baseline.parameters.iter().zip(deviations.iter());
            let far = all.filter(|((id, ..), _)| !is_near(id.joint, joint));
            far.map(|(_, x)| x * x).sum::<f64>() / deviations.norm_squared()
        });
        let own = &signals[joint.index()];
        let rest = match change.filter(|_| inertial > 0.0) {
            None => 0.0,
            // the friction stage shows a constant torque, and any parameters that fit it absorb it; a large one
            // absorbs the joint's weight, which then moves them by amounts that depend on the other joints
            Some(change) if own.offset.1 > 0.0 => {
                offset_rest(change, joint, baseline).min(price_of_any(change, |_| true, baseline))
            }
            Some(_) => (elsewhere - PATTERN_ERROR).max(0.0) * inertial,
        };
        let silent = if own.cost() > 0.0 { 0.0 } else { SILENT_SIGNAL_PRICE };
        // a torque that reads wrong also spoils the fit of the joint before, but less than the fit of the same joint
        let part = |other: usize| match is_near(JointIndex::new(other), joint) {
            true if signals[other].unexplained.0 < own.ratio() => 0.0,
            _ => 1.0,
        };
        let others = signals.iter().enumerate().filter(|(j, _)| *j != joint.index());
        let others: f64 =
            others.map(|(j, of)| of.offset.1 + of.noise_cost() + part(j) * of.unexplained.1).sum();
        let beside = rest + others + silent + 4.0 * PARAMETER_PRICE;
        for (cause, left) in own_causes(own, run, baseline, joint) {
            let anywhere = match (cause, change) {
                (ArmCause::UnexplainedTorque { .. }, Some(change)) => moved_anywhere(change, joint, baseline),
                _ => 0.0,
            };
            causes.push((cause, beside + left + anywhere));
        }
    }
    if let Some(change) = change {
        let channels = Shown { change, signals: &signals, run, baseline }.channels();
        channels.into_iter().for_each(|of| add_channel(&mut causes, of));
    }
    causes.extend(noise_of_all(change, &signals, baseline));
    // a change of the arm adds no constant to the torque of a joint, unless the actual posture differs from the
    // assumed one
    let offsets: f64 = signals.iter().map(|of| of.offset.1).sum();
    causes.push((ArmCause::Unknown, UNKNOWN_PRICE + offsets.min(MOST_FOR_OFFSETS)));
    causes.sort_by(|a, b| a.1.total_cmp(&b.1));
    // this limit is below half the least advantage at any rate of false alarms
    if advantage_of(&causes) < ARM_MARGIN {
        causes.clear();
    }
    Some(causes)
}

/// Noise of most torque signals, such as from a supply or a ground, with its cost; `None` if fewer signals have more
/// noise. The parameters may have any values, since the rows determine them badly.
fn noise_of_all(change: Option<&Change>, signals: &[Signal], baseline: &Baseline) -> Option<(ArmCause, f64)> {
    let ratios: Vec<f64> =
        signals.iter().filter(|of| of.noise_cost() > 0.0).filter_map(Signal::noise_ratio).collect();
    if ratios.len() < 2 || 3 * ratios.len() < 2 * signals.len() {
        return None;
    }
    let ratio = ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / ratios.len() as f64;
    let rest = change.map_or(0.0, |change| price_of_any(change, |_| true, baseline));
    let others: f64 = signals.iter().map(|of| of.offset.1 + of.unexplained.1).sum();
    Some((ArmCause::NoiseOfAll(ratio.exp()), rest + others + 4.0 * PARAMETER_PRICE))
}

/// Adds a fault of a channel. If the friction stage shows the same offset of a torque, both are one cause. It has the
/// lower cost and the size that explains the rest of the test, if there is one. The friction stage shows a part of an
/// offset, since the cycle's parameters have absorbed some of it.
fn add_channel(causes: &mut Vec<(ArmCause, f64)>, (cause, cost): (ArmCause, f64)) {
    let offset_of = |of: &ArmCause| match of {
        ArmCause::TorqueSignal { joint, fault: SignalFault::Offset(_) } => Some(*joint),
        _ => None,
    };
    let own =
        offset_of(&cause).and_then(|joint| causes.iter_mut().find(|of| offset_of(&of.0) == Some(joint)));
    match own {
        Some(own) if is_measured(own.0, cause) => own.1 = own.1.min(cost),
        Some(own) if cost < UNKNOWN_PRICE => *own = (cause, cost.min(own.1)),
        Some(own) if cost < own.1 => *own = (cause, cost),
        Some(_) => {}
        None => causes.push((cause, cost)),
    }
}

/// True if the offset in the friction stage is nearer the truth than the one that explains the rest of the test. This
/// is so if it is nearly all of that offset, or clearly has the opposite sign.
fn is_measured(seen: ArmCause, whole: ArmCause) -> bool {
    let size = |of: ArmCause| match of {
        ArmCause::TorqueSignal { fault: SignalFault::Offset(size), .. } => Some(size),
        _ => None,
    };
    let part = size(seen).zip(size(whole)).map(|(seen, whole)| seen / whole);
    part.is_some_and(|part| !(-MOST_TURNED..NEARLY_ALL).contains(&part))
}

/// Price of a change that does not predict how the parameters near a joint move.
fn moved_anywhere(change: &Change, joint: JointIndex, baseline: &Baseline) -> f64 {
    price_of_any(change, |of| is_near(of, joint), baseline)
}

/// Price of a change that does not predict how the parameters of some joints move, in units of chi². It assumes
/// normally distributed deviations with the variance that they show.
fn price_of_any(change: &Change, of: impl Fn(JointIndex) -> bool, baseline: &Baseline) -> f64 {
    let all = baseline.parameters.iter().zip(change.deviations.iter());
    let near: Vec<f64> = all.filter(|((id, ..), _)| of(id.joint)).map(|(_, x)| x * x).collect();
    let variance = near.iter().sum::<f64>() / near.len().max(1) as f64;
    if change.square > 0.0 { near.len() as f64 * variance.max(1.0).ln() } else { 0.0 }
}

/// True if a wrong torque signal of `joint` changes the parameters of `of`. It changes those of its joint and of the
/// joint before, since the torque of that joint has most of the same columns.
fn is_near(of: JointIndex, joint: JointIndex) -> bool {
    of == joint || of.index() + 1 == joint.index()
}

/// The body at the last link that explains most of a change, and the part of the change's square that it does not
/// explain. The method is generalised least squares with a wide prior.
fn load(change: &Change, baseline: &Baseline) -> Option<(Load, f64)> {
    let Change { deviations, scale, .. } = change;
    let of_load = |i: usize, k: usize| baseline.parameters[i].2[k] * scale / baseline.deviation(i);
    let x = DMatrix::from_fn(deviations.len(), 10, of_load);
    let prior = DMatrix::from_diagonal(&DVector::from_fn(10, |k, _| LOAD_PRIOR[k].powi(-2)));
    let covariance = (x.transpose() * &x + prior).try_inverse()?;
    let found = &covariance * (x.transpose() * deviations);
    let left = (deviations - &x * &found).norm_squared() / deviations.norm_squared();
    let mass = found[0];
    let centre = [1, 2, 3].map(|k| found[k] / mass);
    let std_error = covariance[(0, 0)].sqrt();
    let found = Load { mass, std_error, centre };
    (mass.is_finite() && (mass != 0.0 || !found.has_seen_mass())).then_some((found, left))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_is_taken_from_the_friction_stage_where_that_shows_it() {
        let of =
            |size| ArmCause::TorqueSignal { joint: JointIndex::new(2), fault: SignalFault::Offset(size) };
        let merged = |seen: f64, whole: f64| {
            let mut causes = vec![(ArmCause::None, 900.0), (of(seen), 40.0)];
            add_channel(&mut causes, (of(whole), 30.0));
            causes[1]
        };
        // nearly all, the opposite sign, a part of it, and a little of it with the opposite sign
        assert_eq!(merged(1.9, 2.0), (of(1.9), 30.0));
        assert_eq!(merged(2.9, -4.3), (of(2.9), 30.0));
        assert_eq!(merged(0.5, 2.0), (of(2.0), 30.0));
        assert_eq!(merged(-0.1, 2.0), (of(2.0), 30.0));
    }

    #[test]
    fn a_rarer_alarm_of_the_arm_needs_more_evidence() {
        let of = |rate: f64| {
            let settings = DetectSettings { false_alarms_per_robot_year: rate, ..DetectSettings::default() };
            least_advantage(&[], &settings)
        };
        assert!((of(0.2) - of(20.0) - 2.0 * 100.0_f64.ln()).abs() < 1e-9);
        let cause = ArmCause::TorqueSignal { joint: JointIndex::new(0), fault: SignalFault::Offset(1.0) };
        let clear = |rate: f64| {
            let causes = vec![(cause, 0.0), (ArmCause::None, 0.5 * (of(0.2) + of(20.0)))];
            ArmEvidence { least_advantage: of(rate), causes }.clear()
        };
        assert_eq!([clear(0.2), clear(20.0)], [ArmCause::None, cause]);
    }
}
