//! The settings of the program.

pub(super) mod work_limits;
pub(super) mod recognition;
pub(super) mod daemon_file;
