//! Rows to stages and cycles.

pub mod cycles;
pub mod stages;
pub mod stages_from_motion;
pub mod joint_side;
