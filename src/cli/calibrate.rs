//! `armwatch calibrate`: the limits of each robot at the requested rate of false alarms.

use clap::Args;
use serde_json::{Value, json};

use super::context::{CliError, EXIT_DONE, Global, runtime};
use super::shared::output;
use crate::pipeline::conclude::method::METHOD;
use armwatch_config::Config;
use armwatch_method::detect::runs::calibration::{CHANGES, Calibration, LevelCalibration, calibration};
use armwatch_model::text;
use armwatch_store::Store;

#[derive(Debug, Args)]
#[command(after_help = "\
For each robot and joint, the command prints the smallest change in friction level that causes an alarm. The limit
is a multiple of the standard deviation of the smoothed change; `false_alarms_per_robot_year` in the configuration
determines the multiple. The command also prints the limit in percent of friction; it is at least
`drift_warning_fraction`. The delay is the expected number of tests until an alarm after a step of 5, 10 and 15 %,
including the test with the step. The command changes nothing; docs/evidence/detection.md has the guarantees of
each phase.

Examples:
  armwatch calibrate
  armwatch calibrate Left
  armwatch calibrate Left --json")]
pub(super) struct CalibrateArgs {
    /// Robot [default: all]
    #[arg(value_name = "ROBOT")]
    robot: Option<String>,
}

pub(super) fn calibrate(global: &Global, args: &CalibrateArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let Some(store) = Store::open_existing_as(&config.database, &config.cluster).await? else {
            let words = format!(
                "there is no database {} yet, so there is no data for calibration: `armwatch run` and \
                `armwatch ingest` create it",
                config.database.display()
            );
            say(global, &words);
            return Ok(EXIT_DONE);
        };
        // not closed: closing moves the write-ahead log, which a store for reading must not
        print(global, &config, &store, args.robot.as_deref()).await
    })
}

/// Reports why there is no result. With --json, standard output contains only results.
fn say(global: &Global, words: &str) {
    if global.json { output::print_hint(words) } else { output::line(words) }
}

async fn print(global: &Global, config: &Config, store: &Store, robot: Option<&str>) -> Result<u8, CliError> {
    let known = store.tested_robots().await?;
    if known.is_empty() && robot.is_none() {
        say(global, "no complete test is stored yet: limits depend on tests");
        return Ok(EXIT_DONE);
    }
    if let Some(name) = robot
        && !known.iter().any(|(_, of)| of == name)
    {
        let names: Vec<&str> = known.iter().map(|(_, name)| name.as_str()).collect();
        let names = if names.is_empty() { "none yet".to_owned() } else { names.join(", ") };
        return Err(CliError::Usage(format!(
            "there is no complete test of robot {name}; robots with tests: {names}"
        )));
    }
    for (place, (robot_id, name)) in
        known.iter().filter(|(_, name)| robot.is_none_or(|wanted| wanted == name)).enumerate()
    {
        let history = store.latest_window(*robot_id, METHOD).await?;
        let found = calibration(&history, &config.detect);
        if global.json {
            output::json(&as_value(name, &found));
        } else {
            if place > 0 {
                output::line("");
            }
            output::block(&as_text(name, &found, config));
        }
    }
    Ok(EXIT_DONE)
}

fn as_text(robot: &str, found: &Calibration, config: &Config) -> String {
    let budget = &found.budget;
    let mut text = format!(
        "robot {}: tests {}, {:.0} per year at the present rate; {} per year in {} channels: one in {:.0} \
        tests per channel",
        text::shown(robot),
        found.tests,
        budget.tests_per_year,
        output::counted(budget.per_robot_year, "false alarm"),
        budget.channels,
        budget.run_length()
    );
    if let Some(sigma) = config.detect.drift_sigma {
        text +=
            &format!("\ndrift_sigma = {sigma} is set, so the limits of friction do not depend on the rate");
    }
    let header = [
        "joint",
        "quantity",
        "learnt from",
        "phase",
        "scatter, %",
        "limit, std",
        "limit, %",
        "delay at 5 %",
        "10 %",
        "15 %",
    ];
    let learning = |of: &LevelCalibration| of.limit.is_none();
    let rows: Vec<Vec<String>> =
        found.joints.iter().filter(|of| !learning(of)).map(|of| row(of, config)).collect();
    if !rows.is_empty() {
        text += "\n";
        text += &output::table(&header, &rows);
    }
    let names: Vec<String> =
        found.joints.iter().filter(|of| learning(of)).map(|of| of.joint.to_string()).collect();
    if !names.is_empty() {
        text += &format!(
            "\nno limit yet of joint {}: a baseline needs {} tests with friction",
            names.join(", "),
            config.detect.baseline_runs
        );
    }
    if found.joints.is_empty() {
        text += "\nno test has a result of a joint";
    }
    text + &format!(
        "\na cause in a single test must be likelier than no change by {:.1} in log-likelihood, to use no more",
        found.advantage
    )
}

fn row(of: &LevelCalibration, config: &Config) -> Vec<String> {
    let percent = |fraction: f64| format!("{:.1}", 100.0 * fraction);
    let mut row = vec![
        of.joint.to_string(),
        of.quantity.to_string(),
        of.learnt.to_string(),
        of.phase.name().to_owned(),
    ];
    if let Some(limit) = &of.limit {
        row.extend([percent(limit.scatter), format!("{:.2}", limit.sigma), percent(limit.change)]);
        row.extend(limit.delays.map(delay));
        if limit.change <= config.detect.drift_warning
            && let Some(cell) = row.get_mut(LIMIT_COLUMN)
        {
            cell.push_str(" (least)");
        }
    }
    row
}

/// Column of the limit in per cent.
const LIMIT_COLUMN: usize = 6;

/// Tests until an alarm; `-` for a thousand and more.
fn delay(tests: f64) -> String {
    if tests < 1000.0 { format!("{tests:.1}") } else { "-".into() }
}

fn as_value(robot: &str, found: &Calibration) -> Value {
    let joint = |of: &LevelCalibration| {
        let limit = of.limit.as_ref();
        let delays = limit.map(|limit| {
            let entry = |(change, delay): (f64, f64)| {
                json!({ "change_fraction": change, "tests": delay.is_finite().then_some(delay) })
            };
            CHANGES.into_iter().zip(limit.delays).map(entry).collect::<Vec<_>>()
        });
        json!({
            "joint": of.joint.number(), "quantity": of.quantity, "tests_learnt": of.learnt, "phase": of.phase.name(),
            "scatter_fraction": limit.map(|of| of.scatter), "limit_std": limit.map(|of| of.sigma),
            "limit_fraction": limit.map(|of| of.change), "expected_delays": delays,
        })
    };
    let budget = &found.budget;
    json!({
        "robot": robot, "tests": found.tests, "tests_per_year": budget.tests_per_year,
        "false_alarms_per_robot_year": budget.per_robot_year, "channels": budget.channels,
        "tests_between_false_alarms_of_a_channel": budget.run_length(),
        "log_likelihood_of_a_cause": found.advantage,
        "joints": found.joints.iter().map(joint).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_method::detect::rate::budget::Budget;
    use armwatch_method::detect::runs::calibration::{LevelFigures, Phase};
    use armwatch_model::anomaly::quantity::Quantity;
    use armwatch_model::robot::JointIndex;

    fn found() -> Calibration {
        let figures =
            LevelFigures { scatter: 0.02, sigma: 4.5, change: 0.061, delays: [f64::INFINITY, 2.14, 1.3] };
        let joint = |joint: usize, limit| LevelCalibration {
            joint: JointIndex::new(joint),
            quantity: Quantity::FrictionIndex,
            learnt: 20,
            phase: Phase::Short,
            limit,
        };
        Calibration {
            budget: Budget { per_robot_year: 1.0, tests_per_year: 365.0, channels: 16 },
            advantage: 11.7,
            tests: 28,
            joints: vec![joint(0, Some(figures)), joint(1, None)],
        }
    }

    #[test]
    fn joints_with_and_without_a_limit_are_told_apart() {
        let text = as_text("Left", &found(), &Config::shipped().expect("no problems"));
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].contains("one in 5840 tests"), "{text}");
        let cells: Vec<&str> = lines[2].split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect();
        assert_eq!(cells, ["1", "friction_index", "20", "short", "2.0", "4.50", "6.1", "-", "2.1", "1.3"]);
        assert!(text.contains("no limit yet of joint 2: a baseline needs 5 tests"), "{text}");
    }

    #[test]
    fn json_has_units_in_its_names_and_null_for_what_is_not_known() {
        let value = as_value("Left", &found());
        assert_eq!(value["joints"][0]["limit_fraction"], 0.061);
        assert_eq!(value["joints"][0]["expected_delays"][0]["tests"], Value::Null);
        assert_eq!(value["joints"][1]["limit_std"], Value::Null);
    }
}
