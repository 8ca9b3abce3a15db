//! Usual behaviour in the tests of a robot: level, scatter, and groups of similar tests.

pub(super) mod first_level;
pub(super) mod first_tests;
pub(super) mod like_length;
pub(super) mod friction_history;
pub(super) mod quiet_scatter;
pub(super) mod whitened;
