//! Estimates that people keep, and those of another estimator.

pub(super) mod parameter_sets;
pub(super) mod reestimates;
pub(super) mod estimates;
