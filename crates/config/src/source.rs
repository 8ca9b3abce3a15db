//! Sources of the configuration.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};

use super::daemon::daemon_file;
use super::settings::Config;
use super::toml::files;
use super::toml::problem::ConfigErrors;
use armwatch_model::robot::Robot;

/// Environment variable that names the configuration file.
const VARIABLE: &str = "ARMWATCH_CONFIG";

/// Paths in the working directory, in the order of the search.
const PLACES: [&str; 2] = ["config/armwatch.toml", "armwatch.toml"];

/// The shipped folder `config/`, embedded in the program: a single binary works in an empty folder.
const SHIPPED: [(&str, &str); 6] = [
    ("config/armwatch.toml", include_str!("../../../config/armwatch.toml")),
    ("config/robots/er3a.toml", include_str!("../../../config/robots/er3a.toml")),
    ("config/robots/scara.toml", include_str!("../../../config/robots/scara.toml")),
    ("config/robots/tx40.toml", include_str!("../../../config/robots/tx40.toml")),
    ("config/robots/ur10e.toml", include_str!("../../../config/robots/ur10e.toml")),
    ("config/exports/native.toml", include_str!("../../../config/exports/native.toml")),
];

/// The shipped files by their names below `config/`: a configuration, descriptions of arms, layouts.
pub fn shipped_files() -> impl Iterator<Item = (&'static str, &'static str)> {
    SHIPPED.iter().chain(&EXAMPLES).map(|(name, text)| (name.strip_prefix("config/").unwrap_or(name), *text))
}

/// The layouts for exports of makers, by name. A layout with questions does not load.
pub fn maker_layouts() -> impl Iterator<Item = (&'static str, &'static str)> {
    let stem = |name: &'static str| name.rsplit('/').next().and_then(|name| name.strip_suffix(".toml"));
    EXAMPLES.iter().skip(OWN_EXAMPLES).filter_map(move |(name, text)| Some((stem(name)?, *text)))
}

/// Layouts at the start of [`EXAMPLES`] that belong to no maker.
const OWN_EXAMPLES: usize = 2;

/// Layouts that the shipped configuration does not name.
const EXAMPLES: [(&str, &str); 16] = [
    ("config/exports/motor_side.toml", include_str!("../../../config/exports/motor_side.toml")),
    ("config/exports/production.toml", include_str!("../../../config/exports/production.toml")),
    ("config/exports/abb_tunemaster.toml", include_str!("../../../config/exports/abb_tunemaster.toml")),
    ("config/exports/br_trace.toml", include_str!("../../../config/exports/br_trace.toml")),
    ("config/exports/codesys_trace.toml", include_str!("../../../config/exports/codesys_trace.toml")),
    ("config/exports/denso_control_log.toml", include_str!("../../../config/exports/denso_control_log.toml")),
    ("config/exports/fanuc_axis_log.toml", include_str!("../../../config/exports/fanuc_axis_log.toml")),
    ("config/exports/franka_log.toml", include_str!("../../../config/exports/franka_log.toml")),
    ("config/exports/franka_states.toml", include_str!("../../../config/exports/franka_states.toml")),
    ("config/exports/kuka_trace.toml", include_str!("../../../config/exports/kuka_trace.toml")),
    ("config/exports/ros_joint_states.toml", include_str!("../../../config/exports/ros_joint_states.toml")),
    ("config/exports/ros_topic_echo.toml", include_str!("../../../config/exports/ros_topic_echo.toml")),
    ("config/exports/staubli_recorder.toml", include_str!("../../../config/exports/staubli_recorder.toml")),
    ("config/exports/twincat_scope.toml", include_str!("../../../config/exports/twincat_scope.toml")),
    ("config/exports/ur10e_current.toml", include_str!("../../../config/exports/ur10e_current.toml")),
    ("config/exports/ur_rtde.toml", include_str!("../../../config/exports/ur_rtde.toml")),
];

/// Source of a configuration. Displayed as `config/armwatch.toml (working directory)`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ConfigSource {
    /// A file named on the command line.
    Argument(PathBuf),
    /// A file named by the environment variable `ARMWATCH_CONFIG`.
    Environment(PathBuf),
    /// A file found in the working directory.
    WorkingDirectory(PathBuf),
    /// The one embedded in the program.
    Shipped,
}

impl ConfigSource {
    /// The first of: `argument`, the value of `ARMWATCH_CONFIG`, `config/armwatch.toml`, `armwatch.toml`, the shipped
    /// one. A missing file that was requested by name is not skipped: reading it then reports the error.
    pub fn locate(argument: Option<&Path>) -> Self {
        locate_in(Path::new(""), argument, std::env::var_os(VARIABLE).as_deref())
    }

    /// Reads the configuration from here.
    ///
    /// # Errors
    ///
    /// Every problem of the configuration and the files it refers to.
    pub fn read(&self) -> Result<Config, ConfigErrors> {
        match self {
            Self::Argument(path) | Self::Environment(path) | Self::WorkingDirectory(path) => {
                Config::read(path)
            }
            Self::Shipped => Config::shipped(),
        }
    }
}

impl ConfigSource {
    /// The description of the robot called `robot`, and nothing else: layouts and settings may be missing or wrong.
    /// `None` if no entry applies to it.
    ///
    /// # Errors
    ///
    /// Every problem of the entries' names and of that description.
    pub fn read_description(&self, robot: &str) -> Result<Option<Robot>, ConfigErrors> {
        match self {
            Self::Argument(path) | Self::Environment(path) | Self::WorkingDirectory(path) => {
                daemon_file::read_description(path, &files::read_text, robot)
            }
            Self::Shipped => daemon_file::read_description(Path::new(SHIPPED[0].0), &shipped_text, robot),
        }
    }
}

impl fmt::Display for ConfigSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Argument(path) => write!(f, "{} (--config)", path.display()),
            Self::Environment(path) => write!(f, "{} ({VARIABLE})", path.display()),
            Self::WorkingDirectory(path) => write!(f, "{} (working directory)", path.display()),
            Self::Shipped => f.write_str("shipped configuration"),
        }
    }
}

impl Config {
    /// Reads the configuration at `path` and the arms and layouts that it refers to.
    ///
    /// # Errors
    ///
    /// Every problem of all those files at once.
    pub fn read(path: &Path) -> Result<Self, ConfigErrors> {
        daemon_file::read(path, &files::read_text)
    }

    /// The configuration embedded in the program: database `armwatch.db`, watched folder `inbox`, native exports of
    /// ER3A arms.
    ///
    /// # Errors
    ///
    /// None in a tested build; the files are read by the same reader as any other.
    pub fn shipped() -> Result<Self, ConfigErrors> {
        daemon_file::read(Path::new(SHIPPED[0].0), &shipped_text)
    }

    /// Finds and reads the configuration: see [`ConfigSource::locate`].
    ///
    /// # Errors
    ///
    /// Every problem of the configuration that was found; none is skipped for the next place.
    pub fn find(argument: Option<&Path>) -> Result<(Self, ConfigSource), ConfigErrors> {
        let source = ConfigSource::locate(argument);
        Ok((source.read()?, source))
    }
}

fn locate_in(folder: &Path, argument: Option<&Path>, variable: Option<&OsStr>) -> ConfigSource {
    if let Some(path) = argument {
        return ConfigSource::Argument(path.to_owned());
    }
    // Shells and service files unset a variable by making it empty.
    if let Some(path) = variable.filter(|path| !path.is_empty()) {
        return ConfigSource::Environment(PathBuf::from(path));
    }
    let found = PLACES.iter().map(|place| folder.join(place)).find(|path| path.exists() && !path.is_dir());
    found.map_or(ConfigSource::Shipped, ConfigSource::WorkingDirectory)
}

fn shipped_text(path: &Path) -> Result<String, ConfigErrors> {
    let found = SHIPPED.iter().find(|(name, _)| Path::new(name) == path);
    found.map(|(_, text)| (*text).to_owned()).ok_or_else(|| {
        ConfigErrors::of_file(&path.display().to_string(), "is not among the shipped files".into(), None)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_place_that_names_a_configuration_wins() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |argument: Option<&str>, variable: Option<&str>| {
            locate_in(folder.path(), argument.map(Path::new), variable.map(OsStr::new))
        };
        assert_eq!(at(None, None), ConfigSource::Shipped);
        assert_eq!(at(None, Some("")), ConfigSource::Shipped);
        let lone = folder.path().join("armwatch.toml");
        std::fs::write(&lone, "").expect("written");
        assert_eq!(at(None, None), ConfigSource::WorkingDirectory(lone));
        std::fs::create_dir(folder.path().join("config")).expect("created");
        let nested = folder.path().join("config/armwatch.toml");
        std::fs::write(&nested, "").expect("written");
        assert_eq!(at(None, None), ConfigSource::WorkingDirectory(nested));
        assert_eq!(at(None, Some("env.toml")), ConfigSource::Environment("env.toml".into()));
        assert_eq!(at(Some("arg.toml"), Some("env.toml")), ConfigSource::Argument("arg.toml".into()));
    }

    #[test]
    fn a_configuration_asked_for_by_name_is_never_replaced_by_another() {
        let errors = ConfigSource::Argument("no/such/armwatch.toml".into()).read().expect_err("missing");
        assert_eq!(errors.0.len(), 1);
        assert!(errors.to_string().starts_with("no/such/armwatch.toml: cannot be read"), "{errors}");
    }
}
