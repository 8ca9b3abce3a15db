//! The arm and where it stands: dynamics, gears, loads, faults, what differs from unit to unit, the hall.

pub mod load;
pub mod dynamics;
pub mod efficiency;
mod balance;
pub(super) mod elastic;
pub mod friction;
pub mod fault;
pub mod unit;
pub mod hall;
