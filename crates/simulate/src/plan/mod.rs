//! The planned motion of a test: pieces of motion, and their combination.

pub mod motion;
pub(super) mod blend;
pub(super) mod strokes;
pub mod excitation;
pub mod points;
pub mod still_posture;
pub mod trajectory;
