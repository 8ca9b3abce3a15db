//! `armwatch trajectory`.

mod arm;
pub(super) mod check;
pub(super) mod design;
pub(super) mod export;
mod samples;
mod words;
