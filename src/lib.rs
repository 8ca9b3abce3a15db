//! The program armwatch: exports of robot arms in, dynamic parameters, friction and anomalies out.
//!
//! # Layout, in reading order
//!
//! The crates below `crates/` do the work: `model` has the nouns, `ingest` reads files, `method` turns samples into
//! numbers, `store` keeps them. The modules here connect them:
//! `ingest -> segment -> identify -> friction -> verify -> store -> detect -> alert`, never back.

pub mod telemetry;
pub mod language;
pub mod metrics;
pub mod pipeline;
pub mod alert;
pub mod urdf_writer;
pub mod report;
pub mod robot_code;
pub mod serve;
pub mod daemon;
pub mod cli;
