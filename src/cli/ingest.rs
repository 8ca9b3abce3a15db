//! `armwatch ingest`: files and folders through the pipeline once.

use std::collections::HashMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::context::{
    CliError, EXIT_DONE, EXIT_FOUND, EXIT_INTERNAL, EXIT_STOPPED, Global, open_store, runtime, shared,
};
use super::shared::{output, paths, reweight};
use crate::analysis::finding::FindingKind;
use crate::anomaly::Severity;
use crate::daemon;
use crate::ingest::find::watch;
use crate::pipeline::conclude::history::{Concluded, RUNS_AT_ONCE};
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, Progress, Retry};
use crate::pipeline::look::replay;
use crate::robot::JointIndex;
use crate::run::RunStatus;
use crate::store::{EventKind, RunResult};

/// Cycles of an export that are read and not stored yet: one is read, two are analysed, one waits.
const IN_FLIGHT: u32 = 4;

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
    let bar = ProgressLine::new(exports);
    for path in exports {
        bar.begin(path);
        let moving = bar.clone();
        let outcome = pipeline.process(path, retry, stop, move |progress| moving.note(progress)).await?;
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
        Conclusion::Faulty(reason) => {
            bar.pause(|| output::print_hint(&format!("{robot}: nothing new is concluded: {reason}")));
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
    /// Cycles of the stored exports, and those of them without parameters.
    cycles: usize,
    refused: usize,
    /// Anomalies that opened, by severity.
    opened: [usize; 3],
}

/// From the worst.
const SEVERITIES: [Severity; 3] = [Severity::Critical, Severity::Warning, Severity::Info];

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
        if let Outcome::Stored(run) = outcome {
            self.cycles += run.cycles as usize;
            self.refused += run.refused.len();
        }
    }

    fn as_text(&self, took: Duration) -> String {
        let Self { stored, known, quarantined, without_result, not_read, cycles, refused, opened } = self;
        let mut text = format!(
            "{stored} stored, {known} known, {quarantined} quarantined, {without_result} without result"
        );
        if *not_read > 0 {
            text.push_str(&format!(", {not_read} not read"));
        }
        if *stored > 0 {
            text.push_str(&format!(
                "; {cycles} cycle{}, {refused} refused",
                if *cycles == 1 { "" } else { "s" }
            ));
        }
        let alarms: Vec<String> = SEVERITIES
            .into_iter()
            .filter(|severity| opened[*severity as usize] > 0)
            .map(|severity| format!("{} {}", opened[severity as usize], output::coloured(severity.name())))
            .collect();
        if !alarms.is_empty() {
            text.push_str(&format!("; opened: {}", alarms.join(", ")));
        }
        text + &format!("; {}", lasting(took))
    }

    fn as_value(&self, took: Duration) -> serde_json::Value {
        let opened: serde_json::Map<_, _> = SEVERITIES
            .into_iter()
            .map(|severity| (severity.name().to_owned(), self.opened[severity as usize].into()))
            .collect();
        json!({
            "outcome": "summary", "stored": self.stored, "known": self.known, "quarantined": self.quarantined,
            "without_result": self.without_result, "not_read": self.not_read, "cycles": self.cycles,
            "refused_cycles": self.refused, "anomalies_opened": opened, "took_s": took.as_secs_f64(),
        })
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

/// How much of all exports is done, in bytes: what is known before an export is read.
#[derive(Debug, Default, Clone, PartialEq)]
struct Work {
    /// Of exports that are stored or quarantined, and of those to come.
    done: u64,
    ahead: u64,
    /// Of one cycle of the last export that was stored.
    of_cycle: Option<f64>,
    /// The export in hand: its bytes, those read, and its stored cycles.
    size: u64,
    read: u64,
    cycles: u32,
    /// Its number, from 1, and its file name.
    at: usize,
    name: String,
}

impl Work {
    fn begin(&mut self, size: u64) {
        self.ahead = self.ahead.saturating_sub(size);
        (self.size, self.read, self.cycles) = (size, 0, 0);
    }

    /// Bytes of the cycles of this export that are stored. Reading is ahead of them by the cycles in flight.
    fn of_this(&self) -> f64 {
        let cycles = f64::from(self.cycles);
        let estimate = match self.of_cycle {
            Some(bytes) => bytes * cycles,
            None => self.read as f64 * cycles / (cycles + f64::from(IN_FLIGHT)),
        };
        estimate.min(self.size as f64)
    }

    fn end(&mut self, outcome: &Outcome) {
        match outcome {
            Outcome::Stored(run) => {
                self.of_cycle = (run.cycles > 0).then(|| self.size as f64 / f64::from(run.cycles));
                self.done += self.size;
            }
            Outcome::Quarantined { known: false, .. } => self.done += self.size,
            // took no time, which says nothing of the others
            _ => {}
        }
        (self.size, self.read, self.cycles) = (0, 0, 0);
    }

    fn fraction(&self) -> f64 {
        let total = (self.done + self.size + self.ahead) as f64;
        if total > 0.0 { (self.done as f64 + self.of_this()) / total } else { 0.0 }
    }

    /// Time that is left after `elapsed`, once there is something to go by.
    fn left(&self, elapsed: Duration) -> Option<Duration> {
        let fraction = self.fraction();
        (fraction > 0.0).then(|| elapsed.mul_f64((1.0 - fraction) / fraction))
    }
}

/// One line over all exports, hidden where there is no terminal; cleared when it is dropped.
#[derive(Debug, Clone)]
struct ProgressLine {
    bar: ProgressBar,
    work: Arc<Mutex<Work>>,
    begun: Instant,
    files: usize,
}

/// Steps of the bar.
const STEPS: u64 = 1000;

impl ProgressLine {
    fn new(exports: &[PathBuf]) -> Self {
        let bar =
            if std::io::stderr().is_terminal() { ProgressBar::new(STEPS) } else { ProgressBar::hidden() };
        // the message is cut where the terminal ends
        if let Ok(style) = ProgressStyle::with_template("{prefix} [{bar:20}] {percent:>3} % {wide_msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        let work = Work { ahead: exports.iter().map(|path| bytes_of(path)).sum(), ..Work::default() };
        Self {
            bar: bar.with_finish(ProgressFinish::AndClear),
            work: Arc::new(Mutex::new(work)),
            begun: Instant::now(),
            files: exports.len(),
        }
    }

    fn work(&self) -> MutexGuard<'_, Work> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin(&self, path: &Path) {
        let mut work = self.work();
        work.begin(bytes_of(path));
        work.at += 1;
        work.name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        self.bar.set_prefix(format!("file {}/{}", work.at, self.files));
        self.show(&work);
    }

    fn note(&self, progress: Progress) {
        let mut work = self.work();
        match progress {
            Progress::Begun | Progress::CaughtUp | Progress::Reading | Progress::Grown(_) => return,
            Progress::Read(bytes) => work.read = bytes,
            Progress::Cycle(cycle) => work.cycles = cycle,
        }
        self.show(&work);
    }

    fn end(&self, outcome: &Outcome) {
        self.work().end(outcome);
    }

    fn show(&self, work: &Work) {
        let left = work.left(self.begun.elapsed()).map(|left| format!(", {} left", lasting(left)));
        self.bar.set_position((work.fraction() * STEPS as f64) as u64);
        self.bar.set_message(format!("cycle {}{}, {}", work.cycles, left.unwrap_or_default(), work.name));
    }

    /// Prints something while the line is away.
    fn pause(&self, print: impl FnOnce()) {
        self.bar.suspend(print);
    }

    /// Takes the line away; how long all took.
    fn clear(&self) -> Duration {
        self.bar.finish_and_clear();
        self.begun.elapsed()
    }
}

fn bytes_of(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |metadata| metadata.len())
}

/// `34 s`, `2 min 5 s`, `1 h 12 min`.
fn lasting(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..60 => format!("{seconds} s"),
        seconds @ 60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        seconds => format!("{} h {} min", seconds / 3600, seconds % 3600 / 60),
    }
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
    let text = as_text(path, outcome);
    let (said, rest) = text.split_once(' ').unwrap_or((&text, ""));
    output::line(&format!("{} {rest}", output::coloured(said)));
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
            let said = output::padded(&output::coloured(said), 12);
            output::line(&format!("{said} {} {}{more}: {}", concluded.robot, event.kind, event.message));
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
            for (cycles, reason) in run.refusals() {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::context::StoredRun;

    fn stored(cycles: u32) -> Outcome {
        Outcome::Stored(StoredRun { run_id: 1, robot: "R".into(), cycles, refused: Vec::new(), rows: 1 })
    }

    #[test]
    fn work_is_counted_in_cycles_that_are_stored_and_not_in_bytes_that_are_read() {
        let mut work = Work { ahead: 2000, ..Work::default() };
        work.begin(1000);
        work.read = 1000;
        assert_eq!((work.fraction(), work.left(Duration::from_secs(5))), (0.0, None), "nothing is stored");
        work.cycles = 4;
        // four cycles are stored and four in flight: half of what is read
        assert_eq!(work.fraction(), 0.25);
        assert_eq!(work.left(Duration::from_secs(5)), Some(Duration::from_secs(15)));
        work.end(&stored(8));
        assert_eq!(work.fraction(), 0.5);
        work.begin(1000);
        (work.read, work.cycles) = (1000, 6);
        assert_eq!(work.fraction(), 0.875, "a cycle has 125 bytes, as in the export before");
        work.end(&stored(8));
        assert_eq!(work.left(Duration::from_secs(5)), Some(Duration::ZERO));
    }

    #[test]
    fn an_export_that_is_known_says_nothing_of_the_time_that_others_take() {
        let mut work = Work { ahead: 2000, ..Work::default() };
        work.begin(1000);
        work.end(&Outcome::AlreadyStored { run_id: 1 });
        work.begin(1000);
        assert_eq!((work.fraction(), work.left(Duration::from_secs(1))), (0.0, None));
    }

    #[test]
    fn the_closing_line_counts_alarms_and_cycles() {
        let mut tally = Tally::default();
        tally.add(&stored(3), false);
        tally.add(&Outcome::AlreadyStored { run_id: 2 }, false);
        let second = Duration::from_millis(1900);
        let line = "1 stored, 1 known, 0 quarantined, 0 without result; 3 cycles, 0 refused; 1 s";
        assert_eq!(tally.as_text(second), line);
        tally.opened[Severity::Critical as usize] = 2;
        assert!(tally.as_text(Duration::from_secs(3750)).ends_with("; opened: 2 critical; 1 h 2 min"));
        let value = tally.as_value(second);
        assert_eq!(
            (&value["outcome"], &value["anomalies_opened"]["critical"]),
            (&"summary".into(), &2.into())
        );
    }
}
