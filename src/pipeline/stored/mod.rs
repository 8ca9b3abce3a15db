//! Answers from stored factors, without exports.

pub mod stored;
pub mod reestimate;
pub mod drive_gain;
pub mod physical;
