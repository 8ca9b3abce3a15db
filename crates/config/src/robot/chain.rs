//! The joints of an arm from base to flange, however their geometry is written.

use armwatch_model::robot::{Joint, Transform};

/// The chain: joints, and the frame at its end in the frame of the last joint.
pub(crate) struct Chain {
    pub joints: Vec<Joint>,
    pub end: Transform,
    /// What was read otherwise than it is written, in sentences.
    pub remarks: Vec<String>,
}
