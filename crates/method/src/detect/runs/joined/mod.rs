//! Anomalies of several joints that are one of the arm.

mod one_of_several;
pub(super) mod coupled_swing;
pub(super) mod warm_up_of_arm;
