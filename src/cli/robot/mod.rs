//! `armwatch robot`.

pub(super) mod check;
pub(super) mod drive_gains;
pub(super) mod urdf;
