//! The joints of an arm from base to flange, for any form of their geometry.

use armwatch_model::robot::{Joint, Transform};

/// The chain: joints, and the frame at its end in the frame of the last joint.
pub(crate) struct Chain {
    pub joints: Vec<Joint>,
    pub end: Transform,
    /// Values that were read differently than written, in sentences.
    pub remarks: Vec<String>,
}
