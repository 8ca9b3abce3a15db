//! Stages and cycles from the rows of a recording.

pub mod cycles;
pub mod stages;
pub mod stages_from_motion;
pub mod joint_side;
