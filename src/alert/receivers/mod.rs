//! Receivers, one file each.

pub(super) mod open;
mod alertmanager;
mod command;
mod email;
mod labels;
mod log;
mod mqtt;
mod webhook;
