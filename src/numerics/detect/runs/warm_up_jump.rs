//! Another time constant of the warm-up from some test on, which no single test shows.
//!
//! Each test says by which factor the slow time constant differs from that of the usual curve, with a standard error that
//! may be a half. The usual curve's own error is alike in all tests, so that later ones are compared with earlier ones and
//! not with it: the latest [`WINDOW`] tests are fitted as a level and a jump at any of them, as [`super::steady_rise`] fits a
//! rise. A jump counts if it is a factor of [`LEAST_FACTOR`] or its inverse, and beyond chance: of Student's distribution,
//! with the probability that a channel has at the rate of false alarms asked for, divided by the number of places that are
//! tried, and with the margin for the model of the noise that other comparisons of causes have. It goes on until the mean of
//! the latest [`LATEST`] tests differs from that before by less than half of the least factor's logarithm.

use super::curve::hypothesis::Cause;
use super::curve::run_cause::RunCause;
use super::quiet_scatter::QuietScatter;
use super::whitened::{Scatter, Whitened};
use crate::analysis::Estimate;
use crate::numerics::detect::rate::budget::{MODEL_MARGIN, beyond_chance};
use crate::numerics::statistics::descriptive::{mean, median};

/// Least ratio of time constants that counts, and the least that is tried of one run.
pub(super) const LEAST_FACTOR: f64 = 1.25;
/// Tests that are fitted at most.
const WINDOW: usize = 80;
/// Fewest tests before a jump and from it on.
const FEWEST: usize = 5;
/// Tests whose mean says whether a jump goes on.
const LATEST: usize = 5;
/// Tests that the scatter is learnt from: more than the level of friction needs, since memory shows in many tests.
const MOST_LEARNT: usize = 200;
/// Tests that the standard error of one, the prior of the scatter, is worth.
const WORTH: f64 = 20.0;
/// Least standard deviation from test to test that is believed, of the factor's logarithm.
const LEAST_DEVIATION: f64 = 0.03;
/// Standard error from which on a test says nothing.
const SAYS_NOTHING: f64 = 1.0;

/// A jump that is more than chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Jump {
    /// Natural logarithm of the factor, from the mean before to the mean of the latest tests.
    pub(super) size: f64,
    /// Tests that have it.
    pub(super) tests: usize,
    before: f64,
}

/// The tests of a joint as they come.
pub(super) struct WarmUpJump {
    baseline: usize,
    alpha: f64,
    tests: Vec<Estimate>,
    /// `None` before the first test.
    scatter: Option<QuietScatter>,
    jump: Option<Jump>,
}

impl WarmUpJump {
    /// Before the first test. `baseline` tests are learnt at once; `alpha` is the probability of a false alarm that the
    /// channel has with each test.
    pub(super) fn new(baseline: usize, alpha: f64) -> Self {
        Self { baseline: baseline.max(2), alpha, tests: Vec::new(), scatter: None, jump: None }
    }

    /// Takes a test; the jump that it belongs to.
    pub(super) fn add(&mut self, cause: &RunCause) -> Option<Jump> {
        let is_of_level = matches!(cause.clear(), None | Some(Cause::TimeConstant(_)));
        let Some(test) = cause.warm_up.filter(|of| is_of_level && of.std_error < SAYS_NOTHING) else {
            return self.jump;
        };
        self.tests.push(test);
        self.jump = match self.jump.take() {
            Some(jump) => self.goes_on(jump),
            None => self.begins(),
        };
        let prior = || QuietScatter::new(test.std_error.max(LEAST_DEVIATION), WORTH, MOST_LEARNT);
        let scatter = self.scatter.get_or_insert_with(prior);
        match self.jump {
            Some(_) => scatter.out(),
            None if self.tests.len() <= self.baseline => scatter.learn(test),
            None => _ = scatter.quiet(test),
        }
        self.jump
    }

    /// Whether the latest tests are still nearer to what they jumped to.
    fn goes_on(&mut self, jump: Jump) -> Option<Jump> {
        let tests = jump.tests + 1;
        let latest: Vec<f64> = self.tests.iter().rev().take(LATEST.min(tests)).map(|of| of.value).collect();
        let size = mean(&latest)? - jump.before;
        if size.signum() == jump.size.signum() && size.abs() > 0.5 * LEAST_FACTOR.ln() {
            return Some(Jump { size, tests, ..jump });
        }
        // what was out says nothing of what is usual
        let begin = self.tests.len().saturating_sub(tests);
        self.tests.truncate(begin);
        None
    }

    fn begins(&self) -> Option<Jump> {
        let tests = &self.tests[self.tests.len().saturating_sub(WINDOW)..];
        let begins = FEWEST..(tests.len() + 1).checked_sub(FEWEST)?;
        let tried = begins.len();
        let likeness = self.scatter.as_ref()?.likeness();
        let usual = median(&tests.iter().map(|of| of.std_error).collect::<Vec<f64>>())?;
        let scatter = Scatter {
            deviation: likeness.variance().sqrt().max(usual).max(LEAST_DEVIATION),
            correlation: likeness.correlation,
            freedom: likeness.freedom,
        };
        let whitened = Whitened::new(tests, &scatter);
        let fits = begins.map(|begin| (begin, whitened.jump(begin)));
        let (begin, fit) = fits.min_by(|a, b| a.1.rest.total_cmp(&b.1.rest))?;
        // a log-likelihood is half a square of standard deviations
        let chance = beyond_chance(0.5 * self.alpha / tried as f64, scatter.freedom);
        let needed = chance.hypot((2.0 * MODEL_MARGIN).sqrt()) * fit.size_error;
        (fit.size.abs() >= needed.max(LEAST_FACTOR.ln())).then_some(Jump {
            size: fit.size,
            tests: tests.len() - begin,
            before: fit.level,
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// One alarm a year of 45 channels and daily tests.
    const ALPHA: f64 = 1.0 / (45.0 * 365.25);

    /// Tests until the first jump, of a series that jumps by `size` with the test `at`.
    fn first(seed: u64, count: usize, correlation: f64, at: usize, size: f64) -> Option<(usize, Jump)> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut state, deviation) = (0.0, 0.2);
        // what the usual curve has wrong is alike in all tests
        let common = 0.1 * rng.sample::<f64, _>(StandardNormal);
        let mut of = WarmUpJump::new(5, ALPHA);
        (0..count).find_map(|test| {
            let fresh = deviation * rng.sample::<f64, _>(StandardNormal);
            state = correlation * state + fresh * f64::sqrt(1.0 - correlation * correlation);
            let value = common + state + if test >= at { size } else { 0.0 };
            let cause =
                RunCause { warm_up: Some(Estimate { value, std_error: 0.15 }), ..RunCause::of_nothing() };
            of.add(&cause).map(|jump| (test, jump))
        })
    }

    #[test]
    fn a_doubled_time_constant_is_found_though_no_test_shows_it() {
        let mut late = 0;
        for seed in 0..100 {
            let Some((test, jump)) = first(seed, 100, 0.2, 40, 2.0_f64.ln()) else {
                late += 1;
                continue;
            };
            assert!(test >= 40, "seed {seed}: {test} {jump:?}");
            late += usize::from(test > 40 + 15);
        }
        assert!(late <= 5, "{late} of 100 not within 15 tests");
    }

    /// 400 series of a year: 0.02 are to be expected of each.
    #[test]
    fn chance_seldom_jumps() {
        for correlation in [0.0, 0.4] {
            let found = (0..400).filter(|seed| first(*seed, 365, correlation, 400, 0.0).is_some()).count();
            println!("correlation {correlation}: {found} of 400 series of a year");
            assert!(found <= 16, "correlation {correlation}: {found} of 400");
        }
    }
}
