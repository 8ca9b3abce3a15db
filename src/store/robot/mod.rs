//! What is concluded from the history of a robot.

pub(super) mod conclude;
pub(super) mod conclusion_faults;
pub(super) mod history;
pub(super) mod friction;
pub(super) mod anomalies;
pub(super) mod health;
pub(super) mod alarm_state;
pub(super) mod alarm_life;
mod episodes;
