//! Intervals of estimates, and their quantiles.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::IdentifiedParameter;

/// Probability that stated intervals contain the true value.
pub const LEVEL: f64 = 0.95;

/// Least degrees of freedom for replacing Student's distribution by the normal one: the relative difference of the
/// quantiles of 95 % is below 1e-6.
const NORMAL_FROM: f64 = 1e6;

/// True if the value is a probability. Functions of statrs panic on any other.
#[must_use]
pub fn is_probability(probability: f64) -> bool {
    (0.0..=1.0).contains(&probability)
}

/// Half the width of the two-sided interval about a parameter's value that contains the true value with the probability
/// `level`, such as 0.95. NaN if error or degrees of freedom are unknown.
#[must_use]
pub fn half_width(parameter: &IdentifiedParameter, level: f64) -> f64 {
    student_quantile(0.5 + 0.5 * level, parameter.degrees_of_freedom) * parameter.std_error
}

/// Quantile of Student's distribution with `freedom` degrees of freedom, not necessarily an integer, at `probability`
/// in (0, 1). NaN for another probability, or unless `freedom` is above 0.
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

/// Quantile of the standard normal distribution at `probability` in (0, 1); NaN for another one.
#[must_use]
pub fn normal_quantile(probability: f64) -> f64 {
    if is_probability(probability) { Normal::standard().inverse_cdf(probability) } else { f64::NAN }
}
