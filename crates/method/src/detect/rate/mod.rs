//! Limits that follow from a rate of false alarms instead of being set.
//!
//! The setting is a number of false alarms for a robot and a year. [`budget`] shares it among the quantities that are
//! watched and the tests that a robot has in a year, which gives each chart the mean number of values between two false
//! alarms. [`average`] turns that run length into the limit of a moving average, [`chart`] into the limit of a sequential
//! chart. Charts want values that are independent and normal; [`whitening`] makes them of a series, and `scatter` says
//! how far a level can be trusted. Where a series has no history yet, `ranks` need no distribution. [`monitor`] puts
//! these together for one series.

pub mod budget;
pub mod average;
mod overshoot;
pub mod chart;
mod ranks;
pub mod whitening;
mod scatter;
pub mod monitor;
