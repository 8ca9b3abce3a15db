//! Detectors of one joint, each in a file behind [`crate::detect::detector::Detector`], and their common parts.

pub(super) mod forecast;
pub(super) mod friction_change;
pub(super) mod steady_rise;
pub(super) mod level_limit;
pub(super) mod friction_drift;
pub(super) mod friction_step;
pub(super) mod friction_swing;
pub(super) mod warm_up;
pub(super) mod oscillation;
pub(super) mod accuracy;
pub(super) mod unlike_peers;

use self::accuracy::Accuracy;
use self::friction_drift::FrictionDrift;
use self::friction_step::FrictionStep;
use self::friction_swing::FrictionSwing;
use self::oscillation::Oscillation;
use self::unlike_peers::UnlikePeers;
use self::warm_up::WarmUp;
use super::series::RunDetector;

/// All detectors of a joint. Anomalies of a joint are found in this order.
pub(super) const JOINT_DETECTORS: &[&RunDetector] = &[
    &FrictionStep,
    &FrictionDrift,
    &FrictionSwing,
    &WarmUp,
    &Oscillation,
    &Accuracy,
    &UnlikePeers::Friction,
    &UnlikePeers::Accuracy,
];
