//! Parameters of one cycle, and the accuracy with which they explain its torques.

pub mod cycle;
pub(crate) mod row_lanes;
pub mod cycle_rows;
pub mod joint_factors;
pub mod filtered_columns;
pub mod load_visibility;
pub mod carried_torque;
pub mod verify;
pub(crate) mod torque_noise;
pub mod torque_series;
pub mod channel_response;
