//! `armwatch conclude`: draws conclusions from a history again from a date on.

use clap::Args;
use jiff::Timestamp;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, EXIT_INTERNAL, Global, open_to_change, runtime};
use super::shared::judged::{ConclusionTiming, judge};
use super::shared::moment::moment;
use super::shared::output;
use armwatch_model::text;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch conclude --from 2023-05-01
  armwatch conclude Front --from 2023-05-01T06:00 --json

armwatch draws conclusions whenever it stores a test or a production log. They use the first tests of each
baseline and about the last 1,000 tests (500 logs) of a robot. Earlier anomalies do not change. A test with an
earlier start that arrives later is stored, but no conclusion uses it; `armwatch explain FILE` reports this. This
command evaluates the history again from the given date, with all tests that have arrived since, and with the
present configuration. It takes about half a second per 1,000 tests. Anomalies keep their numbers and their
answers.")]
pub(super) struct ConcludeArgs {
    /// Robot [default: all]
    robot: Option<String>,
    /// Time from which the history is evaluated again, UTC: a date, a date with time, or RFC 3339 with an offset
    #[arg(long, value_name = "TIME", value_parser = moment)]
    from: Timestamp,
}

pub(super) fn conclude(global: &Global, args: &ConcludeArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = open_to_change(&config).await?;
        let robots = store.reopen_history(args.robot.as_deref(), args.from).await?;
        if let (Some(robot), []) = (&args.robot, &robots[..]) {
            let robot = text::shown(robot);
            return Err(CliError::Usage(format!("there is no robot {robot}; `armwatch robots` lists them")));
        }
        let mut exit = EXIT_DONE;
        for robot in robots {
            let judged = judge(config.clone(), &store, &robot).await?;
            if matches!(judged, ConclusionTiming::Failed(_)) {
                exit = EXIT_INTERNAL;
            }
            match global.json {
                true => {
                    output::json(&json!({ "robot": robot, "from": args.from, "judged": judged.is_now() }))
                }
                false => output::line(&format!(
                    "{}: opened from {}{}",
                    text::shown(&robot),
                    args.from,
                    judged.words()
                )),
            }
        }
        store.close().await?;
        Ok(exit)
    })
}
