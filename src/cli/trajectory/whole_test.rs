//! `armwatch trajectory test`: a cycle of the whole test for a controller, like that of the simulator.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::{Value, json};

use super::arm::arm;
use super::check::{print_used, used_value};
use super::export::{header, steps};
use super::motion_check::{MotionCheck, Unchecked};
use super::surroundings::SurroundingsArgs;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::cycle::CycleArgs;
use crate::cli::shared::levels::Levels;
use crate::cli::shared::output;
use crate::cli::shared::plot::PlotFile;
use crate::cli::shared::position_columns::offsets_text;
use crate::cli::shared::programme::programme;
use crate::cli::shared::result_file::{refuse_source, result_file, write_lines};
use crate::report::figure::Figure;
use crate::report::trajectory::motion_figure;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::Stage;
use armwatch_simulate::plan::motion::MotionPiece;
use armwatch_simulate::plan::still_posture::axis_tilt;
use armwatch_simulate::plan::trajectory::{CyclePlan, PlanSettings, Segment, plan_cycle};
use armwatch_trajectory::limits::SampledMotion;

/// Cycles of the source's test.
const WHOLE_TEST: f64 = 24.0;
/// Instants per second for the comparison of the motion with limits, Hz.
const CHECK_RATE_HZ: f64 = 1000.0;
/// Points of a curve in the picture.
const POINTS: u32 = 1200;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory test --robot er3a -o test.csv
  armwatch trajectory test --robot er3a --trajectory er3a.json \\
      --rate-hz 500 -o test.csv --plot test.svg
  armwatch trajectory test --robot er3a --warming-s 0 --levels 2,4,6 \\
      -o daily.csv

One cycle has rest, the excitation (from the programme, else from the description, else random), each joint over
its range near full speed, each joint alone through its speed levels, all joints together for warming, and the
return home. A controller that repeats its programme needs one cycle; the whole test of the published method has
24.

The file has time_s and, for each joint, pos_1_rad, vel_1_rad_s, acc_1_rad_s2 (m for a prismatic joint), then
stage (0 between stages, 1 excitation, 2 friction, 3 warming), cycle, joint and level. Record these four with the
motion: then armwatch need not search for the stages in the export. Positions are those that the controller has at
its joints: the positions of the model minus position_offset_* of the description. They are on the joint side: gear
ratios, [transmission], and signs and units of a layout are not applied.

A test without a warming stage and with few levels is a daily check of one or two minutes.

If the programme or the test breaks a limit of the arm, the exit status is 1 and the command writes nothing.")]
pub(in crate::cli) struct WholeTestArgs {
    /// Arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
    /// Programme of `armwatch trajectory design` for the excitation
    #[arg(help_heading = "Motion", long, value_name = "PROGRAMME")]
    trajectory: Option<PathBuf>,
    /// Duration of the warming stage, s; 0 for none
    #[arg(help_heading = "Motion", long, default_value_t = 180.0, value_name = "S")]
    warming_s: f64,
    /// Speed levels of the friction stage, such as 2,4,6; none for no friction stage [default: all of the
    /// description]
    #[arg(help_heading = "Motion", long, value_name = "LEVELS")]
    levels: Option<Levels>,
    /// Seed of a random excitation, for an arm without one
    #[arg(help_heading = "Motion", long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    cycle: CycleArgs,
    /// Number of consecutive cycles
    #[arg(help_heading = "Motion", long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    cycles: u32,
    /// Rows per second, Hz
    #[arg(help_heading = "File", long, default_value_t = 250.0, value_name = "HZ")]
    rate_hz: f64,
    /// CSV file to write [default: only describe the test]
    #[arg(help_heading = "File", short, long, value_name = "FILE", value_parser = result_file())]
    output: Option<PathBuf>,
    /// Picture to write, .svg or .html
    #[arg(help_heading = "File", long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
    /// Write the file even if the motion breaks limits of the arm
    #[arg(help_heading = "File", long)]
    despite_broken_limits: bool,
    #[command(flatten)]
    surroundings: SurroundingsArgs,
}

pub(in crate::cli) fn whole_test(global: &Global, args: &WholeTestArgs) -> Result<u8, CliError> {
    let mut robot = arm(global, &args.robot)?;
    let limit = args.surroundings.limit(&robot)?;
    if let Some(path) = &args.trajectory {
        refuse_source(args.output.as_deref(), path, "the programme itself")?;
        robot.excitation = Some(programme(path, &robot)?.series);
    }
    let settings = PlanSettings {
        warming_s: args.cycle.warming_s(args.warming_s),
        seed: args.seed,
        levels: args.cycle.levels(args.levels.clone().map(|levels| levels.0)),
        excitation: args.cycle.excitation(&robot)?,
        posture: args.cycle.posture(),
        rest_s: args.cycle.rest_s(),
    };
    if !(0.0..=86_400.0).contains(&args.warming_s) {
        return Err(CliError::Usage(format!("--warming-s {}: 0 to 86400 s is possible", args.warming_s)));
    }
    let of_excitation = match &robot.excitation {
        Some(series) if args.trajectory.is_some() => {
            MotionCheck::of_series(&robot, series, limit.as_ref())?.broken()
        }
        _ => Vec::new(),
    };
    if refused(&of_excitation, args) {
        return Ok(EXIT_FOUND);
    }
    let plan = plan_cycle(&robot, &settings).map_err(|error| CliError::Usage(error.to_string()))?;
    let judged = MotionCheck::of_samples(&robot, &sampled(&robot, &plan), limit.as_ref())?;
    judged.print_unchecked();
    match global.json {
        true => output::json(&as_value(&plan, &robot, &judged, args)),
        false => describe(&plan, &robot, &judged, args),
    }
    if refused(&judged.broken(), args) {
        return Ok(EXIT_FOUND);
    }
    if let Some(path) = &args.output {
        write_rows(path, &robot, &plan, args)?;
        offsets_text(&robot).iter().for_each(|offsets| output::print_hint(offsets));
    }
    if let Some(plot) = &args.plot {
        plot.write(&picture(&robot, &plan))?;
    }
    Ok(EXIT_DONE)
}

/// Reports the broken limits; returns true if they forbid writing.
fn refused(broken: &[String], args: &WholeTestArgs) -> bool {
    broken.iter().for_each(|sentence| output::print_hint(sentence));
    let refused = !broken.is_empty() && !args.despite_broken_limits;
    if refused {
        output::print_hint(
            "nothing is written: the test breaks limits of the arm; --despite-broken-limits writes it anyway",
        );
    }
    refused
}

/// The cycle at enough instants per second for a check of its limits.
fn sampled(robot: &Robot, plan: &CyclePlan) -> SampledMotion {
    let n = robot.joint_count();
    let rows = (plan.duration * CHECK_RATE_HZ).ceil() as u64;
    let mut motion = SampledMotion { positions: vec![Vec::new(); n], ..SampledMotion::default() };
    let (mut velocities, mut accelerations) = (vec![Vec::new(); n], vec![Vec::new(); n]);
    for k in 0..=rows {
        let time = k as f64 / CHECK_RATE_HZ;
        let state = segment_at(plan, time).state_at(time);
        motion.times.push(time);
        for j in 0..n {
            motion.positions[j].push(state.position[j]);
            velocities[j].push(state.velocity[j]);
            accelerations[j].push(state.acceleration[j]);
        }
    }
    SampledMotion { velocities: Some(velocities), accelerations: Some(accelerations), ..motion }
}

fn write_rows(path: &Path, robot: &Robot, plan: &CyclePlan, args: &WholeTestArgs) -> Result<(), CliError> {
    let steps = steps(args.rate_hz, plan.duration * f64::from(args.cycles))?;
    let row = |k: u64| {
        let time = k as f64 / args.rate_hz;
        let cycle = ((time / plan.duration) as u32).min(args.cycles - 1);
        let within = time - f64::from(cycle) * plan.duration;
        let segment = segment_at(plan, within);
        let state = segment.state_at(within);
        let mut cells = vec![time.to_string()];
        for (j, joint) in robot.joints.iter().enumerate() {
            let position = joint.recorded_position(state.position[j]);
            let of_joint = [position, state.velocity[j], state.acceleration[j]];
            cells.extend(of_joint.map(|value| value.to_string()));
        }
        let signal = segment.signal.map_or((0, 0), |of| (of.joint.number(), usize::from(of.level)));
        let signals = [usize::from(segment.stage.number()), cycle as usize + 1, signal.0, signal.1];
        cells.extend(signals.map(|number| number.to_string()));
        cells.join(",")
    };
    let header = header(robot, false) + ",stage,cycle,joint,level";
    write_lines(path, std::iter::once(header).chain((0..=steps).map(row)))
}

/// The motion at a time within the cycle, s.
fn segment_at(plan: &CyclePlan, time: f64) -> &Segment {
    &plan.segments[plan.segments.partition_point(|segment| segment.start <= time).saturating_sub(1)]
}

/// A stage of the cycle: its name, its start and the duration of its motions, s.
fn stages(plan: &CyclePlan) -> Vec<(Stage, f64, f64)> {
    let of = |stage: Stage| {
        let own = || plan.segments.iter().filter(move |segment| segment.stage == stage);
        let lasts: f64 = own().map(|segment| segment.duration).sum();
        own().next().map(|first| (stage, first.start, lasts))
    };
    [Stage::Excitation, Stage::Friction, Stage::Warming, Stage::Between].into_iter().filter_map(of).collect()
}

fn describe(plan: &CyclePlan, robot: &Robot, judged: &MotionCheck<'_>, args: &WholeTestArgs) {
    let rows: Vec<Vec<String>> = stages(plan)
        .into_iter()
        .map(|(stage, begins, lasts)| vec![stage.to_string(), format!("{begins:.1}"), format!("{lasts:.1}")])
        .collect();
    output::print_table(&["stage", "begins, s", "motions last, s"], &rows, &[]);
    output::line("");
    print_friction(&friction(plan, robot));
    print_used(robot, &judged.check);
    judged.print();
    output::line("");
    output::line(&format!(
        "one cycle: {:.1} s; {} of them: {}; {WHOLE_TEST:.0}: {}",
        plan.duration,
        args.cycles,
        hours(plan.duration * f64::from(args.cycles)),
        hours(plan.duration * WHOLE_TEST)
    ));
    judged.hints().iter().for_each(|hint| output::print_hint(hint));
}

/// The friction test of one joint.
struct JointFrictionTest {
    joint: JointIndex,
    /// Angle of its axis from the vertical, rad.
    tilt: f64,
    /// Positions of the other joints, rad (m).
    posture: Vec<f64>,
    /// Speed, rad/s (m/s), plateaus, and duration of each, s.
    levels: Vec<(f64, u32, f64)>,
}

fn friction(plan: &CyclePlan, robot: &Robot) -> Vec<JointFrictionTest> {
    let of = |joint: JointIndex| {
        let own = plan.segments.iter().filter_map(|segment| match segment.motion {
            MotionPiece::Plateaus(plateaus) if plateaus.joint == joint.index() => Some(plateaus),
            _ => None,
        });
        let own: Vec<_> = own.collect();
        own.first().map(|first| JointFrictionTest {
            joint,
            tilt: axis_tilt(robot, joint, &first.posture),
            posture: first.posture[..robot.joint_count()].to_vec(),
            levels: own.iter().map(|of| (of.stroke.speed, of.strokes, of.stroke.plateau_s)).collect(),
        })
    };
    robot.joint_indices().filter_map(of).collect()
}

/// Largest tilt with constant gravity torque, rad.
const STILL: f64 = 1e-6;

fn print_friction(tests: &[JointFrictionTest]) {
    if tests.is_empty() {
        return;
    }
    let list = |of: &mut dyn Iterator<Item = String>| of.collect::<Vec<_>>().join(", ");
    let rows: Vec<Vec<String>> = tests
        .iter()
        .map(|test| {
            let held = test.posture.iter().enumerate().map(|(j, q)| match j == test.joint.index() {
                true => "*".to_owned(),
                false => format!("{q:.2}"),
            });
            vec![
                test.joint.to_string(),
                (if test.tilt < STILL { "still" } else { "moves" }).to_owned(),
                list(&mut held.into_iter()),
                list(&mut test.levels.iter().map(|(speed, ..)| format!("{speed:.3}"))),
                list(&mut test.levels.iter().map(|(_, count, lasts)| format!("{count} x {lasts:.2}"))),
            ]
        })
        .collect();
    output::print_table(
        &["friction of joint", "gravity", "posture", "at constant speeds", "plateaus, s"],
        &rows,
        &[],
    );
    output::line("");
}

fn hours(seconds: f64) -> String {
    let minutes = (seconds / 60.0).round() as u64;
    match (minutes / 60, minutes % 60) {
        (0, 0) => format!("{seconds:.0} s"),
        (0, minutes) => format!("{minutes} min"),
        (hours, minutes) => format!("{hours} h {minutes} min"),
    }
}

fn as_value(plan: &CyclePlan, robot: &Robot, judged: &MotionCheck<'_>, args: &WholeTestArgs) -> Value {
    let friction = friction(plan, robot).into_iter().map(|test| {
        let level = |&(speed, count, lasts): &(f64, u32, f64)| json!({ "speed": speed, "plateaus": count, "plateau_s": lasts });
        json!({
            "joint": test.joint.number(), "gravity_is_still": test.tilt < STILL, "axis_tilt_rad": test.tilt,
            "posture": test.posture, "levels": test.levels.iter().map(level).collect::<Vec<_>>(),
        })
    });
    let stages = stages(plan).into_iter().map(
        |(stage, begins, lasts)| json!({ "stage": stage.to_string(), "begins_s": begins, "lasts_s": lasts }),
    );
    json!({
        "cycle_s": plan.duration, "cycles": args.cycles, "stages": stages.collect::<Vec<_>>(),
        "friction": friction.collect::<Vec<_>>(),
        "joints": used_value(&judged.check), "torques": judged.torque_value(), "clearances": judged.clearance_value(),
        "broken": judged.broken_value(),
        "not_judged": judged.unchecked().iter().map(Unchecked::as_value).collect::<Vec<_>>(),
    })
}

fn picture(robot: &Robot, plan: &CyclePlan) -> Figure {
    let n = robot.joint_count();
    let times: Vec<f64> = (0..=POINTS).map(|k| plan.duration * f64::from(k) / f64::from(POINTS)).collect();
    let state = |time: &f64| {
        let state = segment_at(plan, *time).state_at(*time);
        (0..n).map(|j| [state.position[j], state.velocity[j], state.acceleration[j]]).collect()
    };
    let states: Vec<Vec<[f64; 3]>> = times.iter().map(state).collect();
    let begins = stages(plan).into_iter().filter(|(stage, ..)| *stage != Stage::Between);
    let subtitle: Vec<String> =
        begins.map(|(stage, begins, lasts)| format!("{stage} from {begins:.0} s, {lasts:.0} s")).collect();
    let title = format!("A cycle of the test of {}, {:.0} s", robot.model, plan.duration);
    motion_figure(robot, &times, &states, title, subtitle.join("; "))
}
