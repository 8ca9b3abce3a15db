//! Excitation trajectories: finite Fourier series, limits, and their information about an arm's parameters.

pub mod series;
pub mod limits;
pub mod clearance;
pub mod observation;
pub mod objective;
pub mod problem;
pub mod recorded_rows;
pub mod prediction;
pub mod information;
pub mod search;
pub mod programme;
