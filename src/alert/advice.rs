//! Advice by the kind of an alarm.

use armwatch_model::anomaly::AnomalyKind;

/// The first thing to check, as a sentence of the table of messages. Detectors say more in English.
#[must_use]
pub const fn advice(kind: AnomalyKind) -> &'static str {
    match kind {
        AnomalyKind::Drift | AnomalyKind::Step => "Check lubrication, gearbox and brake.",
        AnomalyKind::Oscillation => {
            "Look for a loose bearing, belt or coupling, or a brake that does not open fully."
        }
        AnomalyKind::Thermal => "Check the lubricant and what cools the joint.",
        AnomalyKind::Sensor => "Check the sensor, its cable and its calibration.",
        AnomalyKind::Accuracy => "Check the mounting, the zero positions and the robot's description.",
        AnomalyKind::Payload => "Check the load, or enter the new tool as maintenance.",
        AnomalyKind::Fleet => "Compare the arm with the others: mounting, load, lubrication.",
    }
}
