//! Feed-forward code: the torque function of a model as source text of other languages, with test vectors.
//!
//! Newton-Euler recursion is applied to expressions instead of numbers ([`code::TorqueCode`]), so that zero terms of an
//! arm are not in its code. Expressions are evaluated here as well: their torque is compared with that of the regressor
//! before any code is written.

pub mod language;
pub mod origin;
mod expression;
mod rigid_body;
pub mod torque;
pub mod warm_up;
mod listing;
pub mod vectors;
mod header;
mod languages;
pub mod code;
