//! `armwatch evaluate`: how good the detectors are, on simulated fleets.

mod command;
mod exports;
mod rates;
mod tables;

pub(in crate::cli) use command::{EvaluateArgs, evaluate};
