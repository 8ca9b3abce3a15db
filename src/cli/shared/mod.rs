//! Shared parts of several commands: output, plots, chosen cycles, loads.

pub(super) mod moment;
pub(super) mod named_value;
pub(super) mod said;
pub mod output;
pub(super) mod paths;
pub(super) mod rows;
pub(super) mod result_file;
pub mod plot;
pub mod programme;
pub(super) mod selection;
pub(super) mod position_columns;
pub(super) mod cycle;
pub(super) mod levels;
pub(super) mod joints;
pub(super) mod judged;
pub(super) mod life;
pub(super) mod load;
pub(super) mod reweight;
pub mod shipped_robot;
pub(super) mod user;
pub(super) mod unknown_robot;
pub(super) mod views;
pub(super) mod verification;
