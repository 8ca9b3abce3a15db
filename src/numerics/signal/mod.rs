//! Channels of a recording: time grid, low-pass and derivatives, temperatures, delays.

pub mod filter;
pub mod temperature;
pub mod time_grid;
pub mod channel_delay;
