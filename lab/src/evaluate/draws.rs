//! Random numbers of one robot: a separate stream, so that threads and their order have no effect.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StudentT};

/// Offset that separates the streams of [`Draws::aside`] from all others.
const ASIDE: u64 = 1 << 62;

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub(super) struct Draws(ChaCha8Rng);

impl Draws {
    /// Stream number `stream` of `seed`.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream);
        Self(rng)
    }

    /// A separate stream, which takes no numbers from this one.
    pub(super) fn aside(&self) -> Self {
        let mut rng = self.0.clone();
        rng.set_stream(rng.get_stream() ^ ASIDE);
        Self(rng)
    }

    /// Uniform.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Uniform in the logarithm; both ends positive.
    pub(super) fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// A whole number from `low` to `high`, both included.
    pub(super) fn whole(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high.max(low))
    }

    /// Returns true with this probability.
    pub(super) fn happens(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// -1 with this probability, otherwise 1.
    pub(super) fn sign(&mut self, negative: f64) -> f64 {
        if self.happens(negative) { -1.0 } else { 1.0 }
    }

    /// Standard normal.
    pub(super) fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// Noise of variance one: normal, or with the tails of Student's distribution of `freedom` (above 2).
    pub(super) fn noise(&mut self, freedom: Option<f64>) -> f64 {
        match freedom.map(|freedom| (freedom, StudentT::new(freedom))) {
            Some((freedom, Ok(student))) => student.sample(&mut self.0) * ((freedom - 2.0) / freedom).sqrt(),
            _ => self.normal(),
        }
    }
}
