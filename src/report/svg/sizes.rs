//! Sizes and colours that all of a picture has in common.

use crate::report::figure::{COLOURS, RAMP};

/// Width of a picture, px. Text is of one size whatever the width at which a picture is shown, so a picture of this
/// width can still be read at half of it.
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
/// Radius of a dot, px; less where dots would cover each other.
pub(super) const DOT: f64 = 2.6;
/// How far from a point a reader points at it, px.
pub(super) const REACH: f64 = 9.0;

/// How many colours there are.
pub(super) fn colours() -> usize {
    COLOURS.len() + RAMP.len()
}
