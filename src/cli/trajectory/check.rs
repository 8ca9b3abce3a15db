//! `armwatch trajectory check`: which limits a motion breaks.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::arm::arm;
use super::samples::samples;
use super::words::{as_value, nearness, print_nearness, sentence};
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::programme::{programme, read};
use crate::numerics::trajectory::limits::{Limited, SampleCheck, broken_by_samples, broken_by_series};
use crate::robot::{JointIndex, Robot};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory check er3a.json --robot er3a
  armwatch trajectory check motion.csv --robot robots/mine.toml
  armwatch trajectory check motion.csv --robot er3a --json

FILE is a programme of `armwatch trajectory design` or a CSV file with a header: time or time_s, and pos_1, pos_2, ..
in rad (m), or pos_1_deg, pos_2_mm. Velocities (vel_1) and accelerations (acc_1) are taken where they are given, and
derived from positions elsewhere, over intervals so long that the last digit of the file does not show. A quantity that
the file is too coarse for is called not judged.

Exit status 0 if every limit is kept, 1 if one is broken or not judged.")]
pub(in crate::cli) struct CheckArgs {
    /// Programme, or CSV file of positions over time
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
}

pub(in crate::cli) fn check(global: &Global, args: &CheckArgs) -> Result<u8, CliError> {
    let robot = arm(global, &args.robot)?;
    let text = read(&args.file)?;
    let found = if text.trim_start().starts_with('{') {
        let programme = programme(&args.file, &robot)?;
        let breaches = broken_by_series(&robot, &programme.series);
        if !global.json {
            print_nearness(&robot, &programme.series);
        }
        let limits = Some(nearness(&robot, &programme.series));
        (SampleCheck { breaches, ..SampleCheck::default() }, limits)
    } else {
        let check = broken_by_samples(&robot, &samples(&args.file, &text, &robot)?);
        if !global.json {
            print_used(&robot, &check);
        }
        (check, None)
    };
    let (check, limits) = found;
    if global.json {
        output::json(&json!({
            "kept": check.breaches.is_empty() && check.unjudged.is_empty(),
            "broken": check.breaches.iter().map(|breach| as_value(&robot, breach)).collect::<Vec<_>>(),
            "not_judged": check.unjudged.iter().map(unjudged_value).collect::<Vec<_>>(),
            "limits": limits.unwrap_or_else(|| used_value(&check)),
        }));
    } else {
        for breach in &check.breaches {
            output::line(&format!("BROKEN {}", sentence(&robot, breach)));
        }
        for (joint, quantity, _) in &check.unjudged {
            output::line(&format!(
                "NOT JUDGED joint {joint}: {quantity}; positions have too few digits for it, give velocities (vel_{joint}) \
                 or more digits"
            ));
        }
        if check.breaches.is_empty() && check.unjudged.is_empty() {
            output::line("Every limit of position, speed and acceleration is kept");
        }
    }
    let kept = check.breaches.is_empty() && check.unjudged.is_empty();
    Ok(if kept { EXIT_DONE } else { EXIT_FOUND })
}

fn print_used(robot: &Robot, check: &SampleCheck) {
    let percent = |share: Option<f64>| {
        share.map_or_else(|| "not judged".to_owned(), |share| format!("{:.1} %", 100.0 * share))
    };
    let rows: Vec<Vec<String>> = robot
        .joint_indices()
        .zip(&check.used)
        .map(|(joint, used)| {
            let [position, speed, acceleration] = used.map(percent);
            vec![joint.to_string(), position, speed, acceleration]
        })
        .collect();
    output::print_table(
        &["joint", "of the range about its middle", "of top speed", "of top acceleration"],
        &rows,
        &[],
    );
}

fn unjudged_value((joint, quantity, _): &(JointIndex, Limited, f64)) -> Value {
    json!({ "joint": joint.number(), "quantity": quantity.to_string() })
}

fn used_value(check: &SampleCheck) -> Value {
    let each = (1..).zip(&check.used);
    each.map(|(joint, [position, speed, acceleration]): (usize, _)| {
        json!({
            "joint": joint, "position_share": position, "speed_share": speed, "acceleration_share": acceleration,
        })
    })
    .collect()
}
