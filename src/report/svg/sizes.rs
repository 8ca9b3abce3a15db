//! Sizes and colours shared by all parts of a picture.

use crate::report::figure::{COLOURS, RAMP};

/// Width of a picture, px. Text has one size at any displayed width, so that a picture of this width is still readable
/// at half of it.
pub(super) const WIDTH: f64 = 960.0;
/// Height of the plotting area of a strip, px.
pub(super) const STRIP_HEIGHT: f64 = 84.0;
/// Space between a plotting area and its strip, px.
pub(super) const STRIP_GAP: f64 = 10.0;
/// Space right of a plotting area, px.
pub(super) const RIGHT: f64 = 14.0;
/// Space above a plotting area for the panel's title, px.
pub(super) const ABOVE: f64 = 32.0;
/// Width of a letter, px; wide enough for common fonts.
pub(super) const LETTER: f64 = 7.4;
/// Radius of a dot, px; smaller if dots would cover each other.
pub(super) const DOT: f64 = 2.6;
/// Distance within which the pointer selects a point, px.
pub(super) const REACH: f64 = 9.0;

/// Number of colours.
pub(super) fn colours() -> usize {
    COLOURS.len() + RAMP.len()
}
