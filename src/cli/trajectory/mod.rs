//! `armwatch trajectory`.

mod arm;
pub(super) mod check;
pub(super) mod design;
pub(super) mod export;
pub(super) mod plot;
mod rated;
mod samples;
pub(super) mod whole_test;
mod words;
