//! `armwatch simulate`: exports of a described arm.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use super::arm_options::ArmOptions;
use super::export_format::export_format;
use super::files;
use super::stage_signal::StageSignalArg;
use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::cycle::CycleArgs;
use crate::cli::shared::levels::Levels;
use crate::cli::shared::load::LoadArgs;
use crate::cli::shared::output;
use crate::cli::shared::paths::not_written;
use crate::cli::shared::programme::programme;
use crate::cli::shared::shipped_robot::shipped_robot;
use armwatch_config::{read_layout, read_robot};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_simulate::arm::fault::{Fault, FaultKind};
use armwatch_simulate::arm::friction::FrictionShape;
use armwatch_simulate::arm::load::Load;
use armwatch_simulate::error::SimulateError;
use armwatch_simulate::run::recording::Clock;
use armwatch_simulate::run::temperatures::{TemperatureColumns, TemperatureSettings};
use armwatch_simulate::{SimulationSettings, not_simulated, simulate_run};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch simulate -o exports
  armwatch simulate -o exports --name R07 --runs 12 --cycles 8 \\
      --fault wear:joint=3,from=6,rate=0.03
  armwatch simulate -o exports --runs 6 --cycles 8 \\
      --fault step:joint=2,from=4,cycle=5,size=0.25
  armwatch simulate -o exports --cycles 8 \\
      --fault jitter:joint=5,from=1,size=0.12
  armwatch simulate -o exports --full-test --gzip
  armwatch simulate -o exports --robot config/robots/scara.toml
  armwatch simulate -o exports --layout config/exports/motor_side.toml
  armwatch simulate -o exports --stage-signal analogue
  armwatch simulate -o exports --runs 12 --cycles 8 --temperatures \\
      --ambient-std-k 3
  armwatch simulate -o exports --clock alternating \\
      --friction-shape late-turn-over
  armwatch simulate -o exports --trajectory er3a.json
  armwatch simulate -o exports --cycles 1 --warming-s 0 --levels 2,4,6
  armwatch simulate -o inbox --cycles 2 --real-time 1
  armwatch simulate -o exports --stiffness 1=20000,2=25000 \\
      --torque-noise-correlation 0.6
  armwatch simulate -o exports --load-mass-kg 3 --load-centre-m 0,0,0.08
  armwatch simulate -o exports --rate-hz 250 --following-lag-s 0.02 \\
      --command-delay-s 0.008 --torque-step 0.05 --torque-hum 50=0.1
  armwatch simulate -o exports --friction-shape stiction \\
      --friction-direction 0.1 --friction-load 0.03 --ripple 1=0.02,2=0.05
  armwatch simulate -o exports --cycles 12 --rest-s 600 --heating-by-work
  armwatch simulate -o exports --parts points,friction --dead-s 1
  armwatch simulate -o exports --robots 20 --unit-spread 0.2 --runs 52 \\
      --interval-h 168 --season-k 6 --day-k 2 --shifts 6-14,14-22

Faults, each with from= (first run) and optionally to= (last run):
  wear:joint=,rate=[,cap=][,part=]  friction grows by a fraction per run; part:
                               all, coulomb, viscous, linear (f1, f2), load
  step:joint=,size=[,cycle=]   friction grows suddenly
  jitter:joint=,size=          friction varies from cycle to cycle
  warm-up:[joint=,]factor=     slow time constant of the warm-up
  load:kg=[,centre=X/Y/Z]      a point mass at the tool frame
  offset:joint=,nm=            offset of the torque signal
  gain:joint=,size=            gain error of the torque signal, a fraction
  noise:joint=,factor=         noise of the torque signal
  zero:joint=,rad=             offset of the position signal
  saturation:joint=,nm=        limit of the torque signal
  delay:joint=,s=              the torque signal is late
  stuck:joint=                 the torque signal keeps its value
  backlash:joint=,rad=         play in the gear
  ripple:joint=,rate=          a ripple at the motor's turn grows
  contact:joint=,nm=[,cycle=]  a push from outside

Each run is one export in the native layout or the given one, with positions as the controller records them: without
position_offset_* of the description. The truth file NAME.truth.json next to it has the
simulated parameters, friction and faults. The same seed gives the same bytes. Existing exports of the same names
are replaced.")]
pub(in crate::cli) struct SimulateArgs {
    /// Folder for exports and truth files; created if missing
    #[arg(help_heading = "Exports", short, long, value_name = "DIR")]
    output: PathBuf,
    /// Robot description with nominal parameters [default: the shipped ER3A]
    #[arg(help_heading = "Arm and faults", long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Programme of `armwatch trajectory design`, instead of the excitation of the description
    #[arg(help_heading = "Recording", long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Stiffness of elastic gears, Nm/rad (N/m), such as 1=20000,3=15000: the export has motor positions, links move
    /// as planned
    #[arg(help_heading = "Arm and faults", long, value_name = "JOINT=STIFFNESS", value_delimiter = ',', value_parser = stiffness)]
    stiffness: Vec<(JointIndex, f64)>,
    /// Name of the robot, and prefix of the file names
    #[arg(help_heading = "Exports", long, default_value = "R01")]
    name: String,
    /// Seed of all random numbers
    #[arg(help_heading = "Exports", long, default_value_t = 1)]
    seed: u64,
    /// Number of runs, with one export each
    #[arg(help_heading = "Exports", long, default_value_t = 1)]
    runs: u32,
    /// Cycles per run [default: 5, with --full-test 24]
    #[arg(help_heading = "Recording", long)]
    cycles: Option<u32>,
    /// Rows per second, Hz [default: 50, with --full-test 250]
    #[arg(help_heading = "Recording", long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Duration of each warming stage, s [default: 20, with --full-test 180]
    #[arg(help_heading = "Recording", long, value_name = "S")]
    warming_s: Option<f64>,
    /// Speed levels of the friction stage, such as 2,4,6; none for no friction stage [default: all of the
    /// description]
    #[arg(help_heading = "Recording", long, value_name = "LEVELS")]
    levels: Option<Levels>,
    /// Simulate the whole two-hour test: 24 cycles at 250 Hz with 180 s of warming
    #[arg(help_heading = "Recording", long)]
    full_test: bool,
    /// Start of the first run, UTC, RFC 3339
    #[arg(help_heading = "Exports", long, default_value = "2026-01-05T08:47:00Z", value_name = "TIME")]
    start: jiff::Timestamp,
    /// Time from the start of a run to the start of the next, h
    #[arg(help_heading = "Exports", long, default_value_t = 24.0, value_name = "H")]
    interval_h: f64,
    /// Fault to simulate, such as wear:joint=3,from=6,rate=0.03 (from run 6, friction of joint 3 grows by 3 % of its
    /// healthy value per run); may be repeated
    #[arg(help_heading = "Arm and faults", long = "fault", value_name = "FAULT")]
    faults: Vec<Fault>,
    /// Standard deviation of the ambient temperature from run to run, K
    #[arg(help_heading = "Temperatures", long, default_value_t = 1.0, value_name = "K")]
    ambient_std_k: f64,
    /// Time between the cold start and the first row, s
    #[arg(help_heading = "Temperatures", long, default_value_t = 0.0, value_name = "S")]
    initial_warm_s: f64,
    /// Write .csv.gz instead of .csv
    #[arg(help_heading = "Exports", long)]
    gzip: bool,
    /// Layout of the exports: columns, units, signs and side of the gears, with all digits [default: native, rounded
    /// as by a controller]
    #[arg(help_heading = "Recording", long, value_name = "FILE")]
    layout: Option<PathBuf>,
    /// Write rows while the time passes, like a controller, at this multiple of real time; the export grows under its
    /// final name
    #[arg(help_heading = "Recording", long, value_name = "SPEED", value_parser = speed, conflicts_with = "gzip")]
    real_time: Option<f64>,
    /// Stage signal of the export; the other columns are those of the native layout, with all digits
    #[arg(help_heading = "Recording", long, value_enum, conflicts_with = "layout")]
    stage_signal: Option<StageSignalArg>,
    /// Simulate friction exactly as f1 to f4 of the description, always warm: no bump at low speed, no ripple, no
    /// warm-up. The true base parameters are then those of the description
    #[arg(help_heading = "Arm and faults", long)]
    plain_friction: bool,
    /// Shape of friction at reversal and breakaway
    #[arg(
        help_heading = "Arm and faults",
        long,
        value_enum,
        default_value = "gearbox",
        conflicts_with = "plain_friction"
    )]
    friction_shape: FrictionShapeArg,
    /// Intervals between rows; their mean is always that of the rate
    #[arg(help_heading = "Recording", long, value_enum, default_value = "even")]
    clock: ClockArg,
    /// Record temperatures like a drive: of each motor, ambient, or both
    #[arg(help_heading = "Temperatures", long, value_enum, value_name = "WHICH", num_args = 0..=1, default_missing_value = "both")]
    temperatures: Option<TemperaturesArg>,
    /// Resolution of recorded temperatures, K
    #[arg(
        help_heading = "Temperatures",
        long,
        default_value_t = 0.1,
        value_name = "K",
        requires = "temperatures"
    )]
    temperature_step_k: f64,
    /// Lag of the motor temperature behind the housing temperature, s
    #[arg(
        help_heading = "Temperatures",
        long,
        default_value_t = 600.0,
        value_name = "S",
        requires = "temperatures"
    )]
    temperature_lag_s: f64,
    #[command(flatten)]
    cycle: CycleArgs,
    #[command(flatten)]
    arm: ArmOptions,
    #[command(flatten)]
    load: LoadArgs,
    /// Folder for truth files [default: next to the exports]
    #[arg(help_heading = "Exports", long, value_name = "DIR")]
    truth: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TemperaturesArg {
    /// Motor of each joint
    Motor,
    /// Ambient
    Ambient,
    /// Motors and ambient
    Both,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FrictionShapeArg {
    /// Smooth within a few mrad/s, with a bump at low speed and a ripple
    Gearbox,
    /// Jumps with the sign of the speed
    Sign,
    /// Smooth within a few hundredths of a rad/s
    Smooth,
    /// Like smooth, but the last joint within some tenths of a rad/s
    LateTurnOver,
    /// Breakaway torque of 1.5 times the Coulomb torque
    Stiction,
    /// Reverses over a travel of 2 mrad instead of over a speed
    Presliding,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ClockArg {
    /// Equal steps
    Even,
    /// Alternating steps of 10 and 12 ms at 91 Hz, like many loggers
    Alternating,
    /// Random deviations of a tenth of the step
    Jittering,
}

/// Steps of 10 and 12 ms alternately: 11 ms plus and minus this fraction.
const ALTERNATING_PART: f64 = 1.0 / 11.0;
/// Standard deviation of an instant of [`ClockArg::Jittering`], steps.
const JITTER_STEPS: f64 = 0.1;

fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed: &f64| *speed > 0.0 && speed.is_finite());
    speed.ok_or_else(|| "above 0, such as 1 for real time".into())
}

fn stiffness(text: &str) -> Result<(JointIndex, f64), String> {
    let parsed = text.split_once('=').and_then(|(joint, stiffness)| {
        Some((JointIndex::from_number(joint.trim().parse().ok()?)?, stiffness.trim().parse().ok()?))
    });
    parsed.ok_or_else(|| "a joint and its stiffness, such as 1=20000".into())
}

pub(in crate::cli) fn simulate(global: &Global, args: &SimulateArgs) -> Result<u8, CliError> {
    let robot = match &args.robot {
        Some(path) => read_robot(path)?,
        None => shipped_robot()?,
    };
    let robot = match &args.trajectory {
        Some(path) => with_trajectory(robot, path)?,
        None => robot,
    };
    let mut settings = args.settings(&robot)?;
    if let Some(path) = &args.layout {
        settings.format = Some(export_format(&read_layout(path)?, &robot, settings.temperatures.columns)?);
    }
    if let Some(signal) = args.stage_signal {
        settings.format = Some(export_format(&signal.layout()?, &robot, settings.temperatures.columns)?);
    }
    let named = |robot_name| SimulationSettings { robot_name, ..settings.clone() };
    let robots: Vec<SimulationSettings> = args.arm.names(&args.name)?.into_iter().map(named).collect();
    let replaced = files::replaced(robot.joint_count(), &robots, &args.output)?;
    replaced.iter().for_each(|sentence| output::print_hint(sentence));
    let unseen = settings.faults.iter().filter_map(|fault| unseen(fault, settings.runs, settings.cycles));
    unseen.for_each(|sentence| output::print_hint(&sentence));
    not_simulated(&robot).iter().for_each(|sentence| output::print_hint(sentence));
    for settings in &robots {
        for run in 0..settings.runs {
            simulate_one(&robot, settings, run, args, global.json)?;
        }
    }
    Ok(EXIT_DONE)
}

/// Why a fault does not occur in `runs` runs of `cycles` cycles, and the remedy.
fn unseen(fault: &Fault, runs: u32, cycles: u32) -> Option<String> {
    let last = fault.last_run.map_or(runs, |last| last.min(runs));
    let (why, remedy) = match fault.kind {
        _ if fault.start_run > runs => (
            format!("begins with run {}, and there {}", fault.start_run, are(runs, "run")),
            "more --runs, or an earlier from=",
        ),
        _ if fault.start_run > last => {
            (format!("begins with run {} and ends with run {last}", fault.start_run), "a later to=")
        }
        // a step is in all of every later run
        FaultKind::Step { cycle, .. } if cycle > cycles && fault.start_run == last => (
            format!("begins with cycle {cycle}, but a run has only {cycles}"),
            "more --cycles, or an earlier cycle=",
        ),
        FaultKind::Contact { cycle, .. } if cycle > cycles => (
            format!("is in cycle {cycle}, but a run has only {cycles}"),
            "more --cycles, or an earlier cycle=",
        ),
        _ => return None,
    };
    Some(format!("--fault {fault} affects no export: it {why}; give {remedy}"))
}

fn are(count: u32, noun: &str) -> String {
    format!("{} {}", if count == 1 { "is" } else { "are" }, output::counted(count, noun))
}

/// The arm with the motion of a programme instead of its description's excitation.
fn with_trajectory(mut robot: Robot, path: &Path) -> Result<Robot, CliError> {
    robot.excitation = Some(programme(path, &robot)?.series);
    Ok(robot)
}

impl SimulateArgs {
    fn settings(&self, robot: &Robot) -> Result<SimulationSettings, CliError> {
        let usual =
            if self.full_test { SimulationSettings::full_test() } else { SimulationSettings::default() };
        let usual = self.arm.applied(usual);
        let interval = Duration::try_from_secs_f64(self.interval_h * 3600.0)
            .map_err(|error| CliError::Usage(format!("--interval-h {}: {error}", self.interval_h)))?;
        Ok(SimulationSettings {
            robot_name: self.name.clone(),
            seed: self.seed,
            sample_rate_hz: self.rate_hz.unwrap_or(usual.sample_rate_hz),
            cycles: self.cycles.unwrap_or(usual.cycles),
            stiffness: self.stiffness.clone(),
            grows: self.real_time.is_some(),
            warming_s: self.cycle.warming_s(self.warming_s.unwrap_or(usual.warming_s)),
            levels: self.cycle.levels(self.levels.clone().map(|levels| levels.0)),
            excitation: self.cycle.excitation(robot)?,
            posture: self.cycle.posture(),
            rest_s: self.cycle.rest_s(),
            runs: self.runs,
            first_start: self.start,
            interval,
            faults: self.faults.clone(),
            gzip: self.gzip,
            initial_warm_s: self.initial_warm_s,
            ambient_std_k: self.ambient_std_k,
            truth_dir: self.truth.clone(),
            clock: match self.clock {
                ClockArg::Even => Clock::Even,
                ClockArg::Alternating => Clock::Alternating(ALTERNATING_PART),
                ClockArg::Jittering => Clock::Jittering(JITTER_STEPS),
            },
            friction: match (self.plain_friction, self.friction_shape) {
                (true, _) => FrictionShape::Polynomial,
                (false, FrictionShapeArg::Gearbox) => FrictionShape::Gearbox,
                (false, FrictionShapeArg::Sign) => FrictionShape::Sign,
                (false, FrictionShapeArg::Smooth) => FrictionShape::Smooth,
                (false, FrictionShapeArg::LateTurnOver) => FrictionShape::LateTurnOver,
                (false, FrictionShapeArg::Stiction) => FrictionShape::Stiction,
                (false, FrictionShapeArg::Presliding) => FrictionShape::Presliding,
            },
            load: self.load.given()?.map(|load| Load {
                mass: load.mass,
                centre: load.centre,
                inertia: load.inertia,
            }),
            temperatures: self.temperature_settings(),
            ..usual
        })
    }
}

impl SimulateArgs {
    fn temperature_settings(&self) -> TemperatureSettings {
        let recorded = |of: TemperaturesArg| {
            self.temperatures.is_some_and(|which| [of, TemperaturesArg::Both].contains(&which))
        };
        TemperatureSettings {
            columns: TemperatureColumns {
                motor: recorded(TemperaturesArg::Motor),
                ambient: recorded(TemperaturesArg::Ambient),
            },
            step_k: self.temperature_step_k,
            lag_s: self.temperature_lag_s,
            ..TemperatureSettings::default()
        }
    }
}

fn simulate_one(
    robot: &Robot,
    settings: &SimulationSettings,
    run: u32,
    args: &SimulateArgs,
    as_json: bool,
) -> Result<(), CliError> {
    let bar = if std::io::stderr().is_terminal() { ProgressBar::new(1) } else { ProgressBar::hidden() };
    if let Ok(style) =
        ProgressStyle::with_template("run {prefix} [{bar:30}] {pos}/{len} rows {msg} eta {eta}")
    {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(format!("{}/{}", run + 1, settings.runs));
    let begin = Instant::now();
    let files = simulate_run(robot, settings, run, &args.output, &mut |progress| {
        if let Some(speed) = args.real_time {
            let recorded = progress.rows as f64 / (settings.sample_rate_hz * speed);
            std::thread::sleep(Duration::from_secs_f64(recorded).saturating_sub(begin.elapsed()));
        }
        bar.set_length(progress.rows_total);
        bar.set_position(progress.rows);
        bar.set_message(format!("cycle {}/{}", progress.cycle, progress.cycles));
    })
    .map_err(|error| match error {
        SimulateError::Write { path, source } => not_written(&path, &source),
        error => CliError::Usage(error.to_string()),
    })?;
    bar.finish_and_clear();
    if as_json {
        output::json(&json!({
            "export": files.export, "truth": files.truth, "started_at": files.started_at.to_string(),
            "rows": files.rows,
        }));
    } else {
        output::line(&format!("{} ({} rows)", files.export.display(), files.rows));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_that_no_export_shows_is_told() {
        let told = |fault: &str, runs, cycles| unseen(&fault.parse().expect("a fault"), runs, cycles);
        let wear = "wear:joint=1,from=6,rate=0.1";
        assert_eq!(
            told(wear, 1, 5).as_deref(),
            Some(
                "--fault wear:joint=1,from=6,rate=0.1,cap=1 affects no export: it begins with run 6, and there is 1 run; give \
                 more --runs, or an earlier from="
            )
        );
        assert!(told(wear, 5, 5).is_some_and(|said| said.contains("there are 5 runs")));
        let past = "noise:joint=1,from=3,to=2,factor=2";
        assert!(told(past, 9, 5).is_some_and(|said| said.contains("ends with run 2; give a later to=")));
        let step = "step:joint=2,from=4,cycle=9,size=0.25";
        assert!(told(step, 4, 8).is_some_and(|said| said.contains("cycle 9, but a run has only 8")));
        let contact = "contact:joint=2,from=1,nm=30,cycle=6";
        assert!(told(contact, 4, 5).is_some_and(|said| said.contains("is in cycle 6")));
        for (fault, runs, cycles) in [
            (wear, 6, 1),
            (step, 5, 8),
            (step, 4, 9),
            (contact, 1, 6),
            ("jitter:joint=1,from=1,size=0.1", 1, 1),
        ] {
            assert_eq!(told(fault, runs, cycles), None, "{fault} in {runs} runs of {cycles} cycles");
        }
    }
}
