//! A summary of a configuration in words.

use std::fmt::Write as _;
use std::time::Duration;

use crate::address::shown_database;
use crate::alerts::settings::Route;
use crate::layout::channels::{JointDelays, Layout};
use crate::layout::parts::PartMatch;
use crate::serve::{ClientSettings, Scope, ServeSettings};
use crate::settings::{Config, FleetEntry};
use crate::snapshot::SnapshotSettings;
use armwatch_model::analysis::finding::FindingKind;
use armwatch_model::robot::{JointKind, Robot, TorqueSensors};

/// The files that were read and the settings in force, with units, one topic per paragraph.
pub fn summary(config: &Config) -> String {
    let mut out = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{name:<25} {value}");
    };
    line("database", shown_database(&config.database));
    if let Some(host) = &config.cluster.host {
        line("host", format!("{host}, whose lease ends after {} of silence", seconds(config.cluster.lease)));
    }
    for folder in &config.watch.folders {
        line("watched folder", folder.display().to_string());
    }
    let links = if config.watch.follow_links { "followed" } else { "left out" };
    line("links out of a folder", links.to_owned());
    line("scan interval", seconds(config.watch.scan_interval));
    line("settling time of a file", seconds(config.watch.settle));
    line("growing files at once", config.watch.live_files.to_string());
    line("rewritten files", config.watch.on_rewrite.name().to_owned());
    let archive = config.watch.archive.as_ref();
    line("archive", archive.map_or_else(|| "off, exports stay".to_owned(), |to| to.display().to_string()));
    let limits = &config.limits;
    line(
        "exports at once",
        format!(
            "{0} small and {0} large ones, large from {1}",
            limits.backlog_files,
            size(limits.large_file_bytes)
        ),
    );
    line("longest export", format!("{} after decompression", size(limits.export_bytes)));
    line("longest cycle", format!("{} rows", limits.cycle_rows));
    line("memory of cycles", size(limits.cycles_bytes as u64));
    line("snapshot", config.snapshot.as_ref().map_or_else(|| "off".to_owned(), snapshot));
    line("factors of tests", kept(config.retention.tests_days, "then removed"));
    line("factors of production", kept(config.retention.production_days, "then joined, one per log"));
    line("HTTP", config.serve.as_ref().map_or_else(|| "off".to_owned(), serve));
    if config.serve.is_some() {
        line("HTTP clients", clients(&config.clients));
    }
    for route in &config.alerts.routes {
        line(&format!("alarms, route {}", route.name), alert_route(route));
    }
    line("file names", config.recognition.file_name.to_string());
    line("date and time in them", config.recognition.formats.wanted());
    line("time zone of file names", config.recognition.time_zone.clone());
    for entry in &config.fleet {
        let files = entry.files.as_ref().map(|files| format!(", files {files}")).unwrap_or_default();
        line(&format!("robot {}{files}", entry.robots), fleet_entry(entry));
    }
    let analysis = &config.analysis;
    line("low-pass cut-off", format!("{} Hz", analysis.cutoff));
    line("reference speed", format!("{} of the largest", percent(analysis.reference_speed_fraction)));
    line("estimator", analysis.estimator.name().to_owned());
    let accepted: Vec<&str> = FindingKind::ALL
        .iter()
        .filter(|kind| analysis.accept.contains(**kind))
        .map(|kind| kind.name())
        .collect();
    if !accepted.is_empty() {
        line("accepted findings", accepted.join(", "));
    }
    let detect = &config.detect;
    line("baseline", format!("{} runs", detect.baseline_runs));
    let levels =
        |warning, critical| format!("warning from {}, critical from {}", percent(warning), percent(critical));
    line("friction drift", levels(detect.drift_warning, detect.drift_critical));
    line("false alarms", format!("{} per robot and year", detect.false_alarms_per_robot_year));
    if let Some(sigma) = detect.drift_sigma {
        line("drift significance", format!("{sigma} standard deviations, whatever the rate"));
    }
    line("oscillation", format!("{} times the baseline's swing", detect.oscillation_ratio));
    line("overdue", format!("after {} usual intervals without a test", detect.overdue_factor));
    line("relative RMSD", levels(detect.accuracy_warning, detect.accuracy_critical));
    out
}

fn snapshot(snapshot: &SnapshotSettings) -> String {
    format!("{}, at most every {}", snapshot.file.display(), seconds(snapshot.interval))
}

fn kept(days: Option<f64>, then: &str) -> String {
    match days {
        Some(1.0) => format!("kept for 1 day, {then}"),
        Some(days) => format!("kept for {days} days, {then}"),
        None => "kept for ever".to_owned(),
    }
}

/// A size with a unit: `64 MiB`, `1.5 GiB`, `1000 bytes`.
fn size(bytes: u64) -> String {
    let units = [(1_u64 << 40, "TiB"), (1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
    match units.into_iter().find(|(unit, _)| bytes >= *unit) {
        Some((unit, name)) if bytes.is_multiple_of(unit) => format!("{} {name}", bytes / unit),
        Some((unit, name)) => format!("{:.1} {name}", bytes as f64 / unit as f64),
        None => format!("{bytes} bytes"),
    }
}

fn serve(serve: &ServeSettings) -> String {
    let token = match &serve.token_file {
        Some(file) => format!("token in {}", file.display()),
        None => "no token file".to_owned(),
    };
    let upload = match &serve.upload {
        Some(upload) => format!(
            "uploads to {}, {} at most, {} at once, {} idle, {} in all, {} stay free",
            upload.spool.display(),
            size(upload.max_bytes),
            upload.at_once,
            seconds(upload.idle_timeout),
            seconds(upload.total_timeout),
            upload.reserve_bytes.map_or_else(|| "5 % of the disk (1 GiB at most)".to_owned(), size)
        ),
        None => "no uploads".to_owned(),
    };
    let url = serve.public_url.as_ref().map(|url| format!(" as {url}")).unwrap_or_default();
    let proxies = match serve.trusted_proxies.as_slice() {
        [] => String::new(),
        some => format!("; behind {}", some.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    };
    let tls = if serve.tls.is_some() { " with TLS" } else { "" };
    format!("{}{tls}{url}{proxies}; {token}; {upload}", serve.listen)
}

fn clients(clients: &ClientSettings) -> String {
    let scopes = |of: &[Scope]| of.iter().map(|scope| scope.name()).collect::<Vec<_>>().join(", ");
    let requests = match clients.requests_per_s {
        0.0 => "any number of requests".to_owned(),
        most => format!("{most} requests per second from one address"),
    };
    let token = |token: &crate::serve::TokenSettings| {
        format!("; token {} in {} may {}", token.name, token.file.display(), scopes(&token.scopes))
    };
    format!("{requests}{}", clients.tokens.iter().map(token).collect::<String>())
}

fn alert_route(route: &Route) -> String {
    let quiet = route.quiet.map(|quiet| {
        format!(", quiet from {} to {}", quiet.from.strftime("%H:%M"), quiet.to.strftime("%H:%M"))
    });
    let digest = route.digest_at.map(|at| format!(", daily at {}", at.strftime("%H:%M")));
    format!(
        "{} to {}, from {} on{}{}",
        route.receiver.name(),
        route.receiver.target(),
        route.severity.name(),
        quiet.unwrap_or_default(),
        digest.unwrap_or_default()
    )
}

fn fleet_entry(entry: &FleetEntry) -> String {
    let carried = match entry.description.has_carried() {
        true => format!(", carrying a tool of {} kg", entry.description.carried.mass()),
        false => String::new(),
    };
    format!("{}{carried}; {}", arm(&entry.description), layout(&entry.layout))
}

fn arm(robot: &Robot) -> String {
    let sliding = robot.joints.iter().filter(|joint| joint.kind == JointKind::Prismatic).count();
    let kinds = match sliding {
        0 => String::new(),
        _ => format!(" ({sliding} prismatic)"),
    };
    let nominal = robot.joints.iter().filter(|joint| joint.nominal.is_some()).count();
    let excitation = if robot.excitation.is_some() { "an excitation" } else { "no excitation" };
    let sensors = match robot.torque_sensors {
        TorqueSensors::Motor => "",
        TorqueSensors::Link => ", torque sensors at the links",
    };
    format!(
        "{} with {} joints{kinds}, {} speed levels, nominal parameters of {nominal} joints, {excitation}{sensors}",
        robot.model,
        robot.joint_count(),
        robot.speed_levels.len(),
    )
}

fn layout(layout: &Layout) -> String {
    let velocity = if layout.velocity.is_some() { "velocity recorded" } else { "velocity derived" };
    let bad = layout.rows.skip_bad;
    let rows = if bad > 0 { format!(", up to {bad} bad rows skipped") } else { String::new() };
    let late = layout.torque.delay != JointDelays::default()
        || layout.velocity.as_ref().is_some_and(|velocity| velocity.delay != JointDelays::default());
    let late = if late { ", delays removed" } else { "" };
    let start = layout.start.as_ref().map(|start| format!(", start from column {}", start.column));
    let unrecorded: Vec<String> = layout.without_torque.iter().map(ToString::to_string).collect();
    let unrecorded = match unrecorded.as_slice() {
        [] => String::new(),
        joints => format!(", no torque of joint {}", joints.join(", ")),
    };
    let parts = layout.parts.as_ref().map_or("", |parts| match parts.matching {
        PartMatch::Row => ", parts side by side by row",
        PartMatch::Time => ", parts side by side by time",
        PartMatch::After => ", parts one after the other",
    });
    let start = start.unwrap_or_default();
    format!("layout {}, {velocity}{rows}{late}{unrecorded}{parts}{start}", layout.name)
}

fn seconds(duration: Duration) -> String {
    format!("{} s", duration.as_secs_f64())
}

/// A fraction in percent, without the digits that binary fractions add.
fn percent(fraction: f64) -> String {
    format!("{} %", (fraction * 1e5).round() / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentages_are_round_where_the_file_has_round_numbers() {
        let shown: Vec<_> = [0.05, 0.15, 0.6, 1.0, 0.07, 0.0125].map(percent).into();
        assert_eq!(shown, ["5 %", "15 %", "60 %", "100 %", "7 %", "1.25 %"]);
    }

    #[test]
    fn the_shipped_summary_names_every_setting_with_its_unit() {
        let text = summary(&Config::shipped().expect("no problems"));
        for expected in [
            "database                  armwatch.db",
            "watched folder            inbox",
            "links out of a folder     left out",
            "scan interval             5 s",
            "settling time of a file   3 s",
            "growing files at once     32",
            "rewritten files           supersede",
            "archive                   off, exports stay",
            "exports at once           2 small and 2 large ones, large from 64 MiB",
            "longest export            64 GiB after decompression",
            "longest cycle             1000000 rows",
            "memory of cycles          512 MiB",
            "factors of tests          kept for 120 days, then removed",
            "factors of production     kept for 7 days, then joined, one per log",
            "HTTP                      off",
            "alarms, route log         log to the log, from info on",
            "time zone of file names   UTC",
            "robot *                   er3a with 6 joints, 6 speed levels, nominal parameters of 6 joints, an excitation; layout native, velocity recorded",
            "low-pass cut-off          12 Hz",
            "reference speed           60 % of the largest",
            "estimator                 weighted",
            "baseline                  5 runs",
            "friction drift            warning from 5 %, critical from 15 %",
            "false alarms              1 per robot and year",
            "oscillation               3 times the baseline's swing",
            "relative RMSD             warning from 10 %, critical from 15 %",
        ] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
    }
}
