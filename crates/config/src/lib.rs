//! TOML files to settings, with every problem found at once.

mod address;
mod toml;
mod alerts;
pub mod robot;
mod layout;
mod daemon;
mod settings;
mod cluster;
mod date_format;
mod moment;
#[cfg(test)]
mod fixtures;
mod pattern;
mod retention;
mod serve;
mod snapshot;
mod source;
mod summary;

pub use self::address::{KINDS_OF_DATABASE, foreign_scheme, is_on_server, shown_database};
pub use self::alerts::language::Language;
pub use self::alerts::receivers;
pub use self::alerts::settings::{AlertSettings, DEFAULT_ROUTE, QuietHours, Route, Site};
pub use self::cluster::{ClusterSettings, host_name};
pub use self::daemon::recognition::{RecogniseError, RecognisedName, UNKNOWN_ROBOT};
pub use self::date_format::DateFormats;
pub use self::layout::channels::{
    BLANKS, Channel, JointDelays, JointFactors, JointSigns, Layout, Misfit, MotorSide, RowRule, StartForm,
    StartSource, TextTime, TimeSource, TorqueQuantity,
};
pub use self::layout::column::{Column, JointColumns, ScaledColumn};
pub use self::layout::layout_file::{LayoutUnits, layout_units, parse_layout, read_layout};
pub use self::layout::parts::{PartMatch, PartName, PartRule};
pub use self::layout::stage_source::{
    FromMotion, OneHot, StageCells, StageKind, StageLevels, StageSignal, StageSource, StageWords,
    WholeRecording, Windows,
};
pub use self::layout::temperature::{AmbientTemperature, MotorTemperature, TemperatureUnit};
pub use self::layout::text_format::{DecimalMark, TextEncoding, TextFormat};
pub use self::moment::{Moment, MomentFormat, duration, forms_of, joined_forms};
pub use self::pattern::FilePatterns;
pub use self::retention::RetentionSettings;
pub use self::robot::cell_file::read_cell;
pub use self::robot::robot_file::{parse_robot, read_robot};
pub use self::serve::{ClientSettings, Scope, ServeSettings, TlsSettings, TokenSettings, UploadSettings};
pub use self::settings::{Config, FleetEntry, Recognition, RewritePolicy, WatchSettings, WorkLimits};
pub use self::snapshot::SnapshotSettings;
pub use self::source::{ConfigSource, maker_layouts, shipped_files};
pub use self::summary::summary;
pub use self::toml::problem::{ConfigErrors, ConfigProblem};
