//! One run of the arm, row by row: its controller, its temperature, sensors and clock, and the true values.

pub mod servo;
pub mod temperatures;
pub mod recording;
pub mod heat;
pub(super) mod arm_thermal_state;
pub mod truth;
pub mod record;
pub mod matched_model;
