//! Pictures and pages of measurements and results: self-contained SVG or HTML, without files.
//!
//! [`figure`] defines the data of a picture and `svg` draws it; the other modules each make the figure for one
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
