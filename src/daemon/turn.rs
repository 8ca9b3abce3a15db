//! Whose turn a file takes: that of its robot, among files of its class.

use std::path::Path;

use armwatch_config::Config;
use armwatch_ingest::bytes::parts;
use armwatch_model::text;

/// Settled files, by what they ask of the machine. Each class has places of its own, so that no number of large
/// or slow files holds up small ones.
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

/// Which way a file is taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ReadMode {
    /// As it grows.
    Growing,
    /// As it has settled, in the turn of its robot.
    Settled(String, Class),
}

/// The robot that an export's name says, or the path of one that says none: such files do not wait for each
/// other.
pub(super) fn robot_of(config: &Config, path: &Path) -> String {
    named_robot(config, path).unwrap_or_else(|| text::of_path(path))
}

/// The robot that an export's name says.
pub(super) fn named_robot(config: &Config, path: &Path) -> Option<String> {
    config
        .recognition
        .recognise(&text::of_file_name(&parts::named_by(path)))
        .ok()
        .map(|recognised| recognised.robot)
}
