//! The planned motion of a test: pieces of motion, and what they are joined to.

pub mod motion;
pub(super) mod blend;
pub(super) mod strokes;
pub mod excitation;
pub mod points;
pub mod still_posture;
pub mod trajectory;
