//! What is concluded from the history of a robot.

pub(super) mod conclude;
pub(super) mod conclusion_faults;
pub(super) mod maintenance;
pub(super) mod baselines;
pub(super) mod baseline_plan;
pub(super) mod history;
pub(super) mod cycle_friction;
pub(super) mod cycle_friction_rows;
pub(super) mod cycle_rmsd;
mod joint_summary;
mod packed;
mod run_series;
mod run_brief;
mod run_brief_rows;
pub mod friction_series;
pub(super) mod friction;
pub(super) mod anomalies;
pub(super) mod health;
pub(super) mod alarm_state;
pub(super) mod alarm_life;
pub(super) mod open_test;
pub(super) mod peers;
mod settled;
mod settled_rows;
mod friction_plan;
mod known_friction;
mod episodes;
