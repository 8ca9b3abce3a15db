//! `armwatch ingest`: files and folders through the pipeline once.

use std::collections::HashMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::{
    CliError, EXIT_DONE, EXIT_FOUND, EXIT_STOPPED, Global, open_store, output, reweight, runtime, shared,
};
use crate::daemon;
use crate::ingest::watch;
use crate::pipeline::conclude::{Concluded, RUNS_AT_ONCE};
use crate::pipeline::{Outcome, Pipeline, Progress, Retry};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz
  armwatch ingest exports/ --db fleet.db
  armwatch ingest exports/ --json | jq .reason

Folders are searched with their subfolders for *.csv, *.csv.gz and *.csv.zst. A file whose content is
stored already is named and passed over; a quarantined one is read again. Sources are never changed.
Exit status 1 if an export was quarantined.")]
pub(super) struct IngestArgs {
    /// Exports, or folders of exports
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

pub(super) fn ingest(global: &Global, args: &IngestArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let exports = find_exports(&args.paths)?;
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let pipeline = Pipeline::new(shared(config), store);
        let done = take_all(&pipeline, &exports, &stop, global.json).await;
        pipeline.close().await?;
        done
    })
}

pub(super) async fn take_all(
    pipeline: &Pipeline,
    exports: &[PathBuf],
    stop: &CancellationToken,
    as_json: bool,
) -> Result<u8, CliError> {
    if !reweight::reweight(pipeline, stop).await? {
        return Ok(EXIT_STOPPED);
    }
    let mut code = EXIT_DONE;
    let mut ended: HashMap<String, usize> = HashMap::new();
    for path in exports {
        let bar = progress_bar(path);
        let moving = bar.clone();
        let outcome = pipeline
            .process(path, Retry::Quarantined, stop, move |progress| match progress {
                Progress::Begun | Progress::CaughtUp => {}
                Progress::Read(bytes) => moving.set_position(bytes),
                Progress::Cycle(cycle) => moving.set_message(format!("cycle {cycle}")),
            })
            .await;
        bar.finish_and_clear();
        let outcome = outcome?;
        print(path, &outcome, as_json);
        if let Outcome::Stored(run) = &outcome {
            let runs = ended.entry(run.robot.clone()).or_default();
            *runs += 1;
            if runs.is_multiple_of(RUNS_AT_ONCE)
                && let Some(concluded) = pipeline.conclude_named(&run.robot).await?
            {
                print_conclusions(&concluded, as_json);
            }
        }
        match outcome {
            Outcome::Quarantined { .. }
            | Outcome::Changed
            | Outcome::Unreadable { .. }
            | Outcome::InWork { .. } => code = EXIT_FOUND,
            Outcome::Interrupted => return Ok(EXIT_STOPPED),
            Outcome::Stored(_) | Outcome::AlreadyStored { .. } => {}
        }
        if stop.is_cancelled() {
            return Ok(EXIT_STOPPED);
        }
    }
    for concluded in pipeline.conclude().await? {
        print_conclusions(&concluded, as_json);
    }
    Ok(code)
}

/// Files as they were named, folders by their exports in the order of their names.
fn find_exports(paths: &[PathBuf]) -> Result<Vec<PathBuf>, CliError> {
    let mut exports = Vec::new();
    for path in paths {
        let metadata = std::fs::metadata(path)
            .map_err(|error| CliError::Usage(format!("{}: {error}", path.display())))?;
        if !metadata.is_dir() {
            exports.push(path.clone());
            continue;
        }
        let scan = watch::scan(std::slice::from_ref(path));
        if scan.files.is_empty() {
            output::note(&format!(
                "{}: no exports in this folder (*.csv, *.csv.gz, *.csv.zst)",
                path.display()
            ));
        }
        exports.extend(scan.files.into_iter().map(|file| file.path));
    }
    Ok(exports)
}

/// A bar over the bytes of a file, hidden where there is no terminal.
fn progress_bar(path: &Path) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let bar = ProgressBar::new(bytes);
    let style = "{prefix} [{bar:30}] {bytes}/{total_bytes} {bytes_per_sec} {msg} eta {eta}";
    if let Ok(style) = ProgressStyle::with_template(style) {
        bar.set_style(style.progress_chars("=> "));
    }
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    bar.set_prefix(name);
    bar
}

fn print(path: &Path, outcome: &Outcome, as_json: bool) {
    if as_json {
        output::json(&as_value(path, outcome));
    } else {
        output::line(&as_text(path, outcome));
    }
}

/// What a robot's history says with the new runs: nothing is printed where it says nothing new.
fn print_conclusions(concluded: &Concluded, as_json: bool) {
    for anomaly in &concluded.new_anomalies {
        if as_json {
            output::json(&json!({
                "outcome": "anomaly", "robot": concluded.robot, "joint": anomaly.joint.number(),
                "anomaly_id": anomaly.anomaly_id, "kind": anomaly.kind, "severity": anomaly.severity.name(),
                "message": anomaly.message,
            }));
        } else {
            output::line(&format!(
                "{:<12} {} {}: {}",
                anomaly.severity, concluded.robot, anomaly.kind, anomaly.message
            ));
        }
    }
}

pub(super) fn as_text(path: &Path, outcome: &Outcome) -> String {
    let file = path.display();
    match outcome {
        Outcome::Stored(run) => {
            let mut text = format!(
                "stored       {file}: robot {}, run {}, {}, {} rows",
                run.robot,
                run.run_id,
                counted(run.cycles),
                run.rows
            );
            // what is wrong with a channel is mostly wrong in every cycle
            for alike in run.refused.chunk_by(|a, b| a.1 == b.1 && a.0 + 1 == b.0) {
                let (first, reason) = &alike[0];
                let last = alike[alike.len() - 1].0;
                let cycles = if last == *first {
                    format!("cycle {first}")
                } else {
                    format!("cycles {first} to {last}")
                };
                text.push_str(&format!("\n             {cycles} without parameters: {reason}"));
            }
            text
        }
        Outcome::AlreadyStored { run_id } => format!("known        {file}: stored as run {run_id}"),
        Outcome::Quarantined { rejection, cycles, .. } => {
            let kept = match cycles {
                0 => String::new(),
                1 => " (1 cycle before it is stored)".into(),
                _ => format!(" ({cycles} cycles before it are stored)"),
            };
            format!("quarantined  {rejection}{kept}")
        }
        Outcome::Unreadable { rejection } => format!("unreadable   {rejection}; then run again"),
        Outcome::Interrupted => format!("interrupted  {file}: run again to continue"),
        Outcome::InWork { run_id } => format!("in work      {file}: being read as run {run_id}; run again"),
        Outcome::Changed => format!("changed      {file}: changed or vanished while it was read; run again"),
    }
}

fn counted(cycles: u32) -> String {
    if cycles == 1 { "1 cycle".into() } else { format!("{cycles} cycles") }
}

fn as_value(path: &Path, outcome: &Outcome) -> serde_json::Value {
    let file = path.display().to_string();
    match outcome {
        Outcome::Stored(run) => json!({
            "file": file, "outcome": "stored", "run_id": run.run_id, "robot": run.robot,
            "cycles": run.cycles, "rows": run.rows,
            "refused": run.refused.iter().map(|(cycle, reason)| json!({"cycle": cycle, "reason": reason})).collect::<Vec<_>>(),
        }),
        Outcome::AlreadyStored { run_id } => json!({"file": file, "outcome": "known", "run_id": run_id}),
        Outcome::Quarantined { run_id, rejection, cycles, .. } => json!({
            "file": file, "outcome": "quarantined", "run_id": run_id, "reason": rejection.sentence(),
            "line": rejection.line, "column": rejection.column, "value": rejection.value,
            "remedy": rejection.remedy, "cycles": cycles,
        }),
        Outcome::Unreadable { rejection } => json!({
            "file": file, "outcome": "unreadable", "reason": rejection.sentence(), "remedy": rejection.remedy,
        }),
        Outcome::Interrupted => json!({"file": file, "outcome": "interrupted"}),
        Outcome::Changed => json!({"file": file, "outcome": "changed"}),
        Outcome::InWork { run_id } => json!({"file": file, "outcome": "in_work", "run_id": run_id}),
    }
}
