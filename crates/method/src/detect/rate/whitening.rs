//! Independent normal values from a series: the part of a value that its past does not predict.
//!
//! A value is `x_t = a + f x_(t-1) + e_t`; the variance of `e_t` is proportional to a known factor for each value.
//! Level, lag-1 autocorrelation `f` and scale are estimated from the earlier values, so that the scores include the
//! uncertainty of a short history. If `e` is normal, the next value has Student's distribution about its prediction,
//! and its distribution function at the value is uniform and independent of all earlier ones (recursive residuals:
//! Brown, Durbin and Evans 1975; self-starting charts: Hawkins 1987). The quantile of the normal distribution gives the
//! score. For `f` other than zero this is an approximation.
//!
//! Tails are not known. Five distributions of `e` compete, normal and Student's with `SHAPES` degrees of freedom, each
//! with its own estimates. The weight of each follows from its predictions until now (Dawid 1984), and the distribution
//! functions are mixed. Student's models weigh a value of `q` standard deviations by `(v + 1) / (v + q²)`, so outliers
//! hardly count. A short history does not show how heavy tails are beyond its values. So a model's values are scored by
//! the heavier tails of `TAILS`, which lowers the rate of false alarms. From some hundred values on, the history does
//! show it: this margin then shrinks as the number of values grows, so that the rate approaches the set one.

use crate::statistics::distributions::{normal_quantile, student_log_density, student_probability};
use armwatch_model::analysis::Estimate;

/// Degrees of freedom of the competing distributions.
const SHAPES: [f64; 5] = [f64::INFINITY, 10.0, 6.0, 4.0, 3.0];
/// Degrees of freedom of the tails for the scores of each model's values while few are known.
const TAILS: [f64; 5] = [f64::INFINITY, 7.0, 4.3, 2.9, 2.2];
/// Number of values after which this margin shrinks, in proportion to their inverse: some hundred distinguish
/// neighbouring shapes.
const MARGIN_UNTIL: f64 = 300.0;
/// Weights of the distributions before any value.
const WEIGHTS: [f64; 5] = [0.8, 0.05, 0.05, 0.05, 0.05];

/// Logarithm of a weight, relative to the largest, below which a distribution is not part of the mixture.
const NEGLIGIBLE: f64 = -14.0;

/// Standard deviation of the level about the first value, in scales.
const LEVEL_DEVIATION: f64 = 3.0;
/// Largest accepted autocorrelation: beyond it there is no level.
const LARGEST_CORRELATION: f64 = 0.95;

/// Knowledge about a series before its own values: from similar robots, or stated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Standard deviation of a value about its prediction, above 0.
    pub scale: f64,
    /// Number of values that this knowledge is worth, above 0.
    pub worth: f64,
    /// Lag-1 autocorrelation, and its standard deviation between series, above 0.
    pub correlation: Estimate,
}

/// Properties of a series, estimated from its values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Likeness {
    /// Mean.
    pub level: f64,
    /// Standard deviation of a value about its prediction.
    pub scale: f64,
    /// Lag-1 autocorrelation, 0 to 0.95.
    pub correlation: f64,
    /// Degrees of freedom of the scale: number of values that it is estimated from.
    pub freedom: f64,
}

/// Estimates from the values of a series until now.
#[derive(Debug, Clone)]
pub(crate) struct Whitener {
    /// Unit of all internal values.
    unit: f64,
    /// The first value, subtracted from the others.
    origin: Option<f64>,
    previous: f64,
    models: Vec<Model>,
}

/// One distribution with its estimates.
#[derive(Debug, Clone)]
struct Model {
    shape: f64,
    tail: f64,
    log_weight: f64,
    /// Values, and the sum of their weighted squares.
    count: f64,
    squares: f64,
    /// Intercept and autocorrelation, with their covariance in squares of the scale.
    intercept: f64,
    correlation: f64,
    covariance: [f64; 3],
}

/// A value as one model predicts it.
struct Predicted {
    off: f64,
    /// Variance of the value and of its prediction, in squares of the scale.
    own: f64,
    of_prediction: f64,
    scale: f64,
    /// Covariance of the estimates with the prediction.
    gain: [f64; 2],
    freedom: f64,
    tail_freedom: f64,
}

impl Whitener {
    /// A whitener before its first value.
    #[must_use]
    pub fn new(prior: Prior) -> Self {
        let model = |((shape, tail), weight): ((f64, f64), f64)| Model {
            shape,
            tail,
            log_weight: weight.ln(),
            count: prior.worth,
            squares: prior.worth,
            intercept: 0.0,
            correlation: prior.correlation.value,
            covariance: [LEVEL_DEVIATION.powi(2), 0.0, prior.correlation.std_error.powi(2)],
        };
        let models = SHAPES.into_iter().zip(TAILS).zip(WEIGHTS).map(model).collect();
        Self { unit: prior.scale, origin: None, previous: 0.0, models }
    }

    /// Score of a value that follows `previous`, from all learnt values: standard normal without a change. `std_error`
    /// is the value's standard error, or 0 if unknown; a value that is less certain than usual counts for less. Returns
    /// 0 while nothing is learnt.
    #[must_use]
    pub fn score(&self, previous: f64, value: f64, std_error: f64) -> f64 {
        let Some(origin) = self.origin else { return 0.0 };
        let [previous, x] = [previous, value].map(|of| (of - origin) / self.unit);
        let (mut below, mut above, mut all) = (0.0, 0.0, 0.0);
        for (model, weight) in self.weighted() {
            let predicted = model.predicted(x, previous, std_error / self.unit);
            let q = predicted.off / predicted.scale;
            let tail = student_probability(-q.abs(), predicted.tail_freedom);
            let (lower, upper) = if q < 0.0 { (tail, 1.0 - tail) } else { (1.0 - tail, tail) };
            below += weight * lower;
            above += weight * upper;
            all += weight;
        }
        let quantile = |part: f64| normal_quantile((part / all).clamp(f64::MIN_POSITIVE, 0.5));
        if below < above { quantile(below) } else { -quantile(above) }
    }

    /// Learns a value.
    pub fn learn(&mut self, value: f64, std_error: f64) {
        let Some(origin) = self.origin else {
            self.origin = Some(value);
            return;
        };
        let x = (value - origin) / self.unit;
        for model in &mut self.models {
            let predicted = model.predicted(x, self.previous, std_error / self.unit);
            model.learn(&predicted);
        }
        let largest = self.models.iter().map(|of| of.log_weight).fold(f64::NEG_INFINITY, f64::max);
        self.models.iter_mut().for_each(|of| of.log_weight -= largest);
        self.previous = x;
    }

    /// Properties of the series. The level is the only value, or the prior's zero, while there are fewer than two.
    #[must_use]
    pub fn likeness(&self) -> Likeness {
        let (mut all, mut level, mut variance, mut correlation, mut freedom) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (model, weight) in self.weighted() {
            let own = model.correlation.clamp(0.0, LARGEST_CORRELATION);
            all += weight;
            level += weight * model.intercept / (1.0 - own);
            variance += weight * model.squares / model.count * spread_of(model.shape);
            correlation += weight * own;
            freedom += weight * model.count;
        }
        Likeness {
            level: self.origin.unwrap_or(0.0) + self.unit * level / all,
            scale: self.unit * (variance / all).sqrt(),
            correlation: correlation / all,
            freedom: freedom / all,
        }
    }

    /// The models that are not negligible, with their weights relative to the largest.
    fn weighted(&self) -> impl Iterator<Item = (&Model, f64)> {
        let counts = |of: &&Model| of.log_weight > NEGLIGIBLE;
        self.models.iter().filter(counts).map(|of| (of, of.log_weight.exp()))
    }
}

/// Variance of Student's distribution; three degrees of freedom have three times that of the scale.
fn spread_of(shape: f64) -> f64 {
    if shape.is_finite() { shape / (shape - 2.0) } else { 1.0 }
}

impl Model {
    fn predicted(&self, x: f64, previous: f64, std_error: f64) -> Predicted {
        let [p, r, s] = self.covariance;
        let gain = [p + r * previous, r + s * previous];
        let usual = self.squares / self.count;
        let own = if std_error > 0.0 { (std_error * std_error / usual).max(1.0) } else { 1.0 };
        let of_prediction = gain[0] + gain[1] * previous;
        let both = |shape: f64| (shape.recip() + self.count.recip()).recip();
        Predicted {
            off: x - self.intercept - self.correlation * previous,
            own,
            of_prediction,
            scale: (usual * (own + of_prediction)).sqrt(),
            gain,
            freedom: both(self.shape),
            tail_freedom: both(self.tail_until_now()),
        }
    }

    /// Degrees of freedom of the tail for the score of a value: the margin shrinks with the number of learnt values.
    fn tail_until_now(&self) -> f64 {
        let margin = (MARGIN_UNTIL / self.count).min(1.0);
        let inverse = self.shape.recip() + margin * (self.tail.recip() - self.shape.recip());
        inverse.recip()
    }

    fn learn(&mut self, of: &Predicted) {
        let q = of.off / of.scale;
        self.log_weight += student_log_density(q, of.freedom) - of.scale.ln();
        let trust = if self.shape.is_finite() { (self.shape + 1.0) / (self.shape + q * q) } else { 1.0 };
        let total = of.own / trust + of.of_prediction;
        self.intercept += of.gain[0] / total * of.off;
        self.correlation += of.gain[1] / total * of.off;
        self.covariance[0] -= of.gain[0] * of.gain[0] / total;
        self.covariance[1] -= of.gain[0] * of.gain[1] / total;
        self.covariance[2] -= of.gain[1] * of.gain[1] / total;
        self.count += 1.0;
        self.squares += trust * of.off * of.off / (of.own + of.of_prediction);
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{StandardNormal, StudentT};

    use super::*;

    /// Little knowledge: a scale that is right within a factor of about three.
    fn vague(scale: f64) -> Prior {
        Prior { scale, worth: 3.0, correlation: Estimate { value: 0.4, std_error: 1.0 } }
    }

    fn series(correlation: f64, count: usize, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut state = 0.0;
        (0..count)
            .map(|_| {
                state = correlation * state + 0.02 * rng.sample::<f64, _>(StandardNormal);
                7.0 + state
            })
            .collect()
    }

    fn scores(values: &[f64], prior: Prior) -> Vec<f64> {
        let mut whitener = Whitener::new(prior);
        let mut previous = 0.0;
        let one = |value: &f64| {
            let score = whitener.score(previous, *value, 0.0);
            whitener.learn(*value, 0.0);
            previous = *value;
            score
        };
        values.iter().map(one).collect()
    }

    #[test]
    fn level_scale_and_memory_come_out() {
        for correlation in [0.0, 0.5, 0.9] {
            let mut whitener = Whitener::new(vague(0.05));
            series(correlation, 3000, 1).iter().for_each(|value| whitener.learn(*value, 0.0));
            let found = whitener.likeness();
            // four standard errors of each
            let error = 0.02 / (1.0 - correlation) / 3000.0_f64.sqrt();
            assert!((found.level - 7.0).abs() < 4.0 * error, "{found:?}");
            assert!((found.scale / 0.02 - 1.0).abs() < 4.0 / 6000.0_f64.sqrt() + 0.02, "{found:?}");
            assert!((found.correlation - correlation).abs() < 0.07, "{found:?}");
            assert!((found.freedom - 3002.0).abs() < 1e-6);
        }
    }

    #[test]
    fn scores_are_standard_normal_and_a_prior_that_is_wrong_by_two_is_soon_forgotten() {
        for (scale, from) in [(0.02, 40), (0.01, 300), (0.04, 300)] {
            let all: Vec<f64> = (0..200)
                .flat_map(|seed| scores(&series(0.3, 400, seed), vague(scale))[from..].to_vec())
                .collect();
            let n = all.len() as f64;
            let variance = all.iter().map(|z| z * z).sum::<f64>() / n;
            let far = all.iter().filter(|z| z.abs() > 3.0).count() as f64 / n;
            // four standard errors are 0.04; 0.0027 of normal values are as far out
            assert!((variance - 1.0).abs() < 0.04, "{scale}: {variance}");
            assert!((far / 0.0027 - 1.0).abs() < 0.5, "{scale}: {far}");
        }
    }

    #[test]
    fn heavy_tails_are_recognised_and_judged_by_heavier_ones_while_few_values_are_known() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let student = StudentT::new(4.0).expect("a shape");
        let mut far = [0.0; 2];
        for _ in 0..40 {
            let values: Vec<f64> = (0..3000).map(|_| rng.sample(student)).collect();
            let all = scores(&values, vague(1.0));
            for (count, part) in far.iter_mut().zip([60..300, 1000..3000]) {
                let length = part.len() as f64;
                *count += all[part].iter().filter(|z| z.abs() > 3.0).count() as f64 / length / 40.0;
            }
        }
        // of normal values, 0.0027 are as far out; the standard error of each is 4e-4 and 2e-4
        assert!(far[0] < 0.0027 && far[0] < far[1] && (far[1] / 0.0027 - 1.0).abs() < 0.3, "{far:?}");
        let mut whitener = Whitener::new(vague(1.0));
        (0..3000).for_each(|_| whitener.learn(rng.sample(student), 0.0));
        assert!((whitener.likeness().scale / 2.0_f64.sqrt() - 1.0).abs() < 0.15, "{:?}", whitener.likeness());
    }

    #[test]
    fn an_uncertain_value_counts_for_less() {
        let mut whitener = Whitener::new(vague(0.05));
        series(0.0, 200, 5).iter().for_each(|value| whitener.learn(*value, 0.0));
        let (sure, unsure) = (whitener.score(7.0, 7.1, 0.0), whitener.score(7.0, 7.1, 0.05));
        assert!(sure > 3.8 && (1.5..2.5).contains(&unsure), "{sure} {unsure}");
        let before = whitener.likeness();
        whitener.learn(7.3, 0.2);
        assert!((whitener.likeness().level - before.level).abs() < 0.001);
    }

    #[test]
    fn the_first_value_says_nothing_and_equal_ones_do_no_harm() {
        let all = scores(&[3.0; 50], vague(1.0));
        assert!(all[0].abs() < 1e-12 && all.iter().all(|z| z.is_finite()), "{all:?}");
    }
}
