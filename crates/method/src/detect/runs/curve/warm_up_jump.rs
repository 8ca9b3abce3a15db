//! Another time constant of the warm-up from some test on, which no single test shows.
//!
//! Each test gives the factor between its slow time constant and that of the usual curve, with a standard error up to a
//! half. The usual curve's own error is the same in all tests, so later ones are compared with earlier ones and not
//! with the curve. The latest [`WINDOW`] tests are fitted as a level and a jump at any of them, by least squares on
//! whitened values. Scatter and autocorrelation are those of the residuals, shrunk towards a prior. (Computed about one
//! level, a jump that is not found at once would count as scatter.) A jump counts if
//!
//! * it is a factor of at least [`LEAST_FACTOR`], or of 1.6 for the part that all joints share, or its inverse,
//! * it is beyond chance by Student's distribution, with the channel's probability at the set rate of false alarms
//!   divided by the number of tried places, and with the margin for the model of the noise that other comparisons of
//!   causes have,
//! * it is more than the effect of a change that all joints have in common, of friction and of the warm-up.
//!
//! It continues until the mean of the latest [`LATEST`] tests differs from the mean before by less than half of the
//! logarithm of the least factor.

use crate::detect::rate::budget::{MODEL_MARGIN, beyond_chance};
use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::curve::run_cause::{RunCause, WarmUpOfRun};
use crate::detect::runs::history::whitened::{Fit, Whitened};
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::Estimate;

/// Least ratio of time constants that counts, and the least tried one of one run.
pub(in crate::detect::runs) const LEAST_FACTOR: f64 = 1.25;
/// Limits that a jump must exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::runs) struct JumpLimits {
    /// Least factor.
    least_factor: f64,
    /// Factor on the limit of chance; above 1 if the scatter of the tests does not show all of it.
    chance: f64,
    /// Logarithm of the factor caused by a change of all joints' friction, per unit of that change.
    with_common: f64,
}

impl JumpLimits {
    /// Limits of a joint. A lower ambient temperature changes the warm-up.
    pub(in crate::detect::runs) const OF_JOINT: Self =
        Self { least_factor: LEAST_FACTOR, chance: 1.0, with_common: 10.0 };
    /// Limits of the part that all joints share. Starts and ambient temperatures differ for some time in all joints
    /// alike, which the scatter of earlier tests does not show. Of 160 simulated years, ten had such a jump with the
    /// limits of a joint, one with these. The change of friction is that of the first cycle.
    pub(in crate::detect::runs) const OF_ARM: Self =
        Self { least_factor: 1.6, chance: 1.6, with_common: 20.0 };
}

/// Most tests in a fit.
const WINDOW: usize = 80;
/// Fewest tests before a jump and from it on.
const FEWEST: usize = 5;
/// Number of tests whose mean decides if a jump continues.
const LATEST: usize = 5;
/// Prior of the standard deviation from test to test, as a part of the standard error of one test, and the number of
/// tests that it is worth. The median of simulated robots is 0.6: every standard error contains the error of the usual
/// curve.
const PART_OF_ERROR: f64 = 0.7;
const WORTH: f64 = 10.0;
/// Least accepted standard deviation from test to test, of the factor's logarithm.
const LEAST_DEVIATION: f64 = 0.03;
/// Prior of the lag-1 autocorrelation, and the number of tests that it is worth: a standard deviation of 0.2.
const CORRELATION: f64 = 0.2;
const CORRELATION_WORTH: f64 = 25.0;
/// Largest accepted autocorrelation.
const MOST_CORRELATION: f64 = 0.9;
/// Least standard error of a test that is not used.
const SAYS_NOTHING: f64 = 1.0;

/// A jump that is more than chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::runs) struct Jump {
    /// Natural logarithm of the factor, from the mean before to the mean of the latest tests.
    pub(in crate::detect::runs) size: f64,
    /// Number of tests with the jump.
    pub(in crate::detect::runs) tests: usize,
    /// Place of the first run with the jump.
    pub(in crate::detect::runs) since: usize,
    before: f64,
}

/// The tests of a joint in their order.
pub(in crate::detect::runs) struct WarmUpJump {
    alpha: f64,
    limits: JumpLimits,
    tests: Vec<Estimate>,
    /// Places of their runs.
    runs: Vec<usize>,
    /// Logarithms of the factors that changes common to all joints may cause in each test: by friction, and by the
    /// warm-up.
    beside: Vec<[f64; 2]>,
    jump: Option<Jump>,
}

impl WarmUpJump {
    /// The state before the first test. `alpha` is the probability of a false alarm of the channel per test.
    pub(in crate::detect::runs) fn new(alpha: f64, limits: JumpLimits) -> Self {
        Self { alpha, limits, tests: Vec::new(), runs: Vec::new(), beside: Vec::new(), jump: None }
    }

    /// Adds the test of the run at this place and returns its jump. `of_arm` is the factor's logarithm that all joints
    /// share; a joint may have more or less of it.
    pub(in crate::detect::runs) fn add(&mut self, run: usize, cause: &RunCause, of_arm: f64) -> Option<Jump> {
        let is_of_level = matches!(cause.clear(), None | Some(Cause::TimeConstant(_)));
        let is_known = |of: &WarmUpOfRun| is_of_level && of.ln_factor.std_error < SAYS_NOTHING;
        let Some(test) = cause.warm_up.filter(is_known) else { return self.jump };
        self.tests.push(test.ln_factor);
        self.runs.push(run);
        self.beside.push([self.limits.with_common * test.common, of_arm]);
        self.jump = match self.jump.take() {
            Some(jump) => self.goes_on(jump),
            None => self.begins(),
        };
        self.jump
    }

    /// Continues the jump if the latest tests are still nearer to its level.
    fn goes_on(&mut self, jump: Jump) -> Option<Jump> {
        let tests = jump.tests + 1;
        let latest: Vec<f64> = self.tests.iter().rev().take(LATEST.min(tests)).map(|of| of.value).collect();
        let size = mean(&latest)? - jump.before;
        if size.signum() == jump.size.signum() && size.abs() > 0.5 * LEAST_FACTOR.ln() {
            return Some(Jump { size, tests, ..jump });
        }
        // tests with a jump are not used for the usual level
        let begin = self.tests.len().saturating_sub(tests);
        self.tests.truncate(begin);
        self.runs.truncate(begin);
        self.beside.truncate(begin);
        None
    }

    fn begins(&self) -> Option<Jump> {
        let tests = &self.tests[self.tests.len().saturating_sub(WINDOW)..];
        let tried = (tests.len() + 1).checked_sub(2 * FEWEST).filter(|tried| *tried > 0)?;
        let prior = prior(tests)?;
        let (begin, fit) = likeliest(tests, prior, CORRELATION)?;
        let correlation = correlation(tests, begin, &fit, prior);
        let (begin, fit) = likeliest(tests, prior, correlation)?;
        let (size_error, freedom) = size_error(&fit, tests);
        // a log-likelihood is half a square of standard deviations
        let chance = beyond_chance(0.5 * self.alpha / tried as f64, freedom);
        let by_chance = chance.hypot((2.0 * MODEL_MARGIN).sqrt()) * size_error;
        let beside = &self.beside[self.beside.len() - tests.len()..];
        let change = |of: usize| {
            let mean = |tests: &[[f64; 2]]| mean(&tests.iter().map(|each| each[of]).collect::<Vec<f64>>());
            Some(mean(&beside[begin..])? - mean(&beside[..begin])?)
        };
        let needed = (self.limits.chance * by_chance).hypot(change(0)?).hypot(change(1)?);
        (fit.size.abs() >= needed.max(self.limits.least_factor.ln())).then_some(Jump {
            size: fit.size,
            tests: tests.len() - begin,
            since: self.runs[self.runs.len() - tests.len() + begin],
            before: fit.level,
        })
    }
}

/// The jump of tests with the one at `begin`: logarithm of the factor, and its standard error by the scatter of the
/// tests about the two levels. The place is given and not fitted. `None` with fewer than [`FEWEST`] tests before it or
/// none from it on.
pub(in crate::detect::runs) fn jump_at(tests: &[Estimate], begin: usize) -> Option<Estimate> {
    let first = begin.saturating_sub(WINDOW);
    let (tests, begin) = (&tests[first..], begin - first);
    if begin < FEWEST || tests.len() <= begin {
        return None;
    }
    let prior = prior(tests)?;
    let pattern = |place: usize| if place < begin { 0.0 } else { 1.0 };
    let fit_with = |correlation: f64| Whitened::new(tests, prior, correlation).fit(pattern);
    let fit = fit_with(correlation(tests, begin, &fit_with(CORRELATION), prior));
    Some(Estimate { value: fit.size, std_error: size_error(&fit, tests).0 })
}

/// Prior of the standard deviation from test to test.
fn prior(tests: &[Estimate]) -> Option<f64> {
    let usual = median(&tests.iter().map(|of| of.std_error).collect::<Vec<f64>>())?;
    Some((PART_OF_ERROR * usual).max(LEAST_DEVIATION))
}

/// Standard error of a jump by the scatter about the fit, and the degrees of freedom of that scatter with its prior.
fn size_error(fit: &Fit, tests: &[Estimate]) -> (f64, f64) {
    // level and size are fitted
    let freedom = WORTH + tests.len() as f64 - 2.0;
    (fit.size_error * ((WORTH + fit.rest) / freedom).sqrt(), freedom)
}

/// The place of the jump that explains the tests best if they scatter by `deviation`, and the fit.
fn likeliest(tests: &[Estimate], deviation: f64, correlation: f64) -> Option<(usize, Fit)> {
    let fits = Whitened::new(tests, deviation, correlation).jumps();
    let places = fits.into_iter().zip(1..).map(|(fit, begin)| (begin, fit));
    let tried = places.filter(|(begin, _)| (FEWEST..=tests.len() - FEWEST).contains(begin));
    tried.min_by(|a, b| a.1.rest.total_cmp(&b.1.rest))
}

/// Lag-1 autocorrelation of the residuals of a jump, shrunk towards its prior. The fit of two means lowers the products
/// of neighbours; the bias is added again.
fn correlation(tests: &[Estimate], begin: usize, fit: &Fit, deviation: f64) -> f64 {
    let expected = |place: usize| fit.level + if place < begin { 0.0 } else { fit.size };
    let residuals: Vec<f64> =
        tests.iter().enumerate().map(|(place, of)| of.value - expected(place)).collect();
    let squares: f64 = residuals.iter().map(|of| of * of).sum();
    let variance = (WORTH * deviation * deviation + squares) / (WORTH + tests.len() as f64 - 2.0);
    let products: f64 = residuals.windows(2).map(|of| of[0] * of[1]).sum();
    let bias = 2.0 * (1.0 + CORRELATION) / (1.0 - CORRELATION);
    let sum = CORRELATION_WORTH * CORRELATION + products / variance + bias;
    (sum / (CORRELATION_WORTH + tests.len() as f64 - 1.0)).clamp(-MOST_CORRELATION, MOST_CORRELATION)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// One alarm per year with 45 channels and daily tests.
    const ALPHA: f64 = 1.0 / (45.0 * 365.25);

    /// Number of tests until the first jump of a series that jumps by `size` with the test `at`.
    fn first(seed: u64, count: usize, correlation: f64, at: usize, size: f64) -> Option<(usize, Jump)> {
        first_with_hall(seed, count, correlation, at, [size, 0.0])
    }

    /// The same if friction of all joints also changes with that test, by this part.
    fn first_with_hall(
        seed: u64,
        count: usize,
        correlation: f64,
        at: usize,
        [size, hall]: [f64; 2],
    ) -> Option<(usize, Jump)> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut state, deviation) = (0.0, 0.2);
        // the error of the usual curve is the same in all tests
        let usual = 0.1 * rng.sample::<f64, _>(StandardNormal);
        let mut of = WarmUpJump::new(ALPHA, JumpLimits::OF_JOINT);
        (0..count).find_map(|test| {
            let fresh = deviation * rng.sample::<f64, _>(StandardNormal);
            state = correlation * state + fresh * f64::sqrt(1.0 - correlation * correlation);
            let [size, hall] = if test >= at { [size, hall] } else { [0.0; 2] };
            let value = usual + state + size;
            let warm_up = WarmUpOfRun { ln_factor: Estimate { value, std_error: 0.15 }, common: hall };
            let cause = RunCause { warm_up: Some(warm_up), ..RunCause::of_nothing() };
            of.add(test, &cause, 0.0).map(|jump| (test, jump))
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

    /// 500 series of 30 tests that jump by 0.4, or not at all, with the twenty-first.
    #[test]
    fn a_jump_at_a_given_place_lies_within_its_standard_errors() {
        for (size, correlation) in [(0.0, 0.0), (0.4, 0.0), (0.4, 0.3)] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut within = 0;
            for _ in 0..500 {
                let mut state = 0.0;
                let test = |place: usize| {
                    let fresh = 0.2 * rng.sample::<f64, _>(StandardNormal);
                    state = correlation * state + fresh * f64::sqrt(1.0 - correlation * correlation);
                    Estimate { value: state + if place < 20 { 0.0 } else { size }, std_error: 0.25 }
                };
                let tests: Vec<Estimate> = (0..30).map(test).collect();
                let jump = jump_at(&tests, 20).expect("a jump");
                within += usize::from((jump.value - size).abs() <= 2.0 * jump.std_error);
            }
            assert!((450..=490).contains(&within), "{size}, {correlation}: {within} of 500");
        }
    }

    #[test]
    fn a_jump_needs_tests_on_both_sides() {
        let tests = [Estimate { value: 0.1, std_error: 0.2 }; 8];
        assert!(jump_at(&tests, FEWEST - 1).is_none() && jump_at(&tests, 8).is_none());
        assert!(jump_at(&tests, FEWEST).is_some() && jump_at(&tests, 7).is_some());
    }

    #[test]
    fn what_goes_with_a_change_of_all_joints_is_no_jump() {
        let found = |hall: f64| {
            (0..50).filter(|seed| first_with_hall(*seed, 100, 0.2, 40, [0.5, hall]).is_some()).count()
        };
        let (alone, with_hall) = (found(0.0), found(0.1));
        assert!(alone >= 45 && with_hall == 0, "{alone} and {with_hall} of 50");
    }

    /// 400 series of a year: 0.02 are expected in each.
    #[test]
    fn chance_seldom_jumps() {
        for correlation in [0.0, 0.4] {
            let found = (0..400).filter(|seed| first(*seed, 365, correlation, 400, 0.0).is_some()).count();
            println!("correlation {correlation}: {found} of 400 series of a year");
            assert!(found <= 16, "correlation {correlation}: {found} of 400");
        }
    }
}
