//! Deterministic noise for tests.

/// A linear congruential sequence of numbers from its seed on, always the same.
#[derive(Debug, Clone)]
pub struct Noise(pub u64);

impl Noise {
    /// A number from 0 to 1.
    pub fn even(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A uniform number with mean 0 and standard deviation 1.
    pub fn uniform(&mut self) -> f64 {
        (self.even() - 0.5) * 12_f64.sqrt()
    }

    /// An approximately normal number with mean 0 and standard deviation 1, a sum of twelve.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.even()).sum::<f64>() - 6.0
    }
}
