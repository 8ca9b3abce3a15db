//! Findings in the cycles of a test, in a form that can be kept: causes of its friction curves, and causes of a change
//! of the arm.
//!
//! They follow from the test, from the usual curves and parameters of the tests that it is compared with (`Frame`), and
//! from the parameters of the few tests before it. Kept findings are valid as long as a hash of all these is the same.
//! The rate of false alarms is not part of it: it decides later how clear a cause must be.

use std::collections::{BTreeMap, HashMap};
use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hash, Hasher};

use serde::{Deserialize, Serialize};

use super::arm::{ArmJudgement, UsualArm};
use super::curve::causes::{RunCauses, UsualCurves};
use armwatch_model::anomaly::RunSummary;

/// Findings in the cycles of a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Judgement {
    pub(super) causes: RunCauses,
    pub(super) arm: ArmJudgement,
}

impl Judgement {
    /// The same judgement with this least advantage of a clear cause.
    pub(super) fn at_least(mut self, advantage: f64) -> Self {
        let RunCauses { of_joints, of_arm } = &mut self.causes;
        of_joints.iter_mut().chain([of_arm]).flatten().for_each(|cause| cause.least_advantage = advantage);
        self
    }
}

/// Judgements of one test with the hash of their inputs. Maintenance of single joints makes several sets of compared
/// tests, each with its own judgement.
type OfTest = Vec<(u64, Judgement)>;

/// Judgements that earlier conclusions made.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Kept {
    method: u64,
    by_test: HashMap<i64, OfTest>,
}

impl Kept {
    /// The judgements of tests, from the bytes of [`Judged::changed`]. Unreadable bytes count as none. `method`
    /// identifies the sources of the detectors: judgements of another method are invalid.
    #[must_use]
    pub fn new<'b>(method: u64, bytes: impl IntoIterator<Item = (i64, &'b [u8])>) -> Self {
        let read = |(run_id, bytes): (i64, &[u8])| Some((run_id, postcard::from_bytes(bytes).ok()?));
        Self { method, by_test: bytes.into_iter().filter_map(read).collect() }
    }

    pub(super) fn find(&self, run_id: i64, key: u64) -> Option<&Judgement> {
        self.by_test.get(&run_id)?.iter().find(|(of, _)| *of == key).map(|(_, judgement)| judgement)
    }
}

/// Judgements that a conclusion used.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Judged {
    by_test: BTreeMap<i64, OfTest>,
    /// Number of tests that were evaluated again.
    pub recomputed: usize,
}

impl Judged {
    pub(super) fn add(&mut self, run_id: i64, key: u64, judgement: &Judgement) {
        let of_test = self.by_test.entry(run_id).or_default();
        if !of_test.iter().any(|(known, _)| *known == key) {
            of_test.push((key, judgement.clone()));
        }
    }

    /// The bytes of each test whose judgements differ from the kept ones, by its key.
    #[must_use]
    pub fn changed(&self, kept: &Kept) -> Vec<(i64, Vec<u8>)> {
        let keys = |of: &OfTest| of.iter().map(|(key, _)| *key).collect::<Vec<u64>>();
        let differs = |(run_id, of): &(&i64, &OfTest)| kept.by_test.get(*run_id).map(keys) != Some(keys(of));
        let packed = |(run_id, of): (&i64, &OfTest)| Some((*run_id, postcard::to_stdvec(of).ok()?));
        self.by_test.iter().filter(differs).filter_map(packed).collect()
    }
}

/// The usual curves and parameters of tests that are compared with each other.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) curves: UsualCurves,
    /// Usual parameters of the tests of each length, by group.
    pub(super) arms: Vec<UsualArm>,
}

impl Frame {
    /// Hash of all of it and of the method, by group.
    pub(super) fn hashes(&self, kept: &Kept) -> Vec<u64> {
        let mut of_curves = Hashed(DefaultHasher::new());
        kept.method.hash(&mut of_curves.0);
        // writing into a hash does not fail
        _ = self.curves.write(&mut of_curves);
        let of_arm = |arm: &UsualArm| {
            let mut hashed = Hashed(of_curves.0.clone());
            _ = write!(hashed, "{arm:?}");
            hashed.0.finish()
        };
        self.arms.iter().map(of_arm).collect()
    }
}

struct Hashed(DefaultHasher);

impl Write for Hashed {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

/// Hash of the inputs of a test's judgement: the frame, the test, and the [`content`] of the tests whose parameters are
/// averaged with its own. `own` is the test's content.
pub(super) fn key(frame: u64, run: &RunSummary, own: u64, together: impl Iterator<Item = u64>) -> u64 {
    let mut hasher = DefaultHasher::new();
    (frame, own).hash(&mut hasher);
    for of in &run.joints {
        let figures = [of.relative_rmsd, of.relative_noise, of.torque_rms];
        (of.joint, figures.map(|figure| figure.map(f64::to_bits))).hash(&mut hasher);
    }
    together.for_each(|content| content.hash(&mut hasher));
    hasher.finish()
}

/// Hash of friction by cycle and of mean parameters.
pub(super) fn content(run: &RunSummary) -> u64 {
    let mut hasher = DefaultHasher::new();
    let mut numbers = |of: &[f64]| of.iter().for_each(|of| of.to_bits().hash(&mut hasher));
    for of in &run.cycle_friction {
        let friction = of.friction;
        numbers(&[f64::from(of.cycle), f64::from(friction.levels), friction.joint.number() as f64]);
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
