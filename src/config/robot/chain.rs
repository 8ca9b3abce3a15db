//! The joints of an arm from base to flange, however their geometry is written.

use crate::robot::{Joint, Transform};

/// The chain: joints, and the frame at its end in the frame of the last joint.
pub(in crate::config) struct Chain {
    pub joints: Vec<Joint>,
    pub end: Transform,
}
