//! Settings of the detectors.

/// Settings of the detectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectSettings {
    /// Runs that form a joint's baseline; below this many the joint is learning.
    pub baseline_runs: usize,
    /// Relative change of friction that is a warning.
    pub drift_warning: f64,
    /// Relative change of friction that is critical.
    pub drift_critical: f64,
    /// Permissible false alarms per robot and year, in all joints, kinds and quantities together.
    pub false_alarms_per_robot_year: f64,
    /// Change of friction, in standard deviations of its smoothed value, that could be chance; `None`: computed from
    /// the rate of false alarms.
    pub drift_sigma: Option<f64>,
    /// Ratio of the RMSD's swing to its baseline that is an oscillation.
    pub oscillation_ratio: f64,
    /// Relative RMSD that is a warning.
    pub accuracy_warning: f64,
    /// Relative RMSD that is critical.
    pub accuracy_critical: f64,
    /// Usual intervals between tests after which the next one is overdue.
    pub overdue_factor: f64,
}

impl Default for DetectSettings {
    fn default() -> Self {
        Self {
            baseline_runs: 5,
            drift_warning: 0.05,
            drift_critical: 0.15,
            false_alarms_per_robot_year: 1.0,
            drift_sigma: None,
            oscillation_ratio: 3.0,
            accuracy_warning: 0.10,
            accuracy_critical: 0.15,
            overdue_factor: 4.0,
        }
    }
}
