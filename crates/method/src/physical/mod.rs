//! Parameters of physical bodies.

pub(crate) mod pseudo_inertia;
pub mod uniform_bodies;
pub mod fit;
pub mod bodies;
pub mod data_share;
