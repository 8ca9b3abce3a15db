//! From a file to stored cycles.

pub mod decide;
pub mod cycles;
pub mod resume_point;
pub mod admitted;
mod claimed;
pub(super) mod attempt;
pub mod resume;
pub(in crate::pipeline) mod cut_file;
pub mod cutting;
pub mod record;
pub mod intake;
mod content;
pub mod new_robot;
pub mod follow;

#[cfg(test)]
mod cut_by_end_tests;
