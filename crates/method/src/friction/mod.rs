//! Friction: over speed, over a run that warms up, and over the life of a robot.

mod golden_section;
mod separable;
pub mod points;
pub mod over_speed;
pub mod warm_up;
pub mod maps;
pub mod index;
