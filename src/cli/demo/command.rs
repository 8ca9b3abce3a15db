//! `armwatch demo`: planted faults, a running daemon, and its findings.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use anstyle::{AnsiColor, Style};
use clap::Args;
use jiff::Timestamp;
use jiff::civil::Date;
use serde::Serialize;
use serde_json::json;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::fleet::{self, CYCLES, DemoArm, DemoFolders};
use super::verdict::{DemoVerdict, FoundAlarm, day, planted_in};
use crate::cli::context::{
    CliError, EXIT_DONE, EXIT_FOUND, EXIT_STOPPED, Global, open_store, runtime, shared,
};
use crate::cli::shared::output;
use crate::daemon::{self, DaemonEvent};
use crate::metrics::Metrics;
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::context::{Outcome, Pipeline};
use crate::serve::{self, ServeError, Server};
use armwatch_config::{Config, ServeSettings};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_model::text;
use armwatch_store::{Store, StoreError};

/// Port of the dashboard, unless another program uses it.
const PORT: u16 = 8650;
/// Interval of checks that all conclusions are drawn.
const LOOK: Duration = Duration::from_millis(50);

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch demo
  armwatch demo --once --dir /tmp/fleet
  armwatch demo --once --json | jq 'select(.event == \"verdict\")'

Five ER3A arms are tested on eight days: 31 tests of eight cycles. Four faults are simulated: wear of a joint, a
payload, a step of friction inside a test, and a joint that jitters. The command first prints the faults, then
each test and each alarm, and at the end the detected faults with their delay in tests. It writes the simulated
exports into a watched folder while the daemon reads them, the first one bit by bit. The detectors have the
shipped settings. The command prints the address of the dashboard and serves it to this computer until Ctrl-C. The
folder stays, with exports, truth files and database. The command prints its size and the next steps. Exit status
1 if a fault was not detected with its joint and kind, or if there was an alarm without a fault; 130 if the
command was stopped before every test was stored.")]
pub(in crate::cli) struct DemoArgs {
    /// Exit after the last result instead of serving the dashboard until Ctrl-C
    #[arg(long)]
    once: bool,
    /// Folder for exports and database, which must be empty or missing [default: a new temporary
    /// folder]
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Day of the first tests, such as 2026-01-05 [default: a week ago; the last tests are then from today or
    /// yesterday]
    #[arg(long, value_name = "DATE")]
    first_day: Option<Date>,
}

/// The running demo.
struct Demo {
    fleet: Vec<DemoArm>,
    /// Arm and number of each test.
    tests: Vec<(DemoArm, u32)>,
    /// The demo's own folder.
    folder: PathBuf,
    database: PathBuf,
    as_json: bool,
    once: bool,
    /// Exports whose outcome is known.
    ended: AtomicUsize,
}

pub(in crate::cli) fn demo(global: &Global, args: &DemoArgs) -> Result<u8, CliError> {
    // the daemon uses absolute paths, and so do the next steps
    let folder = demo_folder(args)?;
    let folder =
        std::path::absolute(&folder).map_err(|e| CliError::Io(format!("{}: {e}", folder.display())))?;
    let inbox = folder.join("inbox");
    std::fs::create_dir_all(&inbox).map_err(|e| CliError::Io(format!("{}: {e}", inbox.display())))?;
    let mut config = Config::shipped()?;
    let robot = Robot::clone(&config.fleet.first().ok_or_else(no_robot)?.description);
    config.database = match &global.db {
        Some(db) => std::path::absolute(db).map_err(|e| CliError::Io(format!("{}: {e}", db.display())))?,
        None => folder.join("armwatch.db"),
    };
    config.watch.folders = vec![inbox.clone()];
    config.watch.scan_interval = Duration::from_millis(500);
    // a multiple of a slow writer's pause
    config.watch.settle = Duration::from_millis(300);
    let arms = match args.first_day {
        Some(day) => fleet::fleet(day),
        None => fleet::latest_first_day(Timestamp::now()).and_then(fleet::fleet),
    };
    let arms = arms.map_err(|error| CliError::Usage(format!("--first-day: {error}")))?;
    let demo = Arc::new(Demo {
        tests: fleet::schedule(&arms),
        fleet: arms,
        database: config.database.clone(),
        as_json: global.json,
        once: args.once,
        ended: AtomicUsize::new(0),
        folder,
    });
    let folders = DemoFolders { made: demo.folder.join("made"), truth: demo.folder.join("truth"), inbox };
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let config = shared(config);
        let (_in_force, configs) = watch::channel(Arc::clone(&config));
        let metrics = Metrics::counting();
        let pipeline = Pipeline::new(config, store.clone()).counting(metrics.clone());
        let serving = stop.child_token();
        let server = match args.once {
            true => None,
            false => dashboard(&demo.folder, configs, store, metrics, &serving).await?,
        };
        demo.introduce();
        let room = fleet::room();
        let writer = fleet::write_exports(robot, demo.tests.clone(), folders, args.seed, Arc::clone(&room));
        let watched = demo.watch(&pipeline, &stop, &room, writer).await;
        serving.cancel();
        if let Some(server) = server {
            server.ended().await;
            // the server that it gives access to has ended
            let _ = std::fs::remove_file(demo.folder.join("token"));
        }
        let ended = match watched {
            Ok(Some(verdict)) if verdict.is_right() => Ok(EXIT_DONE),
            Ok(Some(_)) => Ok(EXIT_FOUND),
            Ok(None) => demo.stopped(pipeline.store()).await.map(|()| EXIT_STOPPED),
            Err(error) => Err(error),
        };
        pipeline.close().await?;
        ended
    })
}

/// Serves the dashboard to this machine and prints its address. Its token, which permits answers to alarms, is made for
/// this demo and comes after `#`, which a browser does not send.
async fn dashboard(
    folder: &Path,
    configs: watch::Receiver<Arc<Config>>,
    store: Store,
    metrics: Metrics,
    stop: &CancellationToken,
) -> Result<Option<Server>, CliError> {
    let failed = |path: &Path, error: std::io::Error| CliError::Io(format!("{}: {error}", path.display()));
    let token_file = folder.join("token");
    let token = random_token().map_err(|error| failed(&token_file, error))?;
    let file = File::options().write(true).create_new(true).mode(0o600).open(&token_file);
    file.and_then(|mut file| file.write_all(token.as_bytes())).map_err(|error| failed(&token_file, error))?;
    for port in [PORT, 0] {
        let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let settings = ServeSettings {
            listen,
            token_file: Some(token_file.clone()),
            public_url: None,
            trusted_proxies: Vec::new(),
            tls: None,
            upload: None,
        };
        let started =
            serve::start(&settings, configs.clone(), store.clone(), metrics.clone(), stop.clone()).await;
        match started {
            Ok(server) => {
                output::print_hint(&format!("dashboard http://{}/#token={token}", server.address));
                return Ok(Some(server));
            }
            // another program has the usual port
            Err(ServeError::Listen { .. }) if port != 0 => {}
            Err(error) => return Err(CliError::Io(error.to_string())),
        }
    }
    Ok(None)
}

fn random_token() -> std::io::Result<String> {
    let mut bytes = [0; 24];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn no_robot() -> CliError {
    CliError::Internal("the shipped configuration describes no robot".into())
}

fn demo_folder(args: &DemoArgs) -> Result<PathBuf, CliError> {
    let Some(folder) = &args.dir else {
        let made = tempfile::Builder::new().prefix("armwatch-demo-").tempdir();
        return made
            .map(tempfile::TempDir::keep)
            .map_err(|error| CliError::Io(format!("no temporary folder: {error}")));
    };
    let filled = std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    if filled {
        return Err(CliError::Usage(format!(
            "{}: not empty; name another folder for the demo",
            folder.display()
        )));
    }
    Ok(folder.clone())
}

impl Demo {
    /// Prints the planted faults, with robot and time.
    fn introduce(&self) {
        let days = self.tests.iter().filter_map(|(arm, test)| arm.start(*test)).map(day);
        let days: std::collections::BTreeSet<String> = days.collect();
        if self.as_json {
            for (arm, planted) in self.planted() {
                output::json(&json!({
                    "event": "planted", "robot": arm.name, "joint": planted.fault.joint.map(JointIndex::number),
                    "fault": planted.fault.to_string(), "kind": planted.kind.name(), "test": planted.test(),
                    "started_at": arm.start(planted.test()).map(|at| at.to_string()),
                }));
            }
            return;
        }
        let (first, last) =
            (days.first().cloned().unwrap_or_default(), days.last().cloned().unwrap_or_default());
        output::line(&format!(
            "{} arms, {} tests of {CYCLES} cycles, {first} to {last}; simulated now, and read like recordings",
            self.fleet.len(),
            self.tests.len()
        ));
        for arm in &self.fleet {
            let Some(planted) = &arm.planted else {
                output::line(&format!("  {:7} stays healthy", arm.name));
                continue;
            };
            let from = arm.start(planted.test()).map(day).unwrap_or_default();
            let joint = planted.fault.joint.map_or_else(String::new, |joint| format!(", joint {joint}"));
            output::line(&format!(
                "  {:7} {}{joint}, from test {} of {} on ({from})",
                arm.name,
                planted.words(),
                planted.test(),
                arm.tests()
            ));
        }
        output::line("");
    }

    fn planted(&self) -> impl Iterator<Item = (&DemoArm, &fleet::Planted)> {
        self.fleet.iter().filter_map(|arm| Some((arm, arm.planted.as_ref()?)))
    }

    /// Runs the daemon together with the writer, until a stop is requested or, with `--once`, all conclusions are
    /// drawn. Returns `None` if it was stopped before.
    async fn watch(
        self: &Arc<Self>,
        pipeline: &Pipeline,
        stop: &CancellationToken,
        room: &Arc<Semaphore>,
        writer: JoinHandle<Result<(), CliError>>,
    ) -> Result<Option<DemoVerdict>, CliError> {
        let done = stop.child_token();
        let writing = tokio::spawn({
            let done = done.clone();
            async move {
                let written = writer.await.map_err(|error| CliError::Internal(error.to_string()));
                written.and_then(|written| written).inspect_err(|_| done.cancel())
            }
        });
        let judging = tokio::spawn({
            let (demo, store, done) = (Arc::clone(self), pipeline.store().clone(), done.clone());
            async move {
                let judged = demo.judge(&store, &done).await;
                if demo.once || judged.is_err() {
                    done.cancel();
                } else {
                    output::print_hint("the dashboard stays until Ctrl-C");
                }
                judged
            }
        });
        // the daemon finishes the current cycles; no more exports are written
        let closing = tokio::spawn({
            let (room, done) = (Arc::clone(room), done.clone());
            async move {
                done.cancelled().await;
                room.close();
            }
        });
        let watched = self.run_daemon(pipeline, &done, room).await;
        done.cancel();
        closing.await.map_err(|error| CliError::Internal(error.to_string()))?;
        let (written, judged) = (writing.await, judging.await);
        watched?;
        written.map_err(|error| CliError::Internal(error.to_string()))??;
        judged.map_err(|error| CliError::Internal(error.to_string()))?
    }

    async fn run_daemon(
        &self,
        pipeline: &Pipeline,
        done: &CancellationToken,
        room: &Semaphore,
    ) -> Result<(), CliError> {
        let claim = pipeline.store().claim().await?;
        let reload = daemon::reload_on_hangup(done).map_err(|error| CliError::Internal(error.to_string()))?;
        let control = daemon::Control { claim, stop: done.clone(), reload, reread: Arc::new(|| None) };
        let mut seen = HashSet::new();
        daemon::watch(pipeline, control, |event| match event {
            DaemonEvent::Export(path, outcome) => {
                self.show_outcome(path, outcome);
                let is_last_word =
                    !matches!(outcome, Outcome::Interrupted | Outcome::Changed | Outcome::InWork { .. });
                if is_last_word && seen.insert(path.to_path_buf()) {
                    self.ended.fetch_add(1, Ordering::Relaxed);
                    room.add_permits(1);
                }
            }
            DaemonEvent::Concluded(concluded) => self.show_conclusions(concluded),
        })
        .await?;
        Ok(())
    }

    /// Waits until every export has its outcome and conclusions are drawn, and reports the findings; `None` if `done`
    /// comes first.
    async fn judge(&self, store: &Store, done: &CancellationToken) -> Result<Option<DemoVerdict>, CliError> {
        while self.ended.load(Ordering::Relaxed) < self.tests.len() || !store.stale_robots().await?.is_empty()
        {
            tokio::select! {
                () = done.cancelled() => return Ok(None),
                () = tokio::time::sleep(LOOK) => {}
            }
        }
        let verdict = self.verdict(store).await?;
        self.show_verdict(&verdict);
        Ok(Some(verdict))
    }

    async fn verdict(&self, store: &Store) -> Result<DemoVerdict, StoreError> {
        let anomalies: Vec<FoundAlarm> =
            store.anomalies_after(0).await?.iter().map(FoundAlarm::from).collect();
        Ok(DemoVerdict::new(&self.fleet, &anomalies, &tests_stored(store).await?))
    }

    fn show_outcome(&self, path: &Path, outcome: &Outcome) {
        let name = text::of_file_name(path);
        match outcome {
            Outcome::Stored(run) => {
                let of_test = |(arm, test): &&(DemoArm, u32)| {
                    let start = arm.start(*test).map(|at| at.strftime("%Y%m%d_%H%M").to_string());
                    start.is_some_and(|start| name.starts_with(&format!("{}_{start}", arm.name)))
                };
                let Some((arm, test)) = self.tests.iter().find(of_test) else { return };
                let started_at = arm.start(*test);
                if self.as_json {
                    output::json(&json!({
                        "event": "stored", "robot": run.robot, "test": test, "run_id": run.run_id,
                        "started_at": started_at.map(|at| at.to_string()), "cycles": run.cycles, "rows": run.rows,
                    }));
                } else {
                    let day = started_at.map(day).unwrap_or_default();
                    output::line(&format!(
                        "stored  {day}  {:7} test {test} of {}: {} cycles, run {}",
                        run.robot,
                        arm.tests(),
                        run.cycles,
                        run.run_id
                    ));
                }
            }
            Outcome::Quarantined { rejection, .. } | Outcome::Unreadable { rejection } => {
                if self.as_json {
                    output::json(
                        &json!({"event": "not stored", "file": name, "reason": rejection.sentence()}),
                    );
                } else {
                    output::line(&format!("NOT STORED  {rejection}"));
                }
            }
            Outcome::AlreadyStored { .. }
            | Outcome::Interrupted
            | Outcome::Changed
            | Outcome::InWork { .. } => {}
        }
    }

    fn show_conclusions(&self, concluded: &Concluded) {
        #[derive(Serialize)]
        struct AlarmJson<'a> {
            event: &'static str,
            #[serde(flatten)]
            alarm: &'a FoundAlarm,
        }
        for alarm in concluded.new_anomalies.iter().map(FoundAlarm::from) {
            if self.as_json {
                output::json(&AlarmJson { event: "alarm", alarm: &alarm });
            } else {
                self.show_alarm(&alarm);
            }
        }
    }

    fn show_alarm(&self, alarm: &FoundAlarm) {
        let day = day(alarm.first_seen_at);
        let place = match planted_in(&self.fleet, alarm) {
            Some((arm, planted)) => {
                let test = arm.test_at(alarm.first_seen_at);
                let later = test.map_or(0, |test| test - planted.test());
                let number = test.map_or_else(String::new, |test| format!("test {test}, "));
                match later {
                    0 => format!("{number}the first one with the fault"),
                    _ => format!("{number}{later} after the first one with the fault"),
                }
            }
            None => "no fault was simulated there".to_owned(),
        };
        let style = Style::new().bold().fg_color(Some(AnsiColor::Yellow.into()));
        let word = output::styled(if alarm.is_alarm() { "ALARM " } else { "noted " }, style);
        output::line(&format!(
            "{word}  {day}  {:7} {} of {}: {place}",
            alarm.robot,
            alarm.kind,
            alarm.joint.map_or_else(|| "the arm".into(), |joint| format!("joint {joint}"))
        ));
        output::line(&format!("        {}: {}", alarm.severity, alarm.message));
    }

    /// Prints the comparison, and the next steps.
    fn show_verdict(&self, verdict: &DemoVerdict) {
        if self.as_json {
            let mut value = verdict.as_value();
            value["folder"] = self.folder.to_string_lossy().into();
            value["database"] = self.database.to_string_lossy().into();
            value["folder_bytes"] = bytes_below(&self.folder).into();
            return output::json(&value);
        }
        verdict.print();
        self.show_next_steps(verdict.example());
    }

    fn show_next_steps(&self, alarm: Option<i64>) {
        let db = match self.database.parent() == Some(self.folder.as_path()) {
            true => String::new(),
            false => format!(" --db {}", self.database.display()),
        };
        let megabytes = |path: &Path| bytes_below(path).div_ceil(1_000_000);
        output::line("");
        output::line(&format!(
            "{} stays, {} MB: {} MB of exports in inbox/, truth files in truth/, the database armwatch.db",
            self.folder.display(),
            megabytes(&self.folder),
            megabytes(&self.folder.join("inbox"))
        ));
        if let Some(program) = program_by_path() {
            output::line(&format!("  alias armwatch={program}"));
        }
        output::line(&format!("  cd {}", self.folder.display()));
        output::line(&format!("  armwatch status{db}"));
        if let Some(alarm) = alarm {
            output::line(&format!("  armwatch alerts show {alarm}{db}"));
        }
        output::line(&format!("  armwatch sql \"SELECT * FROM fleet_health\"{db}"));
        output::line(&format!("  rm -r {}   # when you no longer need it", self.folder.display()));
    }

    /// Reports the stored tests, and the findings in them.
    async fn stopped(&self, store: &Store) -> Result<(), CliError> {
        let verdict = self.verdict(store).await?;
        let stored: u32 = tests_stored(store).await?.values().sum();
        if self.as_json {
            output::json(&json!({"event": "stopped", "stored": stored, "tests": self.tests.len()}));
        } else {
            output::line("");
            output::line(&format!(
                "stopped: {stored} of {} tests are stored; the others were not simulated or not read",
                self.tests.len()
            ));
        }
        self.show_verdict(&verdict);
        Ok(())
    }
}

/// Stored tests of each arm.
async fn tests_stored(store: &Store) -> Result<HashMap<String, u32>, StoreError> {
    let mut stored = HashMap::new();
    for run in store.runs().await? {
        if run.kind == RunKind::Test && run.status == RunStatus::Complete {
            *stored.entry(run.robot).or_default() += 1;
        }
    }
    Ok(stored)
}

/// Bytes of all files below a folder; unreadable ones count as zero.
fn bytes_below(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => bytes_below(&entry.path()),
            _ => entry.metadata().map_or(0, |of| of.len()),
        })
        .sum()
}

/// The absolute path of this program, if it was started by a path; `None` if its name was enough.
fn program_by_path() -> Option<String> {
    let typed = std::env::args_os().next()?;
    let path = Path::new(&typed);
    let by_path = path.components().count() > 1;
    by_path.then(|| std::path::absolute(path).ok())?.map(|path| path.display().to_string())
}
