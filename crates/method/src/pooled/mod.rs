//! Parameters of many cycles together, from their stored factors.

pub mod pool;
pub mod estimate;
pub mod per_joint;
mod cycle_errors;
pub mod nominal_prior;
pub mod loaded_rows;
pub mod drive_gain;
pub mod payload;
