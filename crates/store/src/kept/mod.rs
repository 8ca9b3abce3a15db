//! Estimates that people store under a name, and those of another estimator.

pub(super) mod parameter_sets;
pub(super) mod reestimates;
pub(super) mod estimates;
