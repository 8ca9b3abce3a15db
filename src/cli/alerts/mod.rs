//! `armwatch alerts`

pub(super) mod command;
mod act;
mod list;
mod quantities;
mod show;
mod test;
pub(super) mod anomaly_texts;
