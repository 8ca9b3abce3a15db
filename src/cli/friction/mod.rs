//! `armwatch friction`.

pub(super) mod command;
pub(super) mod index;
