//! Descriptions of arms, as TOML or URDF.

pub(super) mod chain;
pub(super) mod joint;
pub(super) mod balance;
pub(super) mod geometry;
pub(super) mod nominal;
pub(super) mod transmission;
pub(super) mod friction_model;
pub(super) mod urdf;
pub(super) mod urdf_arm;
pub(super) mod shape;
pub(super) mod cell_file;
pub mod robot_file;
