//! Friction: over speed, over a run that warms up, and over the life of a robot.

pub mod composite;
pub mod plateaus;
mod plateau;
mod slow_passes;
mod golden_section;
pub mod over_speed;
pub mod level_means;
pub mod excitation;
pub mod warm_up;
mod separable;
mod warm_up_curve;
mod warm_up_early;
pub mod thermal_state;
mod thermal_source;
mod law;
mod map;
pub mod published_map;
mod effect_layout;
mod run_points;
mod run_effects;
pub mod record;
mod jump;
pub mod run_record;
pub mod held_map;
pub mod baseline;
pub mod index;
