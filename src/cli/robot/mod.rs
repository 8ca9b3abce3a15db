//! `armwatch robot`.

pub(super) mod check;
mod sources;
pub(super) mod code;
pub(super) mod drive_gains;
pub(super) mod mjcf;
pub(super) mod urdf;
