//! What a run says of the whole arm: inertial parameters and torque signals against the robot's first runs, and which
//! cause explains them.
//!
//! Inertial parameters do not depend on warmth. A body at the last link changes them along known directions, its mass
//! and first moments in the first place; a torque channel that reads wrong changes those of its own joint, turns
//! friction over unevenly or leaves more unexplained. What a gain or offset of a torque and an offset of a position do to
//! the parameters is known from the test motion ([`ChannelResponse`]), so that each has one unknown, its size. Every cause has a price for its parameters, and the cause with
//! the least unexplained rest wins (likelihood ratio with the Schwarz price).

use nalgebra::{DMatrix, DVector};

use super::like_length::of_like_length;
use crate::analysis::response::{ChannelFault, ChannelResponse, FaultResponse};
use crate::anomaly::{RunParameter, RunSummary};
use crate::numerics::statistics::descriptive::{mean, median, robust_deviation};
use crate::robot::{JointIndex, ParameterId, ParameterKind};

/// Prior standard deviations of a load: mass, kg, first moments, kg m, and inertia, kg m². Wide for what an arm of
/// some ten kilograms carries.
const LOAD_PRIOR: [f64; 10] = [20.0, 5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0];
/// Least standard deviation of a parameter from run to run, as a fraction of it.
const LEAST_DEVIATION: f64 = 1e-3;
/// Part of a change that a pattern may miss: patterns are models.
const PATTERN_ERROR: f64 = 0.05;
/// The same of the direction of a known fault, which is computed from the motion: a load, which has more unknowns, must not
/// be taken for it.
const DIRECTION_ERROR: f64 = 0.015;
/// Least mass that is called a load, kg, and how many of its standard errors.
const LEAST_MASS: f64 = 0.1;
const MASS_ERRORS: f64 = 5.0;
/// The same of a load that the run before had.
const MASS_ERRORS_STILL: f64 = 3.0;
/// Deviation of an offset or of an unexplained rest, in standard deviations, from which on it is looked at.
const SIGNAL_DEVIATIONS: f64 = 8.0;
/// Least offset of a torque signal, as a fraction of the joint's friction.
const LEAST_OFFSET: f64 = 0.03;
/// Least change of a gain.
pub(super) const LEAST_GAIN: f64 = 0.02;
/// Least offset of a position, rad (m).
pub(super) const LEAST_POSITION_OFFSET: f64 = 0.003;
/// Least ratio of the unexplained rest to the usual one.
const LEAST_RMSD_RATIO: f64 = 1.6;
/// Least standard deviation of the logarithm of the unexplained rest from run to run.
const LEAST_RMSD_DEVIATION: f64 = 0.05;
/// A single deviation counts no more than this many squared: beyond, all models are wrong.
const MOST_CHI_SQUARE: f64 = 2000.0;
/// Mean square of the deviations of all parameters from which on they have changed: a baseline of a few runs knows the
/// deviations badly, and nothing of a season.
const LEAST_MEAN_SQUARE: f64 = 25.0;
/// F ratio of the fault of a channel from which on a smaller change of parameters is looked at: what a cause needs to be
/// clear.
const LEAST_RATIO: f64 = LEAST_ADVANTAGE + CHANNEL_PRICE + PARAMETER_PRICE;
/// Latest runs in whose mean a change is looked for that one run does not show.
const MOST_TOGETHER: usize = 8;
/// Least advantage of a cause over none, in units of chi².
const LEAST_ADVANTAGE: f64 = 60.0;
/// Price of one parameter, in units of chi².
const PARAMETER_PRICE: f64 = 4.0;
/// Further price of a torque signal that shows in parameters alone: a load does that too.
const SILENT_SIGNAL_PRICE: f64 = 60.0;
/// Further price of a channel whose fault is known but for its size.
const CHANNEL_PRICE: f64 = 20.0;
/// Price of a cause that is not known: it explains anything.
const UNKNOWN_PRICE: f64 = 150.0;

/// Why the arm of a run differs from that of the first runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ArmCause {
    /// It does not.
    None,
    /// A body at the last link.
    Load(Load),
    /// The torque signal of a joint.
    TorqueSignal { joint: JointIndex, fault: SignalFault },
    /// The position signal of a joint reads too much by so many rad (m).
    PositionSignal { joint: JointIndex, offset: f64 },
    /// Parameters changed in another way.
    Unknown,
}

/// A body at the last link, or one taken away where the mass is negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Load {
    /// Mass, kg.
    pub(super) mass: f64,
    /// Its standard error, kg.
    pub(super) std_error: f64,
    /// Centre in the frame of the last link, m.
    pub(super) centre: [f64; 3],
}

/// What is wrong with a torque signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SignalFault {
    /// Friction does not turn over evenly: half the sum of both directions, Nm (N), beyond the usual.
    Offset(f64),
    /// Torque that the model does not explain, as a multiple of the usual.
    Unexplained(f64),
    /// The joint's own parameters have changed by this fraction.
    Gain(f64),
}

impl ArmCause {
    /// What it would be, in words that follow "rather than".
    pub(super) fn words(&self) -> String {
        match self {
            Self::None => "no change of the arm".into(),
            Self::Load(load) => format!("a load of {:+.2} kg", load.mass),
            Self::TorqueSignal { joint, fault: SignalFault::Offset(_) } => {
                format!("an offset of the torque signal of joint {joint}")
            }
            Self::TorqueSignal { joint, fault: SignalFault::Gain(part) } => {
                format!("a gain of {:+.1} % of the torque signal of joint {joint}", 100.0 * part)
            }
            Self::TorqueSignal { joint, fault: SignalFault::Unexplained(_) } => {
                format!("noise of the torque signal of joint {joint}")
            }
            Self::PositionSignal { joint, offset } => {
                format!("an offset of {offset:+.4} rad (m) of the position of joint {joint}")
            }
            Self::Unknown => "a change of the arm that is not known".into(),
        }
    }
}

/// The causes of a run, each with its cost in units of chi², the least first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmEvidence {
    pub(super) causes: Vec<(ArmCause, f64)>,
}

impl ArmEvidence {
    /// The cause, where it is clear.
    pub(super) fn clear(&self) -> ArmCause {
        self.at_least(LEAST_ADVANTAGE, MASS_ERRORS)
    }

    /// The cause, where it is still the likeliest of a run after one that had it.
    pub(super) fn still(&self) -> ArmCause {
        self.at_least(0.5 * LEAST_ADVANTAGE, MASS_ERRORS_STILL)
    }

    fn at_least(&self, advantage: f64, mass_errors: f64) -> ArmCause {
        let is_clear = |cause: &ArmCause| match cause {
            ArmCause::Load(load) => load.mass.abs() >= LEAST_MASS.max(mass_errors * load.std_error),
            ArmCause::TorqueSignal { fault: SignalFault::Gain(part), .. } => part.abs() >= LEAST_GAIN,
            ArmCause::PositionSignal { offset, .. } => offset.abs() >= LEAST_POSITION_OFFSET,
            _ => true,
        };
        match self.causes.first().filter(|_| self.advantage() >= advantage) {
            Some((cause, _)) if is_clear(cause) => *cause,
            _ => ArmCause::None,
        }
    }

    /// How much less than without a cause is left unexplained, in units of chi².
    pub(super) fn advantage(&self) -> f64 {
        let none = self.causes.iter().find(|(cause, _)| *cause == ArmCause::None);
        match (self.causes.first(), none) {
            (Some((_, cost)), Some((_, none))) => none - cost,
            _ => 0.0,
        }
    }

    /// Odds of each cause against all others together, the likeliest first.
    pub(super) fn odds(&self) -> Vec<(ArmCause, f64)> {
        let least = self.causes.first().map_or(0.0, |(_, cost)| *cost);
        let weight = |cost: f64| (-0.5 * (cost - least)).exp();
        let all: f64 = self.causes.iter().map(|(_, cost)| weight(*cost)).sum();
        let odds = |cost: f64| weight(cost) / (all - weight(cost)).max(f64::MIN_POSITIVE);
        self.causes.iter().map(|(cause, cost)| (*cause, odds(*cost))).collect()
    }
}

/// A figure of the first runs: the usual value and its deviation from run to run.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Usual {
    value: f64,
    deviation: f64,
}

impl Usual {
    /// Of the first `count` values. `least` is the least deviation.
    fn of(values: impl Iterator<Item = f64>, count: usize, least: f64) -> Option<Self> {
        let first: Vec<f64> = values.take(count).collect();
        let value = median(&first)?;
        if first.len() < count.max(2) {
            return None;
        }
        // that of the median itself is a part of the deviation from it
        let own = (1.0 + std::f64::consts::FRAC_PI_2 / first.len() as f64).sqrt();
        Some(Self { value, deviation: own * robust_deviation(&first).unwrap_or(0.0).max(least) })
    }

    fn deviations(&self, value: f64) -> f64 {
        (value - self.value) / self.deviation
    }
}

/// The evidence of each run, `None` before there is a baseline and for runs without figures. A run is compared with the first
/// runs of like length.
pub(super) fn arm_evidence(
    history: &[RunSummary],
    joints: usize,
    baseline_runs: usize,
) -> Vec<Option<ArmEvidence>> {
    let mut found = vec![None; history.len()];
    for places in of_like_length(history) {
        let runs: Vec<&RunSummary> = places.iter().map(|&place| &history[place]).collect();
        for (place, evidence) in places.iter().zip(evidence_of_like(&runs, joints, baseline_runs)) {
            found[*place] = evidence;
        }
    }
    found
}

fn evidence_of_like(
    history: &[&RunSummary],
    joints: usize,
    baseline_runs: usize,
) -> Vec<Option<ArmEvidence>> {
    let baseline = Baseline::of(history, joints, baseline_runs);
    let changes: Vec<Option<DVector<f64>>> = history.iter().map(|run| baseline.change(run)).collect();
    let own_variance = std::f64::consts::FRAC_PI_2 / baseline_runs.max(2) as f64;
    let one = |(place, run): (usize, &&RunSummary)| {
        let change = Change::of(&changes[..=place], &baseline.directions, own_variance);
        evidence(run, change.as_ref(), &baseline, joints)
    };
    history.iter().enumerate().map(one).collect()
}

/// How the inertial parameters differ from those of the first runs.
struct Change {
    /// In their standard deviations.
    deviations: DVector<f64>,
    /// These are as many times as large as those of one run, since they are of the mean of several.
    scale: f64,
    /// What of the square counts: zero where it is no change.
    square: f64,
}

impl Change {
    /// Of the latest run, whose change is the last of `changes`; `None` where it has no parameters. What one run does not
    /// show is looked for in the mean of the latest runs. `own_variance` is that of the baseline in the variances of a run.
    fn of(changes: &[Option<DVector<f64>>], directions: &[Direction], own_variance: f64) -> Option<Self> {
        let latest = changes.last()?.clone()?;
        let chi_square: f64 = latest.iter().map(|x| (x * x).min(MOST_CHI_SQUARE)).sum();
        // what chance makes of so many parameters is no change
        if chi_square > LEAST_MEAN_SQUARE * latest.len() as f64 {
            return Some(Self { deviations: latest, scale: 1.0, square: chi_square });
        }
        let mut sum = DVector::zeros(latest.len());
        for (runs, change) in (1..).zip(changes.iter().rev().flatten().take(MOST_TOGETHER)) {
            sum += change;
            if !usize::is_power_of_two(runs) {
                continue;
            }
            // the baseline is the same for all runs
            let variance = ((runs as f64).recip() + own_variance) / (1.0 + own_variance);
            let scale = variance.sqrt().recip();
            let deviations = &sum * (scale / runs as f64);
            let square = along_one_direction(&deviations, directions);
            if square > 0.0 {
                return Some(Self { deviations, scale, square });
            }
        }
        Some(Self { deviations: latest, scale: 1.0, square: 0.0 })
    }
}

/// The first runs of an arm, of like length.
struct Baseline {
    /// Usual value and deviation of each inertial parameter, with what it stands for.
    parameters: Vec<(ParameterId, Usual, [f64; 10])>,
    /// How much more than their deviations the parameters of the first runs vary, squared.
    inflation: f64,
    offsets: Vec<Option<Usual>>,
    rmsd: Vec<Option<Usual>>,
    /// What faults of channels do to the parameters; empty where no test says it.
    directions: Vec<Direction>,
}

/// What one fault of a channel does, by its size.
struct Direction {
    joint: JointIndex,
    fault: ChannelFault,
    /// Change of the parameters, in their standard deviations.
    change: DVector<f64>,
    /// Unexplained torque of each joint, as a fraction of its torque.
    unexplained: Vec<f64>,
}

impl Baseline {
    fn of(history: &[&RunSummary], joints: usize, baseline_runs: usize) -> Self {
        let count = baseline_runs.max(2);
        let last = history.iter().flat_map(|run| &run.parameters).map(|of| of.id.joint).max();
        let first = history.iter().find(|run| !run.parameters.is_empty());
        let usual = |of: &RunParameter| {
            let own: Vec<&RunParameter> = history
                .iter()
                .filter_map(|run| run.parameters.iter().find(|other| other.id == of.id))
                .take(count)
                .collect();
            let scatter: Vec<f64> = own
                .iter()
                .map(|of| of.std_dev / f64::from(of.cycles).sqrt())
                .filter(|s| s.is_finite())
                .collect();
            let least =
                median(&scatter).unwrap_or(0.0).max(LEAST_DEVIATION * of.mean.abs()).max(f64::MIN_POSITIVE);
            // errors of single runs are known well, deviations of a few runs are not: these are pooled below
            let means: Vec<f64> = own.iter().map(|of| of.mean).collect();
            let value = median(&means).filter(|_| means.len() == count)?;
            let usual =
                Usual { value, deviation: least * (1.0 + std::f64::consts::FRAC_PI_2 / count as f64).sqrt() };
            Some((of.id, usual, of_last_link(&of.terms, last?)))
        };
        let parameters: Vec<_> =
            first.map(|run| run.parameters.iter().filter_map(usual).collect()).unwrap_or_default();
        let mut found = Self {
            parameters,
            inflation: 1.0,
            offsets: (0..joints).map(|j| Usual::of_offsets(history, JointIndex::new(j), count)).collect(),
            rmsd: (0..joints).map(|j| Usual::of_rmsd(history, JointIndex::new(j), count)).collect(),
            directions: Vec::new(),
        };
        let own: Vec<f64> = history
            .iter()
            .filter_map(|run| found.change(run))
            .take(count)
            .map(|change| change.norm_squared() / change.len().max(1) as f64)
            .collect();
        // the median was taken from these runs, and a run may be odd
        let freedom = (count as f64 - 1.0) / count as f64;
        found.inflation = own.iter().copied().fold(1.0, f64::max) / freedom;
        let response = history.iter().rev().find_map(|run| run.response.as_deref());
        found.directions = response.map(|of| found.directions(of)).unwrap_or_default();
        found
    }

    /// Empty where the response lacks a parameter, as that of another description does.
    fn directions(&self, response: &ChannelResponse) -> Vec<Direction> {
        let place =
            |(id, ..): &(ParameterId, Usual, [f64; 10])| response.parameters.iter().position(|of| of == id);
        let places: Option<Vec<usize>> = self.parameters.iter().map(place).collect();
        let Some(places) = places.filter(|places| !places.is_empty()) else { return Vec::new() };
        let scaled = |of: &FaultResponse| Direction {
            joint: of.joint,
            fault: of.fault,
            change: DVector::from_fn(places.len(), |row, _| of.change[places[row]] / self.deviation(row)),
            unexplained: of.unexplained.clone(),
        };
        response.faults.iter().map(scaled).collect()
    }

    /// Standard deviation of a parameter of a run.
    fn deviation(&self, row: usize) -> f64 {
        self.parameters[row].1.deviation * self.inflation.sqrt()
    }

    /// Deviations of the inertial parameters of a run, in standard deviations; `None` where it lacks one.
    fn change(&self, run: &RunSummary) -> Option<DVector<f64>> {
        if self.parameters.is_empty() {
            return None;
        }
        let value = |(id, usual, _): &(ParameterId, Usual, [f64; 10])| {
            let of = run.parameters.iter().find(|of| of.id == *id)?;
            Some(usual.deviations(of.mean) / self.inflation.sqrt())
        };
        let values: Option<Vec<f64>> = self.parameters.iter().map(value).collect();
        values.map(DVector::from_vec)
    }
}

impl Usual {
    fn of_offsets(history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<Self> {
        let runs: Vec<Vec<f64>> =
            history.iter().map(|run| offsets(run, joint)).filter(|of| of.len() > 1).take(count).collect();
        let within: Vec<f64> =
            runs.iter().filter_map(|run| Some(robust_deviation(run)? / (run.len() as f64).sqrt())).collect();
        let friction = history.iter().find_map(|run| friction(run, joint)).unwrap_or(0.0);
        let least = median(&within).unwrap_or(0.0).max(1e-3 * friction).max(f64::MIN_POSITIVE);
        Self::of(runs.iter().filter_map(|run| mean(run)), count, least)
    }

    fn of_rmsd(history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<Self> {
        let values = history.iter().filter_map(|run| rmsd(run, joint)).map(f64::ln);
        Self::of(values, count, LEAST_RMSD_DEVIATION)
    }
}

fn offsets(run: &RunSummary, joint: JointIndex) -> Vec<f64> {
    let own = run.cycle_friction.iter().filter(|of| of.friction.joint == joint);
    own.map(|of| of.friction.offset).collect()
}

/// Mean friction of a joint, Nm (N).
fn friction(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    let own = run.cycle_friction.iter().filter(|of| of.friction.joint == joint);
    mean(&own.map(|of| of.friction.ln_torque).collect::<Vec<f64>>()).map(f64::exp)
}

fn rmsd(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    run.joints.iter().find(|of| of.joint == joint)?.relative_rmsd.filter(|rmsd| *rmsd > 0.0)
}

/// The coefficients of the ten standard parameters of the last link in a base parameter.
fn of_last_link(terms: &[(f64, ParameterId)], last: JointIndex) -> [f64; 10] {
    let mut found = [0.0; 10];
    for (coefficient, id) in terms.iter().filter(|(_, id)| id.joint == last) {
        if let ParameterKind::Inertial(place) = id.kind {
            found[usize::from(place)] += coefficient;
        }
    }
    found
}

/// A joint's torque signal in one run.
#[derive(Debug, Clone, Copy, Default)]
struct Signal {
    /// Offset beyond the usual, Nm (N), and chi² of it where it counts.
    offset: (f64, f64),
    /// Unexplained rest as a multiple of the usual, and chi² of it where it counts.
    unexplained: (f64, f64),
}

fn evidence(
    run: &RunSummary,
    change: Option<&Change>,
    baseline: &Baseline,
    joints: usize,
) -> Option<ArmEvidence> {
    let signals: Vec<Signal> = (0..joints).map(|j| signal(run, baseline, JointIndex::new(j))).collect();
    // an unexplained rest alone has many causes
    if change.is_none() && run.cycle_friction.is_empty() {
        return None;
    }
    let inertial = change.map_or(0.0, |change| change.square);
    let signal_cost = |of: &Signal| of.offset.1 + of.unexplained.1;
    let all_signals: f64 = signals.iter().map(signal_cost).sum();
    let mut causes = vec![(ArmCause::None, inertial + all_signals)];
    if let Some(change) = change.filter(|_| inertial > 0.0)
        && let Some((load, left)) = load(change, baseline)
        && load.mass.abs() >= LEAST_MASS.max(MASS_ERRORS_STILL * load.std_error)
    {
        let rest = (left - PATTERN_ERROR).max(0.0) * inertial;
        causes.push((ArmCause::Load(load), rest + all_signals + 10.0 * PARAMETER_PRICE));
    }
    for joint in (0..joints).map(JointIndex::new) {
        let elsewhere = change.map_or(0.0, |Change { deviations, .. }| {
            let all = baseline.parameters.iter().zip(deviations.iter());
            let far = all.filter(|((id, ..), _)| !is_near(id.joint, joint));
            far.map(|(_, x)| x * x).sum::<f64>() / deviations.norm_squared()
        });
        let own = &signals[joint.index()];
        // a constant torque goes into whatever parameters it fits: it is seen in the friction stage, not in these
        let is_elsewhere = inertial > 0.0 && own.offset.1 == 0.0;
        let rest = if is_elsewhere { (elsewhere - PATTERN_ERROR).max(0.0) * inertial } else { 0.0 };
        let silent = if signal_cost(own) > 0.0 { 0.0 } else { SILENT_SIGNAL_PRICE };
        // a torque that reads wrong spoils the fit of the joint before as well, but less than its own
        let part = |other: usize| match is_near(JointIndex::new(other), joint) {
            true if signals[other].unexplained.0 < signals[joint.index()].unexplained.0 => 0.0,
            _ => 1.0,
        };
        let others = signals.iter().enumerate().filter(|(j, _)| *j != joint.index());
        let others: f64 = others.map(|(j, of)| of.offset.1 + part(j) * of.unexplained.1).sum();
        let fault = fault(&signals[joint.index()], run, baseline, joint);
        // where it is known what a gain does, that is looked for below
        if matches!(fault, SignalFault::Gain(_)) && !baseline.directions.is_empty() {
            continue;
        }
        causes
            .push((ArmCause::TorqueSignal { joint, fault }, rest + others + silent + 4.0 * PARAMETER_PRICE));
    }
    if let Some(change) = change.filter(|_| inertial > 0.0) {
        // of the strengths of a fault the one that explains most
        let mut best: Vec<(&Direction, (ArmCause, f64))> = Vec::new();
        for of in &baseline.directions {
            let Some(found) = channel(of, change, &signals, run, baseline) else { continue };
            let is_same =
                |(known, _): &&mut (&Direction, _)| (known.joint, known.fault) == (of.joint, of.fault);
            match best.iter_mut().find(is_same) {
                Some((_, known)) if known.1 > found.1 => *known = found,
                Some(_) => {}
                None => best.push((of, found)),
            }
        }
        causes.extend(best.into_iter().map(|(_, found)| found));
    }
    causes.push((ArmCause::Unknown, UNKNOWN_PRICE));
    causes.sort_by(|a, b| a.1.total_cmp(&b.1));
    Some(ArmEvidence { causes })
}

/// Square of a change that is small but points where one fault of a channel moves the parameters, in the variance of what
/// that fault leaves; zero for any other. A season moves the parameters more than their errors say, but in no such direction,
/// so the statistic is an F ratio, for which the scale of the errors does not matter.
fn along_one_direction(change: &DVector<f64>, directions: &[Direction]) -> f64 {
    let rest = |of: &Direction| {
        let along = of.change.dot(change);
        change.norm_squared() - along * along / of.change.norm_squared().max(f64::MIN_POSITIVE)
    };
    let Some(least) = directions.iter().map(rest).min_by(f64::total_cmp) else { return 0.0 };
    let variance = (least / (change.len() as f64 - 1.0).max(1.0)).max(1.0);
    let ratio = (change.norm_squared() - least) / variance;
    if ratio >= LEAST_RATIO { change.norm_squared() / variance } else { 0.0 }
}

/// A fault of one channel with the size that explains most of a change of parameters, and its cost.
fn channel(
    direction: &Direction,
    change: &Change,
    signals: &[Signal],
    run: &RunSummary,
    baseline: &Baseline,
) -> Option<(ArmCause, f64)> {
    let Change { deviations, scale, square } = change;
    let along = direction.change.dot(deviations) / direction.change.norm_squared();
    if !along.is_finite() {
        return None;
    }
    let left = (deviations - &direction.change * along).norm_squared() / deviations.norm_squared();
    let rest = (left - DIRECTION_ERROR).max(0.0) * square;
    let size = along / scale;
    let joint = direction.joint;
    let cause = match direction.fault {
        ChannelFault::TorqueGain => ArmCause::TorqueSignal { joint, fault: SignalFault::Gain(size) },
        ChannelFault::TorqueOffset => ArmCause::TorqueSignal { joint, fault: SignalFault::Offset(size) },
        ChannelFault::PositionOffset => ArmCause::PositionSignal { joint, offset: size },
    };
    let mut cost = rest + CHANNEL_PRICE + PARAMETER_PRICE;
    for (other, signal) in signals.iter().enumerate() {
        // gravity in another posture than is believed is an offset of every joint that carries it
        cost += match direction.fault {
            ChannelFault::PositionOffset => 0.0,
            ChannelFault::TorqueOffset if other == joint.index() => 0.0,
            _ => signal.offset.1,
        };
        cost += match (baseline.rmsd[other], rmsd(run, JointIndex::new(other))) {
            (Some(usual), Some(now)) => {
                let expected = usual.value.exp().hypot(size * direction.unexplained[other]);
                Usual { value: expected.ln(), ..usual }.excess_of_rmsd(now).1
            }
            _ => 0.0,
        };
    }
    Some((cause, cost))
}

impl Usual {
    /// Ratio of a relative RMSD to this one, whose logarithm this is, and chi² of it where it counts.
    fn excess_of_rmsd(&self, rmsd: f64) -> (f64, f64) {
        let (ratio, deviations) = ((rmsd.ln() - self.value).exp(), self.deviations(rmsd.ln()));
        let counts = deviations >= SIGNAL_DEVIATIONS && ratio >= LEAST_RMSD_RATIO;
        (ratio, if counts { (deviations * deviations).min(MOST_CHI_SQUARE) } else { 0.0 })
    }
}

/// Whether the parameters of `of` are among those that a wrong torque signal of `joint` changes: its own, and those of
/// the joint before it, whose torque has most of the same columns.
fn is_near(of: JointIndex, joint: JointIndex) -> bool {
    of == joint || of.index() + 1 == joint.index()
}

fn signal(run: &RunSummary, baseline: &Baseline, joint: JointIndex) -> Signal {
    let mut found = Signal::default();
    if let (Some(usual), Some(offset)) = (baseline.offsets[joint.index()], mean(&offsets(run, joint))) {
        let (beyond, deviations) = (offset - usual.value, usual.deviations(offset));
        let enough = beyond.abs() >= LEAST_OFFSET * friction(run, joint).unwrap_or(0.0);
        let counts = deviations.abs() >= SIGNAL_DEVIATIONS && enough;
        found.offset = (beyond, if counts { (deviations * deviations).min(MOST_CHI_SQUARE) } else { 0.0 });
    }
    if let (Some(usual), Some(rmsd)) = (baseline.rmsd[joint.index()], rmsd(run, joint)) {
        found.unexplained = usual.excess_of_rmsd(rmsd);
    }
    found
}

/// What is most likely wrong with the torque signal of a joint.
fn fault(signal: &Signal, run: &RunSummary, baseline: &Baseline, joint: JointIndex) -> SignalFault {
    if signal.offset.1 > 0.0 {
        return SignalFault::Offset(signal.offset.0);
    }
    if signal.unexplained.1 > 0.0 {
        return SignalFault::Unexplained(signal.unexplained.0);
    }
    // least squares of the joint's parameters against their usual values
    let (mut with, mut own) = (0.0, 0.0);
    for (id, usual, _) in baseline.parameters.iter().filter(|(id, ..)| id.joint == joint) {
        if let Some(of) = run.parameters.iter().find(|of| of.id == *id) {
            let weight = usual.deviation.powi(-2);
            with += weight * usual.value * (of.mean - usual.value);
            own += weight * usual.value * usual.value;
        }
    }
    SignalFault::Gain(if own > 0.0 { with / own } else { 0.0 })
}

/// The body at the last link that explains most of a change, and the part of its square that it leaves; generalised least
/// squares with a wide prior.
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
    (mass.is_finite() && mass != 0.0).then_some((Load { mass, std_error, centre }, left))
}
