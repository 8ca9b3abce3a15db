//! Statistics of small samples: means and medians, quantiles, information criteria, slopes, a test for white noise.

pub mod descriptive;
pub mod distributions;
pub mod slope;
pub mod whiteness;
pub(crate) mod information;
