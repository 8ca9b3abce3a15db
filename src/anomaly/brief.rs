//! What stands for the cycles of a test that are not read: a few numbers, and what was found in them.

/// What was found in the cycles of a test, as bytes, each with the hash of all that it follows from.
pub type Judgements = Vec<(u64, Vec<u8>)>;

/// What is known of the cycles of a complete test without reading them.
///
/// It follows from the test's own figures alone, but for `judgements`, each of which has the hash of all that it follows
/// from: it holds where that hash is the one that the history now gives.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Brief {
    /// Hash of friction by cycle and of mean parameters.
    pub content: u64,
    /// Cycles that parameters were identified from; 0 without parameters.
    pub length: u32,
    /// Whether it has inertial parameters.
    pub has_parameters: bool,
    /// By position of the joint; none beyond the last one with a figure.
    pub joints: Vec<JointBrief>,
    /// What was found in the cycles against the tests that they were compared with, by hash; one entry for each set of
    /// these, so that maintenance of single joints makes several.
    pub judgements: Judgements,
}

/// What is known of the cycles of a test in one joint.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JointBrief {
    /// Cycles with friction.
    pub friction: u32,
    /// Cycles whose RMSD stands between those of its neighbours.
    pub inner: u32,
    /// The most by which one of them stands out of both, in logarithms; 0 at least.
    pub furthest: f64,
    /// Whether a cycle has an RMSD.
    pub has_rmsd: bool,
}

impl Brief {
    /// That of a joint by its position.
    #[must_use]
    pub fn joint(&self, position: usize) -> JointBrief {
        self.joints.get(position).copied().unwrap_or_default()
    }
}
