//! `armwatch status`: the state of the fleet at a glance.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use clap::Args;
use jiff::Timestamp;
use serde::Serialize;

use super::alerts::anomaly_texts;
use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::joints::{named, reasons};
use super::shared::output;
use armwatch_config::Recognition;
use armwatch_model::anomaly::Severity;
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_store::{
    AlarmState, AnomalyRow, BlockedFile, DaemonState, FaultState, FleetHealthRow, HealthStatus, HostRow,
    HostState, QuarantineRow, RunRow, Store, StoredCounts, UnansweredFolder, time_in_views,
};

/// States of alarms that people have answered and that are not closed.
const ANSWERED: [AlarmState; 3] = [AlarmState::Acknowledged, AlarmState::Shelved, AlarmState::Maintenance];

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch status
  armwatch status --db /var/lib/armwatch/armwatch.db
  armwatch status --json | \\
      jq '.robots[] | select(.status == \"critical\") | .robot'

The command prints one line per robot, the worst first. The status of a robot is that of its worst joint. The
friction index of each joint follows, as a change in percent from the joint's baseline: `?` means no value, `!`
means an open alarm. A status is stale if the next test of the robot is late, compared with its usual interval.
The command only reads. It works while the daemon runs, and for users without write access to the database.")]
pub(super) struct StatusArgs {}

/// What the glance shows.
struct FleetGlance {
    counts: StoredCounts,
    health: Vec<FleetHealthRow>,
    /// Anomalies that nobody has answered, the worst first.
    open: Vec<AnomalyRow>,
    /// How many alarms are in each of the states [`ANSWERED`].
    answered: [usize; ANSWERED.len()],
    quarantine: Vec<QuarantineRow>,
    /// Growing files that cannot be read on.
    blocked: Vec<BlockedFile>,
    runs: Vec<RunRow>,
    /// Daemons of a database on a server that have a name.
    hosts: Vec<HostRow>,
    /// The daemon of the database.
    daemon: DaemonState,
    /// Watched folders that do not answer.
    unanswered: Vec<UnansweredFolder>,
    /// Tests that are the only one of their robot, and whose names the pattern of file names does not match.
    unmatched: Vec<i64>,
}

pub(super) fn status(global: &Global, _args: &StatusArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let now = Timestamp::now();
    let fleet = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let fleet = FleetGlance::read(&store, &config.recognition, now).await;
        store.close().await?;
        fleet
    })?;
    if global.json {
        output::json(&fleet.as_json(now));
    } else {
        fleet.print(now);
    }
    Ok(EXIT_DONE)
}

/// A daemon, and the time of its last sign of life.
fn host_in_words(row: &HostRow) -> String {
    let seen = anomaly_texts::minute(row.seen_at);
    match (row.state, row.is_lost()) {
        (HostState::AtWork, _) => format!("{} at work", row.host),
        (_, true) => format!("{} silent since {seen}", row.host),
        (_, false) => format!("{} stopped at {seen}", row.host),
    }
}

impl FleetGlance {
    async fn read(store: &Store, recognition: &Recognition, now: Timestamp) -> Result<Self, CliError> {
        let mut open = anomaly_texts::all(store, now).await?;
        let answered = ANSWERED
            .map(|state| open.iter().filter(|row| is_alarm(row.severity) && row.state == state).count());
        open.retain(|row| row.state == AlarmState::Open);
        open.sort_by_key(|row| (Reverse(row.severity), Reverse(row.last_seen_at), row.anomaly_id));
        let mut quarantine = store.faults().await?;
        quarantine.retain(|fault| fault.state == FaultState::Open);
        let mut hosts = store.hosts().await?;
        hosts.retain(|row| !row.host.is_empty());
        let runs = store.runs().await?;
        Ok(Self {
            unmatched: unmatched(&runs, recognition),
            hosts,
            daemon: store.daemon().await?,
            unanswered: store.unanswered_folders().await?,
            counts: store.counts().await?,
            health: store.fleet_health().await?,
            open,
            answered,
            quarantine,
            blocked: store.blocked_files().await?,
            runs,
        })
    }

    /// Robots with their joints, the worst first.
    fn robots(&self) -> Vec<(&str, HealthStatus, Vec<&FleetHealthRow>)> {
        let mut robots: Vec<(&str, HealthStatus, Vec<&FleetHealthRow>)> = Vec::new();
        for row in &self.health {
            match robots.last_mut().filter(|(robot, ..)| *robot == row.robot) {
                Some((_, worst, joints)) => {
                    *worst = if row.status.rank() < worst.rank() { row.status } else { *worst };
                    joints.push(row);
                }
                None => robots.push((&row.robot, row.status, vec![row])),
            }
        }
        robots.sort_by_key(|(robot, status, _)| (status.rank(), robot.to_owned()));
        robots
    }

    /// Runs that are being stored.
    fn live(&self) -> impl Iterator<Item = &RunRow> {
        self.runs.iter().filter(|run| run.status == RunStatus::Streaming)
    }

    fn print(&self, now: Timestamp) {
        let last = self.health.iter().filter_map(|row| row.last_result_at).max();
        let last = last.map_or_else(|| "none yet".to_owned(), anomaly_texts::minute);
        let tests =
            self.runs.iter().filter(|run| run.kind == RunKind::Test && run.status == RunStatus::Complete);
        let StoredCounts { cycles, .. } = self.counts;
        let robots = self.robots();
        output::line(&format!(
            "fleet       {}, {}, {}; last result {last}",
            output::counted(robots.len(), "robot"),
            output::counted(tests.count(), "complete test"),
            output::counted(cycles, "cycle"),
        ));
        if !self.hosts.is_empty() {
            let hosts: Vec<String> = self.hosts.iter().map(host_in_words).collect();
            output::line(&format!("daemons     {}", hosts.join(", ")));
        }
        match self.daemon {
            DaemonState::Absent => {
                output::line("daemon      none runs on this database; `armwatch run` reads new exports");
            }
            DaemonState::SilentSince(since) => {
                let since = anomaly_texts::minute(since);
                output::line(&format!("daemon      no sign of life since {since}: it hangs or was stopped"));
            }
            DaemonState::AtWork => {}
        }
        for of in &self.unanswered {
            let host = if of.host.is_empty() { String::new() } else { format!("{}: ", of.host) };
            let since = of.looked_at.map_or_else(|| "the daemon started".to_owned(), anomaly_texts::minute);
            output::line(&format!("folder      {host}{} not scanned since {since}: no answer", of.folder));
        }
        let open: Vec<Severity> = self.open.iter().map(|row| row.severity).collect();
        output::line(&format!("alarms      {}", alarms_in_words(&open, self.answered)));
        if !self.quarantine.is_empty() {
            let count = output::counted(self.quarantine.len(), "export");
            output::line(&format!("quarantine  {count}: `armwatch quarantine list` shows the reason"));
        }
        for file in &self.blocked {
            output::line(&format!("blocked     {} {}; {}", file.source_name, file.message, file.remedy));
        }
        for run in self.runs.iter().filter(|run| self.unmatched.contains(&run.run_id)) {
            output::line(&format!(
                "new robot   {}, by its only test {}, whose name recognition.file_name does not match; \
                `armwatch set-aside {}` excludes it",
                run.robot, run.source_name, run.run_id
            ));
        }
        for run in self.live() {
            let (robot, cycles) = (&run.robot, output::counted(run.cycles, "cycle"));
            output::line(&format!("being read  {robot}: {}, {cycles} stored", run.source_name));
        }
        if robots.is_empty() {
            output::line("");
            output::line(
                "no test is stored yet: `armwatch ingest FILE` reads an export, `armwatch run` watches \
                folders, `armwatch demo` shows a simulated fleet",
            );
            return;
        }
        self.print_robots(now, &robots);
        for row in &self.open {
            let severity = output::coloured(row.severity.name());
            let since = anomaly_texts::minute(row.onset_at.unwrap_or(row.first_seen_at));
            output::line("");
            output::line(&format!(
                "{severity} {}, since {since} (`armwatch alerts show {}`)",
                anomaly_texts::name(row),
                row.anomaly_id
            ));
            output::line(&format!("  {}", row.message));
        }
    }

    fn print_robots(&self, now: Timestamp, robots: &[(&str, HealthStatus, Vec<&FleetHealthRow>)]) {
        let cells = |(robot, status, joints): &(&str, HealthStatus, Vec<&FleetHealthRow>)| {
            let last = joints.iter().filter_map(|row| row.last_result_at).max();
            let changes: Vec<String> = joints.iter().map(|row| change(row, self.calls(row))).collect();
            let stale = stale_since(*status, joints, now);
            let stale = stale.map(|since| format!(", stale since {}", anomaly_texts::minute(since)));
            vec![
                (*robot).to_owned(),
                format!("{}{}", output::coloured(status.name()), stale.unwrap_or_default()),
                changes.join(" "),
                last.map_or_else(|| "-".to_owned(), anomaly_texts::minute),
            ]
        };
        let rows: Vec<Vec<String>> = robots.iter().map(cells).collect();
        let table = output::table(&["robot", "status", "friction by joint, %", "last result"], &rows);
        output::line("");
        output::block(&table);
        for (robot, _, joints) in robots {
            let is_unclear = |row: &&&FleetHealthRow| match row.status {
                HealthStatus::Unknown | HealthStatus::Overdue => true,
                HealthStatus::Ok => row.friction_index.is_none(),
                HealthStatus::Learning | HealthStatus::Warning | HealthStatus::Critical => false,
            };
            let unclear = joints.iter().filter(is_unclear);
            for of in reasons(unclear.filter_map(|row| Some((row.joint, row.reason.as_deref()?)))) {
                output::line(&format!("{robot}: {}: {}", named(&of.joints, joints.len()), of.why));
            }
        }
    }

    /// Returns true if a joint has an open alarm, its own or one of the whole arm.
    fn calls(&self, of: &FleetHealthRow) -> bool {
        self.open.iter().any(|row| {
            is_alarm(row.severity) && row.robot == of.robot && row.joint.is_none_or(|joint| joint == of.joint)
        })
    }

    fn as_json(&self, now: Timestamp) -> FleetJson<'_> {
        let live = |run: &RunRow| LiveRun {
            robot: run.robot.clone(),
            run_id: run.run_id,
            source_name: run.source_name.clone(),
            cycles: run.cycles,
        };
        FleetJson {
            unanswered_folders: &self.unanswered,
            hosts: &self.hosts,
            daemon: self.daemon.name(),
            daemon_silent_since: match self.daemon {
                DaemonState::SilentSince(since) => Some(time_in_views(since)),
                _ => None,
            },
            robots: self
                .robots()
                .into_iter()
                .map(|(robot, status, joints)| RobotJson {
                    stale_since: stale_since(status, &joints, now).map(time_in_views),
                    robot,
                    status,
                    joints,
                })
                .collect(),
            anomalies: &self.open,
            unmatched_run_ids: &self.unmatched,
            quarantined: self.quarantine.len(),
            blocked: &self.blocked,
            live: self.live().map(live).collect(),
            complete_runs: self.counts.complete_runs,
            cycles: self.counts.cycles,
        }
    }
}

/// The state of the fleet as JSON.
#[derive(Serialize)]
struct FleetJson<'a> {
    unanswered_folders: &'a [UnansweredFolder],
    hosts: &'a [HostRow],
    daemon: &'static str,
    daemon_silent_since: Option<String>,
    robots: Vec<RobotJson<'a>>,
    anomalies: &'a [AnomalyRow],
    unmatched_run_ids: &'a [i64],
    quarantined: usize,
    blocked: &'a [BlockedFile],
    live: Vec<LiveRun>,
    complete_runs: u64,
    cycles: u64,
}

#[derive(Serialize)]
struct RobotJson<'a> {
    robot: &'a str,
    status: HealthStatus,
    stale_since: Option<String>,
    joints: Vec<&'a FleetHealthRow>,
}

#[derive(Serialize)]
struct LiveRun {
    robot: String,
    run_id: i64,
    source_name: String,
    cycles: u32,
}

/// The time since which a robot's status is older than its usual interval between tests; `None` if it is not, or if the
/// status itself shows that.
fn stale_since(status: HealthStatus, joints: &[&FleetHealthRow], now: Timestamp) -> Option<Timestamp> {
    let expected_by = joints.iter().find_map(|row| row.expected_by)?;
    (status != HealthStatus::Overdue && expected_by < now).then_some(expected_by)
}

/// Tests that are the only one of their robot, and whose names do not match the pattern of file names.
fn unmatched(runs: &[RunRow], recognition: &Recognition) -> Vec<i64> {
    let mut tests: BTreeMap<&str, Vec<&RunRow>> = BTreeMap::new();
    for run in runs.iter().filter(|run| run.kind == RunKind::Test && run.status == RunStatus::Complete) {
        tests.entry(&run.robot).or_default().push(run);
    }
    let only = tests.into_values().filter_map(|of_robot| match of_robot[..] {
        [run] => Some(run),
        _ => None,
    });
    only.filter(|run| !recognition.fits(&run.source_name)).map(|run| run.run_id).collect()
}

/// Returns true if an anomaly of this severity is an alarm; milder ones are information only.
fn is_alarm(severity: Severity) -> bool {
    severity >= Severity::Warning
}

/// Numbers of open alarms, of alarms in each state of [`ANSWERED`], and of open anomalies that are information only.
fn alarms_in_words(open: &[Severity], answered: [usize; ANSWERED.len()]) -> String {
    let count_of = |severity: Severity| open.iter().filter(|of| **of == severity).count();
    let counted = |count: usize, what: &str| (count > 0).then(|| format!("{count} {what}"));
    let alarms: Vec<String> = [Severity::Critical, Severity::Warning]
        .into_iter()
        .filter_map(|severity| counted(count_of(severity), &output::coloured(severity.name())))
        .collect();
    let alarms =
        if alarms.is_empty() { "none open".to_owned() } else { format!("{} open", alarms.join(", ")) };
    let answered: Vec<String> = ANSWERED
        .into_iter()
        .zip(answered)
        .filter_map(|(state, count)| {
            let word = if state == AlarmState::Maintenance { "in maintenance" } else { state.name() };
            counted(count, word)
        })
        .collect();
    let answered =
        (!answered.is_empty()).then(|| format!("{} (`armwatch alerts list`)", answered.join(", ")));
    let remarks = counted(count_of(Severity::Info), "worth knowing");
    [Some(alarms), answered, remarks].into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// Friction index of a joint, in a fixed width; marked if an alarm of it is open.
fn change(row: &FleetHealthRow, is_marked: bool) -> String {
    let change =
        row.friction_index.map_or_else(|| "?".to_owned(), |index| format!("{:+.0}", 100.0 * (index - 1.0)));
    let mark = if is_marked { "!" } else { " " };
    format!("{change:>4}{mark}")
}

#[cfg(test)]
mod tests {
    use anstream::adapter::strip_str;

    use super::*;

    #[test]
    fn alarms_are_counted_by_what_is_asked_of_people() {
        use Severity::{Critical, Info, Warning};
        let cases: [(&[Severity], [usize; 3], &str); 6] = [
            (&[], [0, 0, 0], "none open"),
            (&[Critical, Warning, Warning], [0, 0, 0], "1 critical, 2 warning open"),
            (&[Warning, Warning, Info, Info], [0, 0, 0], "2 warning open; 2 worth knowing"),
            (&[Info], [0, 0, 0], "none open; 1 worth knowing"),
            (&[], [2, 1, 0], "none open; 2 acknowledged, 1 shelved (`armwatch alerts list`)"),
            (
                &[Critical, Info],
                [0, 0, 3],
                "1 critical open; 3 in maintenance (`armwatch alerts list`); 1 worth knowing",
            ),
        ];
        for (open, answered, words) in cases {
            assert_eq!(strip_str(&alarms_in_words(open, answered)).to_string(), words);
        }
    }

    #[test]
    fn a_status_is_stale_when_the_next_test_is_late_and_the_status_does_not_say_so() {
        let at = |second| Timestamp::from_second(second).expect("a time");
        let row = FleetHealthRow {
            robot: "R01".into(),
            joint: armwatch_model::robot::JointIndex::new(0),
            last_run_at: at(0),
            moving_relative_rmsd: None,
            friction_index: None,
            open_anomalies: 0,
            status: HealthStatus::Ok,
            last_result_at: None,
            reason: None,
            expected_by: Some(at(100)),
            friction_quantity: None,
            forecast: None,
        };
        let stale = |status, now| stale_since(status, &[&row], at(now));
        assert_eq!(stale(HealthStatus::Ok, 101), Some(at(100)));
        assert_eq!(stale(HealthStatus::Critical, 101), Some(at(100)));
        assert_eq!(stale(HealthStatus::Ok, 99), None);
        assert_eq!(stale(HealthStatus::Overdue, 101), None);
    }
}
