//! Least squares from growing triangular factors, independent of the meaning of the columns.

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
