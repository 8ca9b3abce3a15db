//! What the runs of a robot say of one joint.

use super::friction_history::FrictionHistory;
use crate::analysis::JointSummary;
use crate::anomaly::RunSummary;
use crate::numerics::detect::detector::Detector;
use crate::numerics::detect::verdict::DetectSettings;
use crate::robot::JointIndex;

/// A detector of a joint's tests.
pub(super) type RunDetector = dyn for<'a> Detector<JointSeries<'a>>;

/// One joint over the complete runs of its robot, oldest first.
pub(super) struct JointSeries<'a> {
    pub(super) joint: JointIndex,
    /// One entry a run; `None` where the run has no summary of the joint.
    pub(super) runs: Vec<Option<&'a JointSummary>>,
    /// Friction of these runs, for the detector of drift and the joint's health.
    pub(super) friction: FrictionHistory,
    pub(super) settings: &'a DetectSettings,
}

impl<'a> JointSeries<'a> {
    pub(super) fn new(history: &'a [RunSummary], joint: JointIndex, settings: &'a DetectSettings) -> Self {
        let runs: Vec<Option<&JointSummary>> =
            history.iter().map(|run| run.joints.iter().find(|summary| summary.joint == joint)).collect();
        let friction = FrictionHistory::new(&runs, settings.baseline_runs);
        Self { joint, runs, friction, settings }
    }

    /// A figure of each run, `None` where it was not measured.
    pub(super) fn figures(&self, figure: impl Fn(&JointSummary) -> Option<f64>) -> Vec<Option<f64>> {
        self.runs.iter().map(|summary| summary.and_then(&figure)).collect()
    }
}
