//! armwatch: exports of robot arms in, dynamic parameters, friction and anomalies out.
//!
//! # Layout, in reading order
//!
//! A robot makes runs; a run has an analysis; analyses yield anomalies. [`robot`], [`run`],
//! [`analysis`] and [`anomaly`] are these nouns. The others are machinery that takes one to the next:
//! `ingest -> segment -> identify -> friction -> verify -> store -> detect -> alert`, never back.

pub mod robot;
pub mod run;
pub mod analysis;
pub mod anomaly;

pub mod numerics;
pub mod config;
pub mod telemetry;
pub mod metrics;
pub mod ingest;
pub mod store;
pub mod export;
pub mod pipeline;
pub mod alert;
pub mod report;
pub mod simulate;
pub mod evaluate;
pub mod design;
pub mod robot_code;
pub mod serve;
pub mod daemon;
pub mod cli;

#[cfg(test)]
mod testing;
