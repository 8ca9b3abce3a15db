//! Model of the arm: kinematics, drives, inverse dynamics, its regressor and base parameters.

pub mod kinematics;
pub(crate) mod actuator;
pub mod carried;
pub mod dynamics;
pub(crate) mod dynamics_lanes;
pub mod regressor;
pub mod regressor_lanes;
pub mod base_parameters;
pub mod robot_check;
mod robot_text;
