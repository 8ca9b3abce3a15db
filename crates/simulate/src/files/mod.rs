//! Rows as a file.

pub(super) mod fixed_point;
pub mod format;
pub mod export;
