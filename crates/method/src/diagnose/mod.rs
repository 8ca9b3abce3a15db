//! Whether a recording, and the model identified on it, can be what they are said to be.

pub mod recording;
pub mod model;
pub(crate) mod refusal;
