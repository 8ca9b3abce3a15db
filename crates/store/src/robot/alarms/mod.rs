//! Anomalies of a robot: their assignment to stored ones, their states, and actions of people.

pub(crate) mod alarm_state;
pub(super) mod episodes;
pub(crate) mod anomalies;
pub(crate) mod alarm_life;
pub(crate) mod health;
