//! Friction of one joint over its robot's runs, as a multiple of the joint's own baseline.
//!
//! A run is compared by the first available quantity: the friction index, warm friction of the friction stage, friction
//! identified from the excitation. The index is already a multiple of the joint's first runs. The baseline of the two
//! torques is the median of the joint's first runs at one speed.

use nalgebra::DVector;

use super::first_level::{FirstLevels, LEVEL_CHANGE};
use crate::detect::control_chart::median_variance;
use crate::detect::rate::OWN_FROM;
use crate::statistics::descriptive::{mean, median, robust_deviation, standard_deviation};
use armwatch_model::analysis::{Estimate, JointSummary, WarmFriction};
use armwatch_model::anomaly::quantity::Quantity;

/// Least accepted standard deviation from run to run of a baseline of few runs, as a fraction of friction: ambient
/// temperature alone moves warm friction by about this.
pub(in crate::detect::runs) const MIN_SPREAD: f64 = 0.01;

/// The same for the friction index, which is corrected for the ambient temperature.
pub(in crate::detect::runs) const MIN_INDEX_SPREAD: f64 = 0.005;

/// Tolerance of the time of the warm points, as a fraction of the baseline's, for runs of about equal temperature.
const WARMTH_TOLERANCE: f64 = 0.25;

/// The same in min, if that is more: gearboxes warm in minutes, so tests of seconds are all cold, whatever their
/// lengths.
const WARMTH_MINUTES: f64 = 0.5;

/// Friction of one joint over the runs.
pub(in crate::detect::runs) struct FrictionHistory {
    /// The quantity of the joint that is checked.
    pub(in crate::detect::runs) source: Source,
    /// Runs with friction that compares with the baseline, oldest first.
    pub(in crate::detect::runs) runs: Vec<Observed>,
    /// Number of runs of the baseline so far, at most the required number.
    pub(in crate::detect::runs) learnt_runs: usize,
    /// Usual standard deviation from run to run, as a fraction of the baseline.
    pub(in crate::detect::runs) spread: f64,
    /// The pooled value over the arm's joints before each run among the first tests: the prior of one joint. Empty
    /// unless enough joints have an index.
    pooled: Vec<(usize, f64)>,
    /// True if the first runs scatter by so much more than those of the arm's other joints that friction must have
    /// changed in them.
    pub(in crate::detect::runs) has_changed_at_first: bool,
    /// Variance of the baseline itself, as a fraction of it squared.
    pub(in crate::detect::runs) baseline_variance: f64,
    /// One per torque with enough runs.
    baselines: Vec<Baseline>,
    /// Place in the history of the last run of the baseline.
    learnt_from: usize,
}

/// Source of the friction of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::detect::runs) enum Source {
    /// The friction index, at equal thermal state.
    Index,
    /// Friction points of the friction stage, in runs of equal temperature.
    Warm,
    /// The identified friction coefficients, in runs of equal temperature.
    Excitation,
}

impl Source {
    /// The quantity of its level.
    pub(in crate::detect::runs) fn quantity(self) -> Quantity {
        match self {
            Self::Index => Quantity::FrictionIndex,
            Self::Warm => Quantity::WarmFriction,
            Self::Excitation => Quantity::ExcitationFriction,
        }
    }

    /// The quantity of a jump inside a test, which compares only cycles of that test: always a ratio.
    pub(in crate::detect::runs) fn quantity_of_jump(self) -> Quantity {
        match self {
            Self::Index => Quantity::FrictionIndex,
            Self::Warm | Self::Excitation => Quantity::FrictionJumpRatio,
        }
    }

    /// Torques of a run, at a speed each.
    fn of(self, summary: &JointSummary) -> impl Iterator<Item = WarmFriction> {
        let (first, slower) = match self {
            Self::Index => (None, None),
            Self::Warm => (summary.warm_friction, None),
            Self::Excitation => (summary.excitation_friction, summary.half_speed_friction),
        };
        let slower = first.zip(slower).map(|(of, Estimate { value: torque, std_error })| WarmFriction {
            torque,
            std_error,
            speed_fraction: 0.5 * of.speed_fraction,
            ..of
        });
        first.into_iter().chain(slower)
    }

    /// The torque of a run at one speed.
    fn at(self, summary: &JointSummary, speed_fraction: f64) -> Option<WarmFriction> {
        self.of(summary).find(|warm| same_speed(warm, speed_fraction))
    }
}

/// Friction of a run relative to the baseline, and its source.
#[derive(Debug, Clone, Copy)]
pub(in crate::detect::runs) struct Observed {
    /// Place of the run in the history.
    pub(in crate::detect::runs) run: usize,
    /// Friction as a multiple of the baseline, without the common part of all joints.
    pub(in crate::detect::runs) ratio: f64,
    /// The common part of all joints, in logarithms ([`crate::detect::runs::arm_detectors::common_change`]).
    common: f64,
    /// Correction of the friction map for temperature: the logarithm of friction as measured over the index.
    correction: Option<f64>,
    /// The part of this correction that all joints share, since the baseline.
    thermal: f64,
    pub(in crate::detect::runs) source: Source,
    /// Standard error of the ratio; zero if the scatter of the baseline contains it.
    pub(in crate::detect::runs) std_error: f64,
    /// The part of the standard error that is not in the scatter from run to run.
    measurement_error: f64,
    /// Scatter as a multiple of the usual one from run to run; zero if it is the usual one.
    relative_scatter: f64,
    /// Friction that the ratio is computed from, Nm; NaN for the index.
    pub(in crate::detect::runs) torque: f64,
}

/// Standard deviation of a joint's share in the common part of all joints, about one.
pub(in crate::detect::runs) const COMMON_SPREAD: f64 = 0.4;

/// Standard deviation of the error of a joint's index, as a fraction of the thermal correction that all joints share:
/// its map knows how friction depends on temperature from the few temperatures of its tests. Healthy joints at 5 to
/// 35 °C differ by 0.3 of that correction at most ([`crate::detect::runs::health`]).
const THERMAL_SPREAD: f64 = 0.15;

/// Standard deviation of the difference of a joint's index between two tests whose common part and common thermal
/// correction differ by this.
pub(in crate::detect::runs) fn share_deviation(common: f64, thermal: f64) -> f64 {
    (COMMON_SPREAD * common).hypot(THERMAL_SPREAD * thermal)
}

impl Observed {
    /// Friction as a multiple of the baseline, as measured.
    pub(in crate::detect::runs) fn measured_ratio(&self) -> f64 {
        self.ratio * self.common.exp()
    }

    /// Standard error including those of the share in the common part of all joints and of the thermal correction. All
    /// are the same in all runs, so averages over runs do not reduce them.
    pub(in crate::detect::runs) fn uncertainty(&self) -> f64 {
        self.std_error.hypot(share_deviation(self.common, self.thermal) * self.ratio)
    }

    /// The logarithm of friction as measured over the index.
    pub(in crate::detect::runs) fn correction(&self) -> Option<f64> {
        self.correction
    }

    /// The part of it that all joints share, since the baseline.
    pub(in crate::detect::runs) fn thermal(&self) -> f64 {
        self.thermal
    }

    /// The common part of all joints, in logarithms.
    pub(in crate::detect::runs) fn common(&self) -> f64 {
        self.common
    }

    /// The common part of all joints, for a message; empty below one percent.
    pub(in crate::detect::runs) fn common_words(&self) -> String {
        let percent = 100.0 * self.common.exp_m1();
        if percent.abs() < 1.0 {
            String::new()
        } else {
            format!(", of which all joints share {percent:+.0} %")
        }
    }
}

impl FrictionHistory {
    /// `series` has one entry per run; the first `baseline_runs` runs with friction are the baseline.
    pub(in crate::detect::runs) fn new(series: &[Option<&JointSummary>], baseline_runs: usize) -> Self {
        let count = baseline_runs.max(1);
        let index = |run: usize| series[run].and_then(|summary| summary.friction_index);
        let learnt = [(Source::Warm, 1.0), (Source::Excitation, 1.0), (Source::Excitation, 0.5)]
            .map(|(source, part)| (source, first_runs(source, part, series, count)));
        let baselines: Vec<Baseline> =
            learnt.iter().filter_map(|(source, runs)| Baseline::new(*source, runs, count)).collect();
        let has_index = (0..series.len()).any(|run| index(run).is_some());
        // the checked quantity, without an index
        let first = baselines.first();
        let warm = baselines.iter().find(|baseline| baseline.source == Source::Warm);
        let runs: Vec<Observed> = (0..series.len())
            .filter_map(|run| match index(run) {
                Some(Estimate { value, std_error }) => {
                    let (source, torque) = (Source::Index, f64::NAN);
                    let measured = warm.and_then(|baseline| baseline.observed(series, run));
                    Some(Observed {
                        run,
                        ratio: value,
                        common: 0.0,
                        correction: measured.map(|of| (of.ratio / value).ln()).filter(|of| of.is_finite()),
                        thermal: 0.0,
                        source,
                        std_error: std_error.max(0.0),
                        measurement_error: std_error.max(0.0),
                        relative_scatter: 0.0,
                        torque,
                    })
                }
                None => baselines.iter().find_map(|baseline| baseline.observed(series, run)),
            })
            .collect();
        // for torques, the last run of the baseline counts even if it was not of equal temperature
        let learnt_from = if has_index {
            runs.get(count - 1).map_or(usize::MAX, |last| last.run)
        } else {
            first.map_or(usize::MAX, |baseline| baseline.last_run)
        };
        let (spread, baseline_variance) = match (first, has_index) {
            (_, true) => index_spread(&runs, learnt_from),
            (Some(baseline), false) => baseline.spread(),
            // no run is comparable
            (None, false) => (MIN_SPREAD, 0.0),
        };
        Self {
            source: if has_index { Source::Index } else { first.map_or(Source::Warm, |of| of.source) },
            runs,
            learnt_runs: learnt.iter().map(|(_, runs)| runs.len()).max().unwrap_or(0),
            spread,
            pooled: Vec::new(),
            has_changed_at_first: false,
            baseline_variance,
            baselines,
            learnt_from,
        }
    }

    /// Makes the runs before `run` the baseline of the index, since friction jumped in `run` while the baseline was
    /// learnt.
    pub(in crate::detect::runs) fn learn_before(&mut self, run: usize) {
        let before: Vec<f64> = self.runs.iter().filter(|of| of.run < run).map(|of| of.ratio).collect();
        let Some(level) = median(&before).filter(|level| *level > 0.0 && self.source == Source::Index) else {
            return;
        };
        self.runs.iter_mut().for_each(|of| of.ratio /= level);
        self.learnt_from = self.runs.iter().rev().find(|of| of.run < run).map_or(0, |of| of.run);
        (self.spread, self.baseline_variance) = index_spread(&self.runs, self.learnt_from);
    }

    /// Raises the standard errors of runs to `error`, a fraction, if it returns one.
    pub(in crate::detect::runs) fn widen(&mut self, error: impl Fn(usize) -> Option<f64>) {
        for of in &mut self.runs {
            if let Some(error) = error(of.run) {
                of.measurement_error = of.measurement_error.max(error * of.ratio);
                of.std_error = of.std_error.max(of.measurement_error);
            }
        }
    }

    /// Subtracts the change since the baseline of the common part of all joints, in logarithms, one entry per run. The
    /// baseline has its own common part, since the others are compared with earlier runs.
    pub(in crate::detect::runs) fn without_common(&mut self, common: &[f64]) {
        let learnt: Vec<f64> =
            self.runs.iter().filter(|of| self.is_learnt_from(of)).map(|of| common[of.run]).collect();
        // a torque's baseline is a median, an index's baseline is the mean of its first runs
        let usual = match self.source {
            Source::Index => learnt.iter().sum::<f64>() / learnt.len().max(1) as f64,
            Source::Warm | Source::Excitation => median(&learnt).unwrap_or(0.0),
        };
        for of in &mut self.runs {
            of.common = common[of.run] - usual;
            of.ratio *= (-of.common).exp();
        }
        if self.source == Source::Index {
            (self.spread, self.baseline_variance) = index_spread(&self.runs, self.learnt_from);
        } else if !self.is_learning() {
            (self.spread, self.baseline_variance) = self.torque_spread();
            let (source, spread) = (self.source, self.spread);
            for of in self.runs.iter_mut().filter(|of| of.source == source) {
                of.std_error = of.measurement_error.max(spread * of.relative_scatter);
            }
        }
    }

    /// Takes the thermal correction that the other joints share, by run. A run without it is as warm as the one before.
    pub(in crate::detect::runs) fn with_thermal(&mut self, shared: &[Option<f64>]) {
        let learnt: Vec<f64> =
            self.runs.iter().filter(|of| self.is_learnt_from(of)).filter_map(|of| shared[of.run]).collect();
        let Some(usual) = mean(&learnt) else { return };
        let mut latest = 0.0;
        for of in &mut self.runs {
            latest = shared[of.run].map_or(latest, |of| of - usual);
            of.thermal = latest;
        }
    }

    /// Limits the scatter of the index in the first runs: beyond `most` it is a change and not scatter.
    pub(super) fn bound_spread(&mut self, most: f64) {
        if self.source == Source::Index && self.spread > most {
            self.baseline_variance *= (most / self.spread).powi(2);
            self.spread = most;
            self.has_changed_at_first = true;
        }
    }

    /// Standard deviation of the index in the first tests before `run`, without the bias of its median over several
    /// joints; `None` without an index or with fewer than two such tests.
    fn deviation_before(&self, run: usize) -> Option<f64> {
        let first = self.runs.iter().take(OWN_FROM).filter(|of| of.run < run).map(|of| of.ratio);
        let first: Vec<f64> = first.collect();
        let deviation = standard_deviation(&first).filter(|_| self.source == Source::Index)?;
        // median of chi-square over its degrees of freedom (Wilson and Hilferty 1931)
        let freedom = first.len() as f64 - 1.0;
        Some(deviation / (1.0 - 2.0 / (9.0 * freedom)).powf(1.5))
    }

    /// Standard deviation from run to run over the arm's joints in the first tests before `run`.
    pub(in crate::detect::runs) fn pooled_before(&self, run: usize) -> Option<f64> {
        let known = self.pooled.partition_point(|(of, _)| *of <= run);
        self.pooled.get(known.checked_sub(1)?).map(|(_, pooled)| *pooled)
    }

    /// Shrinks the scatter of the first runs towards that of the arm's joints, unless it is a change.
    fn shrink_spread(&mut self) {
        let pooled = self.pooled_before(self.learnt_from.saturating_add(1));
        let Some(pooled) = pooled.filter(|_| !self.has_changed_at_first) else { return };
        let own = (self.learnt_runs as f64 - 1.0).max(0.0);
        let variance =
            (POOLED_TESTS * pooled * pooled + own * self.spread * self.spread) / (POOLED_TESTS + own);
        self.baseline_variance *= variance / (self.spread * self.spread);
        self.spread = variance.sqrt();
    }

    /// Standard deviation from run to run of the torques of the baseline, as a fraction, and the variance of their
    /// median. If few of these torques are comparable, both include the common part of all joints.
    fn torque_spread(&self) -> (f64, f64) {
        let own = |of: &&Observed| of.source == self.source && self.is_learnt_from(of);
        let ratios: Vec<f64> = self.runs.iter().filter(own).map(|of| of.ratio).collect();
        if 2 * ratios.len() <= self.learnt_runs {
            return (self.spread, self.baseline_variance);
        }
        let spread = robust_deviation(&ratios).unwrap_or(0.0).max(MIN_SPREAD);
        (spread, median_variance(spread, ratios.len()))
    }

    /// Returns true if the run at this place is part of a baseline.
    pub(in crate::detect::runs) fn is_learnt_at(&self, run: usize) -> bool {
        run <= self.learnt_from
    }

    /// Returns true while there is no baseline to compare a run with.
    pub(in crate::detect::runs) fn is_learning(&self) -> bool {
        self.source != Source::Index && self.baselines.is_empty()
    }

    /// The baseline of a torque; `None` for the index.
    pub(in crate::detect::runs) fn baseline(&self, source: Source) -> Option<&Baseline> {
        self.baselines.iter().find(|baseline| baseline.source == source)
    }

    /// Returns true if this run is part of the baseline.
    pub(in crate::detect::runs) fn is_learnt_from(&self, observed: &Observed) -> bool {
        observed.run <= self.learnt_from
    }

    /// Variance of one run's ratio without the common part of all joints. Torques depend on ambient temperature, and an
    /// index does not: their variance is at least that of a steady joint.
    pub(in crate::detect::runs) fn own_variance(&self, observed: &Observed) -> f64 {
        match self.source {
            Source::Index => self.variance(observed),
            Source::Warm | Source::Excitation => {
                let scatter = MIN_SPREAD * observed.relative_scatter.max(1.0);
                observed.measurement_error.max(scatter).powi(2)
            }
        }
    }

    /// Variance of one run's ratio, at least the usual one.
    pub(in crate::detect::runs) fn variance(&self, observed: &Observed) -> f64 {
        (self.spread * self.spread).max(observed.std_error * observed.std_error)
    }
}

/// Scatter of a joint's first runs, as a multiple of the median of the arm's other joints, beyond which it is a change.
const MOST_SPREAD: f64 = 3.0;
/// Fewest other joints for that median.
const FEWEST_OTHERS: usize = 3;
/// Number of tests that the scatter of the arm's joints is worth as a prior of one joint.
pub(in crate::detect::runs) const POOLED_TESTS: f64 = 20.0;

/// Limits the scatter of each joint's index by that of the other joints of the arm, and shrinks it towards that of all
/// joints: the first runs of one joint determine it badly.
pub(in crate::detect::runs) fn bound_spreads(joints: &mut [FrictionHistory]) {
    let own: Vec<Option<f64>> =
        joints.iter().map(|of| (of.source == Source::Index).then_some(of.spread)).collect();
    let pooled: Vec<(usize, f64)> = pooled_by_run(joints);
    for (j, joint) in joints.iter_mut().enumerate().filter(|(j, _)| own[*j].is_some()) {
        joint.pooled.clone_from(&pooled);
        let others: Vec<f64> =
            own.iter().enumerate().filter(|(other, _)| *other != j).filter_map(|(_, of)| *of).collect();
        if others.len() >= FEWEST_OTHERS
            && let Some(usual) = median(&others)
        {
            joint.bound_spread(MOST_SPREAD * usual);
        }
        joint.shrink_spread();
    }
}

/// Median over the joints of the standard deviation of the index in the tests before each of the first runs.
fn pooled_by_run(joints: &[FrictionHistory]) -> Vec<(usize, f64)> {
    let Some(longest) = joints.iter().max_by_key(|of| of.runs.len()) else { return Vec::new() };
    let pooled = |run: usize| {
        let known: Vec<f64> = joints.iter().filter_map(|of| of.deviation_before(run)).collect();
        median(&known).filter(|_| known.len() > FEWEST_OTHERS).map(|pooled| (run, pooled))
    };
    longest.runs.iter().take(OWN_FROM).filter_map(|of| pooled(of.run + 1)).collect()
}

/// Least square of a jump between two tests of a baseline, in variances of a test.
const LEAST_JUMP_SQUARE: f64 = 64.0;

/// If the index of a joint jumps between two tests of its baseline and stays there, beyond the other joints, makes the
/// earlier tests its baseline.
pub(in crate::detect::runs) fn learn_before_jumps(joints: &mut [FrictionHistory]) {
    let jumps: Vec<Option<usize>> = (0..joints.len()).map(|own| jump_at_first(joints, own)).collect();
    for (joint, jump) in joints.iter_mut().zip(jumps) {
        if let Some(run) = jump {
            joint.learn_before(run);
        }
    }
}

/// Place of the first run in the baseline with another level of the index than the runs before it.
fn jump_at_first(joints: &[FrictionHistory], own: usize) -> Option<usize> {
    let joint = &joints[own];
    let is_index = |of: &&Observed| of.source == Source::Index && of.ratio > 0.0;
    let learnt: Vec<&Observed> =
        joint.runs.iter().filter(|of| joint.is_learnt_from(of)).filter(is_index).collect();
    let level = |of: &Observed| {
        let others = joints.iter().enumerate().filter(|(other, _)| *other != own);
        let in_run = |(_, of_joint): (usize, &FrictionHistory)| {
            of_joint.runs.iter().filter(is_index).find(|other| other.run == of.run).map(|of| of.ratio.ln())
        };
        of.ratio.ln() - median(&others.filter_map(in_run).collect::<Vec<f64>>()).unwrap_or(0.0)
    };
    let errors: Vec<f64> = learnt.iter().map(|of| of.std_error).collect();
    let error = median(&errors)?.max(MIN_INDEX_SPREAD);
    let tests: Vec<DVector<f64>> =
        learnt.iter().map(|of| DVector::from_element(1, level(of) / error)).collect();
    let is_jump =
        |before: &DVector<f64>, behind: &DVector<f64>| error * (behind[0] - before[0]).abs() >= LEVEL_CHANGE;
    let levels = FirstLevels::of(&tests, LEAST_JUMP_SQUARE, is_jump);
    (!levels.changed.is_empty()).then(|| learnt[levels.usual.len()].run)
}

/// Standard deviation from run to run of the index in the joint's baseline, and the variance of the baseline. The own
/// error of an index already contains that variance.
fn index_spread(observed: &[Observed], last_run: usize) -> (f64, f64) {
    let first: Vec<f64> = observed.iter().filter(|o| o.run <= last_run).map(|o| o.ratio).collect();
    let errors: Vec<f64> = observed.iter().filter(|o| o.run <= last_run).map(|o| o.std_error).collect();
    let spread =
        robust_deviation(&first).unwrap_or(0.0).max(median(&errors).unwrap_or(0.0)).max(MIN_INDEX_SPREAD);
    (spread, spread * spread / first.len().max(1) as f64)
}

/// Runs with friction at `part` of the speed of the first, at most `count`, with their places in the history.
fn first_runs(
    source: Source,
    part: f64,
    series: &[Option<&JointSummary>],
    count: usize,
) -> Vec<(usize, WarmFriction)> {
    let Some(first) = series.iter().flatten().find_map(|summary| source.of(summary).next()) else {
        return Vec::new();
    };
    let at_speed = |summary| source.at(summary, part * first.speed_fraction);
    (0..series.len())
        .filter_map(|run| series[run].and_then(at_speed).map(|warm| (run, warm)))
        .take(count)
        .collect()
}

/// Friction torque of the joint's first runs.
#[derive(Debug)]
pub(in crate::detect::runs) struct Baseline {
    source: Source,
    /// Median of the torques, Nm.
    pub(in crate::detect::runs) torque: f64,
    /// Speed of the points as a fraction of the largest.
    pub(in crate::detect::runs) speed_fraction: f64,
    /// Usual standard error of one run's torque, Nm; may be not a number.
    std_error: f64,
    /// Usual time of the points since the run's start, min.
    minute: f64,
    /// Torques of the median, and the last run of these.
    torques: Vec<f64>,
    last_run: usize,
}

impl Baseline {
    /// Returns `None` with fewer than `count` runs.
    fn new(source: Source, first: &[(usize, WarmFriction)], count: usize) -> Option<Self> {
        if first.len() < count {
            return None;
        }
        let figures =
            |of: fn(&WarmFriction) -> f64| first.iter().map(|(_, warm)| of(warm)).collect::<Vec<_>>();
        let torques = figures(|warm| warm.torque);
        Some(Self {
            source,
            torque: median(&torques).filter(|torque| *torque > 0.0)?,
            speed_fraction: first.first()?.1.speed_fraction,
            std_error: median(&figures(|warm| warm.std_error))?,
            minute: median(&figures(|warm| warm.minute))?,
            torques,
            last_run: first.last()?.0,
        })
    }

    /// Friction of a run, if it had the same temperature as the baseline.
    fn observed(&self, series: &[Option<&JointSummary>], run: usize) -> Option<Observed> {
        let warm = series[run].and_then(|summary| self.source.at(summary, self.speed_fraction))?;
        let comparable =
            (warm.minute - self.minute).abs() <= (WARMTH_TOLERANCE * self.minute).max(WARMTH_MINUTES);
        // the scatter of the baseline has the errors of its runs in it; a run with a larger one scatters more
        let relative_scatter = match self.source {
            Source::Index | Source::Warm => 0.0,
            Source::Excitation => (warm.std_error / self.std_error).max(1.0),
        };
        comparable.then_some(Observed {
            run,
            ratio: warm.torque / self.torque,
            common: 0.0,
            correction: None,
            thermal: 0.0,
            source: self.source,
            std_error: self.spread().0 * relative_scatter,
            measurement_error: 0.0,
            relative_scatter,
            torque: warm.torque,
        })
    }

    /// Standard deviation from run to run as a fraction, and the variance of the median.
    fn spread(&self) -> (f64, f64) {
        let spread = (robust_deviation(&self.torques).unwrap_or(0.0) / self.torque).max(MIN_SPREAD);
        (spread, median_variance(spread, self.torques.len()))
    }
}

/// Compares with a tolerance: levels are from one list, but may be written in two ways.
fn same_speed(warm: &WarmFriction, speed_fraction: f64) -> bool {
    (warm.speed_fraction - speed_fraction).abs() < 1e-6
}
