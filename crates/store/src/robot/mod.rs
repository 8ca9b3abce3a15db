//! Conclusions from the history of a robot.

pub(super) mod figures;
pub(super) mod alarms;
pub(super) mod maintenance;
pub(super) mod history;
pub(super) mod conclusion_faults;
pub(super) mod conclude;
pub(super) mod dates;
pub(super) mod cycle_friction_rows;
pub(super) mod summaries;
mod settled;
pub(super) mod windows;
pub(super) mod indices;
pub(super) mod unfinished_run;
pub(super) mod peers;
