//! `armwatch-lab benchmark ingest`: time and memory of `ingest` compared with a plain read of the same bytes.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use serde_json::json;

use super::processor_time::children_cpu_s;
use crate::context::{LabOptions, own_program};
use crate::plain_read::read_with_polars;
use armwatch::cli::context::{ANY_PROCESSOR, CliError, EXIT_DONE};
use armwatch::cli::shared::output;
use armwatch::cli::shared::shipped_robot::shipped_robot;
use armwatch_simulate::{SimulationSettings, simulate_run};

/// Time between two measurements of a running child's memory.
const LOOK: Duration = Duration::from_millis(5);
/// Small exports that are simulated; the others are copies with shifted times.
const DISTINCT_SMALL: u32 = 8;
/// Start of the first simulated export.
const FIRST_START: &str = "2026-01-05T08:47:00Z";
/// Shift of time between two small exports of one origin, s.
const SHIFT_S: f64 = 0.001;

#[derive(Debug, Args)]
#[command(after_help = "\
Simulates an export, reads it with polars alone, takes it with `ingest` into a new database, each in a process
of its own and in turns, and prints the best time of each, the least processor time, their ratios and the peak
memory. The first read of all warms the file cache and does not count. Other programs that run meanwhile lengthen the
times; the ratio of processor times (cpu_s) changes least.

Examples:
  armwatch-lab benchmark ingest
  armwatch-lab benchmark ingest --cycles 1
  armwatch-lab benchmark ingest --small-files 1000
  armwatch-lab benchmark ingest --any-processor
  armwatch-lab benchmark ingest --file R00_20260105_0847_Col23_180s_cycle24.csv \\
      --json")]
pub(crate) struct IngestBenchmarkArgs {
    /// Cycles of the simulated export, five minutes each; 24 are a whole test
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=200))]
    cycles: u32,
    /// Rows a second, Hz
    #[arg(long, default_value_t = 250.0)]
    rate_hz: f64,
    /// An export to take instead, plain, with a header and commas
    #[arg(long, value_name = "EXPORT")]
    file: Option<PathBuf>,
    /// Turns of reading and ingesting
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=20))]
    rounds: u32,
    /// Instead: this many small exports of one robot, a quarter of them, and the ratio of the times
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=100_000))]
    small_files: Option<u32>,
    /// Let the program's own kernels run as on a processor without 256-bit registers; other crates, such as those that read
    /// and hash, go on choosing for themselves
    #[arg(long)]
    any_processor: bool,
}

#[derive(Debug, Args)]
pub(crate) struct PlainReadArgs {
    /// File to read
    file: PathBuf,
}

/// Cost of a child process.
#[derive(Debug, Clone, Copy)]
struct ProcessCost {
    wall_s: f64,
    /// Processor time of all threads, user and system, s; zero if the system does not report it.
    cpu_s: f64,
    /// Largest resident memory, MB; zero if the system does not report it.
    peak_mb: f64,
}

pub(crate) fn plain_read(args: &PlainReadArgs) -> Result<u8, CliError> {
    let rows = read_with_polars(&args.file).map_err(|error| CliError::Usage(error.to_string()))?;
    output::line(&rows.to_string());
    Ok(EXIT_DONE)
}

pub(crate) fn throughput(global: &LabOptions, args: &IngestBenchmarkArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    match args.small_files {
        Some(files) => small_files(global, files, args.any_processor, folder.path()),
        None => one_export(global, args, folder.path()),
    }
}

fn one_export(global: &LabOptions, args: &IngestBenchmarkArgs, folder: &Path) -> Result<u8, CliError> {
    let (export, setting) = match &args.file {
        Some(file) => (file.clone(), Setting::Given(global)),
        None => (simulated(folder, args.cycles, args.rate_hz)?, Setting::Shipped(folder)),
    };
    let program = global.program()?;
    let child = Child { program: &program, setting, any_processor: args.any_processor };
    let own = own_program()?;
    let reader = Child { program: &own, setting: child.setting, any_processor: args.any_processor };
    let bytes = std::fs::metadata(&export).map_err(|error| named(&export, &error))?.len();
    let read = ["benchmark".into(), "plain-read".into(), export.clone()];
    let rows = run(&reader, &read)?.1;
    let (mut plain, mut ingest): (Vec<ProcessCost>, Vec<ProcessCost>) = (Vec::new(), Vec::new());
    for round in 0..args.rounds {
        plain.push(run(&reader, &read)?.0);
        let database = folder.join(format!("{round}.db"));
        ingest.push(run(&child, &["ingest".into(), export.clone(), "--db".into(), database])?.0);
    }
    let rows: u64 = rows.trim().parse().unwrap_or(0);
    let (plain, ingest) = (best(&plain), best(&ingest));
    let ratio = ingest.wall_s / plain.wall_s;
    let cpu_ratio = Some(ingest.cpu_s / plain.cpu_s).filter(|ratio| ratio.is_finite());
    if global.json {
        let cost = |cost: ProcessCost| json!({"wall_s": cost.wall_s, "cpu_s": cost.cpu_s, "rows_per_s": rows as f64 / cost.wall_s, "peak_mb": cost.peak_mb});
        output::json(&json!({
            "rows": rows, "bytes": bytes, "rounds": args.rounds, "ratio": ratio, "cpu_ratio": cpu_ratio,
            "polars": cost(plain), "ingest": cost(ingest),
        }));
        return Ok(EXIT_DONE);
    }
    let line = |what: &str, cost: ProcessCost| {
        let rows_per_s = rows as f64 / cost.wall_s;
        vec![
            what.into(),
            format!("{:.2}", cost.wall_s),
            format!("{:.2}", cost.cpu_s),
            format!("{rows_per_s:.0}"),
            format!("{:.0}", cost.peak_mb),
        ]
    };
    output::line(&format!("{rows} rows, {:.1} MB, best of {} turns", bytes as f64 / 1e6, args.rounds));
    let lines = [line("polars, plain read", plain), line("armwatch ingest", ingest)];
    output::line(&output::table(&["", "wall_s", "cpu_s", "rows_per_s", "peak_mb"], &lines));
    let cpu_ratio = cpu_ratio.map_or_else(String::new, |ratio| format!(", of processor times {ratio:.2}"));
    output::line(&format!("ratio of times {ratio:.2}{cpu_ratio}"));
    Ok(EXIT_DONE)
}

fn small_files(global: &LabOptions, files: u32, any_processor: bool, folder: &Path) -> Result<u8, CliError> {
    let program = global.program()?;
    let child = Child { program: &program, setting: Setting::Shipped(folder), any_processor };
    let mut costs = Vec::new();
    for count in [files / 4, files] {
        let exports = folder.join(format!("{count}"));
        write_small(&exports, count)?;
        let database = folder.join(format!("{count}.db"));
        costs.push((count, run(&child, &["ingest".into(), exports, "--db".into(), database])?.0));
    }
    let per_file = |(count, cost): &(u32, ProcessCost)| cost.wall_s / f64::from(*count);
    let growth = per_file(&costs[1]) / per_file(&costs[0]);
    if global.json {
        let costs = costs.iter().map(|entry| {
            let (files, cost) = entry;
            json!({
                "files": files, "wall_s": cost.wall_s, "per_file_s": per_file(entry),
                "cpu_per_file_s": cost.cpu_s / f64::from(*files), "peak_mb": cost.peak_mb,
            })
        });
        output::json(&json!({"growth": growth, "series": costs.collect::<Vec<_>>()}));
        return Ok(EXIT_DONE);
    }
    let lines: Vec<Vec<String>> = costs
        .iter()
        .map(|entry| {
            let (count, cost) = entry;
            vec![
                count.to_string(),
                format!("{:.2}", cost.wall_s),
                format!("{:.1}", 1e3 * per_file(entry)),
                format!("{:.1}", 1e3 * cost.cpu_s / f64::from(*count)),
                format!("{:.0}", cost.peak_mb),
            ]
        })
        .collect();
    output::line(&output::table(&["files", "wall_s", "per_file_ms", "cpu_per_file_ms", "peak_mb"], &lines));
    output::line(&format!(
        "time of a file with all of them against a quarter of them: {growth:.2} (1 is linear)"
    ));
    Ok(EXIT_DONE)
}

/// Configuration of a child: the caller's, or the shipped one in a folder without a configuration.
#[derive(Clone, Copy)]
enum Setting<'a> {
    Given(&'a LabOptions),
    Shipped(&'a Path),
}

/// Options of a child.
struct Child<'a> {
    program: &'a Path,
    setting: Setting<'a>,
    /// True to imitate a processor without wide registers.
    any_processor: bool,
}

/// Runs a program with `arguments` and quiet logs. Returns its cost and its output.
fn run(child: &Child<'_>, arguments: &[PathBuf]) -> Result<(ProcessCost, String), CliError> {
    let mut command = Command::new(child.program);
    command.arg("-q").args(arguments).stdin(Stdio::null()).stdout(Stdio::piped());
    if child.any_processor {
        command.env(ANY_PROCESSOR, "1");
    }
    match child.setting {
        Setting::Given(global) => {
            if let Some(config) = &global.config {
                command.arg("--config").arg(config);
            }
        }
        Setting::Shipped(folder) => {
            command.env_remove("ARMWATCH_CONFIG").current_dir(folder);
        }
    }
    let (started, cpu_before) = (Instant::now(), children_cpu_s());
    let mut child = command.spawn().map_err(|error| CliError::Io(error.to_string()))?;
    let status = PathBuf::from(format!("/proc/{}/status", child.id()));
    let mut printed = child.stdout.take().map(BufReader::new);
    // reading must continue during the wait, because the pipe would fill up otherwise
    let reader = std::thread::spawn(move || {
        let mut text = String::new();
        if let Some(printed) = &mut printed {
            let _ = std::io::Read::read_to_string(printed, &mut text);
        }
        text
    });
    let mut peak_mb = 0.0_f64;
    let ended = loop {
        peak_mb = peak_mb.max(memory_mb(&status, "VmHWM:").unwrap_or(0.0));
        if let Some(ended) = child.try_wait().map_err(|error| CliError::Io(error.to_string()))? {
            break ended;
        }
        std::thread::sleep(LOOK);
    };
    let (wall_s, cpu_s) = (started.elapsed().as_secs_f64(), children_cpu_s() - cpu_before);
    let text = reader.join().unwrap_or_default();
    if !ended.success() {
        let what: Vec<String> = arguments.iter().map(|part| part.display().to_string()).collect();
        return Err(CliError::Io(format!("armwatch {}: {ended}\n{text}", what.join(" "))));
    }
    Ok((ProcessCost { wall_s, cpu_s, peak_mb }, text))
}

/// Memory of a process by a field of its `/proc/PID/status`, MB: `VmRSS:` is the present resident memory, `VmHWM:` its
/// maximum; `None` if the system does not report it.
pub(super) fn memory_mb(status: &Path, field: &str) -> Option<f64> {
    let text = std::fs::read_to_string(status).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    let kilobytes: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024.0 / 1e6)
}

/// The shortest times, and the largest memory of all turns.
fn best(costs: &[ProcessCost]) -> ProcessCost {
    costs.iter().fold(
        ProcessCost { wall_s: f64::INFINITY, cpu_s: f64::INFINITY, peak_mb: 0.0 },
        |best, cost| ProcessCost {
            wall_s: best.wall_s.min(cost.wall_s),
            cpu_s: best.cpu_s.min(cost.cpu_s),
            peak_mb: best.peak_mb.max(cost.peak_mb),
        },
    )
}

pub(super) fn simulated(folder: &Path, cycles: u32, rate_hz: f64) -> Result<PathBuf, CliError> {
    output::print_hint(&format!("simulating {cycles} cycles at {rate_hz} Hz"));
    let settings = SimulationSettings {
        cycles,
        sample_rate_hz: rate_hz,
        first_start: first_start()?,
        ..SimulationSettings::full_test()
    };
    let made = simulate_run(&shipped_robot()?, &settings, 0, folder, &mut |_| ());
    Ok(made.map_err(|error| CliError::Usage(error.to_string()))?.export)
}

fn first_start() -> Result<Timestamp, CliError> {
    FIRST_START.parse().map_err(|error| CliError::Internal(format!("{FIRST_START}: {error}")))
}

/// Writes `count` exports of one cycle each, a day apart.
fn write_small(folder: &Path, count: u32) -> Result<(), CliError> {
    output::print_hint(&format!("writing {count} small exports"));
    let first_start = first_start()?;
    let settings =
        SimulationSettings { cycles: 1, warming_s: 5.0, first_start, ..SimulationSettings::default() };
    let robot = shipped_robot()?;
    let origins = folder.with_extension("origins");
    std::fs::create_dir_all(folder).map_err(|error| named(folder, &error))?;
    let mut made = Vec::new();
    for run in 0..DISTINCT_SMALL.min(count) {
        let files = simulate_run(&robot, &settings, run, &origins, &mut |_| ());
        made.push(files.map_err(|error| CliError::Usage(error.to_string()))?);
    }
    for number in 0..count {
        let origin = &made[(number % DISTINCT_SMALL) as usize];
        let started = first_start + SignedDuration::from_hours(24 * i64::from(number));
        let name = format!("R01_{}_5s_cycle1.csv", started.strftime("%Y%m%d_%H%M"));
        let path = folder.join(name);
        shift_time(&origin.export, &path, f64::from(number) * SHIFT_S)
            .map_err(|error| named(&path, &error))?;
    }
    Ok(())
}

/// Copies an export with its first column, time, moved by `by` seconds.
pub(super) fn shift_time(from: &Path, to: &Path, by: f64) -> std::io::Result<()> {
    let mut copy = BufWriter::new(File::create_new(to)?);
    for (number, line) in BufReader::new(File::open(from)?).lines().enumerate() {
        let line = line?;
        match line.split_once(',').and_then(|(time, rest)| Some((time.parse::<f64>().ok()?, rest))) {
            Some((time, rest)) if number > 0 => writeln!(copy, "{:.6},{rest}", time + by)?,
            _ => writeln!(copy, "{line}")?,
        }
    }
    copy.flush()
}

fn named(path: &Path, error: &std::io::Error) -> CliError {
    CliError::Io(format!("{}: {error}", path.display()))
}
