//! `armwatch config`.

pub(super) mod check;
