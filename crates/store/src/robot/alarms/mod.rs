//! Anomalies of a robot: which stored one each is, their states, and what people do with them.

pub(crate) mod alarm_state;
pub(super) mod episodes;
pub(crate) mod anomalies;
pub(crate) mod alarm_life;
pub(crate) mod health;
