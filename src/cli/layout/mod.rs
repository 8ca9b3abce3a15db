//! `armwatch layout`.

pub(super) mod infer;
mod trial;
