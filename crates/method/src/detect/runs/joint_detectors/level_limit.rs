//! Limit of the change of a joint's level of friction.
//!
//! A change must reach `drift_warning`, and must be more than chance. The limit of the smoothed change has the mean run
//! length of the joint's share of the rate of false alarms ([`Budget`], [`average::limit`]), in standard deviations of
//! the smoothed value and of the baseline together. These are estimated from the joint's own tests, with their
//! autocorrelation ([`QuietScatter`]). While the tests are few, they are shrunk towards a prior: the median scatter of
//! the arm's joints in the tests so far, if four have an index. Student's distribution widens the limit during that
//! time. A smaller change counts as well if the tests together are beyond chance in a sequential chart
//! ([`LevelLimit::is_shifted`]). If the first tests of a joint scatter by more than three times the median of the arm's
//! other joints, they contain a change. The limit then uses three times this median until later tests are learnt. After
//! [`OWN_FROM`] tests nothing more is learnt: a year of wear would be. `drift_sigma` overrides all of this.

use std::cell::Cell;

use super::steady_rise::Scatter;
use crate::detect::control_chart::{EWMA_WEIGHT, Limits};
use crate::detect::rate::OWN_FROM;
use crate::detect::rate::average;
use crate::detect::rate::budget::Budget;
use crate::detect::rate::chart::{self, SequentialChart};
use crate::detect::rate::whitening::Likeness;
use crate::detect::runs::history::friction_history::{FrictionHistory, Observed, POOLED_TESTS, Source};
use crate::detect::runs::history::quiet_scatter::QuietScatter;
use crate::detect::runs::series::JointSeries;
use crate::statistics::descriptive::median;
use armwatch_model::analysis::Estimate;

/// The limit of one joint, with the scatter learnt so far.
pub(in crate::detect::runs) struct LevelLimit {
    limits: Limits,
    /// True if `drift_sigma` sets the number of standard deviations.
    overruled: bool,
    /// Number of standard deviations, cached until the next test is learnt: the quantile is slow to compute.
    estimated: Cell<Option<f64>>,
    alpha: f64,
    scatter: QuietScatter,
    /// Chart of shifts of the level of any size, and the friction of the test before.
    chart: SequentialChart,
    previous: f64,
    /// True if friction changed in the tests of the baseline, which then do not show the scatter.
    is_bounded: bool,
    /// True if the scatter over the arm's joints is known.
    has_pool: bool,
    /// Number of tests of the baseline.
    baseline: usize,
    /// Standard deviation of the baseline, used for the variances, and the least accepted one: the usual standard error
    /// of a test, or the value of healthy joints.
    stated: f64,
    least: f64,
    baseline_variance: f64,
}

impl LevelLimit {
    pub(in crate::detect::runs) fn new(series: &JointSeries<'_>) -> Self {
        let settings = series.settings;
        let friction = series.friction;
        let errors: Vec<f64> =
            friction.runs.iter().filter(|of| friction.is_learnt_from(of)).map(|of| of.std_error).collect();
        let least = least_spread(friction.source).max(median(&errors).unwrap_or(0.0));
        let is_bounded = friction.has_changed_at_first;
        let prior = if is_bounded { friction.spread } else { least };
        let budget = Budget::new(settings.false_alarms_per_robot_year, series.joints, &series.starts);
        let sigma = settings.drift_sigma.unwrap_or_else(|| average::limit(EWMA_WEIGHT, budget.run_length()));
        Self {
            limits: Limits { warning: settings.drift_warning, critical: settings.drift_critical, sigma },
            overruled: settings.drift_sigma.is_some(),
            estimated: Cell::new(None),
            alpha: budget.alpha(),
            scatter: QuietScatter::new(prior, POOLED_TESTS, OWN_FROM),
            chart: SequentialChart::default(),
            previous: 1.0,
            is_bounded,
            has_pool: false,
            baseline: friction.learnt_runs,
            stated: friction.spread,
            least,
            baseline_variance: friction.baseline_variance,
        }
    }

    /// Uses the scatter of the arm's joints before `run` as the prior of this joint.
    pub(in crate::detect::runs) fn before(&mut self, friction: &FrictionHistory, run: usize) {
        let pooled = friction.pooled_before(run).filter(|_| !self.is_bounded && self.learnt() < OWN_FROM);
        if let Some(pooled) = pooled.map(|pooled| pooled.max(self.least)) {
            self.has_pool = true;
            self.scatter.expect(pooled);
            self.estimated.set(None);
        }
    }

    /// Learns a test of the baseline, unless friction changed in it.
    pub(in crate::detect::runs) fn learn(&mut self, observed: &Observed) {
        self.previous = observed.ratio;
        if self.is_bounded {
            return;
        }
        self.scatter.learn(estimate(observed));
        self.estimated.set(None);
    }

    /// Adds a quiet test, which is learnt after later ones.
    pub(in crate::detect::runs) fn quiet(&mut self, observed: &Observed) {
        if self.scatter.quiet(estimate(observed)) {
            self.estimated.set(None);
        }
    }

    /// Returns true if this test and those before it are beyond chance for tests of one level: the mixture of
    /// Shiryaev-Roberts statistics ([`crate::detect::rate::chart`]) over the scores against the learnt tests.
    pub(in crate::detect::runs) fn is_shifted(&mut self, observed: &Observed) -> bool {
        let Estimate { value, std_error } = estimate(observed);
        let score = self.scatter.score(self.previous, value, std_error);
        self.previous = value;
        self.chart.add(score) >= chart::limit(self.alpha.recip()) && !self.overruled && !self.is_bounded
    }

    /// Drops the waiting tests, since a test is out: they may belong to the same change.
    pub(in crate::detect::runs) fn out(&mut self) {
        self.chart.restart();
        self.scatter.out();
    }

    /// Number of learnt tests.
    pub(in crate::detect::runs) fn learnt(&self) -> usize {
        self.scatter.learnt()
    }

    /// The smoothed change that raises an alarm; `average` is the variance of the average for values with the history's
    /// spread.
    pub(in crate::detect::runs) fn threshold(&self, average: f64) -> f64 {
        self.limits().threshold(self.deviation(average))
    }

    /// Warning and critical change, and the number of standard deviations that are still chance.
    pub(in crate::detect::runs) fn limits(&self) -> Limits {
        let sigma = match self.overruled {
            true => self.limits.sigma,
            false => {
                let found = || self.scatter.likeness().estimated_limit(self.limits.sigma);
                let estimated = self.estimated.get().unwrap_or_else(found);
                self.estimated.set(Some(estimated));
                estimated
            }
        };
        Limits { sigma, ..self.limits }
    }

    /// Standard deviation of the difference between average and baseline.
    fn deviation(&self, average: f64) -> f64 {
        if self.overruled {
            return (average + self.baseline_variance).sqrt();
        }
        let likeness = self.scatter.likeness();
        let known = (self.spread(&likeness) / self.stated).powi(2);
        let of_average = average * likeness.average_inflation(EWMA_WEIGHT);
        let of_baseline = self.baseline_variance * likeness.mean_inflation(self.baseline);
        (known * (of_average + of_baseline)).sqrt()
    }

    /// Standard deviation of a test about the level, as known so far.
    pub(in crate::detect::runs) fn scatter(&self) -> f64 {
        if self.overruled { self.stated } else { self.spread(&self.scatter.likeness()) }
    }

    /// The same with its autocorrelation and the degrees of freedom of both.
    pub(super) fn known_scatter(&self) -> Scatter {
        let likeness = self.scatter.likeness();
        Scatter {
            deviation: if self.overruled { self.stated } else { self.spread(&likeness) },
            correlation: likeness.correlation,
            freedom: likeness.freedom,
        }
    }

    /// Probability of a false alarm of the level per test; `None` if `drift_sigma` overrides the rate.
    pub(in crate::detect::runs) fn alpha(&self) -> Option<f64> {
        (!self.overruled).then_some(self.alpha)
    }

    /// Standard deviation of a test. The baseline's own scatter is its lower limit until the joint has a history,
    /// except if other joints show the scatter better.
    fn spread(&self, likeness: &Likeness) -> f64 {
        let floor = if self.learnt() < OWN_FROM && !self.has_pool { self.stated } else { self.least };
        likeness.variance().sqrt().max(floor)
    }
}

fn estimate(of: &Observed) -> Estimate {
    Estimate { value: of.ratio, std_error: of.std_error }
}

/// Least accepted standard deviation from test to test, as a fraction of friction. It is also that of the prior.
fn least_spread(source: Source) -> f64 {
    match source {
        Source::Index => crate::detect::runs::history::friction_history::MIN_INDEX_SPREAD,
        Source::Warm | Source::Excitation => crate::detect::runs::history::friction_history::MIN_SPREAD,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::control_chart::steady_variance;
    use crate::detect::runs::fixtures::{JOINT, history, wobble};
    use crate::detect::runs::series::friction_history;
    use armwatch_model::anomaly::settings::DetectSettings;

    /// The limit after `learnt` daily tests with the scatter `scatter`.
    fn limit(settings: &DetectSettings, learnt: usize, scatter: f64) -> (f64, f64) {
        let runs = history(20, |_| 12.0);
        let causes = vec![None; runs.len()];
        let friction = friction_history(&runs, JOINT, &causes, settings.baseline_runs);
        let series = JointSeries::new(&runs, JOINT, &friction, &causes, &[], settings);
        let mut limit = LevelLimit::new(&series);
        let mut observed = series.friction.runs.first().copied().expect("warm friction");
        for run in 0..learnt {
            // wobble has a standard deviation of 0.5 %
            observed.ratio = 1.0 + (wobble(run) - 1.0) * scatter / 0.005;
            limit.learn(&observed);
        }
        let average = steady_variance(series.friction.spread);
        (limit.threshold(average), limit.limits().sigma)
    }

    #[test]
    fn a_steady_joint_has_the_least_change_and_a_restless_one_more() {
        let settings = DetectSettings::default();
        assert!((limit(&settings, 5, 0.005).0 - 0.05).abs() < 0.004);
        assert!((limit(&settings, 60, 0.005).0 - 0.05).abs() < 1e-12);
        assert!(limit(&settings, 60, 0.04).0 > 0.09);
    }

    #[test]
    fn the_limit_shrinks_as_tests_come_and_follows_the_rate() {
        let of = |rate: f64, learnt: usize| {
            let settings = DetectSettings { false_alarms_per_robot_year: rate, ..DetectSettings::default() };
            limit(&settings, learnt, 0.03).1
        };
        assert!(of(1.0, 5) > of(1.0, 40) && of(1.0, 40) > of(1.0, 400));
        assert!(of(0.1, 400) > of(1.0, 400) && of(1.0, 400) > of(20.0, 400));
        // one per year in 24 channels and daily tests: a probability of 1.2e-4 for each
        assert!((3.5..4.2).contains(&of(1.0, 4000)), "{}", of(1.0, 4000));
    }

    #[test]
    fn standard_deviations_that_are_set_overrule_the_rate() {
        let settings = DetectSettings { drift_sigma: Some(7.0), ..DetectSettings::default() };
        assert!((limit(&settings, 5, 0.04).1 - 7.0).abs() < 1e-12);
        assert!((limit(&settings, 5, 0.04).0 - limit(&settings, 60, 0.04).0).abs() < 1e-12);
    }
}
