//! `armwatch layout`.

pub(super) mod infer;
