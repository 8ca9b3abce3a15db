//! Statistics of a few numbers: means and medians, quantiles, whether a series is white noise.

pub mod descriptive;
pub mod distributions;
pub mod whiteness;
