//! Answers that read an export again and store nothing.

pub mod explain;
mod explanation_texts;
pub mod replay;
pub mod torque;
