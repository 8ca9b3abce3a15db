//! `armwatch demo`: a small fleet, from simulated exports to findings.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use jiff::Timestamp;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::context::{CliError, EXIT_DONE, EXIT_STOPPED, Global, open_store, runtime, shared};
use super::shared::output;
use crate::config::{Config, ServeSettings};
use crate::daemon::{self, Event};
use crate::metrics::Metrics;
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::context::{Outcome, Pipeline};
use crate::robot::{JointIndex, Robot};
use crate::serve::{self, ServeError, Server};
use crate::simulate::error::SimulateError;
use crate::simulate::fault::Fault;
use crate::simulate::{SimulationSettings, simulate_run};
use crate::store::{HealthStatus, Store};

/// Runs of each arm: five to learn, then wear has time to show.
const RUNS: u32 = 11;
/// Cycles of a run.
const CYCLES: u32 = 3;
/// First of the demo's test days.
const FIRST_START: &str = "2026-01-05T08:47:00Z";
/// Where the dashboard listens, unless another program does.
const PORT: u16 = 8650;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch demo
  armwatch demo --once --dir /tmp/fleet

Three ER3A arms are tested once a day for eleven days; the gearbox of one joint of one arm wears. The
exports are written into a watched folder while the daemon takes them: those of the first day bit by
bit, so that their cycles are stored while the run is still 'streaming'. The dashboard is served to this
machine at the address that is printed first. Folder and database stay; `armwatch status --db FILE` and any
SQLite program open them.")]
pub(super) struct DemoArgs {
    /// End after the last result instead of watching on
    #[arg(long)]
    once: bool,
    /// Folder for exports and database, which must be empty or missing [default: a new temporary
    /// folder]
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
    /// Everything random follows from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn demo(global: &Global, args: &DemoArgs) -> Result<u8, CliError> {
    // the daemon names files from the root on, and what it names is compared with what was written
    let folder = demo_folder(args)?;
    let folder =
        std::path::absolute(&folder).map_err(|e| CliError::Io(format!("{}: {e}", folder.display())))?;
    let inbox = folder.join("inbox");
    std::fs::create_dir_all(&inbox).map_err(|e| CliError::Io(format!("{}: {e}", inbox.display())))?;
    let mut config = Config::shipped()?;
    let robot = Robot::clone(&config.fleet.first().ok_or_else(no_robot)?.description);
    config.database = global.db.clone().unwrap_or_else(|| folder.join("armwatch.db"));
    config.watch.folders = vec![inbox.clone()];
    config.watch.scan_interval = Duration::from_millis(500);
    // some times the pause of a slow writer
    config.watch.settle = Duration::from_millis(300);
    let database = config.database.clone();
    output::print_hint(&format!("exports   {}\ndatabase  {}", inbox.display(), database.display()));
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let config = shared(config);
        let (_in_force, configs) = watch::channel(Arc::clone(&config));
        let metrics = Metrics::counting().map_err(|error| CliError::Internal(error.to_string()))?;
        let pipeline = Pipeline::new(config, store.clone()).counting(metrics.clone());
        let serving = stop.child_token();
        let server = match args.once {
            true => None,
            false => dashboard(&folder, configs, store, metrics, &serving).await?,
        };
        let writer = write_fleet(robot, folder.join("made"), inbox, args.seed, stop.clone());
        let watched = watch_fleet(&pipeline, args.once, &stop, writer).await;
        serving.cancel();
        if let Some(server) = server {
            server.ended().await;
        }
        let shown = show_findings(pipeline.store(), &database).await;
        watched?;
        shown?;
        pipeline.close().await?;
        Ok(if args.once && stop.is_cancelled() { EXIT_STOPPED } else { EXIT_DONE })
    })
}

/// Serves the dashboard to this machine and prints its address. Its token, with which alarms can be answered, is made
/// for this demo and stands behind `#`, which a browser does not send.
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
        let settings = ServeSettings { listen, token_file: Some(token_file.clone()), upload: None };
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

/// The demo's arms: two healthy ones, and one whose joint 3 wears.
fn fleet(seed: u64) -> Result<Vec<SimulationSettings>, CliError> {
    let first_start: Timestamp =
        FIRST_START.parse().map_err(|error| CliError::Internal(format!("{FIRST_START}: {error}")))?;
    let wear = Fault::wear(JointIndex::new(2), 7, 0.04);
    let arm = |name: &str, minutes: i64, faults: Vec<Fault>| SimulationSettings {
        robot_name: name.into(),
        seed,
        cycles: CYCLES,
        runs: RUNS,
        first_start: first_start + jiff::SignedDuration::from_mins(minutes),
        faults,
        ..SimulationSettings::default()
    };
    Ok(vec![arm("Left", 0, vec![]), arm("Middle", 20, vec![wear]), arm("Right", 40, vec![])])
}

type Written = JoinHandle<Result<Vec<PathBuf>, CliError>>;

/// Days whose exports are written slowly, as a controller writes them while it moves.
const SLOW_DAYS: u32 = 1;
/// Pieces in which a slow export is written: some to a cycle.
const PIECES: usize = 30;
/// Time between two pieces: below the time to settle, and two seconds for an export.
const PIECE_PAUSE: Duration = Duration::from_millis(60);

/// Writes the fleet's exports day by day, as the controllers would: those of the first day bit by bit, the
/// others appear whole.
fn write_fleet(robot: Robot, made: PathBuf, inbox: PathBuf, seed: u64, stop: CancellationToken) -> Written {
    tokio::task::spawn_blocking(move || {
        let mut written = Vec::new();
        for run in 0..RUNS {
            for settings in fleet(seed)? {
                if stop.is_cancelled() {
                    return Ok(written);
                }
                let files = simulate_run(&robot, &settings, run, &made, &mut |_| ()).map_err(as_cli_error)?;
                let export = inbox.join(files.export.file_name().unwrap_or_default());
                let moved = if run < SLOW_DAYS {
                    append_slowly(&files.export, &export)
                } else {
                    std::fs::rename(&files.export, &export)
                };
                moved.map_err(|error| CliError::Io(format!("{}: {error}", export.display())))?;
                written.push(export);
            }
        }
        Ok(written)
    })
}

fn append_slowly(from: &Path, to: &Path) -> std::io::Result<()> {
    let text = std::fs::read(from)?;
    let mut export = File::options().create_new(true).append(true).open(to)?;
    for piece in text.chunks(text.len() / PIECES + 1) {
        export.write_all(piece)?;
        std::thread::sleep(PIECE_PAUSE);
    }
    std::fs::remove_file(from)
}

fn as_cli_error(error: SimulateError) -> CliError {
    match error {
        SimulateError::Write { .. } => CliError::Io(error.to_string()),
        _ => CliError::Internal(error.to_string()),
    }
}

/// Runs the daemon beside the writer until every export has its outcome or a stop is asked for.
async fn watch_fleet(
    pipeline: &Pipeline,
    once: bool,
    stop: &CancellationToken,
    writer: Written,
) -> Result<(), CliError> {
    let (to_tally, mut outcomes) = tokio::sync::mpsc::unbounded_channel::<PathBuf>();
    let done = stop.child_token();
    let tally = tokio::spawn({
        let done = done.clone();
        async move {
            let mut seen = HashSet::new();
            let written = writer.await.map_err(|error| CliError::Internal(error.to_string()))?;
            let written = match written {
                Ok(written) => written,
                Err(error) => {
                    done.cancel();
                    return Err(error);
                }
            };
            while !written.iter().all(|path| seen.contains(path)) {
                let Some(path) = outcomes.recv().await else { break };
                seen.insert(path);
            }
            if once {
                done.cancel();
            } else {
                output::print_hint("every export is stored; the dashboard stays until Ctrl-C");
            }
            Ok(())
        }
    });
    let claim = pipeline.store().claim()?;
    let reload = daemon::reload_on_hangup(&done).map_err(|error| CliError::Internal(error.to_string()))?;
    let control = daemon::Control { claim, stop: done.clone(), reload, reread: &|| None };
    daemon::watch(pipeline, control, |event| match event {
        Event::Export(path, outcome) => {
            show_outcome(path, outcome);
            // the tally may be done already when the demo watches on
            let _ = to_tally.send(path.to_path_buf());
        }
        Event::Concluded(concluded) => show_conclusions(concluded),
    })
    .await?;
    drop(to_tally);
    tally.await.map_err(|error| CliError::Internal(error.to_string()))?
}

fn show_outcome(path: &Path, outcome: &Outcome) {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    match outcome {
        Outcome::Stored(run) => {
            output::line(&format!("stored  {name}: {} cycles, {} rows", run.cycles, run.rows));
        }
        Outcome::Quarantined { rejection, .. } => output::line(&format!("quarantined  {rejection}")),
        Outcome::Unreadable { rejection } => output::line(&format!("unreadable   {rejection}")),
        Outcome::AlreadyStored { .. } | Outcome::Interrupted | Outcome::Changed | Outcome::InWork { .. } => {}
    }
}

fn show_conclusions(concluded: &Concluded) {
    for anomaly in &concluded.new_anomalies {
        output::line(&format!(
            "{}  {} {}: {}",
            anomaly.severity, concluded.robot, anomaly.kind, anomaly.message
        ));
    }
}

/// What the database says in the end.
async fn show_findings(store: &Store, database: &Path) -> Result<(), CliError> {
    let health = store.fleet_health().await?;
    let rows: Vec<Vec<String>> = health
        .iter()
        .map(|row| {
            let number = |value: Option<f64>| value.map_or_else(|| "-".into(), |value| format!("{value:.3}"));
            vec![
                row.robot.clone(),
                row.joint.to_string(),
                row.status.name().to_owned(),
                number(row.friction_index),
                number(row.moving_relative_rmsd),
                row.open_anomalies.to_string(),
                row.last_result_at.map_or_else(|| "-".into(), |at| at.strftime("%Y-%m-%d %H:%M").to_string()),
            ]
        })
        .collect();
    let header = [
        "robot",
        "joint",
        "status",
        "friction_index",
        "moving_relative_rmsd",
        "open_anomalies",
        "last_result_at (UTC)",
    ];
    output::line(&format!("\n{}", output::table(&header, &rows)));
    for row in health.iter().filter(|row| row.status == HealthStatus::Unknown) {
        if let Some(reason) = &row.reason {
            output::line(&format!("{} joint {}: {reason}", row.robot, row.joint));
        }
    }
    let anomalies = store.anomalies_after(0).await?;
    if anomalies.is_empty() {
        output::line("\nno anomalies");
    }
    for anomaly in &anomalies {
        output::line(&format!(
            "\n{} {} on {}, {} since {}: {}",
            anomaly.severity,
            anomaly.kind,
            anomaly.robot,
            anomaly.state,
            anomaly.first_seen_at,
            anomaly.message
        ));
    }
    output::line(&format!(
        "\nthe database stays:\n  armwatch status --db {0}\n  armwatch sql \"SELECT * FROM fleet_health\" --db {0}",
        database.display()
    ));
    Ok(())
}
