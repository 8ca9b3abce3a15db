//! What stands for the cycles of a test that are not read: a few numbers, and what was found in them.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::cycle_peaks::peaks_of_joint;
use super::{RunParameter, RunSummary};

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

/// The brief of a test whose cycles were read, without judgements.
#[must_use]
pub fn brief(run: &RunSummary) -> Brief {
    let of_rmsd = run.whole_cycle_rmsd.iter().map(|of| of.joint);
    let of_friction = run.cycle_friction.iter().map(|of| of.friction.joint);
    let joints = of_rmsd.chain(of_friction).map(|joint| joint.index() + 1).max().unwrap_or(0);
    let of_joint = |j: usize| {
        let (distances, furthest) = peaks_of_joint(run, j);
        let friction = run.cycle_friction.iter().filter(|of| of.friction.joint.index() == j).count();
        let count = |of: usize| u32::try_from(of).unwrap_or(u32::MAX);
        JointBrief {
            friction: count(friction),
            inner: count(distances.count()),
            furthest,
            has_rmsd: run.whole_cycle_rmsd.iter().any(|of| of.joint.index() == j),
        }
    };
    Brief {
        content: content(run),
        length: if run.parameters.is_empty() { 0 } else { length(run) },
        has_parameters: !run.parameters.is_empty(),
        joints: (0..joints).map(of_joint).collect(),
        judgements: Vec::new(),
    }
}

/// Hash of friction by cycle and of mean parameters.
#[must_use]
pub fn content(run: &RunSummary) -> u64 {
    let mut hasher = DefaultHasher::new();
    let mut numbers = |of: &[f64]| of.iter().for_each(|of| of.to_bits().hash(&mut hasher));
    for of in &run.cycle_friction {
        let friction = of.friction;
        let whole = [of.cycle, friction.levels].map(f64::from);
        numbers(&[whole[0], whole[1], friction.joint.number() as f64]);
        numbers(&[friction.minute, friction.ln_torque, friction.offset, friction.speed_fraction]);
    }
    numbers(&[run.cycle_friction.len() as f64, run.parameters.len() as f64]);
    for of in &run.parameters {
        numbers(&[of.mean, of.std_dev, f64::from(of.cycles), of.terms.len() as f64]);
        of.terms.iter().for_each(|(coefficient, _)| numbers(&[*coefficient]));
    }
    for of in &run.parameters {
        of.id.hash(&mut hasher);
        of.terms.iter().for_each(|(_, id)| id.hash(&mut hasher));
    }
    hasher.finish()
}

/// Cycles of a test that parameters were identified from.
#[must_use]
pub fn length(run: &RunSummary) -> u32 {
    match run.left_out() {
        Some(brief) if brief.has_parameters => brief.length,
        Some(_) => run.cycles,
        None => run.parameters.iter().map(|of: &RunParameter| of.cycles).max().unwrap_or(run.cycles),
    }
}
