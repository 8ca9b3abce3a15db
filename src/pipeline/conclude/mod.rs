//! What the history of a robot says.

pub mod conclude;
pub mod isolation;
