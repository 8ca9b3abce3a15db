//! The settings of the program.

pub(super) mod work_limits;
pub(super) mod recognition;
mod like_date;
pub(super) mod daemon_file;
