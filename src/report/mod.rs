//! Pictures and pages of what was measured and computed: data to self-contained SVG or HTML, without files.
//!
//! [`figure`] says what a picture is made of and `svg` draws it; the others each make the figure of one
//! question.

pub mod anomaly;
pub mod figure;
pub mod friction;
pub mod friction_index;
pub mod page;
pub mod residuals;
pub mod rmsd;
mod scale;
mod svg;
pub mod torque;
mod translation;
pub mod trajectory;
