//! Student's distribution: from a standard error and its degrees of freedom to an interval.

use crate::analysis::IdentifiedParameter;

/// Half the width of the two-sided interval about a parameter's value that holds the truth with the
/// probability `level`, such as 0.95. Not a number if error or degrees of freedom are not known.
#[must_use]
pub fn half_width(parameter: &IdentifiedParameter, level: f64) -> f64 {
    match parameter.degrees_of_freedom.is_nan() {
        true => f64::NAN,
        false => student_quantile(0.5 + 0.5 * level, parameter.degrees_of_freedom) * parameter.std_error,
    }
}

/// Quantile of Student's distribution with `freedom` degrees of freedom at `probability` (0.5 to
/// 1): expansion about the normal quantile (Abramowitz & Stegun 26.7.5), good to 1 % from four degrees
/// of freedom on; fewer than three count as three.
#[must_use]
pub fn student_quantile(probability: f64, freedom: f64) -> f64 {
    let z = normal_quantile(probability);
    let v = freedom.max(3.0);
    let (z3, z5, z7) = (z.powi(3), z.powi(5), z.powi(7));
    let z9 = z.powi(9);
    z + (z3 + z) / (4.0 * v)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * v * v)
        + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * v.powi(3))
        + (79.0 * z9 + 776.0 * z7 + 1482.0 * z5 - 1920.0 * z3 - 945.0 * z) / (92160.0 * v.powi(4))
}

/// Quantile of the standard normal distribution at `probability` in (0, 1), absolute error below
/// 4.5e-4 (Abramowitz & Stegun 26.2.23).
#[must_use]
pub fn normal_quantile(probability: f64) -> f64 {
    let tail = probability.min(1.0 - probability).max(f64::MIN_POSITIVE);
    let t = (-2.0 * tail.ln()).sqrt();
    let x = t
        - (2.515_517 + 0.802_853 * t + 0.010_328 * t * t)
            / (1.0 + 1.432_788 * t + 0.189_269 * t * t + 0.001_308 * t.powi(3));
    if probability < 0.5 { -x } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (freedom, table) in [(5.0, 2.571), (10.0, 2.228), (30.0, 2.042), (1e6, 1.960)] {
            let found = student_quantile(0.975, freedom);
            assert!((found - table).abs() < 0.002, "{freedom}: {found} {table}");
        }
    }
}
