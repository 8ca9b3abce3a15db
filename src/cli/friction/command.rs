//! `armwatch friction`: friction points and their warm-up fits, computed again from stored data.

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use super::index;
use super::index::JointIndexSeries;
use crate::cli::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use crate::cli::shared::life::RobotLife;
use crate::cli::shared::output;
use crate::cli::shared::plot::{PlotFile, index_limits};
use crate::cli::shared::result_file::{result_file, write_lines};
use crate::cli::shared::selection::{named_runs, runs_of};
use crate::report::figure::Figure;
use crate::report::friction::{
    CyclePoints, RunCurves, friction_figure, friction_speed_figure, run_comparison_figure,
};
use armwatch_method::analyse_run::warm_up_fits;
use armwatch_method::friction::warm_up::warm_up_torque;
use armwatch_model::analysis::{Decay, Estimate, FrictionPoint, WarmUpFit};
use armwatch_model::text;
use armwatch_store::{RunRow, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch friction --run 3
  armwatch friction --robot Left --joint 3
  armwatch friction --run 3 --run 4 --speed 0.6 --plot friction.svg
  armwatch friction --run 3 --plot curves.html --over speed
  armwatch friction --robot Left --plot runs.svg --over runs
  armwatch friction --robot Left -o points.csv
  armwatch friction --robot Left --index --plot index.svg
  armwatch friction --run 3 --json | jq '{joint, speed_fraction, a_nm, t1_min}'

The command fits the curve a + b exp(-t/t1) + c exp(-t/t2) per joint and speed to the friction of both directions
over the minutes since the start of the run. The fit uses the points of all chosen runs, each counted from its own
start. model is the number of exponentials that the points support: double, single or constant. A number in
brackets is the standard error. A fast exponential that only the first cycle shows has no standard error (-). Only
its value at the first point and its longest possible time constant are known (--json: c_first_nm, t2_max_min).
The command stores nothing. The view warmup_fits has the fits of each run, and of all runs of a robot at the
reference speed.

A picture of several runs shows each run in its own colour at one speed. A picture of a single run shows all
speeds.

--index shows the friction index of each run instead: friction relative to the baseline of the joint at equal
speed and thermal state, with its 95 % interval, next to friction as measured. The command then prints statistics
of the index about its mean over the runs: the lag-1 autocorrelation (standard error in brackets), the probability
that white noise has this much memory (Ljung-Box), the resulting fitness for control charts, and the share of the
variance of measured friction between runs that warm-up and ambient temperature explain. A worn joint has memory.
Fewer than 8 runs give no statistics. thermal state is the source of the correction: motion, motor_temperature or
ambient_and_motion; docs/method.md has the rules.

-o writes the points as CSV: robot, run_id, cycle, minute, joint, speed_fraction, speed_rad_s, direction,
torque_nm, std_nm, samples, gravity, fit_nm. --json prints one object per joint and speed, with its fit and its
points.")]
#[command(group(ArgGroup::new("recordings").args(["runs", "robots"]).required(true).multiple(true)))]
pub(in crate::cli) struct FrictionArgs {
    /// Run whose points are used; may be repeated
    #[arg(help_heading = "Selection", long = "run", value_name = "RUN")]
    runs: Vec<i64>,
    /// Robot, with all its complete runs; may be repeated
    #[arg(help_heading = "Selection", long = "robot", value_name = "NAME")]
    robots: Vec<String>,
    /// Use only this joint, from 1
    #[arg(help_heading = "Selection", long, value_name = "JOINT", value_parser = clap::value_parser!(u8).range(1..))]
    joint: Option<u8>,
    /// Use only the speed level nearest to this fraction of the largest speed, above 0 and at most 1
    #[arg(help_heading = "Selection", long, value_name = "FRACTION", value_parser = fraction)]
    speed: Option<f64>,
    /// Write the points as CSV into this file
    #[arg(help_heading = "Files", short, long, value_name = "FILE", value_parser = result_file())]
    output: Option<PathBuf>,
    /// Draw points and curves into this file, .svg or .html
    #[arg(help_heading = "Files", long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
    /// Show the friction index by run, with a test for white noise from run to run
    #[arg(help_heading = "Display", long, requires = "robots", conflicts_with_all = ["runs", "speed", "output"])]
    index: bool,
    /// Horizontal axis of the picture [default: time for one run, runs for several]
    #[arg(help_heading = "Display", long, value_enum, requires = "plot")]
    over: Option<OverArg>,
}

/// Reads a fraction of the largest speed.
fn fraction(text: &str) -> Result<f64, String> {
    match text.trim_end_matches([' ', '%']).parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1.0 && !text.contains('%') => Ok(value),
        Ok(percent) if percent > 0.0 && percent <= 100.0 => Err(format!(
            "a fraction of the largest speed is above 0 and at most 1; did you mean {}?",
            percent / 100.0
        )),
        _ => Err("a fraction of the largest speed is above 0 and at most 1, such as 0.6".into()),
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OverArg {
    /// Minutes since the start of the run, all speeds, with one curve fitted to all chosen runs
    Time,
    /// Speed, for some cycles from cold to warm
    Speed,
    /// Minutes at one speed, each run with its own colour and curve
    Runs,
}

/// Speed for comparing runs, like in figure 5.23 of the thesis, as a fraction of the largest.
const COMPARED_SPEED: f64 = 0.6;

/// A friction point with its source.
struct Sourced {
    robot: String,
    run_id: i64,
    /// Day of the run's start.
    day: String,
    cycle: u32,
    point: FrictionPoint,
}

pub(in crate::cli) fn friction(global: &Global, args: &FrictionArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    if args.index {
        let series = runtime()?.block_on(async {
            let store = open_to_read(&config).await?;
            let done = index_series(args, &store).await;
            store.close().await?;
            done
        })?;
        if let Some(plot) = &args.plot {
            plot.write(&index::figure(&series, index_limits(&config), &args.robots.join(", ")))?;
        }
        index::print(&series, global.json);
        return Ok(EXIT_DONE);
    }
    let (names, points) = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = chosen_points(args, &store).await;
        store.close().await?;
        done
    })?;
    let bare: Vec<FrictionPoint> = points.iter().map(|of| of.point).collect();
    let fits = warm_up_fits(&bare);
    if let Some(plot) = &args.plot {
        plot.write(&figure(args, &names, &points, &bare, &fits))?;
    }
    if let Some(path) = &args.output {
        write_lines(path, csv_lines(&points, &fits))?;
    }
    if global.json {
        levels(&bare).into_iter().for_each(|level| output::json(&as_value(level, &points, &fits)));
    } else {
        output::block(&as_text(&names, &bare, &fits));
    }
    Ok(EXIT_DONE)
}

async fn index_series(args: &FrictionArgs, store: &Store) -> Result<Vec<JointIndexSeries>, CliError> {
    let known = store.runs().await?;
    let mut series = Vec::new();
    for robot in &args.robots {
        runs_of(&known, robot)?;
        let mut rows = store.friction_indices(robot).await?;
        rows.retain(|row| args.joint.is_none_or(|joint| row.joint.number() == usize::from(joint)));
        let life = RobotLife::read(store, robot).await?;
        series.extend(JointIndexSeries::of(robot, &rows, &store.thermal_sources(robot).await?, &life));
    }
    if series.is_empty() {
        refuse_missing_joint(store, args.robots.iter().map(String::as_str), args.joint).await?;
        return Err(CliError::Usage(format!(
            "{} has no friction index: it needs as many runs as the baseline, each with six or more cycles \
            with friction stages, in which friction falls while the joint warms; the view friction_map has \
            the joints with a map",
            args.robots.join(", ")
        )));
    }
    Ok(series)
}

async fn chosen_points(args: &FrictionArgs, store: &Store) -> Result<(String, Vec<Sourced>), CliError> {
    let known = store.runs().await?;
    let mut runs: Vec<&RunRow> = Vec::new();
    for run in &args.runs {
        runs.extend(named_runs(&known, &run.to_string())?);
    }
    for robot in &args.robots {
        runs.extend(runs_of(&known, robot)?);
    }
    runs.sort_by_key(|run| (run.started_at, run.run_id));
    runs.dedup_by_key(|run| run.run_id);
    let mut points = Vec::new();
    for run in &runs {
        let of_run = store.friction_points(run.run_id).await?;
        points.extend(of_run.into_iter().map(|of| Sourced {
            robot: run.robot.clone(),
            run_id: run.run_id,
            day: run.started_at.strftime("%Y-%m-%d").to_string(),
            cycle: of.cycle,
            point: of.point,
        }));
    }
    keep_chosen(args, &mut points);
    if points.is_empty() {
        refuse_missing_joint(store, runs.iter().map(|run| run.robot.as_str()), args.joint).await?;
        let of_joint = args.joint.map_or_else(String::new, |joint| format!(" of joint {joint}"));
        return Err(CliError::Usage(format!(
            "there are no friction points{of_joint}: no cycle of {} has a friction stage with plateaus; \
             `SELECT cycle, reason, remarks FROM cycles` says why",
            names(&runs)
        )));
    }
    Ok((names(&runs), points))
}

/// Refuses a joint that none of the robots has. The number of joints is unknown for a robot without a complete test.
async fn refuse_missing_joint<'r>(
    store: &Store,
    robots: impl Iterator<Item = &'r str>,
    joint: Option<u8>,
) -> Result<(), CliError> {
    let Some(joint) = joint.map(usize::from) else { return Ok(()) };
    let health = store.fleet_health().await?;
    let joints = |robot: &str| {
        health.iter().filter(|row| row.robot == robot).map(|row| row.joint.number()).max().unwrap_or(0)
    };
    let robots: BTreeSet<&str> = robots.collect();
    let counts: Vec<(&str, usize)> = robots.into_iter().map(|robot| (robot, joints(robot))).collect();
    if counts.iter().any(|(_, count)| *count == 0 || *count >= joint) {
        return Ok(());
    }
    let told =
        counts.iter().map(|(robot, count)| format!("{robot} has {}", output::counted(*count, "joint")));
    let told: Vec<String> = told.collect();
    Err(CliError::Usage(format!("{}, but no joint {joint}", told.join(", "))))
}

fn keep_chosen(args: &FrictionArgs, points: &mut Vec<Sourced>) {
    points.retain(|of| args.joint.is_none_or(|joint| of.point.joint.number() == usize::from(joint)));
    if let Some(speed) = args.speed {
        let distance = |level: f64| (level - speed).abs();
        let levels = points.iter().map(|of| of.point.speed_fraction);
        let nearest = levels.min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        points.retain(|of| Some(of.point.speed_fraction) == nearest);
    }
}

fn names(runs: &[&RunRow]) -> String {
    let mut robots: Vec<&str> = runs.iter().map(|run| run.robot.as_str()).collect();
    robots.sort_unstable();
    robots.dedup();
    match runs {
        [run] => format!("{}, run {}", run.robot, run.run_id),
        _ => format!("{}, {} runs", robots.join(", "), runs.len()),
    }
}

/// Joints and speed levels with points.
fn levels(points: &[FrictionPoint]) -> Vec<(usize, f64)> {
    let mut levels: Vec<(usize, f64)> =
        points.iter().map(|point| (point.joint.number(), point.speed_fraction)).collect();
    levels.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    levels.dedup();
    levels
}

fn is_of(level: (usize, f64), joint: usize, speed_fraction: f64) -> bool {
    level.0 == joint && level.1.total_cmp(&speed_fraction).is_eq()
}

fn fit_of(fits: &[WarmUpFit], level: (usize, f64)) -> Option<&WarmUpFit> {
    fits.iter().find(|fit| is_of(level, fit.joint.number(), fit.speed_fraction))
}

/// An estimate with its standard error in brackets, or `-` without one.
fn shown(estimate: Estimate) -> String {
    let number = |value: f64| if value.is_finite() { format!("{value:.4}") } else { "-".to_owned() };
    format!("{} ({})", number(estimate.value), number(estimate.std_error))
}

fn as_text(names: &str, points: &[FrictionPoint], fits: &[WarmUpFit]) -> String {
    let decay = |decay: &Option<Decay>| {
        decay.map_or_else(
            || ["-".to_string(), "-".to_string()],
            |decay| [shown(decay.amplitude), shown(decay.time_constant)],
        )
    };
    let row = |level: (usize, f64)| {
        let of_level = points.iter().filter(|p| is_of(level, p.joint.number(), p.speed_fraction)).count();
        let mut cells = vec![level.0.to_string(), format!("{:.2}", level.1), of_level.to_string()];
        match fit_of(fits, level) {
            Some(fit) => {
                cells.extend([fit.model.name().to_string(), shown(fit.a)]);
                cells.extend(decay(&fit.slow).into_iter().chain(decay(&fit.fast)));
                cells.push(format!("{:.4}", fit.rmsd));
            }
            None => cells.push("too few points".into()),
        }
        cells
    };
    let header = ["joint", "speed", "points", "model", "a_nm", "b_nm", "t1_min", "c_nm", "t2_min", "rmsd_nm"];
    let rows: Vec<Vec<String>> = levels(points).into_iter().map(row).collect();
    format!("friction over time: {}\n{}", text::shown(names), output::table(&header, &rows))
}

fn figure(
    args: &FrictionArgs,
    names: &str,
    points: &[Sourced],
    bare: &[FrictionPoint],
    fits: &[WarmUpFit],
) -> Figure {
    const POINTS: &str = "mean friction on constant-speed plateaus, gravity removed";
    let runs = points.chunk_by(|a, b| a.run_id == b.run_id).count();
    // points of several runs in one colour would make wear look like scatter
    match args.over.unwrap_or(if runs > 1 { OverArg::Runs } else { OverArg::Time }) {
        OverArg::Time => {
            let mixed = match runs {
                1 => String::new(),
                _ => format!(" to {runs} runs together"),
            };
            let curves = format!(
                "curves a + b exp(-t/t1) + c exp(-t/t2) fitted{mixed} as far as the points support them"
            );
            friction_figure(bare, fits, format!("{names}: friction over time"), format!("{POINTS}; {curves}"))
        }
        OverArg::Runs => {
            let title = format!("{names}: friction over time by run");
            let curves =
                "means of both directions; curves a + b exp(-t/t1) + c exp(-t/t2) fitted to each run";
            run_comparison_figure(&run_curves(points), title, format!("{POINTS}, {curves}"))
        }
        OverArg::Speed => {
            let cycles = points.chunk_by(|a, b| (a.run_id, a.cycle) == (b.run_id, b.cycle));
            let cycles: Vec<CyclePoints> = cycles
                .map(|of| CyclePoints {
                    label: match runs {
                        1 => format!("cycle {}", of[0].cycle),
                        _ => format!("run {}, cycle {}", of[0].run_id, of[0].cycle),
                    },
                    points: of.iter().map(|of| of.point).collect(),
                })
                .collect();
            let both = "both directions together";
            let title = format!("{names}: friction over speed");
            friction_speed_figure(&cycles, title, format!("{POINTS}, {both}"))
        }
    }
}

/// Points of each run at the level nearest to [`COMPARED_SPEED`], unless `--speed` selects one.
fn run_curves(points: &[Sourced]) -> Vec<RunCurves> {
    let one_robot = points.windows(2).all(|pair| pair[0].robot == pair[1].robot);
    let distance = |of: &Sourced| (of.point.speed_fraction - COMPARED_SPEED).abs();
    points
        .chunk_by(|a, b| a.run_id == b.run_id)
        .map(|of_run| {
            let nearest = of_run.iter().map(distance).fold(f64::INFINITY, f64::min);
            let at_level = |of: &&Sourced| distance(of) <= nearest;
            let points: Vec<FrictionPoint> = of_run.iter().filter(at_level).map(|of| of.point).collect();
            let fits = warm_up_fits(&points);
            let Sourced { robot, run_id, day, .. } = &of_run[0];
            let label = if one_robot {
                format!("run {run_id}, {day}")
            } else {
                format!("{robot}, run {run_id}, {day}")
            };
            RunCurves { label, points, fits }
        })
        .collect()
}

fn csv_lines<'a>(points: &'a [Sourced], fits: &'a [WarmUpFit]) -> impl Iterator<Item = String> + use<'a> {
    const HEADER: &str = "robot,run_id,cycle,minute,joint,speed_fraction,speed_rad_s,direction,torque_nm,std_nm,\
                          samples,gravity,fit_nm";
    let line = move |Sourced { robot, run_id, cycle, point, .. }: &Sourced| {
        let minute = point.time / 60.0;
        let fit = fit_of(fits, (point.joint.number(), point.speed_fraction));
        let fit = fit.map_or_else(String::new, |fit| warm_up_torque(fit, minute).to_string());
        let quoted = match robot.contains([',', '"', '\n']) {
            true => format!("\"{}\"", robot.replace('"', "\"\"")),
            false => robot.clone(),
        };
        format!(
            "{quoted},{run_id},{cycle},{minute},{},{},{},{},{},{},{},{},{fit}",
            point.joint,
            point.speed_fraction,
            point.speed,
            point.direction,
            point.torque,
            if point.std.is_finite() { point.std.to_string() } else { String::new() },
            point.samples,
            point.gravity.name(),
        )
    };
    std::iter::once(HEADER.to_string()).chain(points.iter().map(line))
}

fn as_value(level: (usize, f64), points: &[Sourced], fits: &[WarmUpFit]) -> serde_json::Value {
    let of_level = points.iter().filter(|of| is_of(level, of.point.joint.number(), of.point.speed_fraction));
    let points: Vec<serde_json::Value> = of_level
        .map(|Sourced { robot, run_id, cycle, point, .. }| {
            json!({
                "robot": robot, "run_id": run_id, "cycle": cycle, "minute": point.time / 60.0,
                "speed_rad_s": point.speed, "direction": point.direction, "torque_nm": point.torque,
                "std_nm": point.std, "samples": point.samples, "gravity": point.gravity.name(),
            })
        })
        .collect();
    let fit = fit_of(fits, level);
    let slow = fit.and_then(|fit| fit.slow);
    let fast = fit.and_then(|fit| fit.fast);
    let mut value = json!({"joint": level.0, "speed_fraction": level.1, "points": points});
    value["model"] = json!(fit.map(|fit| fit.model.name()));
    value["rmsd_nm"] = json!(fit.map(|fit| fit.rmsd));
    value["samples"] = json!(fit.map(|fit| fit.samples));
    let estimates = [
        ("a", "nm", fit.map(|fit| fit.a)),
        ("b", "nm", slow.map(|decay| decay.amplitude)),
        ("t1", "min", slow.map(|decay| decay.time_constant)),
        ("c", "nm", fast.map(|decay| decay.amplitude)),
        ("t2", "min", fast.map(|decay| decay.time_constant)),
    ];
    for (name, unit, estimate) in estimates {
        value[format!("{name}_{unit}")] = json!(estimate.map(|estimate| estimate.value));
        value[format!("{name}_std_error_{unit}")] = json!(estimate.map(|estimate| estimate.std_error));
    }
    let shown = fit.and_then(|fit| fit.fast_shown);
    value["c_first_nm"] = json!(shown.map(|shown| shown.at_first.value));
    value["c_first_std_error_nm"] = json!(shown.map(|shown| shown.at_first.std_error));
    value["t2_max_min"] = json!(shown.map(|shown| shown.longest));
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_without_standard_error_has_a_dash_in_its_place() {
        assert_eq!(shown(Estimate { value: 4.298_96, std_error: f64::NAN }), "4.2990 (-)");
        assert_eq!(shown(Estimate { value: 8.564_1, std_error: 0.080_4 }), "8.5641 (0.0804)");
    }
}
