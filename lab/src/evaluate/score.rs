//! Quality of alarms: false ones per robot-year, detection, delay, joint and cause.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::detectors::LabAlarm;
use super::event::{Event, named_joint};
use super::history::History;
use super::scenario::Scenario;
use armwatch_method::statistics::descriptive::median;
use armwatch_method::statistics::distributions::{chi_square_tail, normal_quantile};
use armwatch_model::anomaly::AnomalyKind;

/// Accepted error of a mass, as a fraction.
const MASS_ERROR: f64 = 0.15;
/// Share of the robots of [`ScenarioScore::most_delay_runs`].
const MOST: f64 = 0.95;

/// Outcome of one robot with one detector.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotOutcome {
    /// Its scenario.
    pub scenario: Scenario,
    /// Years of its history.
    pub years: f64,
    /// Kinds of its false alarms: all of a robot without an event, otherwise those before the event.
    pub false_alarms: Vec<AnomalyKind>,
    /// The first alarm since the event, if there was an event and an alarm.
    pub found: Option<FirstAlarm>,
    /// Kinds of further alarms since the event, of other joints or kinds than the right one.
    pub further: Vec<AnomalyKind>,
    /// Alarms of the right joint and kind since the event, except the first.
    pub repeated: usize,
    /// Size of the event, in the unit of [`Scenario::size`].
    pub size: f64,
}

/// The first alarm since an event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstAlarm {
    /// Tests from the first with the event until the alarm; 0 is the same test.
    pub delay_runs: usize,
    /// Days between these tests.
    pub delay_days: f64,
    /// Its kind, by the whole history.
    pub kind: AnomalyKind,
    /// Its kind when first reported, by the tests until then.
    pub first_kind: Option<AnomalyKind>,
    /// True if it names the right joint, or the whole arm if that is right.
    pub is_right_joint: bool,
    /// True if its value is right: the mass of a load to 15 %, the onset of a step to one cycle, the cycle of a
    /// contact. `None` for alarms of another kind and events without such a value.
    pub is_right_figure: Option<bool>,
}

/// The true event of a robot, and the times of its tests.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Its scenario.
    pub scenario: Scenario,
    /// Index of the joint, if the event concerns one.
    pub joint: usize,
    /// Index of the first test with the event.
    pub onset: usize,
    /// First cycle of that test with the event, from 0.
    pub cycle: usize,
    /// Size, in the unit of [`Scenario::size`].
    pub size: f64,
    /// Starts of its tests.
    pub starts: Vec<Timestamp>,
    /// Years of its history.
    pub years: f64,
}

impl From<&History> for Truth {
    fn from(history: &History) -> Self {
        let Event { scenario, joint, onset, cycle, size, .. } = history.event;
        let starts = history.runs.iter().map(|run| run.started_at).collect();
        Self { scenario, joint, onset, cycle, size, starts, years: history.years }
    }
}

/// Evaluates the alarms of a history. `first_said` gives the alarms of the tests up to an index.
pub fn outcome(
    truth: &Truth,
    alarms: &[LabAlarm],
    first_said: impl Fn(usize) -> Vec<LabAlarm>,
) -> RobotOutcome {
    let mut found = RobotOutcome {
        scenario: truth.scenario,
        years: truth.years,
        false_alarms: Vec::new(),
        found: None,
        further: Vec::new(),
        repeated: 0,
        size: truth.size,
    };
    let Some(kind) = truth.scenario.kind() else {
        found.false_alarms = alarms.iter().map(|alarm| alarm.kind).collect();
        return found;
    };
    let joint = named_joint(truth.scenario, truth.joint);
    let before = alarms.iter().filter(|alarm| alarm.first < truth.onset);
    found.false_alarms = before.map(|alarm| alarm.kind).collect();
    let since: Vec<&LabAlarm> = alarms.iter().filter(|alarm| alarm.first >= truth.onset).collect();
    let is_right = |alarm: &LabAlarm| alarm.kind == kind && alarm.joint == joint;
    found.repeated = since.iter().filter(|alarm| is_right(alarm)).count().saturating_sub(1);
    found.further = since.iter().filter(|alarm| !is_right(alarm)).map(|alarm| alarm.kind).collect();
    let Some(first) = foremost(since.iter().copied()) else { return found };
    let said = first_said(first.first);
    let said = foremost(said.iter().filter(|alarm| alarm.first >= truth.onset && alarm.last == first.first));
    let start = |place: usize| truth.starts[place];
    found.found = Some(FirstAlarm {
        delay_runs: first.first - truth.onset,
        delay_days: start(first.first).duration_since(start(truth.onset)).as_secs_f64() / 86_400.0,
        kind: first.kind,
        first_kind: said.map(|alarm| alarm.kind),
        is_right_joint: first.joint == joint,
        is_right_figure: is_right_figure(truth, first),
    });
    found
}

/// See [`FirstAlarm::is_right_figure`].
fn is_right_figure(truth: &Truth, alarm: &LabAlarm) -> Option<bool> {
    if Some(alarm.kind) != truth.scenario.kind() {
        return None;
    }
    match truth.scenario {
        Scenario::Payload => Some((alarm.value - truth.size).abs() <= MASS_ERROR * truth.size.abs()),
        Scenario::StepInside | Scenario::StepInBaseline => {
            let (run, cycle) = alarm.onset;
            let cycle = cycle.map_or(0, |cycle| cycle.saturating_sub(1)) as usize;
            Some(run == truth.onset && cycle.abs_diff(truth.cycle) <= 1)
        }
        Scenario::Contact => {
            let (run, cycle) = alarm.onset;
            Some(run == truth.onset && cycle.is_some_and(|cycle| cycle as usize == truth.cycle + 1))
        }
        _ => None,
    }
}

/// The alarm that a person would read first: of the earliest test, then the most severe, then the one with the best
/// odds.
fn foremost<'a>(alarms: impl Iterator<Item = &'a LabAlarm>) -> Option<&'a LabAlarm> {
    alarms.min_by(|a, b| {
        a.first.cmp(&b.first).then(b.severity.cmp(&a.severity)).then(b.odds.total_cmp(&a.odds))
    })
}

/// Results of one scenario with one detector.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioScore {
    /// The scenario.
    pub scenario: Scenario,
    /// Robots.
    pub robots: usize,
    /// Robot-years.
    pub years: f64,
    /// False alarms: all of robots without an event; otherwise those before the event. [`Self::years`] is too long for
    /// the latter.
    pub false_alarms: usize,
    /// Kinds of these.
    pub false_kinds: BTreeMap<&'static str, usize>,
    /// Robots with an alarm since the event.
    pub detected: usize,
    /// Number of these with the right joint. Similarly: the right kind in the end, the right kind when first reported.
    pub right_joint: usize,
    /// See [`Self::right_joint`].
    pub right_kind: usize,
    /// See [`Self::right_joint`].
    pub right_first_kind: usize,
    /// Robots whose first alarm has a value to check, see [`FirstAlarm::is_right_figure`]: right ones and all.
    pub right_figure: (usize, usize),
    /// Delay in tests within which 95 % of all robots have an alarm; infinite if fewer ever have one.
    pub most_delay_runs: f64,
    /// Median delay, tests and days; NaN without a detection.
    pub delay_runs: f64,
    /// See [`Self::delay_runs`].
    pub delay_days: f64,
    /// Alarms since the event in addition to the right one, by kind.
    pub further_kinds: BTreeMap<&'static str, usize>,
    /// Right alarms since the event except the first of each robot: the fault had seemed to end in between.
    pub repeated: usize,
    /// Robots by the kind of the first alarm, `missed` if there was none.
    pub said: BTreeMap<&'static str, usize>,
    /// Detection over size.
    pub by_size: Vec<SizeBin>,
}

/// Events of similar size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeBin {
    /// Geometric mean of their magnitudes.
    pub size: f64,
    /// Robots, and those with an alarm since the event.
    pub robots: usize,
    /// See [`Self::robots`].
    pub detected: usize,
    /// Median delay in tests; NaN without a detection.
    pub delay_runs: f64,
}

/// Number of size ranges.
const SIZE_BINS: usize = 6;

impl ScenarioScore {
    /// Computes the score from the outcomes of one scenario.
    pub fn of(scenario: Scenario, outcomes: &[&RobotOutcome]) -> Self {
        let found: Vec<&FirstAlarm> = outcomes.iter().filter_map(|of| of.found.as_ref()).collect();
        let count = |of: &dyn Fn(&FirstAlarm) -> bool| found.iter().filter(|found| of(found)).count();
        let delays = |of: fn(&FirstAlarm) -> f64| {
            median(&found.iter().map(|found| of(found)).collect::<Vec<f64>>()).unwrap_or(f64::NAN)
        };
        let by_kind = |of: fn(&RobotOutcome) -> &[AnomalyKind]| {
            let mut counts = BTreeMap::new();
            for kind in outcomes.iter().flat_map(|outcome| of(outcome)) {
                *counts.entry(kind.name()).or_default() += 1;
            }
            counts
        };
        let mut said = BTreeMap::new();
        if scenario.kind().is_some() {
            for of in outcomes {
                *said.entry(of.found.map_or("missed", |found| found.kind.name())).or_default() += 1;
            }
        }
        let robots = outcomes.len();
        Self {
            scenario,
            robots,
            years: outcomes.iter().map(|of| of.years).sum(),
            false_alarms: outcomes.iter().map(|of| of.false_alarms.len()).sum(),
            false_kinds: by_kind(|of| &of.false_alarms),
            detected: found.len(),
            right_joint: count(&|found| found.is_right_joint),
            right_kind: count(&|found| Some(found.kind) == scenario.kind()),
            right_first_kind: count(&|found| found.first_kind == scenario.kind()),
            right_figure: (
                count(&|found| found.is_right_figure == Some(true)),
                count(&|found| found.is_right_figure.is_some()),
            ),
            most_delay_runs: most_delay(outcomes),
            delay_runs: delays(|found| found.delay_runs as f64),
            delay_days: delays(|found| found.delay_days),
            further_kinds: by_kind(|of| &of.further),
            repeated: outcomes.iter().map(|of| of.repeated).sum(),
            said,
            by_size: if scenario.kind().is_some() { by_size(scenario, outcomes) } else { Vec::new() },
        }
    }

    /// Alarms per robot since the event, in addition to the right one.
    pub fn further_a_robot(&self) -> f64 {
        self.further_kinds.values().sum::<usize>() as f64 / self.robots.max(1) as f64
    }

    /// Right alarms per robot since the event, except the first.
    pub fn repeated_a_robot(&self) -> f64 {
        self.repeated as f64 / self.robots.max(1) as f64
    }

    /// False alarms per robot-year with their 95 % interval.
    pub fn rate(&self) -> (f64, [f64; 2]) {
        rate(self.false_alarms, self.years)
    }
}

fn most_delay(outcomes: &[&RobotOutcome]) -> f64 {
    let delay = |of: &&RobotOutcome| of.found.map_or(f64::INFINITY, |found| found.delay_runs as f64);
    let mut delays: Vec<f64> = outcomes.iter().map(delay).collect();
    delays.sort_by(f64::total_cmp);
    let place = (MOST * delays.len() as f64).ceil() as usize;
    delays.get(place.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

fn by_size(scenario: Scenario, outcomes: &[&RobotOutcome]) -> Vec<SizeBin> {
    let magnitude = |of: &RobotOutcome| match scenario {
        // a factor: as far from one as its inverse
        Scenario::WarmUp | Scenario::Lubricant => of.size.ln().abs().exp(),
        _ => of.size.abs(),
    };
    let mut sorted: Vec<&RobotOutcome> = outcomes.to_vec();
    sorted.sort_by(|a, b| magnitude(a).total_cmp(&magnitude(b)));
    sorted
        .chunks(sorted.len().div_ceil(SIZE_BINS).max(1))
        .map(|bin| {
            let logs: f64 = bin.iter().map(|of| magnitude(of).ln()).sum();
            let delays: Vec<f64> = bin.iter().filter_map(|of| Some(of.found?.delay_runs as f64)).collect();
            SizeBin {
                size: (logs / bin.len() as f64).exp(),
                robots: bin.len(),
                detected: delays.len(),
                delay_runs: median(&delays).unwrap_or(f64::NAN),
            }
        })
        .collect()
}

/// Events per year, with the exact 95 % interval of a Poisson count (Garwood 1936).
pub fn rate(events: usize, years: f64) -> (f64, [f64; 2]) {
    let count = events as f64;
    // the tail of chi-square with 2 k degrees of freedom at 2 m is the probability of fewer than k events of mean m
    let mean_with = |freedom: f64, tail: f64| {
        let (mut low, mut high) = (0.0, 2.0 * (count + 10.0 * (count + 1.0).sqrt() + 10.0));
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if chi_square_tail(middle, freedom) > tail { low = middle } else { high = middle }
        }
        0.25 * (low + high)
    };
    let low = if events == 0 { 0.0 } else { mean_with(2.0 * count, 0.975) };
    let high = mean_with(2.0 * (count + 1.0), 0.025);
    (count / years, [low / years, high / years])
}

/// 95 % interval of a probability that `of` in `all` estimates (Wilson 1927).
pub fn share_95(of: usize, all: usize) -> [f64; 2] {
    let (n, z) = (all.max(1) as f64, normal_quantile(0.975));
    let share = of as f64 / n;
    let middle = share + z * z / (2.0 * n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    [-1.0, 1.0].map(|sign| ((middle + sign * half) / (1.0 + z * z / n)).clamp(0.0, 1.0))
}

/// Mean, over the kinds that occurred, of F1 of the final kind of the first alarm since the event. A missed event, or
/// one with an alarm of another kind, counts against its own kind; an alarm of a robot without an event counts against
/// the kind of its first alarm. NaN without events.
pub fn macro_f1(outcomes: &[&RobotOutcome]) -> f64 {
    let mut scores = Vec::new();
    for kind in AnomalyKind::ALL {
        let truth = |of: &RobotOutcome| of.scenario.kind() == Some(kind);
        let said = |of: &RobotOutcome| match of.scenario.kind() {
            Some(_) => of.found.map(|found| found.kind) == Some(kind),
            None => of.false_alarms.first() == Some(&kind),
        };
        let happened = outcomes.iter().filter(|of| truth(of)).count();
        if happened == 0 {
            continue;
        }
        let named = outcomes.iter().filter(|of| said(of)).count();
        let right = outcomes.iter().filter(|of| truth(of) && said(of)).count();
        scores.push(2.0 * right as f64 / (happened + named) as f64);
    }
    if scores.is_empty() { f64::NAN } else { scores.iter().sum::<f64>() / scores.len() as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_of_a_rate_is_that_of_the_tables() {
        // exact limits of a Poisson mean: 0 events 0 to 3.689, 10 events 4.795 to 18.39
        let (rate_of_none, [low, high]) = rate(0, 1.0);
        assert!(rate_of_none == 0.0 && low == 0.0 && (high - 3.6889).abs() < 1e-3, "{high}");
        let (_, [low, high]) = rate(10, 2.0);
        assert!((low - 4.7954 / 2.0).abs() < 1e-3 && (high - 18.3904 / 2.0).abs() < 1e-3, "{low} {high}");
    }

    #[test]
    fn the_interval_of_a_probability_is_wilsons() {
        // 8 of 10: 0.490 to 0.943
        let [low, high] = share_95(8, 10);
        assert!((low - 0.4902).abs() < 1e-3 && (high - 0.9433).abs() < 1e-3, "{low} {high}");
        assert!(share_95(0, 10)[0].abs() < 1e-12 && share_95(10, 10)[1] > 0.999);
    }

    #[test]
    fn the_delay_of_most_counts_missed_robots() {
        let found = |delay_runs| {
            let mut of = robot(Scenario::Wear, Some(AnomalyKind::Drift));
            of.found.iter_mut().for_each(|found| found.delay_runs = delay_runs);
            of
        };
        let mut all: Vec<RobotOutcome> = (0..20).map(found).collect();
        let delay = |all: &[RobotOutcome]| most_delay(&all.iter().collect::<Vec<_>>());
        assert!((delay(&all) - 18.0).abs() < 1e-12);
        all[0] = robot(Scenario::Wear, None);
        assert!((delay(&all) - 19.0).abs() < 1e-12);
        all[1] = robot(Scenario::Wear, None);
        assert_eq!(delay(&all), f64::INFINITY);
    }

    fn robot(scenario: Scenario, said: Option<AnomalyKind>) -> RobotOutcome {
        let found = said.map(|kind| FirstAlarm {
            delay_runs: 1,
            delay_days: 2.0,
            kind,
            first_kind: Some(kind),
            is_right_joint: true,
            is_right_figure: None,
        });
        let found = found.filter(|_| scenario.kind().is_some());
        let false_alarms = if scenario.kind().is_none() { said.into_iter().collect() } else { Vec::new() };
        RobotOutcome {
            scenario,
            years: 1.0,
            false_alarms,
            found,
            further: Vec::new(),
            repeated: 0,
            size: 0.1,
        }
    }

    #[test]
    fn missed_and_wrong_kinds_and_false_alarms_lower_f1() {
        let all = [
            robot(Scenario::Wear, Some(AnomalyKind::Drift)),
            robot(Scenario::Wear, None),
            robot(Scenario::Jitter, Some(AnomalyKind::Oscillation)),
            robot(Scenario::Jitter, Some(AnomalyKind::Drift)),
            robot(Scenario::Healthy, Some(AnomalyKind::Drift)),
        ];
        // drift: 1 of 2 that occurred, 3 named: 2/5; oscillation: 1 of 2, 1 named: 2/3
        let f1 = macro_f1(&all.iter().collect::<Vec<&RobotOutcome>>());
        assert!((f1 - 0.5 * (2.0 / 5.0 + 2.0 / 3.0)).abs() < 1e-12, "{f1}");
    }
}
