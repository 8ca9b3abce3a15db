//! armwatch: exports of robot arms in, dynamic parameters, friction and anomalies out.

pub mod analysis;
pub mod anomaly;
pub mod config;
pub mod ingest;
pub mod numerics;
pub mod robot;
pub mod run;
pub mod simulate;
pub mod store;

#[cfg(test)]
mod testing;
