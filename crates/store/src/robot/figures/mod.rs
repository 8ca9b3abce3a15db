//! Results of a test in rows that are short enough to be read for a whole history.

pub(super) mod packed;
pub(super) mod joint_summary;
pub(crate) mod cycle_friction;
pub(crate) mod cycle_rmsd;
pub(super) mod run_summary;
pub mod friction_series;
