//! Channels of a recording: time grid, low-pass and derivatives, temperatures, delays.

mod low_pass;
pub mod filter;
pub(crate) mod temperature;
pub mod time_grid;
pub mod channel_delay;
pub mod slower;
mod arrival;
pub(crate) mod fold;
pub mod restore;
pub(crate) mod noise;
