//! `armwatch ingest`: files and folders through the pipeline once.

mod progress;
mod tally;
mod words;

use std::collections::HashMap;
use std::path::PathBuf;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use tokio_util::sync::CancellationToken;

use self::progress::ProgressLine;
use self::tally::Tally;
use self::words::{print, print_conclusions};
use super::context::{
    CliError, EXIT_INTERNAL, EXIT_STOPPED, Global, open_store_until, require_database, runtime, shared,
};
use super::shared::{output, paths, reweight};
use crate::analysis::finding::FindingKind;
use crate::daemon;
use crate::ingest::find::watch;
use crate::pipeline::conclude::history::RUNS_AT_ONCE;
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, Retry};
use crate::pipeline::look::replay;
use crate::run::RunStatus;
use crate::store::{EventKind, RunResult, SessionKind};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz
  armwatch ingest exports/ --db fleet.db
  armwatch ingest exports/ --json | jq .reason
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz \\
      --accept late_torque
  armwatch ingest --again 12 13

Folders are searched with their subfolders for *.csv, *.csv.gz and *.csv.zst. A file whose content is
stored already is named and passed over; a quarantined one is read again. Sources are never changed.

The last line counts what became of the exports; with --json it is an object whose outcome is summary.

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
    /// Take cycles in spite of this finding, as doubtful ones; may be given several times. Adds to [analysis] accept of
    /// the configuration; a refusal says the name of its finding, docs/method.md explains them
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
    if !args.again.is_empty() {
        require_database(&config)?;
    }
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let Some(store) = open_store_until(&stop, &config).await? else { return Ok(EXIT_STOPPED) };
        let session = store.join(SessionKind::Command).await?;
        let pipeline = Pipeline::new(shared(config), store);
        let done = match args.again.is_empty() {
            true => take_all(&pipeline, &exports, &stop, global.json).await,
            false => take_again(&pipeline, &args.again, &stop, global.json).await,
        };
        session.leave().await;
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
    let bar = ProgressLine::new(exports);
    let mut exports_ahead = pipeline.read_all_ahead(exports, retry, stop);
    for path in exports {
        let ahead = exports_ahead.next().await?;
        bar.begin(path);
        let moving = bar.clone();
        let progress = move |progress| moving.note(progress);
        let outcome = pipeline.process_ahead(path, ahead, retry, stop, progress).await?;
        let empty = without_result(pipeline, &outcome).await?;
        bar.end(&outcome);
        bar.pause(|| print(path, &outcome, empty.as_ref(), as_json));
        tally.add(&outcome, empty.is_some());
        if let Outcome::Stored(run) = &outcome {
            let runs = ended.entry(run.robot.clone()).or_default();
            *runs += 1;
            if runs.is_multiple_of(RUNS_AT_ONCE) {
                conclude(pipeline, &run.robot, &bar, &mut tally, as_json).await?;
            }
        }
        if matches!(outcome, Outcome::Interrupted) || stop.is_cancelled() {
            return Ok(EXIT_STOPPED);
        }
    }
    let mut is_faulty = false;
    // conclusions of one robot may be news for others of its model, and these for no one
    for _ in 0..2 {
        for robot in pipeline.store().stale_robots().await? {
            is_faulty |= !conclude(pipeline, &robot.name, &bar, &mut tally, as_json).await?;
        }
    }
    let took = bar.clear();
    if as_json {
        output::json(&tally.as_value(took));
    } else {
        output::line(&tally.as_text(took));
    }
    // other robots are concluded all the same
    Ok(if is_faulty { EXIT_INTERNAL } else { tally.exit_code() })
}

/// Draws and prints what a robot's history says; `false`, with the reason in the log, if that cannot be.
async fn conclude(
    pipeline: &Pipeline,
    robot: &str,
    bar: &ProgressLine,
    tally: &mut Tally,
    as_json: bool,
) -> Result<bool, CliError> {
    match pipeline.conclude_isolated(robot).await? {
        Conclusion::Drawn(concluded) => {
            let opened = concluded.events.iter().filter(|event| event.what == EventKind::Opened);
            opened.for_each(|event| tally.opened[event.severity as usize] += 1);
            bar.pause(|| print_conclusions(&concluded, as_json));
        }
        Conclusion::UpToDate => {}
        Conclusion::Elsewhere => {
            bar.pause(|| output::print_hint(&format!("{robot}: a daemon judges its history now")));
        }
        Conclusion::Faulty(reason) => {
            bar.pause(|| output::print_hint(&format!("{robot}: nothing new is concluded: {reason}")));
            return Ok(false);
        }
    }
    Ok(true)
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
        let metadata = paths::metadata(path)?;
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
