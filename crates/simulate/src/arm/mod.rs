//! The arm and its environment: dynamics, gears, loads, faults, individual differences, the ambient temperature.

pub mod load;
pub mod dynamics;
pub mod efficiency;
mod balance;
pub(super) mod elastic;
pub mod friction;
pub mod fault;
pub mod unit;
pub mod hall;
