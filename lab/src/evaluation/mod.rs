//! `armwatch-lab evaluate`: how good the detectors are, on simulated fleets.

mod command;
mod exports;
mod tables;

pub(crate) use command::{EvaluateArgs, evaluate};
