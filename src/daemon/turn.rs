//! The queue of a file: that of its robot, among files of its class.

use std::path::Path;

use armwatch_config::Config;
use armwatch_ingest::bytes::parts;
use armwatch_model::text;

/// Settled files by the resources that they need. Each class has separate places, so that large or slow files never
/// delay small ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Class {
    /// Read within seconds.
    Small,
    /// Read within minutes or more.
    Large,
}

impl Class {
    pub(super) const ALL: [Self; 2] = [Self::Small, Self::Large];

    pub(super) fn of(bytes: u64, config: &Config) -> Self {
        if bytes < config.limits.large_file_bytes { Self::Small } else { Self::Large }
    }
}

/// How a file is read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ReadMode {
    /// While it grows.
    Growing,
    /// After it has settled, in the turn of its robot.
    Settled(String, Class),
}

/// The robot in an export's name, or the path if the name gives none: such files do not wait for each other.
pub(super) fn robot_of(config: &Config, path: &Path) -> String {
    named_robot(config, path).unwrap_or_else(|| text::of_path(path))
}

/// The robot in an export's name.
pub(super) fn named_robot(config: &Config, path: &Path) -> Option<String> {
    config
        .recognition
        .recognise(&text::of_file_name(&parts::named_by(path)))
        .ok()
        .map(|recognised| recognised.robot)
}
