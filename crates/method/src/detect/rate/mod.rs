//! Limits that follow from a rate of false alarms instead of being set.
//!
//! The setting is a number of false alarms per robot and year. [`budget`] divides it among the checked quantities and
//! the tests per year, which gives the mean number of values between two false alarms of each chart. [`average`] turns
//! that run length into the limit of a moving average, `chart` into the limit of a sequential chart. Charts need
//! values that are independent and normal. `whitening` computes these from a series, and `scatter` gives the variance
//! of a level.

pub mod budget;
pub mod average;
pub(crate) mod chart;
pub(crate) mod whitening;
mod scatter;

/// Number of a series' own values that its limit is based on alone.
pub(crate) const OWN_FROM: usize = 40;
