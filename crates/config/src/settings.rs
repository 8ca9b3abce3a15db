//! The checked contents of the configuration.

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

/// All settings of the program, read and checked.
#[derive(Debug, Clone)]
pub struct Config {
    /// Database file, or the address of one on a server.
    pub database: PathBuf,
    /// Identity of this daemon among several on the database.
    pub cluster: ClusterSettings,
    /// Folders to watch and how.
    pub watch: WatchSettings,
    /// Limits on the work.
    pub limits: WorkLimits,
    /// The HTTP server; `None` for none.
    pub serve: Option<ServeSettings>,
    /// Clients that may use HTTP, and their limits.
    pub clients: ClientSettings,
    /// Path of copies for readers; `None` for no copies.
    pub snapshot: Option<SnapshotSettings>,
    /// How long factors of single cycles are kept.
    pub retention: RetentionSettings,
    /// Receivers of alarms.
    pub alerts: AlertSettings,
    /// Rules that derive robot and start time from a file name.
    pub recognition: Recognition,
    /// The robots; the first entry whose pattern matches a robot's name applies.
    pub fleet: Vec<FleetEntry>,
    /// Settings of a cycle's analysis.
    pub analysis: AnalysisSettings,
    /// Conditions for anomalies.
    pub detect: DetectSettings,
}

impl Config {
    /// The database file; `None` if the database is on a server.
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
        let key = self.serve.as_ref().and_then(|serve| serve.tls.as_ref()).map(|tls| &*tls.key);
        served.into_iter().chain(key).chain(tokens).chain(files)
    }

    /// The entry of the robot called `robot`: the first whose pattern matches the whole name, preferably one for all
    /// its files.
    pub fn robot_entry(&self, robot: &str) -> Option<&FleetEntry> {
        let mut entries = self.fleet.iter().filter(|entry| pattern::matches(&entry.robots, robot));
        let for_all = entries.clone().find(|entry| entry.files.is_none());
        for_all.or_else(|| entries.next())
    }

    /// Returns true if the name or the rows of an export of this robot give its start, so that the time of its file is
    /// not needed.
    pub fn names_start(&self, robot: &str, file_name: &str) -> bool {
        self.recognition.recognise(file_name).is_ok_and(|named| named.started_at.is_some())
            || self.export_entry(robot, file_name).is_some_and(|entry| entry.layout.start.is_some())
    }

    /// The entry for an export of the robot called `robot`: the first whose patterns match its name and that
    /// of the file.
    pub fn export_entry(&self, robot: &str, file_name: &str) -> Option<&FleetEntry> {
        self.fleet.iter().find(|entry| {
            let of_file = entry.files.as_ref().is_none_or(|files| files.matches(file_name));
            of_file && pattern::matches(&entry.robots, robot)
        })
    }
}

impl Config {
    /// The part of a recording in a file name; `None` if the file is a whole recording.
    ///
    /// Without `[parts]` in the layout, numbered names are parts if they give one time without the number too.
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

    /// Returns true if an export gives the same rows for one robot and file name as for another, so that a copy under
    /// another name is the same recording. Two layouts may read two arms of one export.
    pub fn reads_alike(&self, (robot, name): (&str, &str), (other, other_name): (&str, &str)) -> bool {
        let layout = |robot, name| self.export_entry(robot, name).map(|entry| &entry.layout);
        let of_other = layout(other, other_name);
        robot == other || of_other.is_none() || layout(robot, name) == of_other
    }

    /// Returns true if some exports of `robot` have a torque of the joint; also for robots without an entry.
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
    /// True if scans follow links that lead out of the watched folder.
    pub follow_links: bool,
    /// Time between two scans.
    pub scan_interval: Duration,
    /// Time without change of a file's size and modification time after which it is complete.
    pub settle: Duration,
    /// Most exports that are read at once while they grow.
    pub live_files: usize,
    /// Treatment of a run whose file is overwritten with another content.
    pub on_rewrite: RewritePolicy,
    /// Folder that receives stored exports; `None` if they stay.
    pub archive: Option<PathBuf>,
}

/// Limits on the work, independent of the exports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WorkLimits {
    /// Most settled exports that are read at once: this many small ones and this many large ones.
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

armwatch_model::named_enum! {
    /// Treatment of a complete run whose file is overwritten with another content.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum RewritePolicy {
        /// The new run supersedes the old one, which is kept and takes no part in conclusions.
        Supersede = "supersede",
        /// Both runs count.
        KeepBoth = "keep_both",
    }
}

/// Rules that derive robot and start time from a file name.
#[derive(Debug, Clone)]
pub struct Recognition {
    /// Pattern over the file name with the named groups `robot` and, optionally, `date` and `time`.
    pub file_name: regex::Regex,
    /// Forms of date and time.
    pub formats: DateFormats,
    /// IANA time zone of date and time in file names.
    pub time_zone: String,
}

/// Robots that share a description and a layout.
#[derive(Debug, Clone)]
pub struct FleetEntry {
    /// Pattern over the whole robot name; `*` matches any characters.
    pub robots: String,
    /// Patterns over the file name of an export, with its endings; one must match. `None` for all files.
    pub files: Option<FilePatterns>,
    /// The arm.
    pub description: Arc<Robot>,
    /// The layout of its exports.
    pub layout: Arc<Layout>,
    /// Largest relative error of a gain between recorded and true torque.
    pub gain_uncertainty: f64,
}
