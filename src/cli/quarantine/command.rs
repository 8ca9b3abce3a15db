//! `armwatch quarantine`: exports that were not understood.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, Subcommand};
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::story;
use crate::cli::context::{
    CliError, EXIT_DONE, EXIT_FOUND, EXIT_STOPPED, Global, open_to_change, open_to_read, runtime, shared,
};
use crate::cli::ingest;
use crate::cli::quarantine::story::ExportState;
use crate::cli::shared::output;
use crate::cli::shared::said::said;
use crate::cli::shared::user::user;
use crate::daemon;
use crate::pipeline::context::Pipeline;
use armwatch_config::Config;
use armwatch_ingest::bytes::fingerprint::{fingerprint, of_bytes};
use armwatch_model::run::RunStatus;
use armwatch_model::text;
use armwatch_store::{FaultState, QuarantineRow, Store};

/// Time between two looks at the daemon's outcome for an export.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// If a daemon has not started an export this long after its next scan, it is busy, or watches other folders.
const PATIENCE: Duration = Duration::from_secs(30);

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch quarantine list
  armwatch quarantine list --robot R07 --json | jq .problem
  armwatch quarantine explain 12
  armwatch quarantine explain R07_20260105_0847.csv
  armwatch quarantine retry 12
  armwatch quarantine retry --all
  armwatch quarantine dismiss notes.csv --reason \"no export\"

A quarantined export stays at its place. There are three remedies. If the export is faulty, export it again,
corrected: armwatch reads it and marks the faulty content as superseded. If the robot or layout file was wrong,
correct it and retry. If the file is no export, dismiss it.")]
pub(in crate::cli) struct QuarantineArgs {
    #[command(subcommand)]
    command: QuarantineCommand,
}

#[derive(Debug, Subcommand)]
enum QuarantineCommand {
    /// List quarantined exports, newest first
    #[command(after_help = "\
Examples:
  armwatch quarantine list
  armwatch quarantine list --robot R07 --all
  armwatch quarantine list --json")]
    List {
        /// Show only exports of this robot
        #[arg(long, value_name = "NAME")]
        robot: Option<String>,
        /// Include faults that are no longer open, each with its outcome
        #[arg(long)]
        all: bool,
    },
    /// Show the place in the file, the fault, the remedy, and the result of a retry
    #[command(after_help = "\
Examples:
  armwatch quarantine explain 12
  armwatch quarantine explain R07_20260105_0847.csv")]
    Explain {
        /// Number or file of the run
        #[arg(value_name = "RUN_ID|FILE")]
        which: String,
    },
    /// Read exports again, after a correction of the robot or layout file
    #[command(after_help = "\
Examples:
  armwatch quarantine retry 12
  armwatch quarantine retry R07_20260105_0847.csv
  armwatch quarantine retry --all --no-wait

The run keeps its number. The view `quarantine` has the result of each attempt. If a daemon works on the database,
the command asks the daemon to retry: it reads its configuration again and reads the export within its scan
interval. The command waits for the result. Exit status 1 if an export still cannot be read.")]
    Retry {
        /// Number or file of the run
        #[arg(value_name = "RUN_ID|FILE", required_unless_present = "all")]
        which: Option<String>,
        /// Retry every quarantined export
        #[arg(long, conflicts_with = "which")]
        all: bool,
        /// Do not wait for the result if a daemon is running
        #[arg(long)]
        no_wait: bool,
    },
    /// Dismiss an export that needs no action, such as a file that is no export
    #[command(after_help = "\
Examples:
  armwatch quarantine dismiss 12 --reason \"list of spare parts, no export\"
  armwatch quarantine dismiss notes.csv --reason \"no export\" --by mueller

A dismissed export is no longer in `quarantine list` or in the counts of the fleet. `list --all` shows it with
time, name and reason. `armwatch quarantine retry`, or another fault in the file, brings it back. The file stays
at its place.")]
    Dismiss {
        /// Number or file of the run
        #[arg(value_name = "RUN_ID|FILE")]
        which: String,
        /// Reason for the dismissal
        #[arg(long, value_name = "TEXT", value_parser = said)]
        reason: String,
        /// Name of the person [default: the user's name]
        #[arg(long, value_name = "NAME", value_parser = said)]
        by: Option<String>,
    },
}

pub(in crate::cli) fn quarantine(global: &Global, args: &QuarantineArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = match args.command {
            QuarantineCommand::List { .. } | QuarantineCommand::Explain { .. } => {
                open_to_read(&config).await?
            }
            QuarantineCommand::Retry { .. } | QuarantineCommand::Dismiss { .. } => {
                open_to_change(&config).await?
            }
        };
        let done = match &args.command {
            QuarantineCommand::List { robot, all } => list(global, &store, robot.as_deref(), *all).await,
            QuarantineCommand::Explain { which } => explain(global, &config, &store, which).await,
            QuarantineCommand::Retry { which, no_wait, .. } => {
                let retry = Retries { global, config: &config, store: &store, no_wait: *no_wait };
                retry.retry(which.as_deref()).await
            }
            QuarantineCommand::Dismiss { which, reason, by } => {
                dismiss(global, &store, which, by.clone().unwrap_or_else(user), reason).await
            }
        };
        store.close().await?;
        done
    })
}

async fn list(global: &Global, store: &Store, robot: Option<&str>, all: bool) -> Result<u8, CliError> {
    let mut faults = store.faults().await?;
    faults.retain(|fault| {
        robot.is_none_or(|name| fault.robot == name) && (all || fault.state == FaultState::Open)
    });
    if global.json {
        faults.iter().for_each(output::json);
    } else if faults.is_empty() {
        let of = robot.map(|name| format!(" of {name}")).unwrap_or_default();
        output::line(&format!("nothing{of} is quarantined"));
    } else {
        let row = |fault: &QuarantineRow| {
            let retry = if fault.retry_asked_at.is_some() { ", retry requested" } else { "" };
            vec![
                fault.run_id.to_string(),
                fault.robot.clone(),
                fault.source_name.clone(),
                story::minute(fault.first_at),
                format!("{}{retry}", fault.state.name()),
                story::one_line(fault),
            ]
        };
        let rows: Vec<_> = faults.iter().map(row).collect();
        output::print_table(&["run", "robot", "file", "since", "state", "problem"], &rows, &[]);
    }
    Ok(EXIT_DONE)
}

async fn explain(global: &Global, config: &Config, store: &Store, which: &str) -> Result<u8, CliError> {
    let faults = store.faults().await?;
    let run_id = find(&faults, which).ok_or_else(|| unknown(which))?;
    let faults: Vec<QuarantineRow> = faults.into_iter().filter(|fault| fault.run_id == run_id).collect();
    let place = place_of(store, run_id).await?;
    let story = story::FaultReport::new(&faults, &place, config.limits.export_bytes)
        .ok_or_else(|| CliError::Internal(format!("run {run_id} has no fault")))?;
    if global.json {
        output::json(&story.as_json());
    } else {
        output::block(&story.as_text());
    }
    Ok(EXIT_DONE)
}

async fn dismiss(
    global: &Global,
    store: &Store,
    which: &str,
    by: String,
    reason: &str,
) -> Result<u8, CliError> {
    let faults = store.faults().await?;
    let run_id = find(&faults, which).ok_or_else(|| unknown(which))?;
    if !store.dismiss(run_id, &by, reason).await? {
        let latest = faults.iter().find(|fault| fault.run_id == run_id);
        let outcome = latest.map(story::outcome).unwrap_or_default();
        return Err(CliError::Usage(format!("run {run_id} is not an open problem: {outcome}")));
    }
    if global.json {
        output::json(&json!({"run_id": run_id, "outcome": "dismissed", "by": by, "reason": reason}));
    } else {
        output::line(&format!(
            "dismissed    run {run_id} by {by}: {reason}; `armwatch quarantine retry {run_id}` brings it back"
        ));
    }
    Ok(EXIT_DONE)
}

/// Searches the known places of a run's content.
async fn place_of(store: &Store, run_id: i64) -> Result<ExportState, CliError> {
    let source = store.run_source(run_id).await?;
    let source = source.ok_or_else(|| CliError::Internal(format!("run {run_id} has no source")))?;
    let mut found = None;
    for path in &source.paths {
        // for an unreadable file, the hash of the path replaces that of the content
        let by_path = of_bytes(path.as_os_str().as_encoded_bytes()) == source.content_hash;
        let place = match fingerprint(path) {
            Ok((hash, _)) if by_path || hash == source.content_hash => {
                return Ok(ExportState::At(path.clone()));
            }
            Ok(_) => ExportState::Changed(path.clone()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => ExportState::Unreadable(path.clone(), error.to_string()),
        };
        found = found.or(Some(place));
    }
    let first = source.paths.into_iter().next().unwrap_or_default();
    Ok(found.unwrap_or(ExportState::Gone(first)))
}

/// The selected run: by number or, the newest first, by path or file name.
fn find(faults: &[QuarantineRow], which: &str) -> Option<i64> {
    if let Ok(number) = which.parse::<i64>() {
        return faults.iter().find(|fault| fault.run_id == number).map(|fault| fault.run_id);
    }
    let absolute = std::path::absolute(which).unwrap_or_default();
    let is_meant = |fault: &&QuarantineRow| {
        fault.source_path == which
            || fault.source_name == which
            || std::path::absolute(&fault.source_path).is_ok_and(|path| path == absolute)
    };
    let open = faults.iter().filter(|fault| fault.state == FaultState::Open).find(is_meant);
    open.or_else(|| faults.iter().find(is_meant)).map(|fault| fault.run_id)
}

fn unknown(which: &str) -> CliError {
    CliError::Usage(format!(
        "no export is or was quarantined as {which}; `armwatch quarantine list --all` shows them"
    ))
}

/// State shared by the retries of one call.
struct Retries<'a> {
    global: &'a Global,
    config: &'a Config,
    store: &'a Store,
    no_wait: bool,
}

impl Retries<'_> {
    async fn retry(&self, which: Option<&str>) -> Result<u8, CliError> {
        let chosen = self.chosen(which).await?;
        if chosen.is_empty() {
            if !self.global.json {
                output::line("nothing is quarantined");
            }
            return Ok(EXIT_DONE);
        }
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let under_daemon = self.store.has_daemon().await.unwrap_or(false);
        let (mut code, mut asked, mut own) = (EXIT_DONE, Vec::new(), Vec::new());
        for fault in chosen {
            self.store.withdraw_dismissal(fault.run_id).await?;
            match place_of(self.store, fault.run_id).await? {
                ExportState::At(path) | ExportState::Unreadable(path, _) => {
                    if under_daemon && is_below(&path, &self.config.watch.folders) {
                        asked.push((fault.run_id, path));
                    } else {
                        own.push(path);
                    }
                }
                place => {
                    self.say_impossible(&fault, &place);
                    code = EXIT_FOUND;
                }
            }
        }
        code = code.max(self.ask(&asked, &stop).await?);
        if own.is_empty() {
            return Ok(code);
        }
        let pipeline = Pipeline::new(shared(self.config.clone()), self.store.clone());
        Ok(code.max(ingest::take_all(&pipeline, &own, &stop, self.global.json).await?))
    }

    /// The quarantined runs to read again, oldest first, in the order of their robots' histories.
    async fn chosen(&self, which: Option<&str>) -> Result<Vec<QuarantineRow>, CliError> {
        let mut faults = self.store.faults().await?;
        let wanted = which.map(|which| find(&faults, which).ok_or_else(|| unknown(which))).transpose()?;
        let of_wanted = |fault: &QuarantineRow| wanted.is_none_or(|run_id| fault.run_id == run_id);
        if let Some(settled) = faults.iter().find(|fault| wanted.is_some() && of_wanted(fault))
            && !matches!(settled.state, FaultState::Open | FaultState::Dismissed)
        {
            return Err(CliError::Usage(format!(
                "run {} is no longer quarantined: {}",
                settled.run_id,
                story::outcome(settled)
            )));
        }
        // a dismissed fault is read again only if it is named
        let is_meant = |fault: &QuarantineRow| {
            fault.state == FaultState::Open || (wanted.is_some() && fault.state == FaultState::Dismissed)
        };
        faults.retain(|fault| is_meant(fault) && of_wanted(fault));
        faults.sort_by(|a, b| (&a.source_name, a.run_id).cmp(&(&b.source_name, b.run_id)));
        Ok(faults)
    }

    fn say_impossible(&self, fault: &QuarantineRow, place: &ExportState) {
        let why = story::what_retry_does(fault, place);
        if self.global.json {
            output::json(
                &json!({"file": fault.source_path, "run_id": fault.run_id, "outcome": "gone", "reason": why}),
            );
        } else {
            output::line(&format!("gone         {}: {why}", fault.source_path));
        }
    }

    /// Asks the running daemon and waits for the outcomes of the exports.
    async fn ask(&self, asked: &[(i64, PathBuf)], stop: &CancellationToken) -> Result<u8, CliError> {
        for (run_id, _) in asked {
            self.store.ask_retry(*run_id).await?;
        }
        let deadline = Instant::now() + 2 * self.config.watch.scan_interval + PATIENCE;
        let mut code = EXIT_DONE;
        for (run_id, path) in asked {
            if self.no_wait {
                self.say(path, *run_id, "asked", "the daemon reads it at its next scan");
                continue;
            }
            code = code.max(self.wait(*run_id, path, deadline, stop).await?);
        }
        Ok(code)
    }

    async fn wait(
        &self,
        run_id: i64,
        path: &Path,
        deadline: Instant,
        stop: &CancellationToken,
    ) -> Result<u8, CliError> {
        loop {
            let known = self.store.known_run(run_id).await?;
            match known {
                Some(run) if run.retry_asked && Instant::now() > deadline => {
                    let why = "the daemon has not retried it yet; the request stays, see `armwatch quarantine list`";
                    self.say(path, run_id, "waiting", why);
                    return Ok(EXIT_FOUND);
                }
                Some(run) if run.retry_asked || run.status == RunStatus::Streaming => {}
                Some(run) if run.status == RunStatus::Quarantined => {
                    self.say(path, run_id, "quarantined", &run.reason.unwrap_or_default());
                    return Ok(EXIT_FOUND);
                }
                Some(run) if run.status == RunStatus::Complete => {
                    let cycles = format!("run {run_id}, {}", output::counted(run.cycles_stored, "cycle"));
                    self.say(path, run_id, "stored", &cycles);
                    return Ok(EXIT_DONE);
                }
                // another export has its content, or has superseded it
                _ => {
                    self.say(path, run_id, "known", "another run has replaced it");
                    return Ok(EXIT_DONE);
                }
            }
            tokio::select! {
                () = stop.cancelled() => return Ok(EXIT_STOPPED),
                () = tokio::time::sleep(LOOK_INTERVAL) => {}
            }
        }
    }

    fn say(&self, path: &Path, run_id: i64, outcome: &str, text: &str) {
        let file = text::of_path(path);
        if self.global.json {
            output::json(&json!({"file": file, "run_id": run_id, "outcome": outcome, "reason": text}));
        } else {
            output::line(&format!("{outcome:<12} {file}: {text}"));
        }
    }
}

/// Returns true if a file is in one of the folders, by any of their names.
fn is_below(path: &Path, folders: &[PathBuf]) -> bool {
    let real = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let path = real(path);
    folders.iter().any(|folder| path.starts_with(real(folder)))
}
