//! Writes rows to files.

pub(super) mod fixed_point;
pub mod format;
pub mod export;
