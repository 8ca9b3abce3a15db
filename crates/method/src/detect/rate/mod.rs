//! Limits that follow from a rate of false alarms instead of being set.
//!
//! The setting is a number of false alarms per robot and year. [`budget`] divides it among the checked quantities and
//! the tests per year, which gives the mean number of values between two false alarms of each chart. [`average`] turns
//! that run length into the limit of a moving average, [`chart`] into the limit of a sequential chart. Charts need
//! values that are independent and normal. [`whitening`] computes these from a series, and `scatter` gives the variance
//! of a level. If a series has no history yet, `ranks` need no distribution. [`monitor`] combines these for one series.

pub mod budget;
pub mod average;
mod overshoot;
pub mod chart;
mod ranks;
pub mod whitening;
mod scatter;
pub mod monitor;
