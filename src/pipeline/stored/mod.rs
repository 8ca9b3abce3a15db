//! Answers from stored factors, without exports.

pub mod chosen_cycles;
pub mod reestimate;
pub mod drive_gain;
pub mod payload;
pub mod physical;
pub mod run_information;
