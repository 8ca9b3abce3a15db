//! What stands for the cycles of a test where they are left out.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::arm_detectors::contact::standing_out;
use super::history::like_length::length;
use crate::anomaly::RunSummary;
use crate::anomaly::brief::{Brief, JointBrief};

/// The brief of a test whose cycles were read, without judgements.
#[must_use]
pub fn brief(run: &RunSummary) -> Brief {
    let of_rmsd = run.whole_cycle_rmsd.iter().map(|of| of.joint);
    let of_friction = run.cycle_friction.iter().map(|of| of.friction.joint);
    let joints = of_rmsd.chain(of_friction).map(|joint| joint.index() + 1).max().unwrap_or(0);
    let of_joint = |j: usize| {
        let (inner, furthest) = standing_out(run, j);
        let friction = run.cycle_friction.iter().filter(|of| of.friction.joint.index() == j).count();
        let count = |of: usize| u32::try_from(of).unwrap_or(u32::MAX);
        JointBrief {
            friction: count(friction),
            inner: count(inner),
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
pub(super) fn content(run: &RunSummary) -> u64 {
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
