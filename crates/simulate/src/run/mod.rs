//! One run of the arm, row by row: its controller, its warmth, what sensors and clock give, and the truth of it.

pub mod servo;
pub mod temperatures;
pub mod recording;
pub mod heat;
pub(super) mod warmth;
pub mod truth;
pub mod record;
pub mod matched_model;
