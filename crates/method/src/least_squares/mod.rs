//! Least squares from growing triangular factors, whatever the columns mean.

pub(crate) mod orthonormal;
pub mod solution;
mod triangle;
pub mod factor;
pub mod dense;
pub(crate) mod weighted;
pub(crate) mod huber;
pub(crate) mod clustered;
pub mod prior;
pub mod essential;
pub mod conditioning;
pub mod rows;
