//! Friction indices, and the maps and baselines that they are computed from.

pub(crate) mod friction;
pub(crate) mod baselines;
pub(crate) mod baseline_plan;
pub(super) mod known_friction;
pub(super) mod friction_plan;
