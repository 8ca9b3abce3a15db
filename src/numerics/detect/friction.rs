//! Friction of one joint over its robot's runs, against the joint's own first ones.
//!
//! A run is held against the baseline by the first of these that it has: the friction index, warm friction of the
//! friction stage, friction identified from the excitation.

use super::verdict::{DetectSettings, EWMA_WEIGHT, Verdict, apart};
use crate::analysis::{Estimate, JointSummary, WarmFriction};
use crate::anomaly::Severity;
use crate::numerics::statistics::descriptive::{median, robust_deviation};

/// Smallest run-to-run standard deviation that a baseline of a few runs is believed to have, as a
/// fraction of friction: hall temperature alone moves warm friction by about this.
const MIN_SPREAD: f64 = 0.01;

/// The same for the friction index, which knows of the hall.
const MIN_INDEX_SPREAD: f64 = 0.005;

/// Runs compare if they were about equally warm: time of the warm points within this fraction of
/// the baseline's.
const WARMTH_TOLERANCE: f64 = 0.25;

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

/// Where friction of a run comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    /// The friction index, at equal thermal state.
    Index,
    /// Friction points of the friction stage, of runs equally warm.
    Warm,
    /// The identified friction coefficients, of runs equally warm.
    Excitation,
}

impl Source {
    /// Name of the quantity.
    pub(super) fn quantity(self) -> &'static str {
        match self {
            Self::Index => "friction_index",
            Self::Warm => "warm_friction_nm",
            Self::Excitation => "excitation_friction_nm",
        }
    }

    fn of(self, summary: &JointSummary) -> Option<WarmFriction> {
        match self {
            Self::Index => None,
            Self::Warm => summary.warm_friction,
            Self::Excitation => summary.excitation_friction,
        }
    }
}

/// Friction of a run against the baseline, and by which road.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observed {
    /// Place of the run in the history.
    pub(super) run: usize,
    pub(super) ratio: f64,
    pub(super) source: Source,
    /// Zero where the scatter of the baseline says all.
    std_error: f64,
    /// Friction that it comes from, Nm; not a number for the index.
    torque: f64,
}

/// Friction against the joint's baseline, smoothed over runs.
pub(super) fn drift(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Drift {
    let index = |run: usize| series[run].and_then(|summary| summary.friction_index);
    let baselines = [Source::Warm, Source::Excitation].map(|source| Baseline::find(source, series, settings));
    let baseline_of = |source: Source| baselines.iter().flatten().find(|baseline| baseline.source == source);
    let has_index = (0..series.len()).any(|run| index(run).is_some());
    // what the joint is watched by, without an index
    let first = baselines.iter().flatten().next();
    let watched = if has_index { Source::Index } else { first.map_or(Source::Warm, |of| of.source) };
    let learnt = [Source::Warm, Source::Excitation].map(|source| Baseline::learnt(source, series, settings));
    let mut result = Drift {
        quantity: watched.quantity(),
        verdicts: vec![Verdict::Unknown; series.len()],
        latest: None,
        learning: !has_index && first.is_none(),
        learnt_runs: learnt.iter().map(Vec::len).max().unwrap_or(0),
    };
    let observed: Vec<Observed> = (0..series.len())
        .filter_map(|run| match index(run) {
            Some(Estimate { value, std_error }) => {
                let (source, torque) = (Source::Index, f64::NAN);
                Some(Observed { run, ratio: value, source, std_error: std_error.max(0.0), torque })
            }
            None => baselines.iter().flatten().find_map(|baseline| baseline.observed(series, run)),
        })
        .collect();
    // torques keep the place that a run has among all with one, also of runs that were not equally warm
    let learnt_from = if has_index {
        observed.get(settings.baseline_runs.max(1) - 1).map_or(usize::MAX, |last| last.run)
    } else {
        first.map_or(usize::MAX, |baseline| baseline.last_run)
    };
    let (spread, baseline_variance) = match (first, has_index) {
        (_, true) => index_spread(&observed, learnt_from),
        (Some(baseline), false) => baseline.spread(),
        (None, false) => return result,
    };
    let baseline = baseline_of(watched).map_or(1.0, |baseline| baseline.torque);
    // a baseline of a few runs may scatter less than healthy runs do
    let before: Vec<f64> = observed.iter().rev().skip(1).map(|of| of.ratio).collect();
    let usual_scatter = robust_deviation(&before).unwrap_or(0.0).max(spread);
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
        let of_one = own.max(usual_scatter * usual_scatter) + baseline_variance;
        let bound = settings.drift_warning.max(settings.drift_sigma * of_one.sqrt());
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
            Verdict::Out {
                severity: if critical { Severity::Critical } else { Severity::Warning },
                score: change.abs(),
                threshold,
                value: of_run.ratio * baseline,
                baseline,
                message: drift_message(change, threshold, of_run, baseline_of(of_run.source), has_index),
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

/// Friction torque of the joint's first runs.
#[derive(Debug)]
struct Baseline {
    source: Source,
    torque: f64,
    /// Usual standard error of one run's torque, Nm; may be not a number.
    std_error: f64,
    minute: f64,
    speed_fraction: f64,
    /// Torques that it is the median of, and the last run of these.
    torques: Vec<f64>,
    last_run: usize,
}

impl Baseline {
    /// Runs at the speed of the first, as many as a baseline needs or fewer, with their places.
    fn learnt(
        source: Source,
        series: &[Option<&JointSummary>],
        settings: &DetectSettings,
    ) -> Vec<(usize, WarmFriction)> {
        let measured: Vec<(usize, WarmFriction)> = (0..series.len())
            .filter_map(|run| series[run].and_then(|summary| source.of(summary)).map(|warm| (run, warm)))
            .collect();
        let Some(speed_fraction) = measured.first().map(|(_, warm)| warm.speed_fraction) else {
            return Vec::new();
        };
        measured
            .into_iter()
            .filter(|(_, warm)| same_speed(warm, speed_fraction))
            .take(settings.baseline_runs.max(1))
            .collect()
    }

    /// `None` with too few runs at the speed of the first.
    fn find(source: Source, series: &[Option<&JointSummary>], settings: &DetectSettings) -> Option<Self> {
        let first = Self::learnt(source, series, settings);
        if first.len() < settings.baseline_runs.max(1) {
            return None;
        }
        let figures =
            |of: fn(&WarmFriction) -> f64| first.iter().map(|(_, warm)| of(warm)).collect::<Vec<_>>();
        let torques = figures(|warm| warm.torque);
        Some(Self {
            source,
            torque: median(&torques).filter(|torque| *torque > 0.0)?,
            std_error: median(&figures(|warm| warm.std_error))?,
            minute: median(&figures(|warm| warm.minute))?,
            speed_fraction: first.first()?.1.speed_fraction,
            torques,
            last_run: first.last()?.0,
        })
    }

    /// Friction of a run, if it was as warm as the baseline.
    fn observed(&self, series: &[Option<&JointSummary>], run: usize) -> Option<Observed> {
        let warm = series[run].and_then(|summary| self.source.of(summary))?;
        let comparable = same_speed(&warm, self.speed_fraction)
            && (warm.minute - self.minute).abs() <= WARMTH_TOLERANCE * self.minute;
        // the scatter of the baseline has the errors of its runs in it; a run with a larger one scatters more
        let std_error = match self.source {
            Source::Index | Source::Warm => 0.0,
            Source::Excitation => self.spread().0 * (warm.std_error / self.std_error).max(1.0),
        };
        comparable.then_some(Observed {
            run,
            ratio: warm.torque / self.torque,
            source: self.source,
            std_error,
            torque: warm.torque,
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
fn drift_message(
    change: f64,
    threshold: f64,
    of_run: Observed,
    baseline: Option<&Baseline>,
    has_index: bool,
) -> String {
    let (side, advice) = if change > 0.0 {
        ("above", "check lubrication, gearbox and brake")
    } else {
        ("below", "a change of grease or a loose transmission lowers friction; check after maintenance")
    };
    let (what, why) = match (of_run.source, has_index) {
        (Source::Index, _) => ("friction at equal speed and warmth", ""),
        (Source::Warm, _) => ("warm friction", ", as measured since the run has no friction index"),
        (Source::Excitation, true) => {
            ("friction identified from the excitation", ", since the run has no friction index")
        }
        (Source::Excitation, false) => {
            ("friction identified from the excitation", ", since the recordings have no friction stage")
        }
    };
    let [percent, limit] = apart(100.0 * change.abs(), 100.0 * threshold);
    let alone = match (of_run.ratio - 1.0) * change.signum() >= threshold {
        true => "",
        false => ", within the limit by itself",
    };
    let figure = match baseline {
        Some(baseline) => format!(
            "{:.2} Nm against {:.2} Nm at {:.0} % speed",
            of_run.torque,
            baseline.torque,
            100.0 * baseline.speed_fraction
        ),
        None => format!("friction index {:.3}, standard error {:.3}", of_run.ratio, of_run.std_error),
    };
    format!(
        "{what}, smoothed over the tests, is {percent} % {side} the joint's baseline (limit {limit} %); \
         latest test{alone}: {figure}{why}; {advice}"
    )
}
