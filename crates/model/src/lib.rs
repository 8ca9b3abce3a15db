//! The nouns of armwatch: a robot makes runs, a run has an analysis, analyses yield anomalies. [`text`] makes names and
//! other text from outside safe to show.
//!
//! Angles are in rad, positions in m, torques in Nm, times in s; joints count from 0 ([`robot::JointIndex`]).

pub mod robot;
pub mod run;
pub mod analysis;
pub mod anomaly;
pub mod text;
