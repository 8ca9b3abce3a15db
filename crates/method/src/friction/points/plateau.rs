//! Rows of one joint at one speed.

/// Largest relative deviation of a plateau's rows from its speed.
pub(super) const SPEED_TOLERANCE: f64 = 0.10;

pub(super) struct Plateau {
    pub(in crate::friction) speed_fraction: f64,
    pub(in crate::friction) direction: i8,
    pub(in crate::friction) rows: Vec<usize>,
}
