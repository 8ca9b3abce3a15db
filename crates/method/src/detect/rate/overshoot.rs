//! How far a likelihood ratio jumps over its limit.

use crate::statistics::distributions::normal_probability;

/// Terms after which the rest of the series is below a thousandth of the result for shifts of 0.3 and more.
const TERMS: u32 = 2000;

/// Mean of `exp(-overshoot)` of the log-likelihood ratio of a shift by `shift` standard deviations over a distant limit:
///
/// ```text
/// v(x) = 2 / x² exp(-2 sum_n Phi(-x sqrt(n) / 2) / n)
/// ```
///
/// which is `exp(-0.583 x)` for small shifts (Siegmund 1985, chapter IV). `shift` above 0, from 0.3 on.
#[must_use]
pub fn overshoot_factor(shift: f64) -> f64 {
    let term = |n: u32| normal_probability(-0.5 * shift * f64::from(n).sqrt()) / f64::from(n);
    let sum: f64 = (1..=TERMS).map(term).take_while(|term| *term > 1e-12).sum();
    2.0 / (shift * shift) * (-2.0 * sum).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_shifts_agree_with_the_exponential() {
        for (shift, tolerance) in [(0.3, 0.002), (0.5, 0.003), (1.0, 0.005), (2.0, 0.03)] {
            let (exact, simple) = (overshoot_factor(shift), (-0.583 * shift).exp());
            assert!((exact / simple - 1.0).abs() < tolerance, "{shift}: {exact} {simple}");
        }
    }

    #[test]
    fn a_large_shift_jumps_by_its_whole_likelihood_ratio() {
        // one value decides: v tends to 2 / x²
        assert!((overshoot_factor(12.0) * 72.0 - 1.0).abs() < 1e-6);
    }
}
