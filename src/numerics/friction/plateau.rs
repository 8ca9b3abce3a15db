//! Rows of one joint at one speed.

/// A plateau's rows lie within this fraction of its speed.
pub(super) const SPEED_TOLERANCE: f64 = 0.10;

pub(super) struct Plateau {
    pub(super) speed_fraction: f64,
    pub(super) direction: i8,
    pub(super) rows: Vec<usize>,
}
