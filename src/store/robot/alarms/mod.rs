//! Anomalies of a robot: which stored one each is, their states, and what people do with them.

pub(in crate::store) mod alarm_state;
pub(super) mod episodes;
pub(in crate::store) mod anomalies;
pub(in crate::store) mod alarm_life;
pub(in crate::store) mod health;
