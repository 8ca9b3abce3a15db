//! Detectors of the whole arm: of its parameters, of what all joints share, and of contacts.

pub(super) mod arm_change;
pub(super) mod common_change;
pub(super) mod contact;
