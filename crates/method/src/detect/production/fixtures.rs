//! Synthetic histories of production.

use jiff::{SignedDuration, Timestamp};

use crate::detect::production::detect_production;
use armwatch_model::analysis::{FrictionExcess, ProductionJoint};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, ProductionSummary};
use armwatch_model::robot::JointIndex;

const JOINTS: usize = 4;

/// Relative RMSD that friction does not explain in healthy logs.
pub(super) const USUAL: f64 = 0.02;

/// One log every eight hours, a test before every tenth.
fn log(index: usize, friction: [f64; JOINTS], unexplained: [f64; JOINTS]) -> ProductionSummary {
    let joint = |j: usize| {
        // friction is a third of the torque: the excess raises the deviation by this part
        let by_friction = friction[j] / 3.0;
        let square = unexplained[j].powi(2) + by_friction.powi(2);
        ProductionJoint {
            joint: JointIndex::new(j),
            windows: 60,
            relative_rmsd: square.sqrt(),
            friction: FrictionExcess { excess: friction[j], share: by_friction.powi(2) / square },
            test_relative_rmsd: Some(0.015),
        }
    };
    ProductionSummary {
        run_id: i64::try_from(index).expect("small") + 1,
        started_at: Timestamp::UNIX_EPOCH
            + SignedDuration::from_hours(8 * i64::try_from(index).expect("small")),
        reference_run_id: 1000 + i64::try_from(index / 10).expect("small"),
        joints: (0..JOINTS).map(joint).collect(),
        evidence: Vec::new(),
    }
}

/// Anomalies found with the default settings.
pub(super) fn detected(history: &[ProductionSummary]) -> Vec<Anomaly> {
    detect_production(history, &DetectSettings::default())
}

pub(super) fn wobble(index: usize, joint: usize) -> f64 {
    0.02 * (((index * 37 + joint * 11) % 13) as f64 / 6.0 - 1.0)
}

pub(super) fn history(logs: usize, of: impl Fn(usize, usize) -> (f64, f64)) -> Vec<ProductionSummary> {
    let each = |i: usize, part: &dyn Fn((f64, f64)) -> f64| std::array::from_fn(|j| part(of(i, j)));
    (0..logs).map(|i| log(i, each(i, &|of| of.0), each(i, &|of| of.1))).collect()
}
