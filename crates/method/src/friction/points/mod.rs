//! Friction points of one cycle: at constant speed, from slow passes, from the excitation, and their means.

mod gravity;
mod plateau;
mod slow_passes;
pub mod plateaus;
pub mod excitation;
pub mod level_means;
