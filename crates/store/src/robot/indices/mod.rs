//! Friction indices: the maps and baselines that they are computed from, and which of them are due.

pub(crate) mod friction;
pub(crate) mod baselines;
pub(crate) mod baseline_plan;
pub(super) mod known_friction;
pub(super) mod friction_plan;
