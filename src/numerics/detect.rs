//! Detectors: anomalies from a robot's stored history.
//!
//! Pure functions over the summaries of all complete runs, oldest first. The whole history is
//! judged anew each time, so a run that arrives late falls into its place, and the same history
//! always gives the same anomalies. Every joint is compared with its own baseline: two arms of one
//! model differ by half in friction when both are healthy.

use jiff::Timestamp;

use super::detect_results::{expected_by, health, without_result};
use super::statistics::{median, robust_deviation};
use crate::analysis::{Estimate, JointSummary, WarmFriction};
use crate::anomaly::{Anomaly, AnomalyKind, Findings, RunSummary, Severity};
use crate::robot::JointIndex;

/// When a change counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectSettings {
    /// Runs that form a joint's baseline; below this many the joint is learning.
    pub baseline_runs: usize,
    /// Relative change of friction that is a warning.
    pub drift_warning: f64,
    /// Relative change of friction that is critical.
    pub drift_critical: f64,
    /// Change of friction, in standard deviations of its smoothed value, that could be chance.
    pub drift_sigma: f64,
    /// Ratio of the RMSD's swing to its baseline that is an oscillation.
    pub oscillation_ratio: f64,
    /// Relative RMSD that is a warning.
    pub accuracy_warning: f64,
    /// Relative RMSD that is critical.
    pub accuracy_critical: f64,
    /// Usual intervals between tests after which the next one is overdue.
    pub overdue_factor: f64,
}

impl Default for DetectSettings {
    fn default() -> Self {
        Self {
            baseline_runs: 5,
            drift_warning: 0.05,
            drift_critical: 0.15,
            drift_sigma: 4.0,
            oscillation_ratio: 3.0,
            accuracy_warning: 0.10,
            accuracy_critical: 0.15,
            overdue_factor: 4.0,
        }
    }
}

/// Weight of the newest run in the smoothed friction index (EWMA, Roberts 1959): three runs in a
/// row carry four fifths of the weight, one odd run does not decide.
pub(super) const EWMA_WEIGHT: f64 = 0.4;

/// Smallest run-to-run standard deviation that a baseline of a few runs is believed to have, as a
/// fraction of friction: hall temperature alone moves warm friction by about this.
const MIN_SPREAD: f64 = 0.01;

/// The same for the friction index, which knows of the hall.
const MIN_INDEX_SPREAD: f64 = 0.005;

/// Runs compare if they were about equally warm: time of the warm points within this fraction of
/// the baseline's.
const WARMTH_TOLERANCE: f64 = 0.25;

/// Swings of the relative RMSD below this are noise of a good fit, whatever their ratio: healthy
/// joints show 0.0012 to 0.003 (thesis 5.1.4).
const MIN_SWING: f64 = 0.004;

/// A relative RMSD beyond its limit that is within this factor of the joint's own baseline is how
/// the joint has always been: worth knowing, not worth a call.
const ACCURACY_AS_EVER: f64 = 1.3;

/// Runs without a sign that end an episode.
const QUIET_RUNS: usize = 2;

/// Looks at the complete runs of one robot, oldest first.
#[must_use]
pub fn detect(history: &[RunSummary], settings: &DetectSettings) -> Findings {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let mut findings = Findings::default();
    let moments: Vec<(i64, Timestamp)> = history.iter().map(|run| (run.run_id, run.started_at)).collect();
    for joint in (0..joints).map(JointIndex::new) {
        let series: Vec<Option<&JointSummary>> =
            history.iter().map(|run| run.joints.iter().find(|summary| summary.joint == joint)).collect();
        let drift = drift(&series, settings);
        findings.health.push(health(history, &series, joint, &drift, settings));
        for (kind, quantity, verdicts) in [
            (AnomalyKind::Drift, drift.quantity, drift.verdicts),
            (AnomalyKind::Oscillation, "moving_relative_rmsd", oscillation(&series, settings)),
            (AnomalyKind::Accuracy, "moving_relative_rmsd", accuracy(&series, settings)),
        ] {
            findings.anomalies.extend(episodes(&moments, joint, kind, quantity, &verdicts));
        }
    }
    findings.anomalies.extend(without_result(history));
    findings.expected_by = expected_by(history, settings.overdue_factor);
    findings
}

/// What one run says of one quantity.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// Not measured, or not comparable.
    Unknown,
    /// As expected.
    Quiet,
    /// Out of bounds.
    Out { severity: Severity, score: f64, threshold: f64, value: f64, baseline: f64, message: String },
}

/// Friction of one joint over the runs.
pub(super) struct Drift {
    pub(super) quantity: &'static str,
    pub(super) verdicts: Vec<Verdict>,
    /// The latest run with friction that compares with the baseline.
    pub(super) latest: Option<Compared>,
    pub(super) learning: bool,
    /// Runs that the baseline has so far, at most those that it needs.
    pub(super) learnt_runs: usize,
}

/// Friction of a run against the baseline, and how far from it chance may take one run.
#[derive(Debug, Clone, Copy)]
pub(super) struct Compared {
    pub(super) observed: Observed,
    /// Deviation of one healthy run that would be more than chance; infinite within the baseline.
    pub(super) bound: f64,
}

/// Friction of a run against the baseline, and by which road.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observed {
    /// Place of the run in the history.
    pub(super) run: usize,
    pub(super) ratio: f64,
    /// Zero where not known.
    std_error: f64,
    /// Warm friction that it comes from, Nm; `None` for the index.
    torque: Option<f64>,
}

impl Observed {
    /// The quantity that it is.
    pub(super) fn quantity(self) -> &'static str {
        if self.torque.is_some() { "warm_friction_nm" } else { "friction_index" }
    }
}

/// Friction against the joint's baseline, smoothed over runs: the friction index where the history has one,
/// else warm friction of runs that were equally warm.
pub(super) fn drift(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Drift {
    let index = |run: usize| series[run].and_then(|summary| summary.friction_index);
    let warm = WarmBaseline::find(series, settings);
    let has_index = (0..series.len()).any(|run| index(run).is_some());
    let mut result = Drift {
        quantity: if has_index { "friction_index" } else { "warm_friction_nm" },
        verdicts: vec![Verdict::Unknown; series.len()],
        latest: None,
        learning: !has_index && warm.is_none(),
        learnt_runs: WarmBaseline::learnt_runs(series, settings),
    };
    let observed: Vec<Observed> = (0..series.len())
        .filter_map(|run| match index(run) {
            Some(Estimate { value, std_error }) => {
                Some(Observed { run, ratio: value, std_error: std_error.max(0.0), torque: None })
            }
            None => warm.as_ref()?.observed(series, run),
        })
        .collect();
    // warm friction keeps the place that a run has among all with it, also of runs that were not equally warm
    let learnt_from = if has_index {
        observed.get(settings.baseline_runs.max(1) - 1).map_or(usize::MAX, |last| last.run)
    } else {
        warm.as_ref().map_or(usize::MAX, |warm| warm.last_run)
    };
    let (spread, baseline_variance) = match (&warm, has_index) {
        (_, true) => index_spread(&observed, learnt_from),
        (Some(warm), false) => warm.spread(),
        (None, false) => return result,
    };
    let usual = EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * spread * spread;
    let (mut smoothed, mut variance) = (1.0, usual);
    for of_run in observed {
        if of_run.run <= learnt_from {
            result.latest = Some(Compared { observed: of_run, bound: f64::INFINITY });
            result.verdicts[of_run.run] = Verdict::Quiet;
            continue;
        }
        // what is less certain than usual has less of a say
        let own = (spread * spread).max(of_run.std_error * of_run.std_error);
        let bound = settings.drift_warning.max(settings.drift_sigma * (own + baseline_variance).sqrt());
        result.latest = Some(Compared { observed: of_run, bound });
        let weight = EWMA_WEIGHT * spread * spread / own;
        smoothed = weight * of_run.ratio + (1.0 - weight) * smoothed;
        variance = weight * weight * own + (1.0 - weight) * (1.0 - weight) * variance;
        let deviation = (variance.max(usual) + baseline_variance).sqrt();
        let threshold = settings.drift_warning.max(settings.drift_sigma * deviation);
        let change: f64 = smoothed - 1.0;
        result.verdicts[of_run.run] = if change.abs() < threshold {
            Verdict::Quiet
        } else {
            let critical = change.abs() >= settings.drift_critical.max(threshold);
            let baseline = warm.as_ref().filter(|_| !has_index).map_or(1.0, |warm| warm.torque);
            Verdict::Out {
                severity: if critical { Severity::Critical } else { Severity::Warning },
                score: change.abs(),
                threshold,
                value: of_run.torque.filter(|_| !has_index).unwrap_or(of_run.ratio),
                baseline,
                message: drift_message(change, threshold, of_run, warm.as_ref()),
            }
        };
    }
    result
}

/// Run-to-run standard deviation of the index in the joint's baseline, and the variance of the baseline, which
/// an index's own error has in it already.
fn index_spread(observed: &[Observed], last_run: usize) -> (f64, f64) {
    let first: Vec<f64> = observed.iter().filter(|o| o.run <= last_run).map(|o| o.ratio).collect();
    let errors: Vec<f64> = observed.iter().filter(|o| o.run <= last_run).map(|o| o.std_error).collect();
    let spread =
        robust_deviation(&first).unwrap_or(0.0).max(median(&errors).unwrap_or(0.0)).max(MIN_INDEX_SPREAD);
    (spread, spread * spread / first.len().max(1) as f64)
}

/// Warm friction of the joint's first runs.
#[derive(Debug)]
struct WarmBaseline {
    torque: f64,
    minute: f64,
    speed_fraction: f64,
    /// Torques that it is the median of, and the last run of these.
    torques: Vec<f64>,
    last_run: usize,
}

impl WarmBaseline {
    /// Runs at the speed of the first, at most those that a baseline needs.
    fn learnt_runs(series: &[Option<&JointSummary>], settings: &DetectSettings) -> usize {
        let mut measured =
            series.iter().filter_map(|summary| summary.and_then(|of| of.warm_friction)).peekable();
        let Some(first) = measured.peek().copied() else { return 0 };
        let alike = measured.filter(|warm| same_speed(warm, first.speed_fraction)).count();
        alike.min(settings.baseline_runs.max(1))
    }

    /// `None` with too few runs at the speed of the first.
    fn find(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Option<Self> {
        let measured: Vec<(usize, WarmFriction)> = (0..series.len())
            .filter_map(|run| series[run].and_then(|summary| summary.warm_friction).map(|warm| (run, warm)))
            .collect();
        let speed_fraction = measured.first()?.1.speed_fraction;
        let first: Vec<(usize, WarmFriction)> = measured
            .into_iter()
            .filter(|(_, warm)| same_speed(warm, speed_fraction))
            .take(settings.baseline_runs.max(1))
            .collect();
        if first.len() < settings.baseline_runs.max(1) {
            return None;
        }
        let torques: Vec<f64> = first.iter().map(|(_, warm)| warm.torque).collect();
        let minutes: Vec<f64> = first.iter().map(|(_, warm)| warm.minute).collect();
        let torque = median(&torques).filter(|torque| *torque > 0.0)?;
        let last_run = first.last()?.0;
        Some(Self { torque, minute: median(&minutes)?, speed_fraction, torques, last_run })
    }

    /// Warm friction of a run, if it was as warm as the baseline.
    fn observed(&self, series: &[Option<&JointSummary>], run: usize) -> Option<Observed> {
        let warm = series[run].and_then(|summary| summary.warm_friction)?;
        let comparable = same_speed(&warm, self.speed_fraction)
            && (warm.minute - self.minute).abs() <= WARMTH_TOLERANCE * self.minute;
        comparable.then_some(Observed {
            run,
            ratio: warm.torque / self.torque,
            std_error: 0.0,
            torque: Some(warm.torque),
        })
    }

    /// Run-to-run standard deviation as a fraction, and the variance of the median, pi/2 of the mean's.
    fn spread(&self) -> (f64, f64) {
        let spread = (robust_deviation(&self.torques).unwrap_or(0.0) / self.torque).max(MIN_SPREAD);
        (spread, std::f64::consts::FRAC_PI_2 * spread * spread / self.torques.len() as f64)
    }
}

/// Levels are copied from one list; one written in two ways is still the same.
fn same_speed(warm: &WarmFriction, speed_fraction: f64) -> bool {
    (warm.speed_fraction - speed_fraction).abs() < 1e-6
}

/// Says first what decides, the smoothed change, then what this run alone gave.
fn drift_message(change: f64, threshold: f64, of_run: Observed, warm: Option<&WarmBaseline>) -> String {
    let (side, advice) = if change > 0.0 {
        ("above", "check lubrication, gearbox and brake")
    } else {
        ("below", "a change of grease or a loose transmission lowers friction; check after maintenance")
    };
    let [percent, limit] = apart(100.0 * change.abs(), 100.0 * threshold);
    let alone = match (of_run.ratio - 1.0) * change.signum() >= threshold {
        true => "",
        false => ", within the limit by itself",
    };
    match (of_run.torque, warm) {
        (Some(torque), Some(warm)) => format!(
            "warm friction, smoothed over the tests, is {percent} % {side} the joint's baseline (limit {limit} %);              latest test{alone}: {torque:.2} Nm against {:.2} Nm at {:.0} % speed, as measured since the run has no \
             friction index; {advice}",
            warm.torque,
            100.0 * warm.speed_fraction
        ),
        _ => format!(
            "friction at equal speed and warmth, smoothed over the tests, is {percent} % {side} the joint's baseline \
             (limit {limit} %); latest test{alone}: friction index {:.3}, standard error {:.3}; {advice}",
            of_run.ratio, of_run.std_error
        ),
    }
}

/// A figure and its limit with as few decimals, up to three, as tell them apart.
fn apart(figure: f64, limit: f64) -> [String; 2] {
    (0..3)
        .map(|decimals| [figure, limit].map(|of| format!("{of:.decimals$}")))
        .find(|[figure, limit]| figure != limit)
        .unwrap_or_else(|| [figure, limit].map(|of| format!("{of:.3}")))
}

/// Swing of the relative RMSD from cycle to cycle against the joint's usual swing.
fn oscillation(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Vec<Verdict> {
    let swings: Vec<Option<f64>> =
        series.iter().map(|summary| summary.and_then(|s| s.rmsd_swing).map(|swing| swing.value)).collect();
    let first: Vec<f64> = swings.iter().flatten().take(settings.baseline_runs).copied().collect();
    let Some(baseline) = median(&first).filter(|_| first.len() >= settings.baseline_runs.max(1)) else {
        return vec![Verdict::Unknown; series.len()];
    };
    let threshold = (settings.oscillation_ratio * baseline).max(MIN_SWING);
    swings
        .iter()
        .map(|swing| match swing {
            None => Verdict::Unknown,
            Some(swing) if *swing < threshold => Verdict::Quiet,
            Some(swing) => Verdict::Out {
                severity: if *swing >= 2.0 * threshold { Severity::Critical } else { Severity::Warning },
                score: *swing,
                threshold,
                value: *swing,
                baseline,
                message: format!(
                    "relative RMSD swings by {:.2} % of torque from cycle to cycle, usually {:.2} %; look for a \
                     loose bearing, belt or encoder coupling",
                    100.0 * swing,
                    100.0 * baseline
                ),
            },
        })
        .collect()
}

/// Relative RMSD against absolute limits; milder where the joint has always been so.
fn accuracy(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Vec<Verdict> {
    let values: Vec<Option<f64>> = series.iter().map(|s| s.and_then(|s| s.relative_rmsd)).collect();
    let first: Vec<f64> = values.iter().flatten().take(settings.baseline_runs).copied().collect();
    let baseline = median(&first).filter(|_| first.len() >= settings.baseline_runs.max(1));
    values
        .iter()
        .map(|value| match value {
            None => Verdict::Unknown,
            Some(value) if *value <= settings.accuracy_warning => Verdict::Quiet,
            Some(value) => {
                let critical = *value > settings.accuracy_critical;
                let as_ever =
                    baseline.is_some_and(|b| b > settings.accuracy_warning && *value <= ACCURACY_AS_EVER * b);
                let threshold = if critical { settings.accuracy_critical } else { settings.accuracy_warning };
                let [percent, limit] = apart(100.0 * value, 100.0 * threshold);
                Verdict::Out {
                    severity: match (as_ever, critical) {
                        (true, _) => Severity::Info,
                        (false, true) => Severity::Critical,
                        (false, false) => Severity::Warning,
                    },
                    score: *value,
                    threshold,
                    value: *value,
                    baseline: baseline.unwrap_or(settings.accuracy_warning),
                    message: format!(
                        "the identified model misses {percent} % of this joint's torque, limit {limit} %{}; check \
                         torque signal, payload and the robot's description",
                        if as_ever { ", as in its baseline" } else { "" }
                    ),
                }
            }
        })
        .collect()
}

/// Joins the verdicts of successive runs, given by key and start, into episodes of a joint.
pub(super) fn episodes(
    runs: &[(i64, Timestamp)],
    joint: JointIndex,
    kind: AnomalyKind,
    quantity: &'static str,
    verdicts: &[Verdict],
) -> Vec<Anomaly> {
    let mut found: Vec<Anomaly> = Vec::new();
    let mut quiet = QUIET_RUNS;
    for (&(run_id, started_at), verdict) in runs.iter().zip(verdicts) {
        match verdict {
            Verdict::Unknown => {}
            Verdict::Quiet => {
                quiet += 1;
                if quiet >= QUIET_RUNS {
                    found.iter_mut().for_each(|anomaly| anomaly.ended = true);
                }
            }
            Verdict::Out { severity, score, threshold, value, baseline, message } => {
                let now = Anomaly {
                    joint: Some(joint),
                    kind,
                    quantity,
                    severity: *severity,
                    score: *score,
                    threshold: *threshold,
                    value: *value,
                    baseline: *baseline,
                    peak_value: *value,
                    peak_score: *score,
                    first_cycle: None,
                    first_run_id: run_id,
                    last_run_id: run_id,
                    first_seen_at: started_at,
                    last_seen_at: started_at,
                    ended: false,
                    message: format!("joint {joint}: {message}"),
                };
                match found.last_mut().filter(|anomaly| !anomaly.ended) {
                    Some(open) => open.go_on(now),
                    None => found.push(now),
                }
                quiet = 0;
            }
        }
    }
    found
}
