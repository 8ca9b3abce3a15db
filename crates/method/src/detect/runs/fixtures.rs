//! Synthetic histories of tests.

use jiff::{SignedDuration, Timestamp};

use super::series::{JointSeries, RunDetector, friction_history};
use crate::detect::verdict::Verdict;
use armwatch_model::analysis::refusal::{Channel, RefusalCause};
use armwatch_model::analysis::{Estimate, JointSummary, RmsdSwing, WarmFriction};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{RunRefusal, RunSummary};
use armwatch_model::robot::JointIndex;

/// Joints of the arm.
pub(super) const JOINTS: usize = 3;

/// Cycles of [`indexed`] tests.
pub(super) const CYCLES: u32 = 8;

/// The joint with results in [`run`].
pub(super) const JOINT: JointIndex = JointIndex::new(2);

/// A daily test with results of one joint.
pub(super) fn run(index: usize, friction: f64, rmsd: f64, swing: f64) -> RunSummary {
    let joint = JointSummary {
        joint: JOINT,
        warm_friction: Some(WarmFriction {
            torque: friction,
            std_error: 0.05,
            minute: 100.0,
            speed_fraction: 0.6,
        }),
        excitation_friction: None,
        half_speed_friction: None,
        friction_index: None,
        relative_rmsd: Some(rmsd),
        rmsd_swing: Some(RmsdSwing { value: swing, cycles: 24 }),
        relative_noise: None,
        torque_rms: None,
    };
    let quiet = |j: usize| JointSummary {
        joint: JointIndex::new(j),
        warm_friction: None,
        excitation_friction: None,
        half_speed_friction: None,
        friction_index: None,
        relative_rmsd: None,
        rmsd_swing: None,
        relative_noise: None,
        torque_rms: None,
    };
    RunSummary {
        run_id: i64::try_from(index).expect("small") + 1,
        started_at: Timestamp::UNIX_EPOCH
            + SignedDuration::from_hours(24 * i64::try_from(index).expect("small")),
        cycles: 24,
        refused_cycles: 0,
        refusals: vec![],
        cycle_friction: vec![],
        whole_cycle_rmsd: vec![],
        parameters: vec![],
        response: None,
        joints: vec![quiet(0), quiet(1), joint],
        epochs: Vec::new(),
    }
}

/// Scatter of healthy friction from run to run, 0.8 % at most.
pub(super) fn wobble(i: usize) -> f64 {
    1.0 + 0.008 * ((i * 37 % 11) as f64 / 5.0 - 1.0)
}

/// Daily tests of an arm whose friction alone changes.
pub(super) fn history(runs: usize, friction: impl Fn(usize) -> f64) -> Vec<RunSummary> {
    (0..runs).map(|i| run(i, friction(i), 0.03, 0.002)).collect()
}

pub(super) fn hours(hours: i64) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours)
}

/// A daily test with the friction index of all joints, `None` for a test without a result.
pub(super) fn indexed(day: i64, index: Option<f64>) -> RunSummary {
    let joint = |j: usize| JointSummary {
        joint: JointIndex::new(j),
        warm_friction: None,
        excitation_friction: None,
        half_speed_friction: None,
        friction_index: index.map(|value| Estimate { value, std_error: 0.004 }),
        relative_rmsd: index.map(|_| 0.03),
        rmsd_swing: None,
        relative_noise: None,
        torque_rms: None,
    };
    RunSummary {
        run_id: day + 1,
        started_at: hours(24 * day),
        cycles: CYCLES,
        refused_cycles: 0,
        refusals: vec![],
        cycle_friction: vec![],
        whole_cycle_rmsd: vec![],
        parameters: vec![],
        response: None,
        joints: (0..JOINTS).map(joint).collect(),
        epochs: Vec::new(),
    }
}

/// Daily tests with an index near one.
pub(super) fn healthy(tests: i64) -> Vec<RunSummary> {
    (0..tests).map(|day| indexed(day, Some(1.0 + 0.002 * (day % 3) as f64))).collect()
}

pub(super) fn refusal(finding: &str, channel: Channel, joint: Option<usize>, cycles: u32) -> RunRefusal {
    let joint = joint.map(JointIndex::new);
    let sentence = format!("the {channel} is wrong");
    RunRefusal {
        cause: RefusalCause { finding: finding.into(), channel, joint, sentence },
        first_cycle: 1,
        cycles,
    }
}

/// A test with all cycles refused.
pub(super) fn refused(day: i64, refusals: Vec<RunRefusal>) -> RunSummary {
    RunSummary { refused_cycles: CYCLES, refusals, ..indexed(day, None) }
}

/// Verdicts of a detector for a joint without friction curves.
pub(super) fn judged(
    detector: &RunDetector,
    history: &[RunSummary],
    joint: JointIndex,
    settings: &DetectSettings,
) -> Vec<Verdict> {
    let causes = vec![None; history.len()];
    let friction = friction_history(history, joint, &causes, settings.baseline_runs);
    detector.judge(&JointSeries::new(history, joint, &friction, &causes, &[], settings))
}
