//! What the history of a robot says.

pub mod history;
pub mod isolation;
