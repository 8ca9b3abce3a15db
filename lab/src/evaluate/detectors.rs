//! The evaluated detectors: those of the program, and simple ones for comparison.

use super::event::BASELINE_RUNS;
use armwatch_method::detect::runs::detect;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{AnomalyKind, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

/// Quiet runs that end an alarm of a simple detector, as for the program's own.
const QUIET_RUNS: usize = 2;
/// First runs that give the three-sigma rule and CUSUM their mean and standard deviation.
const REFERENCE_RUNS: usize = 4 * BASELINE_RUNS;
/// Allowance and limit of CUSUM, in standard deviations (Montgomery 2009, 9.1).
const CUSUM_ALLOWANCE: f64 = 0.5;
const CUSUM_LIMIT: f64 = 5.0;

armwatch_model::named_enum! {
    /// A detector on histories.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum HistoryDetector {
        /// [`detect`] with the shipped settings.
        Armwatch = "armwatch",
        /// An alarm of every joint in every run.
        Always = "always",
        /// No alarm.
        Never = "never",
        /// The friction index is three standard deviations away from its mean over the first twenty runs.
        ThreeSigma = "three-sigma",
        /// Tabular CUSUM of the friction index, allowance 0.5 and limit 5 standard deviations of the first twenty runs.
        Cusum = "cusum",
    }
}

/// An anomaly that was a warning or critical in one run at least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LabAlarm {
    /// Its kind.
    pub kind: AnomalyKind,
    /// The joint that it names; `None` for the whole arm.
    pub joint: Option<JointIndex>,
    /// Index of the first run that showed it.
    pub first: usize,
    /// Index of the latest run that showed it.
    pub last: usize,
    /// Its severity.
    pub severity: Severity,
    /// Odds of its cause; 0 if causes were not compared.
    pub odds: f64,
    /// Start of the change according to the alarm: index of the run, and cycle, from 1.
    pub onset: (usize, Option<u32>),
    /// Its value; NaN for the simple detectors.
    pub value: f64,
}

impl LabAlarm {
    /// An alarm of a simple detector, which reports only that there is a change.
    fn simple(joint: JointIndex, first: usize) -> Self {
        Self {
            kind: AnomalyKind::Drift,
            joint: Some(joint),
            first,
            last: first,
            severity: Severity::Warning,
            odds: 0.0,
            onset: (first, None),
            value: f64::NAN,
        }
    }
}

impl HistoryDetector {
    /// Its alarms over a history.
    pub(super) fn alarms(self, history: &[RunSummary]) -> Vec<LabAlarm> {
        match self {
            Self::Armwatch => of_program(history),
            Self::Always => always(history),
            Self::Never => Vec::new(),
            Self::ThreeSigma => by_joint(history, three_sigma),
            Self::Cusum => by_joint(history, cusum),
        }
    }
}

fn of_program(history: &[RunSummary]) -> Vec<LabAlarm> {
    let place = |run_id: i64| history.iter().position(|run| run.run_id == run_id).unwrap_or(0);
    detect(history, &DetectSettings::default())
        .anomalies
        .iter()
        .filter(|anomaly| anomaly.peak_severity >= Severity::Warning)
        .map(|anomaly| LabAlarm {
            kind: anomaly.kind,
            joint: anomaly.joint,
            first: place(anomaly.first_run_id),
            last: place(anomaly.last_run_id),
            severity: anomaly.peak_severity,
            odds: anomaly.odds.unwrap_or(0.0),
            onset: (place(anomaly.onset.run_id), anomaly.onset.cycle),
            value: anomaly.value,
        })
        .collect()
}

/// A separate alarm for each run and joint.
fn always(history: &[RunSummary]) -> Vec<LabAlarm> {
    let all = history
        .iter()
        .enumerate()
        .flat_map(|(place, run)| run.joints.iter().map(move |of| (place, of.joint)));
    all.map(|(place, joint)| LabAlarm::simple(joint, place)).collect()
}

/// Alarms of a rule on the friction index of each joint. Each epoch of a joint starts again.
fn by_joint(history: &[RunSummary], rule: impl Fn(&[f64]) -> Vec<bool>) -> Vec<LabAlarm> {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let mut found = Vec::new();
    for joint in 0..joints {
        let epoch = |run: &RunSummary| run.epochs.get(joint).copied().unwrap_or(0);
        let epochs = history.iter().map(epoch).max().unwrap_or(0);
        for of in 0..=epochs {
            let runs: Vec<(usize, f64)> = history
                .iter()
                .enumerate()
                .filter(|(_, run)| epoch(run) == of)
                .filter_map(|(place, run)| Some((place, run.joints.get(joint)?.friction_index?.value)))
                .collect();
            let indices: Vec<f64> = runs.iter().map(|(_, index)| *index).collect();
            let out = rule(&indices);
            found.extend(episodes(&runs, &out, JointIndex::new(joint)));
        }
    }
    found
}

fn episodes(runs: &[(usize, f64)], out: &[bool], joint: JointIndex) -> Vec<LabAlarm> {
    let mut found: Vec<LabAlarm> = Vec::new();
    let mut quiet = QUIET_RUNS;
    for (&(place, _), &out) in runs.iter().zip(out) {
        if !out {
            quiet += 1;
            continue;
        }
        match found.last_mut().filter(|_| quiet < QUIET_RUNS) {
            Some(open) => open.last = place,
            None => found.push(LabAlarm::simple(joint, place)),
        }
        quiet = 0;
    }
    found
}

/// Deviations from the mean of the first runs, in units of their standard deviation; zero for these runs themselves.
fn standardised(indices: &[f64]) -> Vec<f64> {
    let first = &indices[..REFERENCE_RUNS.min(indices.len())];
    let count = first.len() as f64;
    let mean = first.iter().sum::<f64>() / count;
    let variance = first.iter().map(|of| (of - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let deviation = variance.sqrt().max(f64::MIN_POSITIVE);
    let of = |(place, index): (usize, &f64)| {
        if place < REFERENCE_RUNS { 0.0 } else { (index - mean) / deviation }
    };
    indices.iter().enumerate().map(of).collect()
}

fn three_sigma(indices: &[f64]) -> Vec<bool> {
    standardised(indices).iter().map(|of| of.abs() > 3.0).collect()
}

fn cusum(indices: &[f64]) -> Vec<bool> {
    let (mut above, mut below) = (0.0_f64, 0.0_f64);
    standardised(indices)
        .iter()
        .map(|of| {
            above = (above + of - CUSUM_ALLOWANCE).max(0.0);
            below = (below - of - CUSUM_ALLOWANCE).max(0.0);
            above > CUSUM_LIMIT || below > CUSUM_LIMIT
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cusum_and_three_sigma_find_what_they_are_known_to_find() {
        // deviations of -1 and 1 standard deviations, then a shift of two
        let usual = |i: usize| if i.is_multiple_of(2) { 0.99 } else { 1.01 };
        let mut indices: Vec<f64> = (0..40).map(usual).collect();
        assert!(!cusum(&indices).contains(&true) && !three_sigma(&indices).contains(&true));
        indices.extend((40..60).map(|i| usual(i) + 0.02));
        // 5 / (2 - 0.5) runs, and one or two for the oscillation
        let first = cusum(&indices).iter().position(|out| *out);
        assert!(matches!(first, Some(42..=45)), "{first:?}");
        indices.push(1.05);
        assert_eq!(three_sigma(&indices).last(), Some(&true));
    }

    #[test]
    fn two_quiet_runs_end_an_alarm() {
        let runs: Vec<(usize, f64)> = (0..8).map(|place| (place, 1.0)).collect();
        let out = [true, false, true, false, false, true, false, false];
        let found = episodes(&runs, &out, JointIndex::new(0));
        let spans: Vec<(usize, usize)> = found.iter().map(|alarm| (alarm.first, alarm.last)).collect();
        assert_eq!(spans, [(0, 2), (5, 5)]);
    }
}
