//! `armwatch config`.

pub(super) mod check;
pub(super) mod init;
pub(super) mod show;
