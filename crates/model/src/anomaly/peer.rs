//! Arms of one model, which are compared with each other.

use crate::analysis::JointSummary;

/// Most arms of its model that a robot is compared with.
pub const MOST_PEERS: usize = 24;

/// Another robot of the same model with its first tests, as many as a baseline has.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    /// Its name.
    pub robot: String,
    /// Summaries of the joints in each of these tests, oldest first.
    pub tests: Vec<Vec<JointSummary>>,
}
