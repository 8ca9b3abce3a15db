//! The daemon's file, `armwatch.toml`, with the arms and layouts that it refers to.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::recognition::{DEFAULT_FILE_NAME, time_zone};
use super::tools::with_tools;
use super::work_limits::{archive_of, read_work_limits};
use crate::address::{KINDS_OF_DATABASE, foreign_scheme};
use crate::alerts::routes::read_alerts;
use crate::alerts::settings::AlertSettings;
use crate::cluster::read_cluster;
use crate::layout::channels::{Channel, Layout, TorqueQuantity};
use crate::layout::layout_file::parse_layout;
use crate::pattern::FilePatterns;
use crate::retention::read_retention;
use crate::robot::robot_file::parse_robot_with;
use crate::serve::{ServeSettings, read_serve};
use crate::settings::{Config, FleetEntry, Recognition, RewritePolicy, WatchSettings, WorkLimits};
use crate::snapshot::read_snapshot;
use crate::toml::files::ReadText;
use crate::toml::problem::ConfigErrors;
use crate::toml::range::Limits;
use crate::toml::suggestion;
use crate::toml::table::{Table, Value, read_document};
use crate::{date_format, pattern};
use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::finding::{FindingKind, FindingKinds};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::anomaly::baseline_runs::MOST_BASELINE_RUNS;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::{JointKind, Robot, TorqueSensors};

const DEFAULT_DATABASE: &str = "armwatch.db";
const DEFAULT_FOLDER: &str = "inbox";
const DEFAULT_SCAN_INTERVAL_S: f64 = 5.0;
const DEFAULT_SETTLE_S: f64 = 3.0;
const DEFAULT_LIVE_FILES: usize = 32;

/// Largest relative error of a drive gain from a catalogue.
const DEFAULT_GAIN_UNCERTAINTY: f64 = 0.15;

/// Most growing exports at once: each holds an open file, a thread and the rows of its current cycle.
const MAX_LIVE_FILES: i64 = 256;

/// Most folders to watch; each is walked at every scan.
const MAX_FOLDERS: usize = 1000;

/// Reads the configuration at `path` and the files that it refers to, all through `read_text`.
///
/// # Errors
///
/// Every problem of all those files at once.
pub(crate) fn read(path: &Path, read_text: &ReadText<'_>) -> Result<Config, ConfigErrors> {
    let text = read_text(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut references = References { folder, read_text, robots: BTreeMap::new(), layouts: BTreeMap::new() };
    read_document(&path.display().to_string(), &text, |root| read_root(root, &mut references))
}

fn read_root(root: &Table<'_>, references: &mut References<'_>) -> Option<Config> {
    let database = root.optional("database").map_or(Some(DEFAULT_DATABASE), |value| read_database(&value));
    let cluster = read_cluster(root.table("cluster").as_ref());
    let watch = read_watch(root.table("watch").as_ref());
    let limits = root.table("limits").map_or(Some(WorkLimits::default()), |t| read_work_limits(&t));
    let serve = read_serve(root.table("serve").as_ref());
    let snapshot = read_snapshot(root.table("snapshot").as_ref(), database);
    let retention = read_retention(root.table("retention").as_ref());
    let alerts = root.table("alerts").map_or_else(|| Some(AlertSettings::default()), |t| read_alerts(&t));
    let recognition = read_recognition(root.table("recognition").as_ref());
    let fleet = with_tools(root, read_fleet(root, references));
    let analysis =
        root.table("analysis").map_or_else(|| Some(AnalysisSettings::default()), |t| read_analysis(&t));
    let detect = root.table("detect").map_or_else(|| Some(DetectSettings::default()), |t| read_detect(&t));
    let public_url = serve.as_ref()?.0.as_ref().and_then(|serve| serve.public_url.clone());
    let alerts = alerts.map(|alerts| AlertSettings { link: alerts.link.clone().or(public_url), ..alerts });
    Some(Config {
        database: PathBuf::from(database?),
        cluster: cluster?,
        watch: with_spool(watch?, serve.as_ref()?.0.as_ref()),
        limits: limits?,
        clients: serve.as_ref()?.1.clone(),
        serve: serve?.0,
        snapshot: snapshot?,
        retention: retention?,
        alerts: alerts?,
        recognition: recognition?,
        fleet: fleet?,
        analysis: analysis?,
        detect: detect?,
    })
}

/// The database, which must not be the address of another kind of server: that would become the name of a file.
fn read_database<'d>(value: &Value<'d>) -> Option<&'d str> {
    let database = value.text()?;
    let Some(scheme) = foreign_scheme(Path::new(database)) else { return Some(database) };
    value.refuse_secret(format!("cannot be an address of {scheme}"), Some(KINDS_OF_DATABASE.to_owned()));
    None
}

/// Adds the folder of uploads to the watched ones.
fn with_spool(mut watch: WatchSettings, serve: Option<&ServeSettings>) -> WatchSettings {
    if let Some(upload) = serve.and_then(|serve| serve.upload.as_ref())
        && !watch.folders.contains(&upload.spool)
    {
        watch.folders.push(upload.spool.clone());
    }
    watch
}

fn read_watch(table: Option<&Table<'_>>) -> Option<WatchSettings> {
    let interval = Limits::between(0.1, 86_400.0, "s");
    let settle = Limits::between(0.0, 3600.0, "s");
    let number = |key, limits, default| table.map_or(Some(default), |t| t.number_or(key, limits, default));
    let scan_interval = number("scan_interval_s", &interval, DEFAULT_SCAN_INTERVAL_S);
    let settle = number("settle_s", &settle, DEFAULT_SETTLE_S);
    let folders = match table.and_then(|t| t.optional("folders")) {
        Some(value) => read_folders(&value),
        None => Some(vec![PathBuf::from(DEFAULT_FOLDER)]),
    };
    let follow_links = match table.and_then(|t| t.optional("follow_links")) {
        Some(value) => value.boolean(),
        None => Some(false),
    };
    let live_files = match table.and_then(|t| t.optional("live_files")) {
        Some(value) => value.integer(1..=MAX_LIVE_FILES).and_then(|number| usize::try_from(number).ok()),
        None => Some(DEFAULT_LIVE_FILES),
    };
    let on_rewrite = match table.and_then(|t| t.optional("on_rewrite")) {
        Some(value) => read_policy(&value),
        None => Some(RewritePolicy::Supersede),
    };
    let archive = match table.and_then(|t| t.optional("archive")) {
        Some(value) => archive_of(&value, folders.as_deref().unwrap_or_default()).map(Some),
        None => Some(None),
    };
    Some(WatchSettings {
        folders: folders?,
        follow_links: follow_links?,
        scan_interval: Duration::try_from_secs_f64(scan_interval?).ok()?,
        settle: Duration::try_from_secs_f64(settle?).ok()?,
        live_files: live_files?,
        on_rewrite: on_rewrite?,
        archive: archive?,
    })
}

fn read_policy(value: &Value<'_>) -> Option<RewritePolicy> {
    let name = value.text()?;
    let policies = [RewritePolicy::Supersede, RewritePolicy::KeepBoth];
    let found = policies.into_iter().find(|policy| policy.name() == name);
    if found.is_none() {
        let names = policies.map(|policy| format!("\"{}\"", policy.name())).join(" or ");
        value.refuse("is not a policy".into(), Some(format!("write {names}")));
    }
    found
}

fn read_folders(value: &Value<'_>) -> Option<Vec<PathBuf>> {
    let items = value.items()?;
    if items.is_empty() || items.len() > MAX_FOLDERS {
        value.refuse(format!("has {} entries, must have 1 to {MAX_FOLDERS}", items.len()), None);
        return None;
    }
    let mut folders: Vec<PathBuf> = Vec::new();
    for item in &items {
        let folder = PathBuf::from(item.text()?);
        if folders.contains(&folder) {
            item.refuse("is listed twice".into(), Some("remove one of them".into()));
            return None;
        }
        folders.push(folder);
    }
    Some(folders)
}

fn read_recognition(table: Option<&Table<'_>>) -> Option<Recognition> {
    let file_name = match table.and_then(|t| t.optional("file_name")) {
        Some(value) => read_file_name(&value),
        None => regex::Regex::new(DEFAULT_FILE_NAME).ok(),
    };
    let zone = match table.and_then(|t| t.optional("time_zone")) {
        Some(value) => read_time_zone(&value),
        None => Some("UTC".to_owned()),
    };
    let file_name = file_name?;
    let has = |group: &str| file_name.capture_names().flatten().any(|name| name == group);
    let formats = date_format::read(table, has);
    Some(Recognition { formats: formats?, file_name, time_zone: zone? })
}

fn read_file_name(value: &Value<'_>) -> Option<regex::Regex> {
    let pattern = match regex::Regex::new(value.text()?) {
        Ok(pattern) => pattern,
        Err(error) => {
            // The last line is the message; those before draw arrows under the pattern.
            let message = error.to_string();
            let reason =
                message.lines().last().unwrap_or_default().trim().trim_start_matches("error: ").to_owned();
            value.refuse(
                format!("is not a regular expression: {reason}"),
                Some("write it in single quotes, so that backslashes stay unchanged".into()),
            );
            return None;
        }
    };
    let has = |group: &str| pattern.capture_names().flatten().any(|name| name == group);
    if !has("robot") {
        value.refuse("has no group robot".into(), Some(format!("write it like '{DEFAULT_FILE_NAME}'")));
        return None;
    }
    if has("time") && !has("date") {
        value.refuse("has a group time but no group date".into(), Some("a time needs a date".into()));
        return None;
    }
    Some(pattern)
}

fn read_time_zone(value: &Value<'_>) -> Option<String> {
    let name = value.text()?;
    if time_zone(name).is_none() {
        let hint = "write an IANA name such as \"Europe/Rome\" or \"UTC\"; names other than UTC need the time zone \
                    database of the operating system (package tzdata)";
        value.refuse("is not a time zone known on this computer".into(), Some(hint.into()));
        return None;
    }
    Some(name.to_owned())
}

/// Files that the fleet refers to. Several entries may share one, which is then read once and whose problems are
/// reported once.
struct References<'r> {
    folder: &'r Path,
    read_text: &'r ReadText<'r>,
    robots: BTreeMap<PathBuf, Option<Arc<Robot>>>,
    layouts: BTreeMap<PathBuf, Option<Arc<Layout>>>,
}

impl References<'_> {
    fn robot(&mut self, table: &Table<'_>, key: &str) -> Option<Arc<Robot>> {
        let read_text = self.read_text;
        let parse = |name: &str, text: &str| parse_robot_with(name, text, read_text);
        refer(self.folder, read_text, &mut self.robots, table, key, parse)
    }

    fn layout(&mut self, table: &Table<'_>, key: &str) -> Option<Arc<Layout>> {
        refer(self.folder, self.read_text, &mut self.layouts, table, key, parse_layout)
    }
}

fn refer<T>(
    folder: &Path,
    read_text: &ReadText<'_>,
    known: &mut BTreeMap<PathBuf, Option<Arc<T>>>,
    table: &Table<'_>,
    key: &str,
    parse: impl FnOnce(&str, &str) -> Result<T, ConfigErrors>,
) -> Option<Arc<T>> {
    let value = table.required(key)?;
    let path = folder.join(value.text()?);
    if let Some(seen) = known.get(&path) {
        return seen.clone();
    }
    let read = match read_text(&path) {
        Ok(text) => parse(&path.display().to_string(), &text).map_err(|errors| table.adopt(errors)).ok(),
        Err(errors) => {
            let reasons = errors.0.iter().map(|p| p.problem.as_str()).collect::<Vec<_>>().join(", ");
            let hint = "paths are relative to the folder of this file".to_owned();
            value.refuse(format!("{} {reasons}", path.display()), Some(hint));
            None
        }
    };
    let read = read.map(Arc::new);
    known.insert(path, read.clone());
    read
}

/// The description of the robot called `robot` in the configuration at `path`, ignoring everything else in it;
/// preferably that of an entry for all its files.
///
/// # Errors
///
/// Problems of syntax, of the entry, and of the description.
pub(crate) fn read_description(
    path: &Path,
    read_text: &ReadText<'_>,
    robot: &str,
) -> Result<Option<Robot>, ConfigErrors> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let file_name = path.display().to_string();
    let named = read_document(&file_name, &read_text(path)?, |root| {
        root.pass_over();
        let mut named: Vec<(bool, String)> = Vec::new();
        for item in root.optional("robot").and_then(|value| value.sections()).unwrap_or_default() {
            let table = item.table()?;
            table.pass_over();
            if table.text("name").is_some_and(|name| pattern::matches(name, robot)) {
                named.push((table.optional("files").is_some(), table.text("description")?.to_owned()));
            }
        }
        Some(named)
    })?;
    let Some((_, description)) = named.into_iter().min_by_key(|(of_some_files, _)| *of_some_files) else {
        return Ok(None);
    };
    let at = folder.join(description);
    parse_robot_with(&at.display().to_string(), &read_text(&at)?, read_text).map(Some)
}

fn read_fleet(root: &Table<'_>, references: &mut References<'_>) -> Option<Vec<FleetEntry>> {
    let hint = || Some("write [[robot]] with name = \"*\", description and layout".into());
    let items = root.required_or_else("robot", hint)?.sections()?;
    if items.is_empty() {
        root.refuse("no robot is configured".into(), hint());
        return None;
    }
    let mut patterns: Vec<&str> = Vec::new();
    let entries: Vec<_> = items
        .iter()
        .map(|item| {
            let table = item.table()?;
            let files = table.optional("files").map(|value| read_files(&value));
            let robots = table.required("name").and_then(|value| match files {
                None => read_pattern(&value, &mut patterns),
                Some(_) => read_exception(&value, &patterns),
            });
            let files = match files {
                Some(files) => Some(files?),
                None => None,
            };
            let description = references.robot(&table, "description");
            let layout = references.layout(&table, "layout");
            let gains = Limits::between(0.0, 0.5, "");
            let gain_uncertainty = table.number_or("gain_uncertainty", &gains, DEFAULT_GAIN_UNCERTAINTY)?;
            let robots = robots?.to_owned();
            let (description, layout) = (description?, layout?);
            let entry = FleetEntry { robots, files, description, layout, gain_uncertainty };
            check_units(&table, &entry)?;
            check_fit(&table, &entry)?;
            Some(FleetEntry { description: entry.layout.described(entry.description), ..entry })
        })
        .collect();
    entries.into_iter().collect()
}

/// One pattern over file names, or several.
pub(super) fn read_files(value: &Value<'_>) -> Option<FilePatterns> {
    if !value.is_array() {
        return value.text().map(|text| FilePatterns(vec![vec![text.to_owned()]]));
    }
    let items = value.items()?;
    if items.is_empty() {
        value.refuse(
            "the list is empty, so that the entry matches no file".into(),
            Some("remove files to match all files of the robot".into()),
        );
        return None;
    }
    let patterns: Vec<_> = items.iter().map(|item| item.text().map(str::to_owned)).collect();
    Some(FilePatterns(vec![patterns.into_iter().collect::<Option<_>>()?]))
}

/// One factor applies to the columns of all joints, and a factor from degrees would silently falsify the metres of a
/// prismatic joint.
fn check_units(table: &Table<'_>, entry: &FleetEntry) -> Option<()> {
    let (robot, layout) = (&entry.description, &entry.layout);
    let slides = robot.joints.iter().any(|joint| joint.kind == JointKind::Prismatic);
    let in_si = |channel: &Channel| channel.to_si == 1.0;
    if slides && !(in_si(&layout.position) && layout.velocity.as_ref().is_none_or(in_si)) {
        table.refuse(
            format!(
                "{} has a prismatic joint, but the layout {} is not in rad and m",
                robot.model, layout.name
            ),
            Some("export rad for revolute and m for prismatic joints".into()),
        );
        return None;
    }
    Some(())
}

/// A layout in amperes or percent needs gains in the description, and sensors after the gears do not measure the
/// motors' torque; reporting that now is better than for each export.
fn check_fit(table: &Table<'_>, entry: &FleetEntry) -> Option<()> {
    let of_motors = entry.layout.motor_side.torque || entry.layout.torque_quantity != TorqueQuantity::Torque;
    if entry.description.torque_sensors == TorqueSensors::Link && of_motors {
        let problem = format!(
            "{} has torque_sensors = \"link\", but the layout {} reads torques of the motors",
            entry.description.model, entry.layout.name
        );
        let hint = "name the columns of the joint torque sensors, in Nm, or remove torque_sensors from the \
            description";
        table.refuse(problem, Some(hint.into()));
        return None;
    }
    match entry.layout.factors(&entry.description) {
        Ok(_) => Some(()),
        Err(misfit) => {
            let file = table.text("description").unwrap_or_default();
            table.refuse(format!("{} ({file})", misfit.problem), Some(misfit.remedy));
            None
        }
    }
}

/// The pattern of an entry for some files only, which must come before one for all files of these robots.
fn read_exception<'d>(value: &Value<'d>, earlier: &[&'d str]) -> Option<&'d str> {
    let robots = value.text()?;
    if let Some(known) = earlier.iter().find(|known| pattern::covers(known, robots)) {
        let problem = format!("is never used: \"{known}\", given before, matches all files of these robots");
        value.refuse(problem, Some("put the entry with files first".into()));
        return None;
    }
    Some(robots)
}

/// A pattern, which must not give any robot two arms. A pattern that is narrower than a later one is the normal way to
/// make an exception.
fn read_pattern<'d>(value: &Value<'d>, earlier: &mut Vec<&'d str>) -> Option<&'d str> {
    let robots = value.text()?;
    let conflict = earlier.iter().find_map(|known| {
        if *known == robots {
            Some((format!("the pattern \"{known}\" is already given"), "remove one of them"))
        } else if pattern::covers(known, robots) {
            let problem = format!("is never used: \"{known}\", given before, matches these robots first");
            Some((problem, "put the narrower pattern first"))
        } else if pattern::overlap(known, robots) && !pattern::covers(robots, known) {
            Some((
                format!("some names match this and \"{known}\", given before"),
                "make one of them narrower",
            ))
        } else {
            None
        }
    });
    earlier.push(robots);
    match conflict {
        Some((problem, hint)) => {
            value.refuse(problem, Some(hint.into()));
            None
        }
        None => Some(robots),
    }
}

fn read_analysis(table: &Table<'_>) -> Option<AnalysisSettings> {
    let default = AnalysisSettings::default();
    let cutoff = table.number_or("cutoff_hz", &Limits::between(0.5, 1000.0, "Hz"), default.cutoff);
    let fraction = Limits::above(0.0, 1.0, "of the largest speed");
    let reference = table.number_or("reference_speed_fraction", &fraction, default.reference_speed_fraction);
    let estimator = match table.optional("estimator") {
        Some(value) => read_estimator(&value),
        None => Some(default.estimator),
    };
    let accept = match table.optional("accept") {
        Some(value) => read_accept(&value),
        None => Some(default.accept),
    };
    Some(AnalysisSettings {
        cutoff: cutoff?,
        reference_speed_fraction: reference?,
        estimator: estimator?,
        accept: accept?,
    })
}

fn read_accept(value: &Value<'_>) -> Option<FindingKinds> {
    let kind = |item: &Value<'_>| {
        let name = item.text()?;
        let found = FindingKind::from_name(name);
        if found.is_none() {
            let hint = match suggestion::nearest(name, FindingKind::ALL.map(FindingKind::name)) {
                Some(known) => format!("did you mean {known}?"),
                None => "docs/method.md has the names, and every refusal names its finding".into(),
            };
            item.refuse("is not a finding that can refuse a cycle".into(), Some(hint));
        }
        found
    };
    value.items()?.iter().map(kind).collect()
}

fn read_estimator(value: &Value<'_>) -> Option<Estimator> {
    let name = value.text()?;
    let found = Estimator::ALL.into_iter().find(|estimator| estimator.name() == name);
    if found.is_none() {
        value.refuse(
            "must be \"ordinary\", \"weighted\" or \"huber\"".into(),
            Some(
                "equal weights; weights from the noise of each joint; the same, with less weight for \
                distant rows"
                    .into(),
            ),
        );
    }
    found
}

fn read_detect(table: &Table<'_>) -> Option<DetectSettings> {
    let default = DetectSettings::default();
    let runs = match table.optional("baseline_runs") {
        Some(value) => {
            value.integer(2..=MOST_BASELINE_RUNS as i64).and_then(|runs| usize::try_from(runs).ok())
        }
        None => Some(default.baseline_runs),
    };
    let drift = read_levels(table, "drift", (default.drift_warning, default.drift_critical));
    let rate = table.number_or(
        "false_alarms_per_robot_year",
        &Limits::between(0.001, 1000.0, ""),
        default.false_alarms_per_robot_year,
    );
    let sigma = match table.optional("drift_sigma") {
        Some(value) => value.number(&Limits::between(0.0, 100.0, "standard deviations")).map(Some),
        None => Some(default.drift_sigma),
    };
    let ratio =
        table.number_or("oscillation_ratio", &Limits::above(1.0, 1000.0, ""), default.oscillation_ratio);
    let accuracy = read_levels(table, "accuracy", (default.accuracy_warning, default.accuracy_critical));
    let overdue = table.number_or("overdue_factor", &Limits::above(1.0, 1000.0, ""), default.overdue_factor);
    let ((drift_warning, drift_critical), (accuracy_warning, accuracy_critical)) = (drift?, accuracy?);
    Some(DetectSettings {
        baseline_runs: runs?,
        drift_warning,
        drift_critical,
        false_alarms_per_robot_year: rate?,
        drift_sigma: sigma?,
        oscillation_ratio: ratio?,
        accuracy_warning,
        accuracy_critical,
        overdue_factor: overdue?,
    })
}

/// The fractions that make a quantity a warning and critical.
fn read_levels(table: &Table<'_>, stem: &str, default: (f64, f64)) -> Option<(f64, f64)> {
    let fraction = Limits::above(0.0, 10.0, "");
    let warning = table.number_or(&format!("{stem}_warning_fraction"), &fraction, default.0);
    let key = format!("{stem}_critical_fraction");
    let critical = table.number_or(&key, &fraction, default.1);
    let (warning, critical) = (warning?, critical?);
    if warning >= critical {
        let problem = format!("{stem}_warning_fraction = {warning} must be smaller than {key} = {critical}");
        table.refuse(problem, None);
        return None;
    }
    Some((warning, critical))
}
