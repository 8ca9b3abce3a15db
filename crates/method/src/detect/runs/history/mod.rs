//! What the tests of a robot usually are: their level, their scatter, and which of them are alike.

pub(super) mod first_level;
pub(super) mod first_tests;
pub(super) mod like_length;
pub(super) mod friction_history;
pub(super) mod quiet_scatter;
pub(super) mod whitened;
