//! Checks that a recording, and the model identified from it, are possible and match the description.

pub mod recording;
pub mod model;
pub(crate) mod refusal;
