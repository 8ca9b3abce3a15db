//! Input and result of a layout proposal.

use armwatch_model::robot::Robot;

/// Torques `[n]`, Nm (N), that hold an arm against gravity at joint positions `[n]`, rad (m).
pub type GravityTorques = fn(&Robot, &[f64]) -> Option<Vec<f64>>;

/// Information that is known beforehand.
#[derive(Debug, Clone, Copy, Default)]
pub struct Hints<'a> {
    /// The arm, whose number of joints and limits help to decide.
    pub robot: Option<&'a Robot>,
    /// Torques that hold the arm against gravity at joint positions, Nm (N); `None` for an arm without masses.
    pub gravity_torques: Option<GravityTorques>,
    /// Rows per second, Hz, for exports without time.
    pub sample_rate: Option<f64>,
}

/// A proposed layout.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Proposed {
    /// Text of the layout file.
    pub toml: String,
    /// Number of open questions; with any, it does not load yet.
    pub questions: usize,
    /// The layout with the likely answer to each question filled in, for a test; `None` if a question has none.
    pub answered: Option<String>,
    /// Number of examined rows.
    pub rows: usize,
    /// Name of the shipped layout that fits.
    pub shipped: Option<&'static str>,
    /// Joints of the arm; zero if unknown.
    pub joints: usize,
}
