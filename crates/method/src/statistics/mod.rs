//! Statistics of a few numbers: means and medians, quantiles, information criteria, slopes, whether a series is white noise.

pub mod descriptive;
pub mod distributions;
pub mod slope;
pub mod whiteness;
pub(crate) mod information;
