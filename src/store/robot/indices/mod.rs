//! Friction indices: the maps and baselines that they are computed from, and which of them are due.

pub(in crate::store) mod friction;
pub(in crate::store) mod baselines;
pub(in crate::store) mod baseline_plan;
pub(super) mod known_friction;
pub(super) mod friction_plan;
