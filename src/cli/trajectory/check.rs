//! `armwatch trajectory check`: which limits a motion breaks.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use super::arm::arm;
use super::limit_texts::{nearness, print_nearness};
use super::motion_check::{MotionCheck, Unchecked};
use super::samples::samples;
use super::surroundings::SurroundingsArgs;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::position_columns::offsets_text;
use crate::cli::shared::programme::{programme, read};
use armwatch_model::robot::Robot;
use armwatch_trajectory::limits::SampleCheck;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory check er3a.json --robot er3a
  armwatch trajectory check motion.csv --robot robots/mine.toml
  armwatch trajectory check motion.csv --robot robots/mine.toml --cell cell.toml
  armwatch trajectory check motion.csv --robot er3a --json

FILE is a programme of `armwatch trajectory design` or a CSV file with a header: time or time_s, and pos_1, pos_2,
.. in rad (m), or pos_1_deg, pos_2_mm. The command uses the velocities (vel_1) and accelerations (acc_1) in the
file. If they are missing, it derives them from positions, over intervals long enough to hide the rounding of the
last digit. It reports a quantity as not judged if the file is too coarse for it. Positions are those of the
controller, as `armwatch trajectory export` writes them: the command adds position_offset_* of the description.

The command checks jerk, peak torque and the clearance of links if the description has limits for them;
docs/trajectories.md has the keys, and the file of a cell.

Peak torque follows from the nominal parameters, without inertia and friction of coupled motors. A root mean
square of torque above the rated torque is a remark, because rest between repetitions lowers it.

Exit status 0 if the motion keeps every limit of the description, 1 if it breaks one or one was not judged.")]
pub(in crate::cli) struct CheckArgs {
    /// Programme, or CSV file with positions over time
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
    #[command(flatten)]
    surroundings: SurroundingsArgs,
}

pub(in crate::cli) fn check(global: &Global, args: &CheckArgs) -> Result<u8, CliError> {
    let robot = arm(global, &args.robot)?;
    let limit = args.surroundings.limit(&robot)?;
    let text = read(&args.file)?;
    let (judged, limits) = if text.trim_start().starts_with('{') {
        let series = programme(&args.file, &robot)?.series;
        if !global.json {
            print_nearness(&robot, &series);
        }
        (MotionCheck::of_series(&robot, &series, limit.as_ref())?, Some(nearness(&robot, &series)))
    } else {
        let judged = MotionCheck::of_samples(&robot, &samples(&args.file, &text, &robot)?, limit.as_ref())?;
        offsets_text(&robot).iter().for_each(|offsets| output::print_hint(offsets));
        if !global.json {
            print_used(&robot, &judged.check);
        }
        (judged, None)
    };
    if global.json {
        output::json(&json!({
            "kept": judged.is_kept(),
            "broken": judged.broken_value(),
            "not_judged": judged.unchecked().iter().map(Unchecked::as_value).collect::<Vec<_>>(),
            "limits": limits.unwrap_or_else(|| used_value(&judged.check)),
            "torques": judged.torque_value(),
            "clearances": judged.clearance_value(),
        }));
    } else {
        judged.print();
        for sentence in judged.broken() {
            output::line(&format!("BROKEN {sentence}"));
        }
        for unchecked in judged.unchecked() {
            output::line(&format!("NOT JUDGED {}", unchecked.sentence()));
        }
        if judged.is_kept() {
            output::line("");
            output::line(&format!("Every limit is kept: {}", judged.quantities()));
        }
        judged.hints().iter().for_each(|hint| output::print_hint(hint));
    }
    Ok(if judged.is_kept() { EXIT_DONE } else { EXIT_FOUND })
}

/// How much of each joint's limits samples use.
pub(super) fn print_used(robot: &Robot, check: &SampleCheck) {
    let percent = |share: Option<f64>| {
        share.map_or_else(|| "not judged".to_owned(), |share| format!("{:.1} %", 100.0 * share))
    };
    let rows: Vec<Vec<String>> = robot
        .joint_indices()
        .zip(&check.used)
        .map(|(joint, used)| {
            let limits = &robot.joints[joint.index()].limits;
            let [position, speed, acceleration, jerk] = used.map(percent);
            let jerk = if limits.jerk.is_some() { jerk } else { "-".to_owned() };
            vec![joint.to_string(), position, speed, acceleration, jerk]
        })
        .collect();
    output::print_table(
        &["joint", "of the range about its middle", "of top speed", "of top acceleration", "of top jerk"],
        &rows,
        &[],
    );
}

/// The same for scripts.
pub(super) fn used_value(check: &SampleCheck) -> Value {
    let each = (1..).zip(&check.used);
    each.map(|(joint, [position, speed, acceleration, jerk]): (usize, _)| {
        json!({
            "joint": joint, "position_share": position, "speed_share": speed, "acceleration_share": acceleration,
            "jerk_share": jerk,
        })
    })
    .collect()
}
