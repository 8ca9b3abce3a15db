//! TOML files to settings, with every problem found at once.

mod daemon_file;
mod files;
#[cfg(test)]
mod fixtures;
mod layout_file;
mod limits;
mod nominal;
mod pattern;
mod problem;
mod quantity;
mod reader;
mod recognition;
mod robot_file;
mod source;
mod suggestion;
mod summary;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

pub use self::layout_file::{parse_layout, read_layout};
pub use self::problem::{ConfigErrors, ConfigProblem};
pub use self::recognition::{RecogniseError, Recognised};
pub use self::robot_file::{parse_robot, read_robot};
pub use self::source::ConfigSource;
pub use self::summary::summary;
use crate::robot::Robot;

/// Everything the program is told, read and checked.
#[derive(Debug, Clone)]
pub struct Config {
    /// Database file.
    pub database: PathBuf,
    /// Folders to watch and how.
    pub watch: WatchSettings,
    /// How a file name gives robot and start time.
    pub recognition: Recognition,
    /// Which robots there are; the first entry whose pattern matches a robot's name is its own.
    pub fleet: Vec<FleetEntry>,
    /// How a cycle is analysed.
    pub analysis: AnalysisSettings,
    /// When a change counts as an anomaly.
    pub detect: DetectSettings,
}

impl Config {
    /// The entry of the robot called `robot`: the first whose pattern matches the whole name.
    #[must_use]
    pub fn robot_entry(&self, robot: &str) -> Option<&FleetEntry> {
        self.fleet.iter().find(|entry| pattern::matches(&entry.robots, robot))
    }
}

/// How a cycle is analysed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnalysisSettings {
    /// Cut-off of the zero-phase low-pass before identification, Hz.
    pub cutoff: f64,
    /// Speed at which friction is compared between runs, as a fraction of each joint's largest.
    pub reference_speed_fraction: f64,
}

impl Default for AnalysisSettings {
    fn default() -> Self {
        Self { cutoff: 12.0, reference_speed_fraction: 0.6 }
    }
}

/// When a change counts as an anomaly. Fractions are relative: 0.05 is 5 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectSettings {
    /// Runs that make up a robot's own baseline; until then it is learning.
    pub baseline_runs: usize,
    /// Change of warm friction against the baseline that warrants a warning.
    pub drift_warning: f64,
    /// Change of warm friction against the baseline that is critical.
    pub drift_critical: f64,
    /// Standard deviations of the baseline that a change must exceed besides.
    pub drift_sigma: f64,
    /// Swing of the RMSD from cycle to cycle against the baseline's that counts as oscillation.
    pub oscillation_ratio: f64,
    /// Relative RMSD that warrants a warning.
    pub accuracy_warning: f64,
    /// Relative RMSD that is critical.
    pub accuracy_critical: f64,
}

impl Default for DetectSettings {
    fn default() -> Self {
        Self {
            baseline_runs: 5,
            drift_warning: 0.05,
            drift_critical: 0.15,
            drift_sigma: 4.0,
            oscillation_ratio: 3.0,
            accuracy_warning: 0.10,
            accuracy_critical: 0.15,
        }
    }
}

/// Folders to watch.
#[derive(Debug, Clone)]
pub struct WatchSettings {
    /// Folders, searched with their subfolders.
    pub folders: Vec<PathBuf>,
    /// Time between two scans.
    pub scan_interval: Duration,
    /// How long a file's size and modification time must stand still before it is read.
    pub settle: Duration,
}

/// How a file name gives robot and start time.
#[derive(Debug, Clone)]
pub struct Recognition {
    /// Pattern over the file name with the named groups `robot` and, where given, `date` (YYYYMMDD)
    /// and `time` (HHMM or HHMMSS).
    pub file_name: regex::Regex,
    /// IANA time zone of date and time in file names.
    pub time_zone: String,
}

/// Robots that share a description and a layout.
#[derive(Debug, Clone)]
pub struct FleetEntry {
    /// Pattern over the whole robot name; `*` stands for any characters.
    pub robots: String,
    /// The arm.
    pub description: Arc<Robot>,
    /// The layout of its exports.
    pub layout: Arc<Layout>,
}

/// How an export's columns become channels in SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Name, such as `native`.
    pub name: String,
    /// Separator between columns.
    pub delimiter: u8,
    /// Column of time.
    pub time: ScaledColumn,
    /// Columns of joint positions.
    pub position: ScaledColumn,
    /// Columns of joint velocities, where recorded.
    pub velocity: Option<ScaledColumn>,
    /// Columns of joint torques.
    pub torque: ScaledColumn,
    /// Column of the stage signal.
    pub stage: StageSignal,
    /// Column of the cycle counter; used if the export has it.
    pub cycle: Option<String>,
    /// Column of the joint under friction test, from 1; used if the export has it.
    pub friction_joint: Option<String>,
    /// Column of the speed level, from 1; used if the export has it.
    pub friction_level: Option<String>,
}

/// A column, or one column a joint, with its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaledColumn {
    /// Header name; `{joint}` stands for the joint number from 1 where there is one a joint.
    pub name: String,
    /// Factor from the column's unit to SI.
    pub to_si: f64,
}

/// Which values of a column mean which stage; any other value is between stages.
#[derive(Debug, Clone, PartialEq)]
pub struct StageSignal {
    /// Header name.
    pub column: String,
    /// Values of the excitation stage.
    pub excitation: Vec<i64>,
    /// Values of the friction stage.
    pub friction: Vec<i64>,
    /// Values of the warming stage.
    pub warming: Vec<i64>,
    /// Values between stages; a value that is in no list is an error.
    pub between: Vec<i64>,
}
