//! `armwatch robots`, `runs`, `cycles`: lists of stored data.

use clap::Args;
use clap::builder::PossibleValuesParser;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::output;
use super::shared::rows::{self, RowArgs};
use super::shared::selection::no_run;
use super::shared::unknown_robot::require_robot;
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_store::{AskError, ListFilter, ResultTable, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robots
  armwatch robots --csv > robots.csv
  armwatch robots --json | jq 'select(.status != \"ok\") | .robot'")]
pub(super) struct RobotsArgs {
    #[command(flatten)]
    rows: RowArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch runs
  armwatch runs --robot R07 --limit 50
  armwatch runs --status quarantined
  armwatch runs --kind production --csv

The first column has the number of the run. Other commands accept this number with --run.")]
pub(super) struct RunsArgs {
    /// Show only runs of this robot
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Show only runs with this status
    #[arg(long, value_name = "STATUS", value_parser = PossibleValuesParser::new(RunStatus::ALL.map(RunStatus::name)))]
    status: Option<String>,
    /// Show only tests, or only production logs
    #[arg(long, value_name = "KIND", value_parser = PossibleValuesParser::new(RunKind::ALL.map(RunKind::name)))]
    kind: Option<String>,
    /// Show at most this many
    #[arg(long, value_name = "N", default_value_t = 20, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..))]
    limit: u32,
    #[command(flatten)]
    rows: RowArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch cycles --run 12
  armwatch cycles --robot R07 --status refused
  armwatch cycles --run 12 --json | jq .residual_std_nm")]
pub(super) struct CyclesArgs {
    /// Show only cycles of this run
    #[arg(long, value_name = "RUN_ID", allow_negative_numbers = true, value_parser = clap::value_parser!(i64).range(1..))]
    run: Option<i64>,
    /// Show only cycles of this robot
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Show only cycles with this status
    #[arg(long, value_name = "STATUS", value_parser = ["complete", "doubtful", "refused"])]
    status: Option<String>,
    /// Show at most this many, the newest
    #[arg(long, value_name = "N", default_value_t = 50, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..))]
    limit: u32,
    #[command(flatten)]
    rows: RowArgs,
}

const NO_RUN: &str =
    "no run is stored yet: `armwatch ingest FILE` reads an export, `armwatch run` watches folders";

pub(super) fn robots(global: &Global, args: &RobotsArgs) -> Result<u8, CliError> {
    let table = asked(global, &ListFilter::default(), async |store| store.robot_list().await)?;
    rows::print(&table, args.rows, global.json, NO_RUN)?;
    Ok(EXIT_DONE)
}

pub(super) fn runs(global: &Global, args: &RunsArgs) -> Result<u8, CliError> {
    let wanted = ListFilter {
        robot: args.robot.as_deref(),
        run_id: None,
        status: args.status.as_deref(),
        kind: args.kind.as_deref(),
        most: args.limit,
    };
    let table = asked(global, &wanted, async |store| store.run_list(&wanted).await)?;
    let is_asked = args.robot.is_some() || args.status.is_some() || args.kind.is_some();
    rows::print(&table, args.rows, global.json, if is_asked { "no run matches" } else { NO_RUN })?;
    say_limit(&table, args.limit);
    Ok(EXIT_DONE)
}

pub(super) fn cycles(global: &Global, args: &CyclesArgs) -> Result<u8, CliError> {
    let wanted = ListFilter {
        robot: args.robot.as_deref(),
        run_id: args.run,
        status: args.status.as_deref(),
        kind: None,
        most: args.limit,
    };
    let table = asked(global, &wanted, async |store| store.cycle_list(&wanted).await)?;
    let is_asked = args.robot.is_some() || args.status.is_some() || args.run.is_some();
    rows::print(&table, args.rows, global.json, if is_asked { "no cycle matches" } else { NO_RUN })?;
    say_limit(&table, args.limit);
    Ok(EXIT_DONE)
}

/// Reports that a list may be incomplete.
fn say_limit(table: &ResultTable, limit: u32) {
    if table.rows.len() == usize::try_from(limit).unwrap_or(usize::MAX) {
        output::print_hint(&format!("the newest {limit}; --limit shows more"));
    }
}

/// The requested rows. If there are none, checks that the named robot and run exist.
fn asked(
    global: &Global,
    wanted: &ListFilter<'_>,
    ask: impl AsyncFnOnce(&Store) -> Result<ResultTable, AskError>,
) -> Result<ResultTable, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let table = ask(&store).await.map_err(rows::as_cli_error);
        let named = match &table {
            Ok(table) if table.rows.is_empty() => require_named(&store, wanted).await,
            _ => Ok(()),
        };
        store.close().await?;
        named?;
        table
    })
}

/// Refuses a robot without runs, and a run that does not exist.
async fn require_named(store: &Store, wanted: &ListFilter<'_>) -> Result<(), CliError> {
    if let Some(run_id) = wanted.run_id
        && store.known_run(run_id).await?.is_none()
    {
        return Err(no_run(&store.runs().await?, run_id));
    }
    match wanted.robot {
        Some(robot) => require_robot(store, robot).await,
        None => Ok(()),
    }
}
