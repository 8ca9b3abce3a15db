//! Quantiles and tails of the distributions for intervals and tests.

use statrs::distribution::{ChiSquared, Continuous, ContinuousCDF, FisherSnedecor, Normal, StudentsT};

use armwatch_model::analysis::interval::is_probability;

pub use armwatch_model::analysis::interval::{normal_quantile, student_quantile};

/// Smallest degrees of freedom that use the normal distribution for probabilities and densities of Student's: at four
/// standard deviations they differ by less than a hundredth.
const NEARLY_NORMAL_FROM: f64 = 1e4;

/// Probability that Student's distribution with `freedom` degrees of freedom, above 0, is below `x`. NaN for another
/// `freedom`.
#[must_use]
pub(crate) fn student_probability(x: f64, freedom: f64) -> f64 {
    if freedom >= NEARLY_NORMAL_FROM {
        return normal_probability(x);
    }
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::NAN, |student| student.cdf(x))
}

/// Logarithm of the density of Student's distribution with `freedom` degrees of freedom, above 0, at `x`. NaN for
/// another `freedom`.
#[must_use]
pub(crate) fn student_log_density(x: f64, freedom: f64) -> f64 {
    if freedom >= NEARLY_NORMAL_FROM {
        return Normal::standard().ln_pdf(x);
    }
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::NAN, |student| student.ln_pdf(x))
}

/// Probability that a standard normal variable is below `x`; NaN for NaN.
#[must_use]
pub fn normal_probability(x: f64) -> f64 {
    Normal::standard().cdf(x)
}

/// Quantile of the F distribution with `above` and `below` degrees of freedom at `probability` in (0, 1). NaN for
/// another probability, or unless both are above 0.
#[must_use]
pub(crate) fn f_quantile(probability: f64, above: f64, below: f64) -> f64 {
    match FisherSnedecor::new(above, below) {
        Ok(fisher) if is_probability(probability) => fisher.inverse_cdf(probability),
        _ => f64::NAN,
    }
}

/// Probability that chi-square with `freedom` degrees of freedom exceeds `x`. NaN unless `freedom` is above 0.
#[must_use]
pub fn chi_square_tail(x: f64, freedom: f64) -> f64 {
    ChiSquared::new(freedom).map_or(f64::NAN, |chi_square| chi_square.sf(x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::IdentifiedParameter;
    use armwatch_model::analysis::interval::{LEVEL, half_width};
    use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};

    /// Two-sided 95 % and 99 % points of Student's distribution (Abramowitz & Stegun, table 26.10).
    #[test]
    fn student_quantiles_are_those_of_tables() {
        for (freedom, at_95, at_99) in [
            (1.0, 12.706, 63.657),
            (2.0, 4.303, 9.925),
            (3.0, 3.182, 5.841),
            (4.0, 2.776, 4.604),
            (5.0, 2.571, 4.032),
            (10.0, 2.228, 3.169),
            (30.0, 2.042, 2.750),
            (120.0, 1.980, 2.617),
            (9e5, 1.960, 2.576),
            (f64::INFINITY, 1.960, 2.576),
        ] {
            for (probability, table) in [(0.975, at_95), (0.995, at_99)] {
                let found = student_quantile(probability, freedom);
                assert!((found - table).abs() < 6e-4, "{freedom} {probability}: {found} {table}");
                let below = student_quantile(1.0 - probability, freedom);
                assert!((found + below).abs() < 1e-6 * found, "{freedom}: {found} {below}");
            }
        }
    }

    /// Comparison with Cauchy's distribution for one degree of freedom, and with the closed form for two.
    #[test]
    fn few_degrees_of_freedom_are_taken_as_they_are() {
        for probability in [0.6_f64, 0.9, 0.975, 0.999] {
            let cauchy = (std::f64::consts::PI * (probability - 0.5)).tan();
            assert!((student_quantile(probability, 1.0) / cauchy - 1.0).abs() < 1e-8, "{probability}");
            let two = (2.0 * probability - 1.0) / (2.0 * probability * (1.0 - probability)).sqrt();
            assert!((student_quantile(probability, 2.0) / two - 1.0).abs() < 1e-8, "{probability}");
        }
        let between = student_quantile(0.975, 1.5);
        assert!(4.303 < between && between < 12.706, "{between}");
    }

    /// Consistency of probabilities with quantiles, and of densities with differences of probabilities.
    #[test]
    fn student_probabilities_and_densities_agree_with_quantiles() {
        for freedom in [2.2, 5.0, 40.0, 9000.0] {
            for probability in [1e-9, 1e-4, 0.2, 0.9] {
                let x = student_quantile(probability, freedom);
                assert!((student_probability(x, freedom) / probability - 1.0).abs() < 1e-5, "{freedom} {x}");
                let step = 1e-4 * x.abs().max(1.0);
                let slope = (student_probability(x + step, freedom) - student_probability(x - step, freedom))
                    / (2.0 * step);
                let density = student_log_density(x, freedom).exp();
                assert!((slope / density - 1.0).abs() < 1e-4, "{freedom} {x}: {slope} {density}");
            }
        }
        assert!((student_probability(-4.0, 9999.0) / student_probability(-4.0, 1e4) - 1.0).abs() < 0.01);
        assert!(student_probability(1.0, 0.0).is_nan() && student_log_density(1.0, -1.0).is_nan());
    }

    #[test]
    fn normal_quantiles_are_those_of_tables() {
        for (probability, table) in [(0.5, 0.0), (0.975, 1.959_964), (0.95, 1.644_854), (0.001, -3.090_232)] {
            let found = normal_quantile(probability);
            assert!((found - table).abs() < 1e-6, "{probability}: {found}");
        }
    }

    /// 95 % points (Abramowitz & Stegun, table 26.9).
    #[test]
    fn f_quantiles_are_those_of_tables() {
        for (above, below, table) in [
            (1.0, 1e6, 3.8415),
            (1.0, 1.0, 161.45),
            (2.0, 3.0, 9.552),
            (5.0, 20.0, 2.711),
            (10.0, 120.0, 1.910),
        ] {
            let found = f_quantile(0.95, above, below);
            assert!((found / table - 1.0).abs() < 3e-4, "{above} {below}: {found} {table}");
        }
    }

    #[test]
    fn chi_square_tails_are_those_of_tables() {
        for (x, freedom, table) in [
            (3.841, 1.0, 0.05),
            (5.991, 2.0, 0.05),
            (9.488, 4.0, 0.05),
            (23.209, 10.0, 0.01),
            (0.0, 4.0, 1.0),
        ] {
            assert!((chi_square_tail(x, freedom) - table).abs() < 1e-4, "{x} {freedom}");
        }
    }

    #[test]
    fn an_interval_without_degrees_of_freedom_is_none() {
        let id = ParameterId { joint: JointIndex::new(0), kind: ParameterKind::MotorInertia };
        let parameter =
            |degrees_of_freedom| IdentifiedParameter { id, value: 1.0, std_error: 0.5, degrees_of_freedom };
        assert!(half_width(&parameter(f64::NAN), LEVEL).is_nan());
        assert!((half_width(&parameter(1.0), LEVEL) - 6.353).abs() < 1e-3);
    }
}
