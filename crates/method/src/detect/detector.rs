//! The interface of a detector.
//!
//! A detector of a joint is one file in `runs/joint_detectors/` or `production/`. The file documents the anomaly, the
//! quantity and the limits, and implements [`Detector`] for a unit struct. `runs/joint_detectors/mod.rs` or
//! `production.rs` has its entry in the list of detectors. Detectors of the arm are functions in `runs/arm_detectors/`.

use super::verdict::Verdict;
use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::anomaly::quantity::Quantity;

/// Checks one quantity of one joint over the history of its robot.
///
/// `Series` is the joint's part of the history. Tests and production logs have separate series, since they share no
/// quantity and have different baselines: the joint's first tests, and the first logs after each test.
pub(super) trait Detector<Series> {
    /// Kind of the anomalies that it finds.
    fn kind(&self) -> AnomalyKind;

    /// The quantity that it checks, unless a verdict names another one.
    fn quantity(&self, series: &Series) -> Quantity;

    /// One verdict per entry of the history, in the same order.
    fn judge(&self, series: &Series) -> Vec<Verdict>;
}
