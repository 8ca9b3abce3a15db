//! Detectors of the whole arm: of its parameters, of changes common to all joints, and of contacts.

pub(super) mod arm_change;
pub(super) mod common_change;
pub(super) mod contact;
