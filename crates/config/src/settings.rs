//! What the configuration says, read and checked.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::address::is_on_server;
use super::alerts::receivers::Secret;
use super::alerts::settings::AlertSettings;
use super::cluster::ClusterSettings;
use super::date_format::DateFormats;
use super::layout::channels::Layout;
use super::layout::parts::{PartName, numbered_part};
use super::pattern::{self, FilePatterns};
use super::retention::RetentionSettings;
use super::serve::{ClientSettings, ServeSettings};
use super::snapshot::SnapshotSettings;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::{JointIndex, Robot};

/// Everything the program is told, read and checked.
#[derive(Debug, Clone)]
pub struct Config {
    /// Database file, or the address of one on a server.
    pub database: PathBuf,
    /// What this daemon is among several on the database.
    pub cluster: ClusterSettings,
    /// Folders to watch and how.
    pub watch: WatchSettings,
    /// What the work may take.
    pub limits: WorkLimits,
    /// What is served over HTTP; `None`: nothing.
    pub serve: Option<ServeSettings>,
    /// Who may ask over HTTP, and how much.
    pub clients: ClientSettings,
    /// Where copies for readers are written; `None`: nowhere.
    pub snapshot: Option<SnapshotSettings>,
    /// How long factors of single cycles are kept.
    pub retention: RetentionSettings,
    /// Who is told of alarms.
    pub alerts: AlertSettings,
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
    /// The database file; `None` where the database is on a server.
    #[must_use]
    pub fn database_file(&self) -> Option<&Path> {
        (!is_on_server(&self.database)).then_some(&*self.database)
    }

    /// The descriptions of the arms, without declared tools.
    pub fn arms(&self) -> impl Iterator<Item = &Arc<Robot>> {
        self.fleet.iter().map(|entry| &entry.description).filter(|robot| !robot.has_carried())
    }

    /// Files that hold a secret.
    pub fn secret_files(&self) -> impl Iterator<Item = &Path> {
        let served = self.serve.as_ref().and_then(|serve| serve.token_file.as_deref());
        let tokens = self.clients.tokens.iter().map(|token| &*token.file);
        let of_routes = self.alerts.routes.iter().flat_map(|route| route.receiver.secrets());
        let files = of_routes.filter_map(|secret| match secret {
            Secret::File(path) => Some(&**path),
            Secret::Environment(_) => None,
        });
        served.into_iter().chain(tokens).chain(files)
    }

    /// The entry of the robot called `robot`: the first whose pattern matches the whole name, one for all its
    /// files if there is one.
    #[must_use]
    pub fn robot_entry(&self, robot: &str) -> Option<&FleetEntry> {
        let mut entries = self.fleet.iter().filter(|entry| pattern::matches(&entry.robots, robot));
        let for_all = entries.clone().find(|entry| entry.files.is_none());
        for_all.or_else(|| entries.next())
    }

    /// Whether the name or the rows of an export of this robot say when it began, so that the time of its file does not.
    #[must_use]
    pub fn names_start(&self, robot: &str, file_name: &str) -> bool {
        self.recognition.recognise(file_name).is_ok_and(|named| named.started_at.is_some())
            || self.export_entry(robot, file_name).is_some_and(|entry| entry.layout.start.is_some())
    }

    /// The entry for an export of the robot called `robot`: the first whose patterns match its name and that
    /// of the file.
    #[must_use]
    pub fn export_entry(&self, robot: &str, file_name: &str) -> Option<&FleetEntry> {
        self.fleet.iter().find(|entry| {
            let of_file = entry.files.as_ref().is_none_or(|files| files.matches(file_name));
            of_file && pattern::matches(&entry.robots, robot)
        })
    }
}

impl Config {
    /// The part of a recording that a file name says; `None` if the file is a recording by itself.
    ///
    /// Without `[parts]` in the layout, numbered names are parts if they say one moment without the number too.
    #[must_use]
    pub fn part_of(&self, file_name: &str) -> Option<PartName> {
        if self.fleet.iter().all(|entry| entry.layout.parts.is_none()) && numbered_part(file_name).is_none() {
            return None;
        }
        let recognised = self.recognition.recognise(file_name).ok()?;
        let entry = self.export_entry(&recognised.robot, file_name)?;
        if let Some(rule) = &entry.layout.parts {
            return rule.part_of(file_name);
        }
        let part = numbered_part(file_name)?;
        let whole = self.recognition.recognise(&format!("{}{}", part.before, part.after)).ok()?;
        (whole.is_definite && whole == recognised).then_some(part)
    }

    /// Whether an export gives the same rows for one robot and file name as for another, so that a copy under another name is
    /// the same recording. Two layouts may read two arms of one export.
    #[must_use]
    pub fn reads_alike(&self, (robot, name): (&str, &str), (other, other_name): (&str, &str)) -> bool {
        let layout = |robot, name| self.export_entry(robot, name).map(|entry| &entry.layout);
        let of_other = layout(other, other_name);
        robot == other || of_other.is_none() || layout(robot, name) == of_other
    }

    /// Whether some exports of `robot` have a torque of the joint; also of robots that no entry describes.
    #[must_use]
    pub fn has_torque(&self, robot: &str, joint: JointIndex) -> bool {
        let mut entries = self.fleet.iter().filter(|entry| pattern::matches(&entry.robots, robot)).peekable();
        entries.peek().is_none() || entries.any(|entry| !entry.layout.without_torque.contains(&joint))
    }
}

/// Folders to watch.
#[derive(Debug, Clone)]
pub struct WatchSettings {
    /// Folders, searched with their subfolders.
    pub folders: Vec<PathBuf>,
    /// Whether scans follow links that lead out of the watched folder.
    pub follow_links: bool,
    /// Time between two scans.
    pub scan_interval: Duration,
    /// How long a file's size and modification time must stand still before it is taken as done.
    pub settle: Duration,
    /// Most exports that are read at once while they grow.
    pub live_files: usize,
    /// What becomes of a run whose file is written over with another content.
    pub on_rewrite: RewritePolicy,
    /// Folder that exports are moved to once they are stored; `None`: they stay.
    pub archive: Option<PathBuf>,
}

/// What the work may take, whatever the exports are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorkLimits {
    /// Settled exports that are read at once: so many small ones and so many large ones.
    pub backlog_files: usize,
    /// From this size on disk an export is large, bytes.
    pub large_file_bytes: u64,
    /// Most bytes of an export after decompression.
    pub export_bytes: u64,
    /// Most rows of a cycle, which are in memory together.
    pub cycle_rows: usize,
    /// Memory of the cycles of all exports that are read or analysed, bytes. Beyond it, they wait for each other.
    pub cycles_bytes: usize,
}

/// What becomes of a complete run whose file is written over with another content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RewritePolicy {
    /// The new run takes its place; the old one is kept and takes no part in conclusions.
    Supersede,
    /// Both stand.
    KeepBoth,
}

impl RewritePolicy {
    /// Name as in the configuration.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Supersede => "supersede",
            Self::KeepBoth => "keep_both",
        }
    }
}

/// How a file name gives robot and start time.
#[derive(Debug, Clone)]
pub struct Recognition {
    /// Pattern over the file name with the named groups `robot` and, where given, `date` and `time`.
    pub file_name: regex::Regex,
    /// How date and time are written.
    pub formats: DateFormats,
    /// IANA time zone of date and time in file names.
    pub time_zone: String,
}

/// Robots that share a description and a layout.
#[derive(Debug, Clone)]
pub struct FleetEntry {
    /// Pattern over the whole robot name; `*` stands for any characters.
    pub robots: String,
    /// Patterns over the file name of an export, with its endings, of which one must match; `None` for all files.
    pub files: Option<FilePatterns>,
    /// The arm.
    pub description: Arc<Robot>,
    /// The layout of its exports.
    pub layout: Arc<Layout>,
    /// Largest relative error of a gain between recorded and true torque.
    pub gain_uncertainty: f64,
}
