//! Settings of the analysis of a cycle.

use super::Estimator;
use super::finding::FindingKinds;

/// Settings of the analysis of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnalysisSettings {
    /// Cut-off of the zero-phase low-pass on position, velocity and torque, Hz.
    pub cutoff: f64,
    /// Speed for comparing friction over runs, as a fraction of the largest speed; the nearest measured level is used.
    /// The thesis uses 0.6.
    pub reference_speed_fraction: f64,
    /// Method that turns rows into parameters.
    pub estimator: Estimator,
    /// Findings that neither refuse a cycle nor make it doubtful: a remark marks the cycle.
    pub accept: FindingKinds,
}

impl Default for AnalysisSettings {
    fn default() -> Self {
        Self {
            cutoff: 12.0,
            reference_speed_fraction: 0.6,
            estimator: Estimator::default(),
            accept: FindingKinds::default(),
        }
    }
}
