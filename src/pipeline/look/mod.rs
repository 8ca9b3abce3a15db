//! Answers that read an export again and store nothing.

pub mod explain;
pub mod replay;
pub mod torque;
