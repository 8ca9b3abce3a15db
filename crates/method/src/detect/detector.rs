//! What a detector is.
//!
//! A detector is one file in `runs/joint_detectors/` or `production/`. The file says what it detects, from which
//! quantity and by which limits, and implements [`Detector`] for a unit struct. Besides that,
//! `runs/joint_detectors/mod.rs` or `production.rs` has its `mod` line and its entry in the list of detectors.

use super::verdict::Verdict;
use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::anomaly::quantity::Quantity;

/// Judges one quantity of one joint over the history of its robot.
///
/// `Series` is what the history says of the joint. Tests and logs of ordinary work have a series each, since
/// they have no figure in common and different baselines: the joint's first tests, and the first logs after
/// each test.
pub(super) trait Detector<Series> {
    /// Kind of the anomalies that it finds.
    fn kind(&self) -> AnomalyKind;

    /// The quantity that it judges. A verdict may name another one.
    fn quantity(&self, series: &Series) -> Quantity;

    /// One verdict for each entry of the history, in its order.
    fn judge(&self, series: &Series) -> Vec<Verdict>;
}
