//! One joint in the production logs of a robot.

use super::causes::LogCauses;
use super::causes::fit::JointRest;
use crate::detect::control_chart::baseline;
use crate::detect::detector::Detector;
use armwatch_model::analysis::ProductionJoint;
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::robot::JointIndex;

/// Logs after a test that determine the baseline. One of three may be an outlier.
pub(super) const LEARNING_LOGS: usize = 3;

/// A detector of a joint's logs.
pub(super) type ProductionDetector = dyn for<'a> Detector<JointLogs<'a>>;

/// One joint over the complete logs of its robot, oldest first.
pub(super) struct JointLogs<'a> {
    pub(super) history: &'a [ProductionSummary],
    /// Causes of each log; `None` if no evidence is stored.
    pub(super) causes: &'a [Option<LogCauses>],
    pub(super) joint: JointIndex,
}

/// Values of successive logs that are compared with one test.
pub(super) struct SinceTest {
    /// The baseline: median of the first [`LEARNING_LOGS`] values.
    pub(super) level: f64,
    /// Values with the places of their logs in the history. The first [`LEARNING_LOGS`] are the baseline's.
    pub(super) values: Vec<(usize, f64)>,
}

impl<'a> JointLogs<'a> {
    /// The joint's result in a log, by the log's place in the history; `None` if the joint does not move.
    pub(super) fn of(&self, log: usize) -> Option<&'a ProductionJoint> {
        self.history[log].joints.iter().find(|of| of.joint == self.joint)
    }

    /// The joint's residuals under the log's likeliest causes, if these are known.
    pub(super) fn rest(&self, log: usize) -> Option<&'a JointRest> {
        self.causes[log].as_ref()?.joints.iter().find(|of| of.joint == self.joint)
    }

    /// A value of the logs, test by test; `value` gets the place of a log in the history. Tests with too few values for
    /// a baseline are omitted.
    pub(super) fn by_test(&self, value: impl Fn(usize) -> Option<f64>) -> Vec<SinceTest> {
        let mut start = 0;
        let groups = self.history.chunk_by(|a, b| a.reference_run_id == b.reference_run_id);
        groups
            .filter_map(|logs| {
                let places = start..start + logs.len();
                start = places.end;
                let values: Vec<(usize, f64)> = places.filter_map(|log| Some((log, value(log)?))).collect();
                let level = baseline(values.iter().map(|(_, value)| *value), LEARNING_LOGS)?;
                Some(SinceTest { level, values })
            })
            .collect()
    }
}

/// Part of the torque that neither the test's model nor additional friction explains.
pub(super) fn unexplained(of: &ProductionJoint) -> f64 {
    of.relative_rmsd * (1.0 - of.friction.share).max(0.0).sqrt()
}
