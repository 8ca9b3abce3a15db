//! Conclusions from a robot's history: anomalies, and the health of each joint.

use std::fmt;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use self::forecast::Forecast;
use self::quantity::Quantity;
use crate::analysis::friction::CycleFriction;
use crate::analysis::measurements::CycleRmsd;
use crate::analysis::refusal::RefusalCause;
use crate::analysis::response::ChannelResponse;
use crate::analysis::work_evidence::JointEvidence;
use crate::analysis::{JointSummary, ProductionJoint};
use crate::robot::{JointIndex, ParameterId};

pub mod baseline_runs;
pub mod cycle_peaks;
pub mod epoch;
pub mod forecast;
pub mod odds;
pub mod peer;
pub mod quantity;
pub mod settings;
pub mod settled;

/// Declares the kinds, one per row: variant, name, label, explanation.
macro_rules! kinds {
    ($($variant:ident $name:literal $label:literal $help:literal;)*) => {
        /// Kind of change that an anomaly is.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum AnomalyKind {
            $(#[doc = $help] $variant,)*
        }

        impl AnomalyKind {
            /// All kinds.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$variant,)*];

            /// Name as in the view `anomalies`.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }

            /// Label for people.
            #[must_use]
            pub const fn label(self) -> &'static str {
                match self {
                    $(Self::$variant => $label,)*
                }
            }

            /// Explanation in one sentence.
            #[must_use]
            pub const fn help(self) -> &'static str {
                match self {
                    $(Self::$variant => $help,)*
                }
            }
        }
    };
}

kinds! {
    Drift "drift" "Drift of friction" "Friction changes slowly over tests.";
    Step "step" "Step of friction" "Friction changes at once, inside a test or between two.";
    Oscillation "oscillation" "Oscillation" "Friction or the relative RMSD swings from cycle to cycle.";
    Thermal "thermal" "Thermal behaviour" "Warm-up time or the friction of all joints changed.";
    Sensor "sensor" "Sensor" "A channel has an offset, is stuck, saturated, noisy or in another unit.";
    Accuracy "accuracy" "Accuracy of the model" "The RMSD exceeds its limit, or no model fits the arm.";
    Payload "payload" "Payload" "Inertial parameters changed, most often because of another load.";
    Fleet "fleet" "Difference from other arms" "The arm differs from other arms of its model.";
}

impl fmt::Display for AnomalyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

crate::named_enum! {
    /// Severity of an anomaly: how soon a person should look.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Severity {
        /// For information.
        Info = "info",
        /// A check should be planned.
        Warning = "warning",
        /// Should be checked before the next shift.
        Critical = "critical",
    }
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

crate::serialize_by_name!(AnomalyKind, Severity);
crate::deserialize_by_name!(AnomalyKind, Severity);

/// One complete run of a robot, as the detectors see it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunSummary {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// Cycles stored.
    pub cycles: u32,
    /// Cycles that were refused.
    pub refused_cycles: u32,
    /// Causes of the refusals, the one of most cycles first.
    pub refusals: Vec<RunRefusal>,
    /// One entry per joint.
    pub joints: Vec<JointSummary>,
    /// Friction of each cycle and joint with friction points, in the order of cycles and joints.
    pub cycle_friction: Vec<CycleSeries>,
    /// Moving relative RMSD of each cycle as a whole with its own parameters, in the order of cycles and joints; omits
    /// cycles that do not count.
    pub whole_cycle_rmsd: Vec<CycleRmsd>,
    /// Means over the cycles of the inertial base parameters, in natural order.
    pub parameters: Vec<RunParameter>,
    /// Response of its parameters to channels that read wrong, if available.
    pub response: Option<Arc<ChannelResponse>>,
    /// Ordinal of each joint's epoch that the test belongs to, by position of the joint; see [`epoch`]. Tests in two
    /// epochs of a joint are not comparable. Joints beyond its end are in their first epoch.
    pub epochs: Vec<u32>,
}

/// Friction of one joint in one cycle of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CycleSeries {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Its friction.
    pub friction: CycleFriction,
}

/// A base parameter over the cycles of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunParameter {
    /// The kept parameter.
    pub id: ParameterId,
    /// Mean over the cycles, in its SI unit.
    pub mean: f64,
    /// Standard deviation of one cycle, from the scatter between cycles; for a single cycle its standard error. NaN if
    /// unknown.
    pub std_dev: f64,
    /// Number of cycles.
    pub cycles: u32,
    /// The standard parameters that it represents, with their coefficients; empty if unknown.
    pub terms: Vec<(f64, ParameterId)>,
}

impl RunSummary {
    /// True if no joint has a result, so that the test gives no information about the arm.
    #[must_use]
    pub fn is_without_result(&self) -> bool {
        !self.joints.iter().any(JointSummary::has_result)
    }
}

/// One cause of refused cycles of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunRefusal {
    /// The cause, with the sentence of the first of these cycles.
    pub cause: RefusalCause,
    /// Number of the first of these cycles, from 1.
    pub first_cycle: u32,
    /// Number of cycles.
    pub cycles: u32,
}

/// One complete production log compared with one test, as the detectors see it. A log with a test in its middle gives
/// two.
#[derive(Debug, Clone, PartialEq)]
pub struct ProductionSummary {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// The test.
    pub reference_run_id: i64,
    /// One entry per joint that moves.
    pub joints: Vec<ProductionJoint>,
    /// Evidence for causes, for each joint that moves; empty for a log that was stored before evidence existed.
    pub evidence: Vec<JointEvidence>,
}

/// Most likely beginning of a change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Onset {
    /// The first run that shows it.
    pub run_id: i64,
    /// The first cycle of that run that shows it, from 1, if known.
    pub cycle: Option<u32>,
    /// Start of that run, or of that cycle.
    pub at: Timestamp,
}

/// A cause that was compared and rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// Name of the cause, in words that follow "rather than".
    pub cause: String,
    /// Posterior odds of this cause against all others together.
    pub odds: f64,
}

/// An anomaly found in a history. The same history always gives the same anomalies. In a longer one, an anomaly is
/// identified by its joint, its cause and the time of its runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Anomaly {
    /// The joint; `None` if the cause affects the whole arm.
    pub joint: Option<JointIndex>,
    /// Kind of the change.
    pub kind: AnomalyKind,
    /// The quantity that changed, as the latest run shows it.
    pub quantity: Quantity,
    /// Severity in the latest run that showed it. Score, threshold, value, baseline and message belong to that run too.
    pub severity: Severity,
    /// Deviation of the value, in the scale of `threshold`.
    pub score: f64,
    /// Least score of an anomaly.
    pub threshold: f64,
    /// The value; NaN if there is none, as for a test without a result.
    pub value: f64,
    /// Expected value from the robot's own history; NaN if there is no value.
    pub baseline: f64,
    /// The value of the run with the largest score of the episode.
    pub peak_value: f64,
    /// Largest score of the episode.
    pub peak_score: f64,
    /// Largest severity of a run that showed it.
    pub peak_severity: Severity,
    /// Cycle of the first run with which it began, if it began in a cycle.
    pub first_cycle: Option<u32>,
    /// Run with which the episode began.
    pub first_run_id: i64,
    /// Latest run that showed it.
    pub last_run_id: i64,
    /// Start of the first run.
    pub first_seen_at: Timestamp,
    /// Start of the latest run.
    pub last_seen_at: Timestamp,
    /// Most likely beginning of the change.
    pub onset: Onset,
    /// Posterior odds of the cause in `kind` and `joint` against all others together; `None` if causes were not
    /// compared. For friction that differs from its baseline, the odds are computed from the latest test's friction
    /// curve.
    pub odds: Option<f64>,
    /// The rejected causes, the likeliest first.
    pub alternatives: Vec<Alternative>,
    /// True if a later run no longer shows it.
    pub ended: bool,
    /// Message for a technician.
    pub message: String,
}

impl Anomaly {
    /// Extends the episode by a later run. Onset and peak are kept, and all other fields are those of that run. If the
    /// later run shows another quantity, its peak replaces the earlier one, because values and scores of two quantities
    /// are not comparable.
    pub fn go_on(&mut self, later: Self) {
        let is_of_later = later.peak_score > self.peak_score || self.quantity != later.quantity;
        let (peak_value, peak_score) = match is_of_later {
            true => (later.peak_value, later.peak_score),
            false => (self.peak_value, self.peak_score),
        };
        *self = Self {
            peak_value,
            peak_score,
            peak_severity: self.peak_severity.max(later.peak_severity),
            first_cycle: self.first_cycle,
            onset: self.onset,
            first_run_id: self.first_run_id,
            first_seen_at: self.first_seen_at,
            ..later
        };
    }
}

crate::named_enum! {
    /// State of knowledge about a joint.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Knowledge {
        /// The latest test gave values that are comparable with the baseline. They agree with it unless there is an
        /// anomaly.
        Compared = "compared",
        /// The history is too short for a baseline.
        Learning = "learning",
        /// The latest test gave a value out of bounds, which one test alone does not decide, or none for this joint.
        Unsettled = "unsettled",
        /// The latest test gave no result for any joint.
        NoResult = "no_result",
    }
}

/// Health of a joint after the robot's latest test.
#[derive(Debug, Clone, PartialEq)]
pub struct JointHealth {
    /// The joint.
    pub joint: JointIndex,
    /// Friction of the latest test relative to the baseline, 1 = unchanged; `None` while learning, and if that test
    /// gave no comparable value.
    pub friction_index: Option<f64>,
    /// The quantity behind `friction_index`.
    pub friction_quantity: Option<Quantity>,
    /// State of knowledge.
    pub knowledge: Knowledge,
    /// Explanation for a technician, if there is one.
    pub reason: Option<String>,
    /// The latest run that gave a result for this joint.
    pub last_result_run_id: Option<i64>,
    /// Forecast of friction reaching its limits; `None` with too few tests since the baseline or the last jump.
    pub forecast: Option<Forecast>,
}

/// Outcome of evaluating a robot's whole history.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Findings {
    /// All anomalies of the history, open ones and ended ones.
    pub anomalies: Vec<Anomaly>,
    /// Health of each joint.
    pub health: Vec<JointHealth>,
    /// Latest time for the next test to begin, from the robot's own usual interval; `None` with too few tests for an
    /// interval.
    pub expected_by: Option<Timestamp>,
}
