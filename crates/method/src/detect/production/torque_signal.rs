//! Wrong torque signal in production (`sensor`): a gain or an offset of one joint's torque explains the torque that the
//! test does not predict.
//!
//! A single log that shows it has the severity `info`. A second log in succession, or an advantage of [`PLAIN`] over no
//! cause, makes it a warning. Offsets are only considered if the friction law of the description has a column for them.

use super::causes::cause::{LEAST_GAIN, WorkCause};
use super::causes::odds::Asked;
use super::series::JointLogs;
use crate::detect::detector::Detector;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Advantage over no cause, in units of chi², that needs no second log as confirmation.
const PLAIN: f64 = 1000.0;

pub(super) struct TorqueSignal;

impl Detector<JointLogs<'_>> for TorqueSignal {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Sensor
    }

    fn quantity(&self, _: &JointLogs<'_>) -> Quantity {
        Quantity::ProductionTorqueOffset
    }

    fn judge(&self, series: &JointLogs<'_>) -> Vec<Verdict> {
        let mut before = false;
        let verdict = |log: usize| {
            let Some(causes) = series.causes[log].as_ref() else { return Verdict::Unknown };
            let (quantity, value, baseline, threshold, score, what) = match causes.cause() {
                WorkCause::Gain(joint, part) if joint == series.joint => {
                    let what = format!("reads {:.1} % {} than", 100.0 * part.abs(), more(part));
                    (Quantity::ProductionTorqueGainRatio, 1.0 + part, 1.0, LEAST_GAIN, part.abs(), what)
                }
                WorkCause::Offset(joint, torque) if joint == series.joint => {
                    let what = format!("reads {:.2} Nm {} than", torque.abs(), more(torque));
                    (Quantity::ProductionTorqueOffset, torque, 0.0, 0.0, torque.abs(), what)
                }
                _ => {
                    before = false;
                    return Verdict::Quiet;
                }
            };
            let confirmed = std::mem::replace(&mut before, true) || causes.advantage() >= PLAIN;
            Verdict::Out {
                severity: if confirmed { Severity::Warning } else { Severity::Info },
                score,
                threshold,
                value,
                baseline,
                message: format!(
                    "in production the torque signal {what} the last test predicts; check the torque sensor or \
                     the motor current's scale and zero, and run a test"
                ),
                why: Why { quantity: Some(quantity), ..causes.why(Asked::Cause) },
            }
        };
        (0..series.history.len()).map(verdict).collect()
    }
}

fn more(size: f64) -> &'static str {
    if size > 0.0 { "more" } else { "less" }
}
