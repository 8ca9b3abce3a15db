//! `armwatch run-date` and `armwatch set-aside`: a person's decisions about single runs.

use std::collections::BTreeSet;

use clap::Args;
use jiff::Timestamp;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_change, runtime};
use super::shared::judged::judge;
use super::shared::moment::moment;
use super::shared::output;
use super::shared::said::said;
use super::shared::selection::no_run;
use super::shared::user::user;
use armwatch_config::Config;
use armwatch_model::run::arrival::GRACE;
use armwatch_store::{DecidedRun, NotDecided, RunDecision, Store, time_in_views};

#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  armwatch run-date 17 --at 2026-03-01T08:30
  armwatch run-date 17 18 19 --as-arrived
  armwatch run-date 40 41 --as-recorded
  armwatch run-date 17 --undo

All comparisons depend on the order of a robot's tests. armwatch therefore reports a start that cannot be right
and excludes the run: see docs/method.md. This command corrects the start of a run, or confirms the recorded one.
The run then takes part in all conclusions. The recorded start stays in the column recorded_start_at of the view
runs. The correction stays after a restart and after the export is read again. If the file is renamed, the start
in its new name counts.

A start more than a day in the future is refused unless --force is given, because every later test would be out of
order.")]
pub(super) struct RunDateArgs {
    /// Numbers of the runs
    #[arg(required = true, value_name = "RUN", value_parser = clap::value_parser!(i64).range(1..))]
    runs: Vec<i64>,
    /// Start of the recording, UTC: a date, a date with time, or RFC 3339 with an offset
    #[arg(long, value_name = "TIME", value_parser = moment, conflicts_with_all = ["as_arrived", "as_recorded", "undo"])]
    at: Option<Timestamp>,
    /// Use the arrival of each file as its start, for example if a controller has lost its clock
    #[arg(long, conflicts_with_all = ["as_recorded", "undo"])]
    as_arrived: bool,
    /// Confirm the recorded start
    #[arg(long, conflicts_with = "undo")]
    as_recorded: bool,
    /// Undo a correction; the recorded start is checked again
    #[arg(long, required_unless_present_any = ["at", "as_arrived", "as_recorded"])]
    undo: bool,
    /// Accept a start in the future, for example if the clock of this computer is slow
    #[arg(long, conflicts_with_all = ["as_arrived", "undo"])]
    force: bool,
}

#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  armwatch set-aside 23
  armwatch set-aside 23 24 --by mueller
  armwatch set-aside 23 --undo

A run that is set aside takes no part in conclusions, baselines and the status of its robot. Its rows stay, and
`armwatch runs` lists it. `armwatch status` does not list a robot without any other run. The run stays set aside
after a restart and after its export is read again.")]
pub(super) struct SetAsideArgs {
    /// Numbers of the runs
    #[arg(required = true, value_name = "RUN", value_parser = clap::value_parser!(i64).range(1..))]
    runs: Vec<i64>,
    /// Name of the person [default: the user's name]
    #[arg(long, value_name = "NAME", value_parser = said, conflicts_with = "undo")]
    by: Option<String>,
    /// Include the runs again
    #[arg(long)]
    undo: bool,
}

pub(super) fn run_date(global: &Global, args: &RunDateArgs) -> Result<u8, CliError> {
    let decision = match (args.at, args.as_arrived, args.as_recorded) {
        (Some(at), ..) if args.runs.len() > 1 => {
            let at = time_in_views(at);
            return Err(CliError::Usage(format!(
                "two runs of a robot cannot both begin at {at}; give one run"
            )));
        }
        (Some(at), ..) => RunDecision::StartedAt(at),
        (_, true, _) => RunDecision::StartedAtArrival,
        (_, _, true) => RunDecision::Confirm,
        _ => RunDecision::StartAsRecorded,
    };
    if !args.force {
        not_in_future(args.at)?;
    }
    decide(global, &args.runs, &decision, args.force)
}

/// Refuses a start in the future, with the usual tolerance of dates.
fn not_in_future(start: Option<Timestamp>) -> Result<(), CliError> {
    let now = Timestamp::now();
    match start.filter(|start| start.duration_since(now) > GRACE) {
        Some(start) => Err(CliError::Usage(format!(
            "{} is more than {} h later than now, {}: no recording can have begun then, and every later \
            test would be out of order; give the right time or use --force if the clock of this computer is \
            wrong",
            time_in_views(start),
            GRACE.as_hours(),
            time_in_views(now)
        ))),
        None => Ok(()),
    }
}

pub(super) fn set_aside(global: &Global, args: &SetAsideArgs) -> Result<u8, CliError> {
    let decision = match args.undo {
        true => RunDecision::TakeBack,
        false => RunDecision::SetAside(args.by.clone().unwrap_or_else(user)),
    };
    decide(global, &args.runs, &decision, false)
}

fn decide(global: &Global, runs: &[i64], decision: &RunDecision, is_forced: bool) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = open_to_change(&config).await?;
        if matches!(decision, RunDecision::Confirm) && !is_forced {
            let rows = store.runs().await?;
            let confirmed = rows.iter().filter(|row| runs.contains(&row.run_id));
            not_in_future(confirmed.map(|row| row.started_at).max())?;
        }
        let done = decide_about(global, &config, &store, runs, decision).await;
        store.close().await?;
        done
    })
}

async fn decide_about(
    global: &Global,
    config: &Config,
    store: &Store,
    runs: &[i64],
    decision: &RunDecision,
) -> Result<u8, CliError> {
    let mut robots = BTreeSet::new();
    let mut refused = None;
    for &run_id in runs {
        match store.decide_about_run(run_id, decision).await? {
            Ok(run) => {
                print(global, run_id, &run, decision);
                robots.insert(run.robot);
            }
            // decisions about earlier runs are kept, and conclusions use them
            Err(why) => {
                refused = Some(refusal(store, run_id, why).await?);
                break;
            }
        }
    }
    for robot in robots {
        let outcome = judge(config.clone(), store, &robot).await?;
        if !global.json {
            output::line(&format!("             {robot}{}", outcome.words()));
        }
    }
    refused.map_or(Ok(EXIT_DONE), Err)
}

async fn refusal(store: &Store, run_id: i64, why: NotDecided) -> Result<CliError, CliError> {
    Ok(match why {
        NotDecided::NoRun => no_run(&store.runs().await?, run_id),
        NotDecided::Status(status) => CliError::Usage(format!(
            "run {run_id} is {}; only a run that was read to its end takes part in conclusions",
            status.name()
        )),
        NotDecided::NothingToUndo => CliError::Usage(format!(
            "there is nothing to undo for run {run_id}; `armwatch runs` shows runs that are set aside or corrected"
        )),
    })
}

fn print(global: &Global, run_id: i64, run: &DecidedRun, decision: &RunDecision) {
    let outcome = match decision {
        RunDecision::StartedAt(_) | RunDecision::StartedAtArrival => "dated",
        RunDecision::Confirm => "confirmed",
        RunDecision::StartAsRecorded => "as recorded",
        RunDecision::SetAside(_) => "set aside",
        RunDecision::TakeBack => "takes part",
    };
    let started_at = time_in_views(run.started_at);
    if global.json {
        output::json(&json!({
            "run_id": run_id, "robot": run.robot, "source_name": run.source_name, "started_at": started_at,
            "recorded_start_at": run.recorded_start.map(time_in_views), "outcome": outcome,
        }));
    } else {
        output::line(&format!(
            "{outcome:<12} run {run_id} of {}, {}: {started_at}",
            run.robot, run.source_name
        ));
    }
}
