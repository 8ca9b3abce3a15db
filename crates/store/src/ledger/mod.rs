//! The exports and their progress: runs, files, faults and resume points.

pub(super) mod supersession;
pub(super) mod stored_cycles;
pub(super) mod runs;
pub(super) mod run_progress;
pub(super) mod robots;
pub(super) mod identity;
pub(super) mod sources;
pub(super) mod quarantine;
pub(super) mod resume;
pub(super) mod file_names;
pub(super) mod attempts;
pub(super) mod blocked;
