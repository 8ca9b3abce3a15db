//! `armwatch report`: a run or a robot on one page, from stored data.

mod browser;
mod cells;
pub(super) mod command;
mod findings;
mod robot;
mod run;
