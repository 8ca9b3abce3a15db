//! `armwatch identify`.

pub(super) mod command;
pub(super) mod args;
pub(super) mod output;
pub(super) mod each_cycle;
pub(super) mod choose_friction;
pub(super) mod prior_choice;
