//! TOML files to settings, with every problem found at once.

mod daemon_file;
mod files;
#[cfg(test)]
mod fixtures;
mod geometry;
mod joint;
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
mod transmission;
mod urdf;
mod urdf_arm;
#[cfg(test)]
mod urdf_tests;
mod urdf_writer;
#[cfg(test)]
mod urdf_writer_tests;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

pub use self::layout_file::{parse_layout, read_layout};
pub use self::problem::{ConfigErrors, ConfigProblem};
pub use self::recognition::{RecogniseError, Recognised};
pub use self::robot_file::{parse_robot, read_robot};
pub use self::source::ConfigSource;
pub use self::summary::summary;
pub use self::urdf_writer::{UrdfFriction, straight_friction, urdf_text};
use crate::numerics::analyse::AnalysisSettings;
use crate::numerics::detect::DetectSettings;
use crate::robot::Robot;
use crate::run::Stage;

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
    /// Whether the first line names the columns; without names, columns go by number from 1.
    pub header: bool,
    /// Where time comes from.
    pub time: TimeSource,
    /// Columns of joint positions.
    pub position: ScaledColumn,
    /// Columns of joint velocities, where recorded.
    pub velocity: Option<ScaledColumn>,
    /// Columns of joint torques.
    pub torque: ScaledColumn,
    /// Where the stages come from.
    pub stage: StageSource,
    /// Which channels are recorded on the motor's side of the transmission.
    pub motor_side: MotorSide,
    /// Column of the cycle counter; used if the export has it.
    pub cycle: Option<String>,
    /// Column of the joint under friction test, from 1; used if the export has it.
    pub friction_joint: Option<String>,
    /// Column of the speed level, from 1; used if the export has it.
    pub friction_level: Option<String>,
}

/// Where the time of a row comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum TimeSource {
    /// A column.
    Column(ScaledColumn),
    /// The number of the row and this sample rate, Hz.
    SampleRate(f64),
}

/// Where the stage of a row comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum StageSource {
    /// A column.
    Signal(StageSignal),
    /// The whole recording is one stage.
    Whole(Stage),
}

/// Channels that are recorded at the motors, before gears and couplings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MotorSide {
    /// Positions and velocities.
    pub position: bool,
    /// Torques.
    pub torque: bool,
}

/// A column, or one column a joint, with its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaledColumn {
    /// Header name, or number of the column from 1 where there is no header. `{joint}` stands for the
    /// joint number from 1 where there is one column a joint, `{joint+6}` for that number plus 6.
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
