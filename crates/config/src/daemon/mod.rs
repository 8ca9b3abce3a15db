//! The settings of the program.

pub(super) mod work_limits;
pub(super) mod recognition;
mod like_date;
mod tools;
pub(super) mod daemon_file;
