//! Friction as a function of speed and thermal state, fitted to the runs of a robot, and the deviations of each run
//! from it.

pub mod thermal_state;
pub(crate) mod record;
pub(super) mod law;
pub(super) mod map;
pub mod published_map;
pub(super) mod thermal_source;
mod effect_layout;
pub(super) mod run_points;
pub(super) mod run_effects;
mod run_solution;
