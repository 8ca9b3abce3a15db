//! `armwatch ingest`: files and folders through the pipeline once.

mod progress;
mod tally;
mod export_texts;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use tokio_util::sync::CancellationToken;

use self::export_texts::{print, print_conclusions};
use self::progress::ProgressLine;
use self::tally::Tally;
use super::context::{
    CliError, EXIT_INTERNAL, EXIT_STOPPED, Global, open_store_until, require_database, runtime, shared,
};
use super::shared::{output, paths, reweight};
use crate::daemon;
use crate::pipeline::conclude::history::RUNS_AT_ONCE;
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Retry};
use crate::pipeline::look::replay;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_ingest::find::join::join_paths;
use armwatch_ingest::find::watch::{self, Complaints};
use armwatch_model::analysis::finding::FindingKind;
use armwatch_model::run::RunStatus;
use armwatch_model::text;
use armwatch_store::{EventKind, RunResult, SessionKind, StoreError};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz
  armwatch ingest exports/ --db fleet.db
  armwatch ingest exports/ --json | jq .reason
  armwatch ingest R00_20260105_0847_Col23_20s_cycle5.csv.gz \\
      --accept late_torque
  armwatch ingest --again 12 13

The command searches folders and their subfolders for *.csv, *.csv.gz, *.csv.zst, *.parquet, *.mcap and *.dat with
*.r64 next to it. It names and skips files whose content is already stored. It reads quarantined files again. It
never changes sources.

The last line has the number of exports per outcome; with --json it is an object whose outcome is summary. Ctrl-C
prints it too, with interrupted set to true; the same command then continues. If another program is reading an
export, the command skips the export and checks it again at the end.

--again reads complete runs from their exports again, for example after a robot or layout file was corrected. The
runs keep their numbers, and conclusions follow. A run is quarantined if its export can no longer be read.

Exit status 1 if an export was quarantined, or if every cycle of an export was refused.")]
pub(super) struct IngestArgs {
    /// Exports, or folders of exports
    #[arg(required_unless_present = "again", value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Read these runs again, instead of files
    #[arg(long, value_name = "RUN_ID", num_args = 1.., allow_negative_numbers = true, value_parser = clap::value_parser!(i64).range(1..), conflicts_with = "paths")]
    again: Vec<i64>,
    /// Accept cycles in spite of this finding and add a remark; may be repeated. Adds to [analysis] accept of the
    /// configuration. Every refusal names its finding; docs/method.md explains the findings
    #[arg(long, value_name = "FINDING", value_parser = finding_kind())]
    accept: Vec<FindingKind>,
}

/// Most attempts at an export that another program is reading.
const LOOKS: usize = 3;

/// Reads the name of a finding; clap proposes the nearest one.
fn finding_kind() -> impl TypedValueParser<Value = FindingKind> {
    PossibleValuesParser::new(FindingKind::ALL.map(FindingKind::name))
        .try_map(|name| FindingKind::from_name(&name).ok_or("no finding of this name"))
}

pub(super) fn ingest(global: &Global, args: &IngestArgs) -> Result<u8, CliError> {
    let mut config = global.read_config()?;
    config.analysis.accept = config.analysis.accept.union(args.accept.iter().copied().collect());
    let exports = find_exports(&args.paths, config.watch.follow_links)?;
    let exports = join_paths(exports, |name| config.part_of(name));
    if !args.again.is_empty() {
        require_database(&config)?;
    }
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let Some(store) = open_store_until(&stop, &config).await? else {
            let count = exports.len() + args.again.len();
            return Ok(end_early(&Tally::default(), Duration::ZERO, count, global.json));
        };
        let session = store.join(SessionKind::Command).await?;
        let access = match config.watch.follow_links {
            true => FileAccess::default(),
            false => FileAccess::within(args.paths.iter().filter_map(|path| std::path::absolute(path).ok())),
        };
        let pipeline = Pipeline::new(shared(config), store).opening(&access);
        let done = match args.again.is_empty() {
            true => take_all(&pipeline, &exports, &stop, global.json).await,
            false => take_again(&pipeline, &args.again, &stop, global.json).await,
        };
        session.leave().await;
        pipeline.close().await?;
        done
    })
}

/// Reads complete runs again: all, or none if one of them cannot be read.
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
                return Err(CliError::Usage(format!("{missing}; put it back, and run again")));
            }
            (status @ (RunStatus::Superseded | RunStatus::SetAside | RunStatus::Streaming), _) => {
                return Err(CliError::Usage(format!(
                    "run {run_id} is {}: only complete and quarantined runs are read again",
                    status.name().replace('_', " ")
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

/// Processes exports one after the other, and prints the outcome of each and a total.
async fn take(
    pipeline: &Pipeline,
    exports: &[PathBuf],
    retry: Retry,
    stop: &CancellationToken,
    as_json: bool,
) -> Result<u8, CliError> {
    let is_ready = reweight::reweight(pipeline, stop).await?;
    let mut turn = IngestBatch {
        pipeline,
        retry,
        stop,
        as_json,
        bar: ProgressLine::new(exports),
        tally: Tally::default(),
        ended: HashMap::new(),
    };
    if !is_ready || !turn.take_each(exports).await? {
        let took = turn.bar.clear();
        return Ok(end_early(&turn.tally, took, exports.len(), as_json));
    }
    let is_faulty = !turn.conclude_all().await?;
    let took = turn.bar.clear();
    print_tally(&turn.tally, took, false, as_json);
    // conclusions of other robots are drawn nevertheless
    Ok(if is_faulty { EXIT_INTERNAL } else { turn.tally.exit_code() })
}

fn print_tally(tally: &Tally, took: Duration, is_interrupted: bool, as_json: bool) {
    if as_json {
        output::json(&tally.as_value(took, is_interrupted));
    } else {
        output::line(&tally.as_text(took));
    }
}

/// Reports the work done before a stop, and how to do the rest.
fn end_early(tally: &Tally, took: Duration, exports: usize, as_json: bool) -> u8 {
    print_tally(tally, took, true, as_json);
    output::print_hint(&format!(
        "stopped after {} of {}; stored results stay: run the same command again to continue",
        tally.decided(),
        output::counted(exports, "export")
    ));
    EXIT_STOPPED
}

/// Exports in progress: their shared state, and their outcomes so far.
struct IngestBatch<'a> {
    pipeline: &'a Pipeline,
    retry: Retry,
    stop: &'a CancellationToken,
    as_json: bool,
    bar: ProgressLine,
    tally: Tally,
    /// Stored exports by robot; conclusions are drawn once there are several.
    ended: HashMap<String, usize>,
}

impl IngestBatch<'_> {
    /// Processes one export after the other and, at the end, tries again those that another program was reading at the
    /// same time. Returns `false` if a stop was requested.
    async fn take_each(&mut self, exports: &[PathBuf]) -> Result<bool, CliError> {
        let mut exports_ahead = self.pipeline.read_all_ahead(exports, self.retry, self.stop);
        let mut elsewhere = Vec::new();
        for path in exports {
            let ahead = exports_ahead.next().await?;
            self.bar.begin(path);
            let moving = self.bar.clone();
            let progress = move |progress| moving.note(progress);
            let taken = self.pipeline.process_ahead(path, ahead, self.retry, self.stop, progress).await;
            if is_taken_elsewhere(&taken) {
                self.bar.end(&Outcome::InWork { run_id: None });
                self.bar.pause(|| output::print_hint(&export_texts::elsewhere(path)));
                elsewhere.push(path);
            } else {
                self.close(path, &taken?).await?;
            }
            if self.stop.is_cancelled() {
                return Ok(false);
            }
        }
        for path in elsewhere {
            let outcome = self.look_again(path).await?;
            self.close(path, &outcome).await?;
            if self.stop.is_cancelled() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Processes an export that another program was reading. If that program ends its run in the meantime, the next
    /// attempt finds it.
    async fn look_again(&self, path: &Path) -> Result<Outcome, CliError> {
        let mut taken = self.look(path).await;
        for _ in 1..LOOKS {
            if taken.is_ok() || !is_taken_elsewhere(&taken) {
                break;
            }
            taken = self.look(path).await;
        }
        match taken {
            Err(PipelineError::Store(StoreError::RunNotOpen { run_id, .. })) => {
                Ok(Outcome::InWork { run_id: Some(run_id) })
            }
            taken => Ok(taken?),
        }
    }

    async fn look(&self, path: &Path) -> Result<Outcome, PipelineError> {
        self.pipeline.process(path, self.retry, self.stop, |_| ()).await
    }

    /// Prints and counts the outcome of an export; draws conclusions if several of its robot are stored.
    async fn close(&mut self, path: &Path, outcome: &Outcome) -> Result<(), CliError> {
        let known_robot = known_robot(self.pipeline, outcome).await?;
        let empty = without_result(self.pipeline, outcome).await?;
        self.bar.end(outcome);
        let as_json = self.as_json;
        self.bar.pause(|| print(path, outcome, known_robot.as_deref(), empty.as_ref(), as_json));
        self.tally.add(outcome, empty.is_some());
        if let Outcome::Stored(run) = outcome {
            let runs = self.ended.entry(run.robot.clone()).or_default();
            *runs += 1;
            if runs.is_multiple_of(RUNS_AT_ONCE) {
                self.conclude(&run.robot).await?;
            }
        }
        Ok(())
    }

    /// Draws conclusions for all robots with new runs; returns `false` if they fail for one of them.
    async fn conclude_all(&mut self) -> Result<bool, CliError> {
        let mut are_drawn = true;
        // conclusions of one robot may change those of others of its model, but the latter change no others
        for _ in 0..2 {
            for robot in self.pipeline.store().stale_robots().await? {
                are_drawn &= self.conclude(&robot.name).await?;
            }
        }
        Ok(are_drawn)
    }

    /// Draws and prints conclusions from a robot's history; returns `false`, with the reason in the log, if they fail.
    async fn conclude(&mut self, robot: &str) -> Result<bool, CliError> {
        let (bar, as_json) = (&self.bar, self.as_json);
        match self.pipeline.conclude_isolated(robot).await? {
            Conclusion::Drawn(concluded) => {
                let opened = concluded.events.iter().filter(|event| event.what == EventKind::Opened);
                opened.for_each(|event| self.tally.opened[event.severity as usize] += 1);
                bar.pause(|| print_conclusions(&concluded, as_json));
            }
            Conclusion::UpToDate => {}
            Conclusion::Elsewhere => {
                bar.pause(|| output::print_hint(&format!("{robot}: a daemon is evaluating its history")));
            }
            Conclusion::Faulty(reason) => {
                bar.pause(|| output::print_hint(&format!("{robot}: no new conclusion: {reason}")));
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// Returns true if another program reads the same export at the same time. In a database file, both write to one run
/// until one of them has ended it; if both start it at once, the second one is refused.
fn is_taken_elsewhere(taken: &Result<Outcome, PipelineError>) -> bool {
    matches!(
        taken,
        Ok(Outcome::InWork { .. })
            | Err(PipelineError::Store(StoreError::RunNotOpen { .. } | StoreError::Refused { .. }))
    )
}

/// The robot of a run that was stored before.
async fn known_robot(pipeline: &Pipeline, outcome: &Outcome) -> Result<Option<String>, CliError> {
    let Outcome::AlreadyStored { run_id } = outcome else { return Ok(None) };
    Ok(pipeline.store().run_source(*run_id).await?.map(|source| source.robot))
}

/// The note about a complete run without results about the arm, stored now or before.
async fn without_result(pipeline: &Pipeline, outcome: &Outcome) -> Result<Option<RunResult>, CliError> {
    let run_id = match outcome {
        Outcome::Stored(run) => run.run_id,
        Outcome::AlreadyStored { run_id } => *run_id,
        _ => return Ok(None),
    };
    let result = pipeline.store().run_result(run_id).await?;
    Ok(result.filter(|result| result.without_result))
}

/// Files as named, folders by their exports in the order of their names.
fn find_exports(paths: &[PathBuf], follow_links: bool) -> Result<Vec<PathBuf>, CliError> {
    let mut exports = Vec::new();
    for path in paths {
        let metadata = paths::metadata(path)?;
        if !metadata.is_dir() {
            exports.push(path.clone());
            continue;
        }
        let scan = watch::scan(std::slice::from_ref(path), follow_links);
        Complaints::default().warn(&scan);
        if scan.files.is_empty() {
            output::print_hint(&format!(
                "{}: no exports in this folder (*.csv, *.csv.gz, *.csv.zst, *.parquet, *.mcap, *.dat with *.r64)",
                text::of_path(path)
            ));
        }
        exports.extend(scan.files.into_iter().map(|file| file.path));
    }
    Ok(exports)
}
