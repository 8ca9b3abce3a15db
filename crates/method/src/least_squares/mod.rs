//! Least squares from growing triangular factors, whatever the columns mean.

pub mod orthonormal;
pub mod solution;
mod triangle;
pub mod factor;
pub mod dense;
pub mod weighted;
pub mod huber;
pub mod clustered;
pub mod prior;
pub mod essential;
pub mod conditioning;
pub mod rows;
