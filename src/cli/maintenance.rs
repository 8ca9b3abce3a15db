//! `armwatch maintenance`: maintenance of robots, which starts new baselines.

use clap::Args;
use jiff::Timestamp;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_change, open_to_read, runtime};
use super::shared::judged::judge;
use super::shared::moment::moment;
use super::shared::output;
use super::shared::said::said;
use super::shared::unknown_robot::unknown_robot;
use super::shared::user::user;
use armwatch_config::Config;
use armwatch_model::anomaly::epoch::Maintenance;
use armwatch_model::robot::JointIndex;
use armwatch_store::{MaintenanceRow, NewMaintenance, NotEntered, Store, time_in_views};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch maintenance Left --joint 3 --what \"gearbox changed\"
  armwatch maintenance Left --what \"all joints greased\" --at 2026-03-01
  armwatch maintenance Left --joint 5 --what \"brake changed\" \\
      --at 2026-03-01T14:30:00Z --by mueller
  armwatch maintenance --list
  armwatch maintenance --list Left --json
  armwatch maintenance --remove 7

Work on a joint, or on the whole arm without --joint, begins a new baseline. Later tests are compared with the
first full tests after the work, and no longer with those before it. Enter work that changes friction, dynamics or
sensors: gearbox, grease, brake, motor, encoder, load. Do not enter a cleaning. The history is evaluated again
immediately, or within a minute by a running daemon. To correct a wrong time or joint, remove the entry and enter
it again.

Alarms of the joint that began before the work, and that are open, acknowledged or shelved, change to the state
maintenance. Without --joint, this includes alarms of all joints and of the arm. The first test of the new
baseline ends the alarms that were based on the old one. An alarm that a later run still shows is open again.

Alarms of the joint that began before the work, and that are open, acknowledged or shelved, are in the state maintenance
from then on. Without --joint, so are those of all joints and of the arm. The first test of the new baseline ends those
that were compared with the old one. One that a later run still shows is open again.")]
pub(super) struct MaintenanceArgs {
    /// Robot; with --list, list only work on this robot [default: all]
    #[arg(value_name = "ROBOT", required_unless_present_any = ["list", "remove"])]
    robot: Option<String>,
    /// Description of the work
    #[arg(long, value_name = "TEXT", required_unless_present_any = ["list", "remove"], value_parser = said)]
    what: Option<String>,
    /// Joint, from 1 [default: the whole arm]
    #[arg(long, value_name = "JOINT", allow_negative_numbers = true, value_parser = clap::value_parser!(u8).range(1..))]
    joint: Option<u8>,
    /// Time of the work, UTC: a date, a date with time, or RFC 3339 with an offset [default: now]
    #[arg(long, value_name = "TIME", value_parser = moment)]
    at: Option<Timestamp>,
    /// Name of the person [default: the user's name]
    #[arg(long, value_name = "NAME", value_parser = said)]
    by: Option<String>,
    /// List the entered work in order of time
    #[arg(long, conflicts_with_all = ["what", "joint", "at", "by", "remove"])]
    list: bool,
    /// Delete the entry with this number, as shown by --list
    #[arg(long, value_name = "NUMBER", allow_negative_numbers = true, value_parser = clap::value_parser!(i64).range(1..), conflicts_with_all = ["robot", "what", "joint", "at", "by"])]
    remove: Option<i64>,
}

pub(super) fn maintenance(global: &Global, args: &MaintenanceArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = if args.list { open_to_read(&config).await? } else { open_to_change(&config).await? };
        let done = match (args.list, args.remove) {
            (true, _) => list(global, &store, args.robot.as_deref()).await,
            (_, Some(number)) => remove(global, config, &store, number).await,
            _ => enter(global, config, &store, args).await,
        };
        store.close().await?;
        done
    })
}

async fn list(global: &Global, store: &Store, robot: Option<&str>) -> Result<u8, CliError> {
    if let Some(robot) = robot {
        known_joints(store, robot).await?;
    }
    let rows = store.maintenance(robot).await?;
    if global.json {
        rows.iter().for_each(|row| output::json(&as_value(row)));
    } else if rows.is_empty() {
        let of = robot.map(|name| format!(" on {name}")).unwrap_or_default();
        output::line(&format!(
            "no work{of} was entered: every joint is compared with its first tests; `armwatch maintenance \
            ROBOT --what TEXT` enters work"
        ));
    } else {
        let cells = |row: &MaintenanceRow| {
            let Maintenance { maintenance_id, joint, at, what, who } = &row.work;
            vec![
                maintenance_id.to_string(),
                row.robot.clone(),
                joint.map_or_else(|| "all".to_owned(), |joint| joint.to_string()),
                minute(*at),
                what.clone(),
                who.clone().unwrap_or_default(),
            ]
        };
        let rows: Vec<Vec<String>> = rows.iter().map(cells).collect();
        output::print_table(&["number", "robot", "joint", "at (UTC)", "what", "by"], &rows, &[]);
    }
    Ok(EXIT_DONE)
}

async fn enter(
    global: &Global,
    config: Config,
    store: &Store,
    args: &MaintenanceArgs,
) -> Result<u8, CliError> {
    let robot = args.robot.clone().unwrap_or_default();
    let joints = known_joints(store, &robot).await?;
    let joint = args.joint.and_then(|number| JointIndex::from_number(usize::from(number)));
    if let Some(joint) = joint.filter(|joint| joints > 0 && joint.number() > joints) {
        return Err(CliError::Usage(format!("{robot} has no joint {joint}; its tests have {joints} joints")));
    }
    let now = Timestamp::now();
    let at = args.at.unwrap_or(now);
    check_time(at, now).map_err(CliError::Usage)?;
    let new = NewMaintenance {
        robot: robot.clone(),
        joint,
        at,
        what: args.what.clone().unwrap_or_default(),
        who: Some(args.by.clone().unwrap_or_else(user)),
    };
    let number = match store.enter_maintenance(&new).await? {
        Ok(number) => number,
        Err(NotEntered::NoRobot) => return Err(unknown_robot(store, &robot).await),
        Err(NotEntered::Known(row)) => {
            return Err(CliError::Usage(format!(
                "this work is already entered, as number {}: {row}; `armwatch maintenance --list {robot}` shows all",
                row.work.maintenance_id
            )));
        }
    };
    let outcome = judge(config, store, &robot).await?;
    if global.json {
        output::json(&json!({
            "maintenance_id": number, "robot": robot, "joint": joint.map(JointIndex::number), "at": time_in_views(at),
            "what": new.what, "by": new.who, "outcome": "entered", "judged": outcome.is_now(),
        }));
    } else {
        output::line(&format!(
            "entered      {number}: {robot}, {}, {}: {}",
            place(joint),
            minute(at),
            new.what
        ));
        output::line(&format!(
            "             later tests have a new baseline{}; `armwatch maintenance --remove {number}` undoes this",
            outcome.words()
        ));
    }
    Ok(EXIT_DONE)
}

async fn remove(global: &Global, config: Config, store: &Store, number: i64) -> Result<u8, CliError> {
    let Some(row) = store.remove_maintenance(number).await? else {
        return Err(CliError::Usage(format!(
            "no work has the number {number}; `armwatch maintenance --list` shows the numbers"
        )));
    };
    let outcome = judge(config, store, &row.robot).await?;
    if global.json {
        let mut value = as_value(&row);
        value["outcome"] = "removed".into();
        value["judged"] = outcome.is_now().into();
        output::json(&value);
    } else {
        output::line(&format!("removed      {number}: {row}"));
        output::line(&format!("             the earlier baseline is valid again{}", outcome.words()));
    }
    Ok(EXIT_DONE)
}

/// Refuses an impossible time of maintenance.
fn check_time(at: Timestamp, now: Timestamp) -> Result<(), String> {
    if at < Timestamp::UNIX_EPOCH {
        return Err(format!(
            "--at {} is before 1970; check the year, which has four digits, as in 2026-03-01",
            minute(at)
        ));
    }
    if at > now {
        return Err(format!(
            "--at {} is in the future; enter work after it is done, because earlier tests are compared with \
            the old baseline",
            minute(at)
        ));
    }
    Ok(())
}

fn place(joint: Option<JointIndex>) -> String {
    joint.map_or_else(|| "the whole arm".to_owned(), |joint| format!("joint {joint}"))
}

/// The number of a robot's joints.
async fn known_joints(store: &Store, robot: &str) -> Result<usize, CliError> {
    match store.known_joints(robot).await? {
        Some(joints) => Ok(joints),
        None => Err(unknown_robot(store, robot).await),
    }
}

fn as_value(row: &MaintenanceRow) -> serde_json::Value {
    let Maintenance { maintenance_id, joint, at, what, who } = &row.work;
    json!({
        "maintenance_id": maintenance_id, "robot": row.robot, "joint": joint.map(JointIndex::number),
        "at": time_in_views(*at), "what": what, "by": who, "recorded_at": time_in_views(row.recorded_at),
    })
}

fn minute(time: Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%MZ").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(text: &str) -> Timestamp {
        text.parse().expect("a time")
    }

    #[test]
    fn work_was_done_between_1970_and_now() {
        let now = time("2026-03-01T14:30:00Z");
        assert_eq!((check_time(now, now), check_time(time("1998-01-01T00:00:00Z"), now)), (Ok(()), Ok(())));
        let year = check_time(time("0020-01-01T00:00:00Z"), now);
        assert!(year.is_err_and(|words| words.contains("before 1970") && words.contains("2026-03-01")));
        assert!(
            check_time(time("2026-03-01T14:31:00Z"), now)
                .is_err_and(|words| words.contains("is in the future"))
        );
    }
}
