//! What is concluded from a robot's history: anomalies, and where each joint's baseline stands.

use std::fmt;

use jiff::Timestamp;

use crate::analysis::{JointSummary, ProductionJoint};
use crate::robot::JointIndex;

/// What kind of change an anomaly is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AnomalyKind {
    /// Slow change over runs.
    Drift,
    /// Swings from cycle to cycle.
    Oscillation,
    /// RMSD over its limit.
    Accuracy,
    /// Torque that the test's parameters do not give and friction does not explain: another load, most often.
    Payload,
}

impl AnomalyKind {
    /// Name as in the view `anomalies`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Drift => "drift",
            Self::Oscillation => "oscillation",
            Self::Accuracy => "accuracy",
            Self::Payload => "payload",
        }
    }
}

impl fmt::Display for AnomalyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How soon a person should look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Worth knowing.
    Info,
    /// Plan a look.
    Warning,
    /// Look before the next shift.
    Critical,
}

impl Severity {
    /// Name as in the view `anomalies`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Critical => "critical",
        }
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One complete run of a robot, as the detectors see it.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSummary {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// Cycles stored.
    pub cycles: u32,
    /// One entry a joint.
    pub joints: Vec<JointSummary>,
}

/// One complete log of production held against one test, as the detectors see it. A log with a test in its middle
/// gives two.
#[derive(Debug, Clone, PartialEq)]
pub struct ProductionSummary {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// The test.
    pub reference_run_id: i64,
    /// One entry a joint that moves.
    pub joints: Vec<ProductionJoint>,
}

/// An anomaly found in a history. The same history always gives the same anomalies, so a repeated
/// search recognises each by robot, joint, kind, quantity and the run it began with.
#[derive(Debug, Clone, PartialEq)]
pub struct Anomaly {
    /// The joint.
    pub joint: JointIndex,
    /// What kind of change.
    pub kind: AnomalyKind,
    /// The quantity that changed, with its unit where it has one.
    pub quantity: &'static str,
    /// Worst severity of the episode.
    pub severity: Severity,
    /// How far out the value is, in the scale of `threshold`.
    pub score: f64,
    /// Score at which the anomaly begins.
    pub threshold: f64,
    /// Value in the latest run of the episode.
    pub value: f64,
    /// What the robot's own history led to expect.
    pub baseline: f64,
    /// Run with which the episode began.
    pub first_run_id: i64,
    /// Latest run that showed it.
    pub last_run_id: i64,
    /// Start of the first run.
    pub first_seen_at: Timestamp,
    /// Start of the latest run.
    pub last_seen_at: Timestamp,
    /// Whether a later run no longer shows it.
    pub ended: bool,
    /// What a technician should read.
    pub message: String,
}

/// Whether a joint has a baseline to be compared with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointHealth {
    /// The joint.
    pub joint: JointIndex,
    /// Warm friction of the latest run against the baseline, 1 = unchanged; `None` while learning.
    pub friction_index: Option<f64>,
    /// Whether the history is still too short.
    pub learning: bool,
}

/// Outcome of looking at a robot's whole history.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Findings {
    /// All anomalies of the history, open ones and ended ones.
    pub anomalies: Vec<Anomaly>,
    /// Where each joint stands.
    pub health: Vec<JointHealth>,
}
