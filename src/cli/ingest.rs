//! `armwatch ingest`: files and folders through the pipeline once.

use std::collections::HashMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::context::{
    CliError, EXIT_DONE, EXIT_FOUND, EXIT_INTERNAL, EXIT_STOPPED, Global, open_store, runtime, shared,
};
use super::shared::{output, reweight};
use crate::analysis::finding::FindingKind;
use crate::daemon;
use crate::ingest::find::watch;
use crate::pipeline::conclude::history::{Concluded, RUNS_AT_ONCE};
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, Progress, Retry};
use crate::pipeline::look::replay;
use crate::robot::JointIndex;
use crate::run::RunStatus;
use crate::store::{EventKind, RunResult};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz
  armwatch ingest exports/ --db fleet.db
  armwatch ingest exports/ --json | jq .reason
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz --accept late_torque
  armwatch ingest --again 12 13

Folders are searched with their subfolders for *.csv, *.csv.gz and *.csv.zst. A file whose content is
stored already is named and passed over; a quarantined one is read again. Sources are never changed.
With --again, complete runs are read anew from their exports, after a robot or layout file was corrected. They keep
their numbers; conclusions follow. If the export is not understood any more, the run is quarantined.
Exit status 1 if an export was quarantined, or gave no result: every cycle was refused.")]
pub(super) struct IngestArgs {
    /// Exports, or folders of exports
    #[arg(required_unless_present = "again", value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Read these runs anew, instead
    #[arg(long, value_name = "RUN_ID", num_args = 1.., conflicts_with = "paths")]
    again: Vec<i64>,
    /// Take cycles in spite of this finding, as doubtful ones; may be given again
    ///
    /// Adds to [analysis] accept of the configuration. A refusal says its name; docs/method.md lists them.
    #[arg(long, value_name = "FINDING", value_parser = finding_kind())]
    accept: Vec<FindingKind>,
}

/// Reads the name of a finding; clap proposes the nearest one.
fn finding_kind() -> impl TypedValueParser<Value = FindingKind> {
    PossibleValuesParser::new(FindingKind::ALL.map(FindingKind::name))
        .try_map(|name| FindingKind::from_name(&name).ok_or("no finding of this name"))
}

pub(super) fn ingest(global: &Global, args: &IngestArgs) -> Result<u8, CliError> {
    let mut config = global.read_config()?;
    config.analysis.accept = config.analysis.accept.union(args.accept.iter().copied().collect());
    let exports = find_exports(&args.paths)?;
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let pipeline = Pipeline::new(shared(config), store);
        let done = match args.again.is_empty() {
            true => take_all(&pipeline, &exports, &stop, global.json).await,
            false => take_again(&pipeline, &args.again, &stop, global.json).await,
        };
        pipeline.close().await?;
        done
    })
}

/// Reads complete runs anew, all or, where one of them cannot be, none.
async fn take_again(
    pipeline: &Pipeline,
    runs: &[i64],
    stop: &CancellationToken,
    as_json: bool,
) -> Result<u8, CliError> {
    let mut exports = Vec::new();
    for &run_id in runs {
        let (run, source) =
            (pipeline.store().known_run(run_id).await?, pipeline.store().run_source(run_id).await?);
        let (Some(run), Some(source)) = (run, source) else {
            return Err(CliError::Usage(format!(
                "there is no run {run_id}; `SELECT run_id, robot, started_at, status FROM runs` lists the runs"
            )));
        };
        let export = replay::export_of(&source, pipeline.config(), None).await;
        match (run.status, export.map_err(|error| CliError::Internal(error.to_string()))?) {
            (RunStatus::Complete | RunStatus::Quarantined, Ok(export)) => exports.push(export),
            (RunStatus::Complete | RunStatus::Quarantined, Err(missing)) => {
                return Err(CliError::Usage(format!("{missing}; put it back there, and run again")));
            }
            (status @ (RunStatus::Superseded | RunStatus::Streaming), _) => {
                return Err(CliError::Usage(format!(
                    "run {run_id} is {}: only complete and quarantined runs are read again",
                    status.name()
                )));
            }
        }
    }
    take(pipeline, &exports, Retry::Complete, stop, as_json).await
}

pub(super) async fn take_all(
    pipeline: &Pipeline,
    exports: &[PathBuf],
    stop: &CancellationToken,
    as_json: bool,
) -> Result<u8, CliError> {
    take(pipeline, exports, Retry::Quarantined, stop, as_json).await
}

async fn take(
    pipeline: &Pipeline,
    exports: &[PathBuf],
    retry: Retry,
    stop: &CancellationToken,
    as_json: bool,
) -> Result<u8, CliError> {
    if !reweight::reweight(pipeline, stop).await? {
        return Ok(EXIT_STOPPED);
    }
    let mut tally = Tally::default();
    let mut ended: HashMap<String, usize> = HashMap::new();
    for path in exports {
        let bar = progress_bar(path);
        let moving = bar.clone();
        let outcome = pipeline
            .process(path, retry, stop, move |progress| match progress {
                Progress::Begun | Progress::CaughtUp | Progress::Reading | Progress::Grown(_) => {}
                Progress::Read(bytes) => moving.set_position(bytes),
                Progress::Cycle(cycle) => moving.set_message(format!("cycle {cycle}")),
            })
            .await;
        bar.finish_and_clear();
        let outcome = outcome?;
        let empty = without_result(pipeline, &outcome).await?;
        print(path, &outcome, empty.as_ref(), as_json);
        tally.add(&outcome, empty.is_some());
        if let Outcome::Stored(run) = &outcome {
            let runs = ended.entry(run.robot.clone()).or_default();
            *runs += 1;
            if runs.is_multiple_of(RUNS_AT_ONCE) {
                conclude(pipeline, &run.robot, as_json).await?;
            }
        }
        if matches!(outcome, Outcome::Interrupted) {
            return Ok(EXIT_STOPPED);
        }
        if stop.is_cancelled() {
            return Ok(EXIT_STOPPED);
        }
    }
    let mut is_faulty = false;
    // conclusions of one robot may be news for others of its model, and these for no one
    for _ in 0..2 {
        for robot in pipeline.store().stale_robots().await? {
            is_faulty |= !conclude(pipeline, &robot.name, as_json).await?;
        }
    }
    if !as_json {
        output::line(&tally.as_text());
    }
    // other robots are concluded all the same
    Ok(if is_faulty { EXIT_INTERNAL } else { tally.exit_code() })
}

/// Draws and prints what a robot's history says; `false`, with the reason in the log, if that cannot be.
async fn conclude(pipeline: &Pipeline, robot: &str, as_json: bool) -> Result<bool, CliError> {
    match pipeline.conclude_isolated(robot).await? {
        Conclusion::Drawn(concluded) => print_conclusions(&concluded, as_json),
        Conclusion::UpToDate => {}
        Conclusion::Faulty(reason) => {
            output::print_hint(&format!("{robot}: nothing new is concluded: {reason}"));
            return Ok(false);
        }
    }
    Ok(true)
}

/// What became of all exports.
#[derive(Debug, Default)]
struct Tally {
    stored: usize,
    known: usize,
    quarantined: usize,
    without_result: usize,
    /// To be tried again.
    not_read: usize,
}

impl Tally {
    fn add(&mut self, outcome: &Outcome, without_result: bool) {
        let counted = match outcome {
            Outcome::Stored(_) => &mut self.stored,
            Outcome::AlreadyStored { .. } => &mut self.known,
            Outcome::Quarantined { .. } => &mut self.quarantined,
            Outcome::Unreadable { .. } | Outcome::Changed | Outcome::InWork { .. } | Outcome::Interrupted => {
                &mut self.not_read
            }
        };
        *counted += 1;
        self.without_result += usize::from(without_result);
    }

    fn as_text(&self) -> String {
        let Self { stored, known, quarantined, without_result, not_read } = self;
        let mut text = format!(
            "{stored} stored, {known} known, {quarantined} quarantined, {without_result} without result"
        );
        if *not_read > 0 {
            text.push_str(&format!(", {not_read} not read"));
        }
        text
    }

    fn exit_code(&self) -> u8 {
        match self.quarantined + self.without_result + self.not_read {
            0 => EXIT_DONE,
            _ => EXIT_FOUND,
        }
    }
}

/// What there is to say of a complete run that says nothing of the arm, stored now or before.
async fn without_result(pipeline: &Pipeline, outcome: &Outcome) -> Result<Option<RunResult>, CliError> {
    let run_id = match outcome {
        Outcome::Stored(run) => run.run_id,
        Outcome::AlreadyStored { run_id } => *run_id,
        _ => return Ok(None),
    };
    let result = pipeline.store().run_result(run_id).await?;
    Ok(result.filter(|result| result.without_result))
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
            output::print_hint(&format!(
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

fn print(path: &Path, outcome: &Outcome, empty: Option<&RunResult>, as_json: bool) {
    if as_json {
        let mut value = as_value(path, outcome);
        if matches!(outcome, Outcome::Stored(_) | Outcome::AlreadyStored { .. }) {
            value["without_result"] = empty.is_some().into();
        }
        output::json(&value);
        return;
    }
    output::line(&as_text(path, outcome));
    if let Some(result) = empty {
        output::line(&format!("             {}", no_result(result, matches!(outcome, Outcome::Stored(_)))));
    }
}

/// Why an export gave no result; the reason itself stands above where the export was read just now.
fn no_result(result: &RunResult, is_read_now: bool) -> String {
    let reason = result.reason.as_deref().filter(|_| !is_read_now);
    match (result.refused, reason) {
        (0, _) => "no result: it holds no cycle that could be measured".into(),
        (refused, reason) => format!(
            "no result: {refused} of {} were refused{}",
            counted(result.cycles),
            reason.map_or_else(String::new, |reason| format!(": {reason}"))
        ),
    }
}

/// What a robot's history says with the new runs: nothing is printed where it says nothing new.
fn print_conclusions(concluded: &Concluded, as_json: bool) {
    for event in &concluded.events {
        let what = event.what.name();
        if as_json {
            // only what calls for a look counts as an anomaly
            let outcome = if event.what.calls() { "anomaly" } else { "anomaly_event" };
            output::json(&json!({
                "outcome": outcome, "event": what, "robot": concluded.robot,
                "joint": event.joint.map(JointIndex::number), "anomaly_id": event.anomaly_id, "kind": event.kind,
                "severity": event.severity.name(), "message": event.message,
            }));
        } else {
            let (said, more) = match event.what {
                EventKind::Opened => (event.severity.name(), String::new()),
                _ if event.what.calls() => (event.severity.name(), format!(" ({what})")),
                _ => (what, String::new()),
            };
            output::line(&format!("{said:<12} {} {}{more}: {}", concluded.robot, event.kind, event.message));
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
