//! A test that is still being written: findings in its cycles so far, alone and compared with the robot's complete
//! tests.
//!
//! The detectors are those that a part of a test is enough for: a step of friction, friction that varies from cycle to
//! cycle, a load, a wrong torque signal, a contact in one cycle. A contact is found one cycle after it. A step needs
//! one cycle before it and two of the new level, so it is found one cycle after its first one. Scatter needs seven
//! cycles. The arm is compared with the same number of first cycles of the complete tests, since parameters change
//! while an arm warms. Detectors that need the whole test (the friction index, drift, warm-up, the swing of the RMSD)
//! run when it is complete. The results are only warnings and critical anomalies.

use std::borrow::Cow;

use super::arm::{arm_evidence, faults, least_advantage as least_advantage_of_arm};
use super::arm_detectors::arm_change::{UNKNOWN_CHANGE, arm_changes};
use super::arm_detectors::contact::{UsualContacts, alpha, open_contact};
use super::curve::causes::{UsualCurves, tests_of_usual};
use super::curve::hypothesis::Cause;
use super::curve::run_cause::{RunCause, least_advantage};
use super::history::like_length::length;
use super::joint_detectors::friction_step::FrictionStep;
use super::joint_detectors::friction_swing::FrictionSwing;
use super::other_unit::with_units;
use super::series::{JointSeries, RunDetector, friction_history};
use crate::detect::episodes::anomalies;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

/// Fewest cycles for a scatter of the mean parameters.
const CYCLES_OF_ARM: u32 = 3;

/// Usual values from the complete tests of a robot, for a test that is compared with them while it is written. They
/// depend on these tests alone, so they are valid for all cycles of the test.
#[derive(Debug, Clone, PartialEq)]
pub struct UsualTests {
    /// Usual curves of all joints, in the tests that are compared with each other; one entry per such set.
    curves: Vec<(Vec<usize>, UsualCurves)>,
    /// By joint: the entry of `curves`, and the quantity of a jump of friction inside a test.
    joints: Vec<(usize, Quantity)>,
    /// Usual distances of cycles from their neighbours, in the tests of all joints' epochs, and the probability of a
    /// false alarm.
    contacts: (UsualContacts, f64),
    /// Least advantage of a clear cause of the arm.
    least_advantage_of_arm: f64,
    /// The first tests that are not much shorter than the longest; the arm is compared with their first cycles.
    arm_run_ids: Vec<i64>,
}

impl UsualTests {
    /// Selects the complete tests of a robot of `joints` joints, oldest first, that are comparable with a test of these
    /// `epochs`.
    #[must_use]
    pub fn new(history: &[RunSummary], joints: usize, epochs: &[u32], settings: &DetectSettings) -> Self {
        // without maintenance since then, it is of the unit of the latest test
        let latest = history.last().filter(|latest| latest.epochs == epochs);
        let apart = latest.map_or(Cow::Borrowed(history), |_| with_units(history, settings));
        let epochs = latest.and(apart.last()).map_or(epochs, |latest| &latest.epochs);
        let history = &apart[..];
        let mut curves: Vec<(Vec<usize>, UsualCurves)> = Vec::new();
        let mut of_joints = Vec::with_capacity(joints);
        let ordinal = |epochs: &[u32], joint: usize| epochs.get(joint).copied().unwrap_or(0);
        for joint in 0..joints {
            let is_compared = |run: &RunSummary| ordinal(&run.epochs, joint) == ordinal(epochs, joint);
            let places: Vec<usize> =
                (0..history.len()).filter(|place| is_compared(&history[*place])).collect();
            let runs: Vec<RunSummary> = places.iter().map(|&place| history[place].clone()).collect();
            let known = curves.iter().position(|(of, _)| *of == places).unwrap_or_else(|| {
                let needed = least_advantage(history, settings);
                let first = tests_of_usual(&runs, joints, settings.baseline_runs);
                curves
                    .push((places, UsualCurves::of(&runs[..first], joints, settings.baseline_runs, needed)));
                curves.len() - 1
            });
            let causes = vec![None; runs.len()];
            let friction = friction_history(&runs, JointIndex::new(joint), &causes, settings.baseline_runs);
            of_joints.push((known, friction.source.quantity_of_jump()));
        }
        let of_epochs =
            |run: &RunSummary| (0..joints).all(|joint| ordinal(&run.epochs, joint) == ordinal(epochs, joint));
        let has_figures = |run: &RunSummary| !(run.parameters.is_empty() && run.cycle_friction.is_empty());
        let places: Vec<usize> = (0..history.len()).filter(|place| of_epochs(&history[*place])).collect();
        let compared: Vec<RunSummary> = places.iter().map(|&place| history[place].clone()).collect();
        let contacts = UsualContacts::of(&compared, joints);
        // short checks are not enough for a test of many cycles
        let of_arm = || places.iter().copied().filter(|&place| has_figures(&history[place]));
        let most = of_arm().map(|place| length(&history[place])).max().unwrap_or(0);
        let first: Vec<usize> = of_arm()
            .filter(|&place| 2 * length(&history[place]) > most)
            .take(settings.baseline_runs.max(2))
            .collect();
        Self {
            curves,
            joints: of_joints,
            contacts: (contacts, alpha(history, joints, settings)),
            least_advantage_of_arm: least_advantage_of_arm(history, settings),
            arm_run_ids: first.into_iter().map(|place| history[place].run_id).collect(),
        }
    }

    /// Keys of the tests whose first cycles [`detect_open`] needs, oldest first.
    #[must_use]
    pub fn arm_run_ids(&self) -> &[i64] {
        &self.arm_run_ids
    }
}

/// Detects anomalies in a test that is still being written, from these cycles. `first_cycles` has the same number of
/// cycles of each of the tests [`UsualTests::arm_run_ids`].
#[must_use]
pub fn detect_open(
    usual: &UsualTests,
    first_cycles: &[RunSummary],
    open: &RunSummary,
    settings: &DetectSettings,
) -> Vec<Anomaly> {
    let joints = usual.joints.len();
    let moment = [(open.run_id, open.started_at)];
    let arm = if open.cycles < CYCLES_OF_ARM || first_cycles.is_empty() {
        vec![None]
    } else {
        let together: Vec<RunSummary> = first_cycles.iter().chain([open]).cloned().collect();
        vec![
            arm_evidence(&together, joints, settings.baseline_runs, usual.least_advantage_of_arm)
                .pop()
                .flatten(),
        ]
    };
    let faults = faults(&arm);
    let causes: Vec<_> = usual.curves.iter().map(|(_, curves)| curves.causes_of_open(open)).collect();
    let mut found = Vec::new();
    for (joint, &(curves, quantity)) in usual.joints.iter().enumerate() {
        let causes = std::slice::from_ref(&causes[curves][joint]);
        let joint = JointIndex::new(joint);
        let open = std::slice::from_ref(open);
        let friction = friction_history(open, joint, causes, settings.baseline_runs);
        let series = JointSeries::new(open, joint, &friction, causes, &faults, settings);
        let detectors: &[&RunDetector] = &[&FrictionStep, &FrictionSwing];
        let of_joint = anomalies(detectors, &series, joint, &moment).into_iter().map(|of| match of.kind {
            // the quantity of the complete test
            AnomalyKind::Step => Anomaly { quantity, ..of },
            _ => of,
        });
        found.extend(of_joint);
    }
    found.extend(arm_changes(&arm, &faults, joints, &moment));
    let likeliest = |(joint, &(curves, _)): (usize, &(usize, Quantity))| {
        causes[curves][joint].as_ref().map(RunCause::likeliest)
    };
    let likeliest: Vec<Option<Cause>> = usual.joints.iter().enumerate().map(likeliest).collect();
    let (usual_contacts, alpha) = &usual.contacts;
    found.extend(open_contact(usual_contacts, *alpha, open, &likeliest, moment[0]));
    // an unknown change may be in addition to a fault that continues, which only the whole test shows
    found.retain(|of| of.severity > Severity::Info && of.quantity != UNKNOWN_CHANGE);
    for of in &mut found {
        of.message =
            format!("{}; seen by cycle {} of a test that is still being written", of.message, open.cycles);
    }
    found
}

#[cfg(test)]
mod tests;
