//! Trajectories for tests: the search for them, and programmes as files.

pub mod search;
pub mod programme;
