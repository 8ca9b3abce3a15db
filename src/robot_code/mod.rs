//! Feed-forward code: the torque function of a model as source text of other languages, with test vectors.
//!
//! Newton-Euler recursion is carried out on expressions instead of numbers ([`code::TorqueCode`]), so that what is zero
//! for an arm is not in its code. Expressions are evaluated here as well: the torque that the code is written from is
//! compared with that of the regressor before anything is written.

pub mod language;
pub mod origin;
mod expression;
mod rigid_body;
pub mod torque;
pub mod warmth;
mod listing;
pub mod vectors;
mod header;
mod languages;
pub mod code;
