//! `armwatch trajectory`.

mod arm;
mod beside;
pub(super) mod check;
pub(super) mod design;
pub(super) mod export;
pub(super) mod plot;
mod motion_check;
mod samples;
mod surroundings;
mod torque;
pub(super) mod whole_test;
mod limit_texts;
