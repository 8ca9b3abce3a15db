//! `armwatch trajectory`.

mod arm;
pub(super) mod check;
pub(super) mod design;
pub(super) mod export;
pub(super) mod plot;
mod samples;
mod words;
