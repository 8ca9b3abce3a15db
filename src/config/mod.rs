//! TOML files to settings, with every problem found at once.

mod daemon_file;
mod chain;
mod column;
mod column_names;
mod settings;
mod date_format;
mod files;
mod friction_model;
#[cfg(test)]
mod fixtures;
mod geometry;
mod joint;
mod layout;
mod layout_file;
mod layout_time;
mod limits;
mod nominal;
mod pattern;
mod problem;
mod quantity;
mod reader;
mod recognition;
mod robot_file;
mod serve;
mod source;
mod stage_file;
mod stage_source;
mod suggestion;
mod summary;
mod temperature;
mod text_format;
mod transmission;
mod urdf;
mod urdf_arm;
#[cfg(test)]
mod urdf_tests;
mod urdf_writer;
#[cfg(test)]
mod urdf_writer_tests;
mod work_limits;

pub use self::column::{Column, JointColumns, ScaledColumn};
pub use self::date_format::DateFormats;
pub use self::layout::{
    Channel, JointDelays, JointFactors, JointSigns, Layout, Misfit, MotorSide, RowRule, StartForm,
    StartSource, TimeSource, TorqueQuantity,
};
pub use self::layout_file::{LayoutUnits, layout_units, parse_layout, read_layout};
pub use self::pattern::FilePatterns;
pub use self::problem::{ConfigErrors, ConfigProblem};
pub use self::recognition::{RecogniseError, Recognised};
pub use self::robot_file::{parse_robot, read_robot};
pub use self::serve::{ServeSettings, UploadSettings};
pub use self::settings::{Config, FleetEntry, Recognition, RewritePolicy, WatchSettings, WorkLimits};
pub use self::source::ConfigSource;
pub use self::stage_source::{OneHot, StageLevels, StageSignal, StageSource, StageWords};
pub use self::summary::summary;
pub use self::temperature::{AmbientTemperature, MotorTemperature, TemperatureUnit};
pub use self::text_format::{DecimalMark, TextEncoding, TextFormat};
pub use self::urdf_writer::{UrdfFriction, straight_friction, urdf_text};
