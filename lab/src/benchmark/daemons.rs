//! `armwatch-lab benchmark daemons`: exports per minute of one daemon and of several on one server database.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use serde_json::{Value, json};

use super::child_daemon::{ChildDaemon, Launch};
use super::processor_time::machine_cpu_s;
use super::throughput::{shift_time, simulated};
use crate::context::LabOptions;
use armwatch::cli::context::{CliError, EXIT_DONE, runtime};
use armwatch::cli::shared::output;
use armwatch_config::{is_on_server, shipped_files};
use armwatch_method::statistics::descriptive::median;
use armwatch_store::{ClaimKind, SessionKind, Store};

/// Interval of checks that all is stored, before nine tenths are stored and afterwards; checks take time of the server.
const SELDOM: Duration = Duration::from_millis(1500);
const LOOK: Duration = Duration::from_millis(150);
/// Time after which missing exports of a turn count as failed.
const LONGEST: Duration = Duration::from_secs(1800);
/// Claims whose time is measured.
const CLAIMS: usize = 300;
/// Rows per second of the exports, Hz.
const RATE_HZ: f64 = 250.0;
/// Shift of time between two exports, so that no two have the same content, s.
const SHIFT_S: f64 = 1e-3;
/// Scan interval, s; all files exist when a turn begins.
const SCAN_S: f64 = 0.1;

/// The arm of all exports.
const ROBOT: &str =
    "[[robot]]\nname = \"*\"\ndescription = \"robots/er3a.toml\"\nlayout = \"exports/native.toml\"\n";

#[derive(Debug, Args)]
#[command(after_help = "\
In turns, the same number of exports is taken by one daemon into a file of SQLite, by one daemon into the database on the
server, and by several there that all see the folder. Each daemon has a processor of its own, by `taskset`. A turn lasts
until every export is stored and every robot concluded. Printed are the medians of all turns: exports a minute, processor time of
the daemons for each export, that of everything else on this machine, which is the server's where it runs here, the ratio of
several daemons to one, and by how much the processor time of an export grows, that of the server included. With one
daemon the server has another processor to itself. With as many daemons as processors it shares theirs, and the ratio
stays below their number even where daemons cost each other nothing. The growth says what they do cost each other. Then, while
nothing else works on the database, the time of a claim and of giving it back, which is each a statement with its commit.

The database on the server must be empty, as `createdb trial` makes it; the robots of the benchmark stay in it.

Examples:
  armwatch-lab benchmark daemons --db postgres:///trial
  armwatch-lab benchmark daemons --db postgres://armwatch@db.plant/trial --daemons 4 --exports 48 --json")]
pub(crate) struct DaemonsArgs {
    /// Daemons beside each other, each on a processor of its own
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(2..=64))]
    daemons: u32,
    /// Exports of each turn, each of a robot of its own
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(2..=1000))]
    exports: u32,
    /// Cycles of each export, five minutes each
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=24))]
    cycles: u32,
    /// Turns of each
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=20))]
    rounds: u32,
}

/// Database of a turn, and the number of daemons that read its exports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Setup {
    File,
    Server(u32),
}

impl Setup {
    fn title(self) -> String {
        match self {
            Self::File => "1 daemon, file of SQLite".into(),
            Self::Server(1) => "1 daemon, server".into(),
            Self::Server(daemons) => format!("{daemons} daemons, server"),
        }
    }

    fn daemons(self) -> u32 {
        match self {
            Self::File => 1,
            Self::Server(daemons) => daemons,
        }
    }
}

/// Times of a turn.
#[derive(Debug, Clone, Copy)]
struct RoundTimes {
    wall_s: f64,
    /// Processor time of all daemons.
    daemons_cpu_s: f64,
    /// Processor time of everything else on the machine; `None` if the system does not report it.
    others_cpu_s: Option<f64>,
}

pub(crate) fn daemons(global: &LabOptions, args: &DaemonsArgs) -> Result<u8, CliError> {
    let address = global.db.clone().filter(|address| is_on_server(address)).ok_or_else(|| {
        CliError::Usage(
            "name an empty database of a PostgreSQL server, such as --db postgres:///trial (`createdb trial`)"
                .into(),
        )
    })?;
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    if args.daemons as usize > processors {
        return Err(CliError::Usage(format!(
            "{} daemons need as many processors; this machine has {processors}",
            args.daemons
        )));
    }
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let folder = folder.path().canonicalize().map_err(|error| CliError::Io(error.to_string()))?;
    let origin = simulated(&folder.join("origin"), args.cycles, RATE_HZ)?;
    let runtime = runtime()?;
    let setups = [Setup::File, Setup::Server(1), Setup::Server(args.daemons)];
    let mut turns: Vec<(Setup, Vec<RoundTimes>)> = setups.map(|setup| (setup, Vec::new())).into();
    let [claim_ms, release_ms] = runtime.block_on(async {
        // create the schema before daemons start together
        let store = Store::open(&address).await?;
        if store.counts().await?.robots > 0 {
            return Err(CliError::Usage(
                "the database already holds robots; name an empty one with --db (`createdb trial`)".into(),
            ));
        }
        let mut number = 0;
        for round in 0..args.rounds {
            for (place, (setup, taken)) in turns.iter_mut().enumerate() {
                output::print_hint(&format!("turn {} of {}: {}", round + 1, args.rounds, setup.title()));
                let turn_folder = folder.join(format!("{round}_{place}"));
                let exports = Exports::write(&origin, &turn_folder, args.exports, number)?;
                number += args.exports;
                let server = (*setup != Setup::File).then_some(&store);
                taken.push(take(global, &turn_folder, *setup, &address, server, &exports).await?);
                std::fs::remove_dir_all(&turn_folder).map_err(|error| named(&turn_folder, &error))?;
            }
        }
        let claims = claim_times(&store).await?;
        store.close().await?;
        Ok(claims)
    })?;
    report(global, args, &turns, [claim_ms, release_ms]);
    Ok(EXIT_DONE)
}

/// Exports of one turn, next to their later folder.
struct Exports {
    paths: Vec<PathBuf>,
}

impl Exports {
    /// Writes `count` copies of an export below a folder, each with a separate robot and separate times.
    fn write(origin: &Path, folder: &Path, count: u32, first: u32) -> Result<Self, CliError> {
        let waiting = folder.join("waiting");
        for made in [&waiting, &folder.join("inbox")] {
            std::fs::create_dir_all(made).map_err(|error| named(made, &error))?;
        }
        let name = origin.file_name().unwrap_or_default().to_string_lossy();
        let (_, rest) =
            name.split_once('_').ok_or_else(|| CliError::Internal(format!("no robot in {name}")))?;
        let mut paths = Vec::new();
        for number in first..first + count {
            let path = waiting.join(format!("R{number:05}_{rest}"));
            let by = f64::from(number + 1) * SHIFT_S;
            shift_time(origin, &path, by).map_err(|error| named(&path, &error))?;
            paths.push(path);
        }
        Ok(Self { paths })
    }

    /// Moves them into the inbox, each as a whole.
    fn show(&self, inbox: &Path) -> Result<(), CliError> {
        for path in &self.paths {
            let shown = inbox.join(path.file_name().unwrap_or_default());
            std::fs::rename(path, &shown).map_err(|error| named(path, &error))?;
            let mark = PathBuf::from(format!("{}.done", shown.display()));
            std::fs::write(&mark, "").map_err(|error| named(&mark, &error))?;
        }
        Ok(())
    }
}

/// Starts the daemons of a turn, moves the exports into the inbox, and waits until all are stored and concluded.
async fn take(
    global: &LabOptions,
    folder: &Path,
    setup: Setup,
    address: &Path,
    server: Option<&Store>,
    exports: &Exports,
) -> Result<RoundTimes, CliError> {
    let file = folder.join("armwatch.db");
    let database = if server.is_some() { address } else { &file };
    let of_file = match server {
        Some(_) => None,
        None => Some(Store::open(&file).await?),
    };
    let store = server.or(of_file.as_ref()).ok_or_else(|| CliError::Internal("no store".into()))?;
    let before = store.counts().await?.complete_runs;
    let mut children = Vec::new();
    for place in 0..setup.daemons() {
        children.push(start(global, folder, setup, database, place)?);
    }
    for child in &mut children {
        until_ready(child).await?;
    }
    let cpu = |children: &[ChildDaemon]| -> f64 { children.iter().filter_map(ChildDaemon::cpu_s).sum() };
    let (own, machine) = (cpu(&children), machine_cpu_s());
    let began = Instant::now();
    exports.show(&folder.join("inbox"))?;
    let wanted = before + exports.paths.len() as u64;
    loop {
        children.iter_mut().try_for_each(ChildDaemon::check)?;
        // acts as the service manager
        children.iter().for_each(|child| drop(child.said()));
        let stored = store.counts().await?.complete_runs;
        if stored >= wanted && store.stale_robots().await?.is_empty() {
            break;
        }
        if began.elapsed() > LONGEST {
            return Err(CliError::Internal(format!("not all was stored within {} s", LONGEST.as_secs())));
        }
        let is_near = 10 * (stored - before) >= 9 * (wanted - before);
        tokio::time::sleep(if is_near { LOOK } else { SELDOM }).await;
    }
    let wall_s = began.elapsed().as_secs_f64();
    let daemons_cpu_s = cpu(&children) - own;
    let others_cpu_s = machine_cpu_s().zip(machine).map(|(after, before)| after - before - daemons_cpu_s);
    children.into_iter().try_for_each(ChildDaemon::stop)?;
    if let Some(store) = of_file {
        store.close().await?;
    }
    Ok(RoundTimes { wall_s, daemons_cpu_s, others_cpu_s })
}

fn start(
    global: &LabOptions,
    folder: &Path,
    setup: Setup,
    database: &Path,
    place: u32,
) -> Result<ChildDaemon, CliError> {
    let name = format!("daemon{place}");
    let cluster = match setup {
        Setup::File => String::new(),
        Setup::Server(_) => format!("[cluster]\nhost = \"{name}\"\nshared_folders = [\"inbox\"]\n"),
    };
    let config = folder.join(format!("{name}.toml"));
    for (file, text) in shipped_files() {
        let path = folder.join(file);
        let parent = path.parent().unwrap_or(folder);
        std::fs::create_dir_all(parent).map_err(|error| named(parent, &error))?;
        std::fs::write(&path, text).map_err(|error| named(&path, &error))?;
    }
    // a JSON string is a TOML string too
    let database = json!(database.to_string_lossy());
    let text = format!("database = {database}\n[watch]\nscan_interval_s = {SCAN_S}\n{cluster}{ROBOT}");
    std::fs::write(&config, text).map_err(|error| named(&config, &error))?;
    let launch = Launch { name: &name, config: Some(&config), processor: Some(place as usize) };
    ChildDaemon::launch(global, folder, &launch)
}

async fn until_ready(child: &mut ChildDaemon) -> Result<(), CliError> {
    let began = Instant::now();
    while !child.said().iter().any(|said| said.starts_with("READY=")) {
        child.check()?;
        if began.elapsed() > LONGEST {
            return Err(CliError::Internal("a daemon does not come up".into()));
        }
        tokio::time::sleep(LOOK).await;
    }
    Ok(())
}

/// Median times of a claim and of its release, ms.
async fn claim_times(store: &Store) -> Result<[f64; 2], CliError> {
    let session = store.join(SessionKind::Command).await?;
    let (mut claims, mut releases) = (Vec::new(), Vec::new());
    for number in 0..CLAIMS {
        let subject = format!("benchmark {number}");
        let began = Instant::now();
        store.claim_work(ClaimKind::Export, &subject).await?;
        claims.push(1e3 * began.elapsed().as_secs_f64());
        let began = Instant::now();
        store.release_work(&[(ClaimKind::Export, &subject)]).await;
        releases.push(1e3 * began.elapsed().as_secs_f64());
    }
    session.leave().await;
    Ok([claims, releases].map(|times| median(&times).unwrap_or(f64::NAN)))
}

/// Medians of the turns of a setup: exports per minute, and processor times for each export, s.
struct TurnMedians {
    title: String,
    exports_a_min: f64,
    cpu_s: f64,
    others_cpu_s: Option<f64>,
}

impl TurnMedians {
    fn new(setup: Setup, turns: &[RoundTimes], exports: u32) -> Self {
        let of = |value: &dyn Fn(&RoundTimes) -> Option<f64>| {
            median(&turns.iter().filter_map(value).collect::<Vec<_>>())
        };
        let each = f64::from(exports);
        Self {
            title: setup.title(),
            exports_a_min: of(&|turn| Some(60.0 * each / turn.wall_s)).unwrap_or(f64::NAN),
            cpu_s: of(&|turn| Some(turn.daemons_cpu_s / each)).unwrap_or(f64::NAN),
            others_cpu_s: of(&|turn| turn.others_cpu_s.map(|cpu_s| cpu_s / each)),
        }
    }
}

fn report(
    global: &LabOptions,
    args: &DaemonsArgs,
    turns: &[(Setup, Vec<RoundTimes>)],
    [claim_ms, release_ms]: [f64; 2],
) {
    let figures: Vec<TurnMedians> =
        turns.iter().map(|(setup, turns)| TurnMedians::new(*setup, turns, args.exports)).collect();
    let [file, one, several] = &figures[..] else { return };
    let ratio = several.exports_a_min / one.exports_a_min;
    let cpu_ratio = one.cpu_s / file.cpu_s;
    let all_cpu_s = |of: &TurnMedians| of.cpu_s + of.others_cpu_s.unwrap_or(0.0);
    let cpu_growth = all_cpu_s(several) / all_cpu_s(one) - 1.0;
    if global.json {
        let row = |figures: &TurnMedians| -> Value {
            json!({
                "setup": figures.title, "exports_per_min": figures.exports_a_min,
                "cpu_per_export_s": figures.cpu_s, "others_cpu_per_export_s": figures.others_cpu_s,
            })
        };
        output::json(&json!({
            "exports": args.exports, "cycles": args.cycles, "rounds": args.rounds, "daemons": args.daemons,
            "setups": figures.iter().map(row).collect::<Vec<_>>(), "ratio": ratio,
            "cpu_growth_of_several": cpu_growth, "cpu_ratio_of_server_to_file": cpu_ratio, "claim_ms": claim_ms, "release_ms": release_ms,
        }));
        return;
    }
    let rows: Vec<Vec<String>> = figures
        .iter()
        .map(|figures| {
            vec![
                figures.title.clone(),
                format!("{:.1}", figures.exports_a_min),
                format!("{:.2}", figures.cpu_s),
                figures.others_cpu_s.map_or_else(String::new, |cpu_s| format!("{cpu_s:.2}")),
            ]
        })
        .collect();
    output::line(&format!(
        "{} exports of {} cycles, medians of {} turns",
        args.exports, args.cycles, args.rounds
    ));
    let header = ["", "exports_per_min", "cpu_per_export_s", "others_cpu_per_export_s"];
    output::line(&output::table(&header, &rows));
    output::line(&format!(
        "{} daemons to one: {ratio:.2}; processor time of all for each export: {:+.0} %; of a daemon, server to file: \
         {cpu_ratio:.2}",
        args.daemons,
        100.0 * cpu_growth
    ));
    output::line(&format!("a claim takes {claim_ms:.2} ms, giving it back {release_ms:.2} ms"));
}

fn named(path: &Path, error: &std::io::Error) -> CliError {
    CliError::Io(format!("{}: {error}", path.display()))
}
