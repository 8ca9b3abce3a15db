//! `armwatch trajectory export`: a programme as samples or waypoints for a controller.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::arm::arm;
use super::motion_check::MotionCheck;
use super::surroundings::SurroundingsArgs;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::position_columns::offsets_text;
use crate::cli::shared::programme::programme;
use crate::cli::shared::result_file::{refuse_source, result_file, write_lines};
use armwatch_model::robot::{FourierExcitation, JointKind, Robot};
use armwatch_trajectory::series::state_at;

/// Most rows of a file: a day at 1 kHz.
const MAX_ROWS: f64 = 86_400_000.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory export er3a.json --robot er3a -o er3a.csv
  armwatch trajectory export er3a.json --robot er3a --rate-hz 500 \\
      --periods 3 -o er3a_500hz.csv
  armwatch trajectory export er3a.json --robot er3a --waypoints \\
      --rate-hz 20 -o er3a_pvt.csv

The file has time_s and, for each joint, pos_1_rad, vel_1_rad_s, acc_1_rad_s2 (m for a prismatic joint), with all
digits. Positions are those that the controller has at its joints: the positions of the programme minus
position_offset_* of the description. They are on the joint side: gear ratios, [transmission], and signs and units
of a layout are not applied.

--waypoints omits accelerations: position, velocity and time (PVT) for a controller that connects them with cubic
polynomials. The command prints the largest difference between these and the motion.

If the motion breaks a limit of the arm, the exit status is 1 and the command writes nothing.")]
pub(in crate::cli) struct TrajectoryExportArgs {
    /// Programme of `armwatch trajectory design`
    #[arg(value_name = "PROGRAMME")]
    file: PathBuf,
    /// Arm whose limits are checked again: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
    /// CSV file to write
    #[arg(short, long, value_name = "FILE", value_parser = result_file())]
    output: PathBuf,
    /// Rows per second, Hz
    #[arg(long, default_value_t = 250.0, value_name = "HZ")]
    rate_hz: f64,
    /// Number of consecutive periods
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    periods: u32,
    /// Write only position, velocity and time
    #[arg(long)]
    waypoints: bool,
    /// Write the file even if the motion breaks limits of the arm
    #[arg(long)]
    despite_broken_limits: bool,
    #[command(flatten)]
    surroundings: SurroundingsArgs,
}

pub(in crate::cli) fn export(global: &Global, args: &TrajectoryExportArgs) -> Result<u8, CliError> {
    refuse_source(Some(&args.output), &args.file, "the programme itself")?;
    let robot = arm(global, &args.robot)?;
    let series = programme(&args.file, &robot)?.series;
    let limit = args.surroundings.limit(&robot)?;
    let judged = MotionCheck::of_series(&robot, &series, limit.as_ref())?;
    judged.print_unchecked();
    let broken = judged.broken();
    if !broken.is_empty() {
        broken.iter().for_each(|sentence| output::print_hint(sentence));
        if !args.despite_broken_limits {
            output::print_hint(
                "nothing is written: the motion breaks limits of the arm; --despite-broken-limits writes it anyway",
            );
            return Ok(EXIT_FOUND);
        }
    }
    let duration = f64::from(args.periods) / series.base_frequency;
    let steps = steps(args.rate_hz, duration)?;
    let header = header(&robot, args.waypoints);
    let columns = if args.waypoints { 2 } else { 3 };
    let row = |k: u64| {
        let time = k as f64 / args.rate_hz;
        let cells =
            state_at(&series, time).into_iter().zip(&robot.joints).flat_map(|([q, qd, qdd], joint)| {
                [joint.recorded_position(q), qd, qdd].into_iter().take(columns)
            });
        [time].into_iter().chain(cells).map(|value| value.to_string()).collect::<Vec<_>>().join(",")
    };
    // the last row is the rest at the end
    write_lines(&args.output, std::iter::once(header).chain((0..=steps).map(row)))?;
    offsets_text(&robot).iter().for_each(|offsets| output::print_hint(offsets));
    let deviation = args.waypoints.then(|| interpolation_error(&series, 1.0 / args.rate_hz));
    if global.json {
        output::json(&json!({
            "rows": steps + 1, "duration_s": duration, "largest_interpolation_error": deviation,
            "broken_limits": broken.len(),
        }));
    } else if let Some(deviation) = deviation {
        output::line(&format!(
            "{} waypoints; cubic polynomials between them are at most {deviation:.2e} rad (m) from the motion",
            steps + 1
        ));
    } else {
        output::line(&format!("{} rows, {duration} s", steps + 1));
    }
    Ok(EXIT_DONE)
}

/// Steps of a file at a rate, Hz, over a duration, s; the number of rows is one more.
pub(super) fn steps(rate_hz: f64, duration: f64) -> Result<u64, CliError> {
    let steps = (rate_hz * duration).round();
    if !(rate_hz > 0.0 && (1.0..=MAX_ROWS).contains(&steps)) {
        return Err(CliError::Usage(format!(
            "--rate-hz {rate_hz}: {steps} rows; 1 to {MAX_ROWS} rows are possible"
        )));
    }
    Ok(steps as u64)
}

/// Names of the columns of a motion.
pub(super) fn header(robot: &Robot, waypoints: bool) -> String {
    let of_joint = |(number, kind): (usize, JointKind)| {
        let unit = if kind == JointKind::Revolute { "rad" } else { "m" };
        let mut names = format!("pos_{number}_{unit},vel_{number}_{unit}_s");
        if !waypoints {
            names += &format!(",acc_{number}_{unit}_s2");
        }
        names
    };
    let joints = (1..).zip(robot.joints.iter().map(|joint| joint.kind)).map(of_joint);
    std::iter::once("time_s".to_owned()).chain(joints).collect::<Vec<_>>().join(",")
}

/// Largest deviation of cubic polynomials between waypoints from the motion. It is evaluated at the middles between
/// them, because the error of such a polynomial is largest there.
fn interpolation_error(series: &FourierExcitation, step: f64) -> f64 {
    let period = 1.0 / series.base_frequency;
    let intervals = (period / step).ceil() as u64;
    let at_middle = |k: u64| {
        let from = k as f64 * step;
        let (start, end) = (state_at(series, from), state_at(series, from + step));
        let middle = state_at(series, from + 0.5 * step);
        let error = |j: usize| {
            let cubic = 0.5 * (start[j][0] + end[j][0]) + 0.125 * step * (start[j][1] - end[j][1]);
            (cubic - middle[j][0]).abs()
        };
        (0..start.len()).map(error).fold(0.0, f64::max)
    };
    (0..intervals).map(at_middle).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    /// The error is the fourth derivative of the motion times the fourth power of the step, divided by 384: sixteen
    /// times less for half the step.
    #[test]
    fn the_error_of_waypoints_is_of_fourth_order() {
        let series = er3a().excitation.expect("Table 4.1");
        let (coarse, fine) = (interpolation_error(&series, 0.1), interpolation_error(&series, 0.05));
        assert!((coarse / fine / 16.0 - 1.0).abs() < 0.1, "{coarse} {fine}");
    }
}
