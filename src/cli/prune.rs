//! `armwatch prune`: removes factors past their retention time.

use std::collections::BTreeMap;

use clap::Args;
use jiff::Timestamp;
use serde_json::json;
use tokio_util::sync::CancellationToken;

use super::context::{CliError, EXIT_DONE, Global, open_to_change, open_to_read, runtime};
use super::shared::output;
use crate::pipeline::retention::{kept_since, prune as take_away};
use armwatch_config::{Config, RetentionSettings, shown_database};
use armwatch_model::run::RunKind;
use armwatch_store::{DueRun, FreeSpace, Store};

/// Pages that one transaction releases: 8 MB.
const PAGES_AT_ONCE: u32 = 2000;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch prune --dry-run
  armwatch prune
  armwatch prune --older-than 30 --json

Results stay for ever: parameters, friction, checks of production, alarms. The command deletes factors of cycles,
which only `identify`, `verify` and a changed estimator need; [retention] in the configuration has the number of
days. It deletes the factors of tests. It joins the factors of production logs, so that `verify` still works on a
whole log. It never changes runs that are being read, robots with pending conclusions, a robot's last eight tests,
and the tests of its baselines.

The age of a run counts from its last cycle, or from the time it was stored if that was later. The daemon prunes
once a day and may run meanwhile. If the command is stopped at any moment, the database stays intact and the next
call continues. Free space returns to the file system if the database supports this: see docs/operations.md.")]
pub(super) struct PruneArgs {
    /// Show the factors to delete, but change nothing
    #[arg(long)]
    dry_run: bool,
    /// Days to keep factors of tests and production, instead of the configured ones
    #[arg(long, value_name = "DAYS", value_parser = days)]
    older_than: Option<f64>,
}

fn days(text: &str) -> Result<f64, String> {
    let wrong = || "give a number of days from 0 to 36500".to_owned();
    text.parse().ok().filter(|days| (0.0..=36_500.0).contains(days)).ok_or_else(wrong)
}

pub(super) fn prune(global: &Global, args: &PruneArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let settings = match args.older_than {
        Some(days) => RetentionSettings { tests_days: Some(days), production_days: Some(days) },
        None => config.retention,
    };
    runtime()?.block_on(async {
        let store = match args.dry_run {
            true => open_to_read(&config).await?,
            false => open_to_change(&config).await?,
        };
        let done = work(global, args, &config, &settings, &store).await;
        store.close().await?;
        done
    })
}

async fn work(
    global: &Global,
    args: &PruneArgs,
    config: &Config,
    settings: &RetentionSettings,
    store: &Store,
) -> Result<u8, CliError> {
    let kept = kept_since(settings, Timestamp::now());
    let before = store.free_space().await?;
    let runs = match args.dry_run {
        true => store.due_runs(&kept).await?,
        false => take_away(store, &kept, &CancellationToken::new()).await?,
    };
    let emptied = store.free_space().await?;
    if !args.dry_run {
        give_back(store, emptied).await?;
    }
    let after = store.free_space().await?;
    let sums = by_robot(&runs);
    if global.json {
        sums.iter().for_each(|sum| output::json(&sum.as_value(args.dry_run)));
        output::json(&json!({
            "dry_run": args.dry_run,
            "bytes": sums.iter().map(RemovedSum::freed).sum::<u64>(),
            "freed_bytes": emptied.bytes().saturating_sub(before.bytes()),
            "given_back_bytes": emptied.page_bytes * emptied.pages.saturating_sub(after.pages),
            "free_bytes": after.bytes(),
            "database_bytes": after.page_bytes * after.pages,
        }));
        return Ok(EXIT_DONE);
    }
    if sums.is_empty() {
        output::line(&format!(
            "no factors have expired: those of tests are kept {}, those of production {}",
            shown_days(settings.tests_days),
            shown_days(settings.production_days)
        ));
    } else {
        let rows: Vec<Vec<String>> = sums.iter().map(|sum| sum.as_row(args.dry_run)).collect();
        output::print_table(&["robot", "kind", "runs", "cycles", "frees", "factors"], &rows, &[]);
    }
    let database = shown_database(&config.database);
    if args.dry_run {
        output::line(&format!(
            "nothing was changed; {} of {database} would be free, including {} that are free now",
            megabytes(sums.iter().map(RemovedSum::freed).sum::<u64>() + before.bytes()),
            megabytes(before.bytes())
        ));
        return Ok(EXIT_DONE);
    }
    output::line(&format!(
        "{} returned to the file system, {} free inside {database}, which has {}",
        megabytes(emptied.page_bytes * emptied.pages.saturating_sub(after.pages)),
        megabytes(after.bytes()),
        megabytes(after.page_bytes * after.pages)
    ));
    if !after.can_shrink && after.free_pages > 0 {
        output::print_hint(
            "later data use the free space; an earlier build created this database, and it does not shrink \
            automatically: docs/operations.md shows how to shrink it",
        );
    }
    Ok(EXIT_DONE)
}

/// Releases all free pages, a few at a time, so that other writers have their turn.
async fn give_back(store: &Store, space: FreeSpace) -> Result<(), CliError> {
    let mut left = space.free_pages;
    while space.can_shrink && left > 0 {
        store.give_back(PAGES_AT_ONCE).await?;
        let now = store.free_space().await?.free_pages;
        // others may free pages in the meantime; stop when the number no longer decreases
        if now >= left {
            break;
        }
        left = now;
    }
    Ok(())
}

/// Removed data of one robot and kind.
struct RemovedSum {
    robot: String,
    kind: RunKind,
    runs: u64,
    cycles: u64,
    bytes: u64,
    /// For production logs, the part that stays: one factor instead of those of all windows.
    stays: u64,
}

impl RemovedSum {
    fn freed(&self) -> u64 {
        self.bytes - self.stays
    }

    fn what(&self, dry_run: bool) -> &'static str {
        match (self.kind, dry_run) {
            (RunKind::Test, true) => "would be deleted",
            (RunKind::Test, false) => "removed",
            (RunKind::Production, true) => "would be joined",
            (RunKind::Production, false) => "joined",
        }
    }

    fn as_row(&self, dry_run: bool) -> Vec<String> {
        let counts = [self.runs, self.cycles].map(|count| count.to_string());
        let [runs, cycles] = counts;
        let (kind, what) = (self.kind.name().to_owned(), self.what(dry_run).to_owned());
        vec![self.robot.clone(), kind, runs, cycles, megabytes(self.freed()), what]
    }

    fn as_value(&self, dry_run: bool) -> serde_json::Value {
        json!({
            "robot": self.robot, "kind": self.kind.name(), "runs": self.runs, "cycles": self.cycles,
            "bytes": self.freed(), "factors": self.what(dry_run),
        })
    }
}

fn by_robot(runs: &[DueRun]) -> Vec<RemovedSum> {
    let mut sums: BTreeMap<(&str, &str), RemovedSum> = BTreeMap::new();
    for run in runs {
        let sum = sums.entry((&run.robot, run.kind.name())).or_insert_with(|| RemovedSum {
            robot: run.robot.clone(),
            kind: run.kind,
            runs: 0,
            cycles: 0,
            bytes: 0,
            stays: 0,
        });
        sum.runs += 1;
        sum.cycles += run.cycles;
        sum.bytes += run.bytes;
        if run.kind == RunKind::Production {
            sum.stays += run.bytes / run.cycles.max(1);
        }
    }
    sums.into_values().collect()
}

fn shown_days(days: Option<f64>) -> String {
    days.map_or_else(|| "for ever".to_owned(), |days| format!("for {days} days"))
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}
