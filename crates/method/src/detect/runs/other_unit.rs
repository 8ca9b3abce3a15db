//! Another arm or another unit of the model under the name of a robot.
//!
//! Two units differ in friction, noise and unexplained torque of every joint at once. A test is compared with the
//! latest tests of each known unit by the logarithms `x` of these quantities. Their variance is `v`. Two hypotheses are
//! compared, in units of chi²:
//!
//! - The same unit: all joints share a change `c` of each quantity, a joint more or less than another
//!   (`x ~ N(c, v + (0.4 c)²)`). Single joints may have faults, each at a price, which explain all their quantities.
//! - Another unit: `x ~ N(0, v + s²)`, with the differences `s` between units of a model.
//!
//! So faults of one to three joints stay theirs. Tests of another unit are an epoch: they are compared with one
//! another, and their friction index refers to the first of them.

use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, LN_10};

use super::history::friction_history::{COMMON_SPREAD, MIN_SPREAD};
use super::history::like_length::length;
use crate::detect::episodes::episodes;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::{mean, median, robust_deviation};
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

/// Latest tests of a unit that a test is compared with.
const LATEST: usize = 8;
/// Fewest tests of the first unit before another one can be found, since they determine the scatter.
const FEWEST_TESTS: usize = 3;
/// Fewest joints that differ in friction or noise. The faults of fewer joints are their own.
const FEWEST_JOINTS: usize = 4;
/// Least change that counts for this, as a logarithm and in variances. At least half of the joints differ in friction.
const LEAST_CHANGE: f64 = 0.05;
const LEAST_SQUARE: f64 = 16.0;
/// Price of a fault of one joint: prior odds of one in a thousand.
const FAULT_PRICE: f64 = 6.0 * LN_10;
/// Standard deviation of the usual change that all joints share, and the price of any larger one, such as by another
/// lubricant.
const COMMON_CHANGE: f64 = 0.05;
const COMMON_PRICE: f64 = FAULT_PRICE;
/// Least evidence for another unit: its prior odds of one in a thousand, and as much again as a margin.
const LEAST_EVIDENCE: f64 = 2.0 * FAULT_PRICE;

/// Quantities of a joint: friction, noise and unexplained torque.
const QUANTITIES: usize = 3;
/// Standard deviation of their logarithms over the units of a model.
const OF_UNITS: [f64; QUANTITIES] = [0.25, 0.2, 0.3];
/// Least standard deviation of their logarithms from test to test.
const LEAST_SCATTER: [f64; QUANTITIES] = [MIN_SPREAD, 0.05, 0.05];

/// Values of one joint in one test: logarithm and own variance.
type Values = [Option<(f64, f64)>; QUANTITIES];
/// Change of one quantity and its variance.
type Change = (f64, f64);

/// Tests of a robot whose name several units have.
pub(super) struct Separated {
    /// The tests, with an epoch for each unit.
    pub(super) history: Vec<RunSummary>,
    /// The alarms of the arm.
    pub(super) anomalies: Vec<Anomaly>,
    /// Number of tests of the latest test's unit, unless it is the first unit.
    pub(super) tests_of_latest: Option<usize>,
}

/// Separates the tests of several units, oldest first; `None` if all are of one unit.
pub(super) fn separated(history: &[RunSummary], settings: &DetectSettings) -> Option<Separated> {
    let (units, found) = units(history);
    if found.is_empty() {
        return None;
    }
    let verdict = |unit: &usize| match unit.checked_sub(1).and_then(|other| found.get(other)) {
        Some(changes) => out(changes),
        None => Verdict::Quiet,
    };
    let moments: Vec<_> = history.iter().map(|run| (run.run_id, run.started_at)).collect();
    let verdicts = units.iter().map(verdict).collect();
    let anomalies = episodes(&moments, None, AnomalyKind::Step, Quantity::ArmIdentity, verdicts);
    let latest = units.last().copied().unwrap_or(0);
    Some(Separated {
        history: with_epochs(history, &units, settings.baseline_runs.max(1)),
        anomalies,
        tests_of_latest: (latest > 0).then(|| units.iter().filter(|unit| **unit == latest).count()),
    })
}

/// The tests with an epoch for each unit.
pub(super) fn with_units<'h>(history: &'h [RunSummary], settings: &DetectSettings) -> Cow<'h, [RunSummary]> {
    separated(history, settings).map_or(Cow::Borrowed(history), |of| Cow::Owned(of.history))
}

/// The unit of each test, 0 for the first, and for each other unit the changes of friction in its first test.
fn units(history: &[RunSummary]) -> (Vec<usize>, Vec<Vec<f64>>) {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let values: Vec<Vec<Values>> = history.iter().map(|run| values(run, joints)).collect();
    let mut units: Vec<usize> = Vec::with_capacity(history.len());
    let mut found: Vec<Vec<f64>> = Vec::new();
    let mut scatter = LEAST_SCATTER;
    let like = |units: &[usize], at: usize, unit: usize| -> Vec<&[Values]> {
        let is_like = |&of: &usize| units[of] == unit && is_compared(&history[of], &history[at]);
        (0..at).rev().filter(is_like).take(LATEST).map(|of| &values[of][..]).collect()
    };
    for at in 0..history.len() {
        let before = units.last().copied().unwrap_or(0);
        let mut against = |unit: usize| {
            let tests = like(&units, at, unit);
            let enough = if unit == 0 { FEWEST_TESTS } else { 1 };
            (tests.len() >= enough).then(|| changes(&values[at], &tests, &mut scatter))
        };
        let Some(of_before) = against(before).filter(is_other) else {
            units.push(before);
            continue;
        };
        let same = |unit: &usize| *unit != before && against(*unit).is_some_and(|of| !is_other(&of));
        if let Some(unit) = (0..=found.len()).find(same) {
            units.push(unit);
            continue;
        }
        found.push(of_before[0].iter().flatten().map(|(change, _)| change.exp_m1()).collect());
        units.push(found.len());
        // the test before may be the first one of this unit, if it was too uncertain
        let Some(last) = at.checked_sub(1).filter(|last| is_compared(&history[*last], &history[at])) else {
            continue;
        };
        let known = like(&units, last, before);
        let mut distance = |tests: &[&[Values]]| {
            let changes = changes(&values[last], tests, &mut scatter);
            changes
                .iter()
                .flatten()
                .flatten()
                .map(|(change, variance)| change * change / variance)
                .sum::<f64>()
        };
        if known.len() >= FEWEST_TESTS && distance(&[&values[at]]) < distance(&known) {
            units[last] = found.len();
        }
    }
    (units, found)
}

/// Returns true if two tests compare: they have like length, and no maintenance was between them.
fn is_compared(one: &RunSummary, other: &RunSummary) -> bool {
    let (a, b) = (length(one), length(other));
    (a == b || a < 2 * b && b < 2 * a) && one.epochs == other.epochs
}

/// Quantities of the joints in a test. Noise and unexplained torque are in Nm (N).
fn values(run: &RunSummary, joints: usize) -> Vec<Values> {
    let of_joint = |joint: JointIndex| {
        let Some(of) = run.joints.iter().find(|of| of.joint == joint) else { return [None; QUANTITIES] };
        let index = of.friction_index.filter(|of| of.value > 0.0);
        let ln_nm = |relative: Option<f64>| {
            let torque = relative? * of.torque_rms?;
            (torque > 0.0).then(|| (torque.ln(), 0.0))
        };
        let ln_index = |Estimate { value, std_error }| (value.ln(), (std_error / value).powi(2));
        [index.map(ln_index), ln_nm(of.relative_noise), ln_nm(of.relative_rmsd)]
    };
    (0..joints).map(JointIndex::new).map(of_joint).collect()
}

/// Changes of each quantity by joint since `tests`, with their variances. `scatter` has the standard deviations from test
/// to test, which these tests update if there are enough of them.
fn changes(
    run: &[Values],
    tests: &[&[Values]],
    scatter: &mut [f64; QUANTITIES],
) -> [Vec<Option<Change>>; QUANTITIES] {
    std::array::from_fn(|quantity| {
        let of_joint = |joint: usize| tests.iter().filter_map(move |of| of[joint][quantity]);
        // robust: the first test of another unit is not always recognised, and counts among these
        let deviation =
            |joint: usize| robust_deviation(&of_joint(joint).map(|(value, _)| value).collect::<Vec<f64>>());
        let own: Vec<Option<f64>> = (0..run.len()).map(deviation).collect();
        if tests.len() >= FEWEST_TESTS
            && let Some(pooled) = mean(&own.iter().flatten().map(|of| of * of).collect::<Vec<f64>>())
        {
            scatter[quantity] = pooled.sqrt().max(LEAST_SCATTER[quantity]);
        }
        let change = |joint: usize| {
            let (value, own_variance) = run[joint][quantity]?;
            let known: Vec<(f64, f64)> = of_joint(joint).collect();
            let usual = median(&known.iter().map(|(value, _)| *value).collect::<Vec<f64>>())?;
            let variance = scatter[quantity].max(own[joint].unwrap_or(0.0)).powi(2);
            let of_median = FRAC_PI_2 / known.len() as f64;
            Some((value - usual, own_variance + variance * (1.0 + of_median)))
        };
        (0..run.len()).map(change).collect()
    })
}

/// Returns true if a test with these changes is of another unit.
fn is_other(changes: &[Vec<Option<Change>>; QUANTITIES]) -> bool {
    let differs = |change: &Option<Change>| {
        change.is_some_and(|(of, variance)| of.abs() >= LEAST_CHANGE && of * of >= LEAST_SQUARE * variance)
    };
    let [friction, noise, _] = changes;
    let known = friction.iter().flatten().count();
    let differing = friction.iter().zip(noise).filter(|(a, b)| differs(a) || differs(b)).count();
    if differing < FEWEST_JOINTS || 2 * friction.iter().filter(|of| differs(of)).count() < known {
        return false;
    }
    let (mut evidence, mut of_joints) = (0.0, vec![0.0; changes[0].len()]);
    for (quantity, (changes, of_units)) in changes.iter().zip(OF_UNITS).enumerate() {
        let common = common(changes, of_units);
        let cost =
            |of: &Option<Change>| of.map_or(0.0, |of| cost_of_same(of, common) - cost_of_other(of, of_units));
        let own: Vec<f64> = changes.iter().map(cost).collect();
        // units of a model may have the same noise, but not the same friction
        if quantity > 0 && price(common) + evidence_of(&own) < 0.0 {
            continue;
        }
        evidence += price(common);
        of_joints.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
    }
    evidence + evidence_of(&of_joints) >= LEAST_EVIDENCE
}

/// Evidence of joints for another unit. A fault of a joint explains it at its price.
fn evidence_of(joints: &[f64]) -> f64 {
    joints.iter().map(|of| of.min(FAULT_PRICE)).sum()
}

fn cost_of_same((change, variance): Change, common: f64) -> f64 {
    let all = variance + (COMMON_SPREAD * common).powi(2);
    (all / variance).ln() + (change - common).powi(2) / all
}

fn cost_of_other((change, variance): Change, of_units: f64) -> f64 {
    let all = variance + of_units * of_units;
    (all / variance).ln() + change * change / all
}

fn price(common: f64) -> f64 {
    (common / COMMON_CHANGE).powi(2).min(COMMON_PRICE)
}

/// The likeliest change that all joints share, if single joints may have faults: zero, or between the changes of two
/// joints.
fn common(changes: &[Option<Change>], of_units: f64) -> f64 {
    let known: Vec<Change> = changes.iter().copied().flatten().collect();
    let cost = |common: f64| {
        let of_joint =
            |of: &Change| cost_of_same(*of, common).min(FAULT_PRICE + cost_of_other(*of, of_units));
        price(common) + known.iter().map(of_joint).sum::<f64>()
    };
    let between = known.iter().flat_map(|a| known.iter().map(move |b| 0.5 * (a.0 + b.0)));
    let costs = std::iter::once(0.0).chain(between).map(|common| (cost(common), common));
    costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, common)| common)
}

/// The tests with an epoch for each unit. The friction index of another unit is a multiple of the median of its first
/// `baseline_runs` tests.
fn with_epochs(history: &[RunSummary], units: &[usize], baseline_runs: usize) -> Vec<RunSummary> {
    let mut apart = history.to_vec();
    for joint in 0..history.iter().map(|run| run.joints.len()).max().unwrap_or(0) {
        let mut epochs: Vec<((u32, usize), Vec<f64>)> = Vec::new();
        let mut ordinals = Vec::with_capacity(history.len());
        for (run, &unit) in history.iter().zip(units) {
            let key = (run.epoch(JointIndex::new(joint)), unit);
            let ordinal = epochs.iter().position(|(of, _)| *of == key).unwrap_or_else(|| {
                epochs.push((key, Vec::new()));
                epochs.len() - 1
            });
            let index =
                run.joints.iter().find(|of| of.joint.index() == joint).and_then(|of| of.friction_index);
            epochs[ordinal].1.extend(index.map(|of| of.value));
            ordinals.push(ordinal);
        }
        for ((run, ordinal), &unit) in apart.iter_mut().zip(ordinals).zip(units) {
            if run.epochs.len() <= joint {
                run.epochs.resize(joint + 1, 0);
            }
            run.epochs[joint] = u32::try_from(ordinal).unwrap_or(u32::MAX);
            let first = &epochs[ordinal].1[..baseline_runs.min(epochs[ordinal].1.len())];
            let of_joint = run.joints.iter_mut().find(|of| of.joint.index() == joint);
            if unit > 0
                && let Some(index) = of_joint.and_then(|of| of.friction_index.as_mut())
                && let Some(level) = median(first).filter(|level| *level > 0.0)
            {
                *index = Estimate { value: index.value / level, std_error: index.std_error / level };
            }
        }
    }
    apart
}

/// The verdict about a test of another unit, whose first test had these changes of friction.
fn out(changes: &[f64]) -> Verdict {
    let least = changes.iter().copied().fold(f64::INFINITY, f64::min);
    let most = changes.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Verdict::Out {
        severity: Severity::Warning,
        score: 1.0,
        threshold: 1.0,
        value: f64::NAN,
        baseline: f64::NAN,
        message: format!(
            "friction of the joints changed by {:+.0} to {:+.0} % between two tests; another arm or another unit under \
             this name is likelier than faults of so many joints at once; check the name of the export, and record an \
             exchange of the arm or its gears as maintenance; tests of the other unit are compared with one another \
             only",
            100.0 * least,
            100.0 * most
        ),
        why: Why::default(),
    }
}

#[cfg(test)]
mod tests;
