//! Sums of identified parameters with their errors, and the thresholds beyond which they are not plausible.

/// Thresholds of plausibility.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlausibleSettings {
    /// Smallest relative RMSD of the moving excitation rows that is reported, and that is refused. Healthy arms stay
    /// below 0.13 (thesis, chapter 5).
    pub relative_rmsd: [f64; 2],
    /// Smallest distance of a negative number from zero, in standard errors, for a finding.
    pub standard_errors: f64,
    /// Smallest factor between identified and nominal inertia of a joint that is reported, and that is refused.
    pub nominal_factors: [f64; 2],
}

impl Default for PlausibleSettings {
    fn default() -> Self {
        Self { relative_rmsd: [0.2, 0.4], standard_errors: 3.0, nominal_factors: [3.0, 9.5] }
    }
}

/// Linear function of the parameters, with its variance from uncorrelated errors.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Combination {
    pub(super) value: f64,
    pub(super) variance: f64,
}

impl Combination {
    pub(super) fn add(&mut self, coefficient: f64, value: f64, sigma: f64) {
        self.value += coefficient * value;
        // a parameter that the motion does not show has no error, so sums with it are unknown
        if coefficient != 0.0 {
            self.variance += if sigma.is_finite() { (coefficient * sigma).powi(2) } else { f64::INFINITY };
        }
    }
}
