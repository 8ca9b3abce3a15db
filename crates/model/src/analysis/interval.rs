//! Intervals of estimates, and the quantiles that they follow from.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::IdentifiedParameter;

/// Probability that stated intervals hold the truth with.
pub const LEVEL: f64 = 0.95;

/// Degrees of freedom from which on Student's distribution is taken for the normal one: the quantiles of 95 % differ by
/// less than 1e-6 of themselves.
const NORMAL_FROM: f64 = 1e6;

/// Whether the value is a probability. Functions of statrs panic on any other.
#[must_use]
pub fn is_probability(probability: f64) -> bool {
    (0.0..=1.0).contains(&probability)
}

/// Half the width of the two-sided interval about a parameter's value that holds the truth with the
/// probability `level`, such as 0.95. Not a number if error or degrees of freedom are not known.
#[must_use]
pub fn half_width(parameter: &IdentifiedParameter, level: f64) -> f64 {
    student_quantile(0.5 + 0.5 * level, parameter.degrees_of_freedom) * parameter.std_error
}

/// Quantile of Student's distribution with `freedom` degrees of freedom, which need not be whole, at `probability` in
/// (0, 1). Not a number for another probability, or unless `freedom` is above 0.
#[must_use]
pub fn student_quantile(probability: f64, freedom: f64) -> f64 {
    if freedom >= NORMAL_FROM {
        return normal_quantile(probability);
    }
    match StudentsT::new(0.0, 1.0, freedom) {
        Ok(student) if is_probability(probability) => student.inverse_cdf(probability),
        _ => f64::NAN,
    }
}

/// Quantile of the standard normal distribution at `probability` in (0, 1); not a number for another one.
#[must_use]
pub fn normal_quantile(probability: f64) -> f64 {
    if is_probability(probability) { Normal::standard().inverse_cdf(probability) } else { f64::NAN }
}
