//! `armwatch trajectory design`: an excitation trajectory for an arm, and what it will tell.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use super::arm::arm;
use super::rated::rated_torques;
use super::words::{nearness, print_nearness, sentence};
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::plot::write_lines;
use crate::design::programme::{Programme, SearchRecord};
use crate::design::search::{Budget, Found, search};
use crate::numerics::model::base_parameters::{BaseParameters, base_parameters};
use crate::numerics::pooled::nominal_prior::nominal_base;
use crate::numerics::statistics::distributions::normal_quantile;
use crate::numerics::trajectory::limits::{MotionLimits, Shares, TorqueLimits, broken_by_series};
use crate::numerics::trajectory::objective::Objective;
use crate::numerics::trajectory::prediction::{Conditioning, Prediction, Recording, conditioning, predict};
use crate::numerics::trajectory::problem::{SearchProblem, SearchSettings};
use crate::robot::{JointKind, ParameterKind, Robot};

/// Share of the top speeds that each joint reaches at least where the scaled condition number is searched: the columns
/// of a joint that hardly moves can be scaled too, and tell nothing.
const REACHED_WHERE_SCALED: f64 = 0.5;

/// Starts of a search where nothing else is asked for.
const STARTS: u64 = 12;

/// Probability that a test without a change shows one, and that a test with the smallest change shows it.
const FALSE_ALARM: f64 = 0.001;
const DETECTION: f64 = 0.9;

/// How much nearer to a torque limit than allowed the search stays, since a motion that is found is not made smaller
/// for torques.
const TORQUE_CLEARANCE: f64 = 0.999;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory design --robot er3a -o er3a.json
  armwatch trajectory design --robot robots/mine.toml --seconds 20 \\
      --speed-share 0.8 -o mine.json
  armwatch trajectory design --robot er3a --objective scaled-condition \\
      --budget-s 300 -o scaled.json
  armwatch trajectory design --robot er3a --columns all \\
      --objective standard-deviation -o precise.json

The motion is a finite Fourier series that starts and ends at rest, without acceleration, and keeps the position, speed
and acceleration limits of the description between its samples too. Where the description has nominal parameters and
rated torques, the root mean square of each joint's torque stays below its rated torque.

The same seed and number of starts give the same file on any number of threads; with --budget-s the file says how many
starts there were, and --starts with that number gives it again. Standard deviations hold for white noise of the torque
signal and one period; docs/trajectories.md says what that leaves out.")]
pub(in crate::cli) struct DesignArgs {
    /// The arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
    /// File for the programme, JSON
    #[arg(short, long, visible_alias = "out", value_name = "FILE")]
    output: Option<PathBuf>,
    /// Duration of the motion, s
    #[arg(help_heading = "Motion", long, default_value_t = 10.0, value_name = "S")]
    seconds: f64,
    /// Harmonics of the series, 2 to 20
    #[arg(help_heading = "Motion", long, default_value_t = 5, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=20))]
    harmonics: u8,
    /// Part of each joint's range that may be used, about its middle
    #[arg(help_heading = "Motion", long, default_value_t = 1.0, value_name = "PART", value_parser = share)]
    position_share: f64,
    /// Part of the largest speeds that may be used
    #[arg(help_heading = "Motion", long, default_value_t = 0.95, value_name = "PART", value_parser = share)]
    speed_share: f64,
    /// Part of the largest accelerations that may be used
    #[arg(help_heading = "Motion", long, default_value_t = 0.95, value_name = "PART", value_parser = share)]
    acceleration_share: f64,
    /// Part of its top speed that each joint reaches at least [default: 0, with --objective
    /// scaled-condition 0.5]
    #[arg(help_heading = "Motion", long, value_name = "PART", value_parser = share_or_none)]
    reach_speed_share: Option<f64>,
    /// Part of the rated torque that the root mean square of a joint's torque may be; 0 for no limit
    #[arg(help_heading = "Motion", long, default_value_t = 1.0, value_name = "PART", value_parser = share_or_none)]
    torque_share: f64,
    /// What is made small
    #[arg(help_heading = "Search", long, value_enum, default_value = "condition")]
    objective: ObjectiveArg,
    /// Parameters that the objective is of
    #[arg(help_heading = "Search", long, value_enum, default_value = "inertial")]
    columns: ColumnsArg,
    /// Everything random follows from it
    #[arg(help_heading = "Search", long, default_value_t = 1)]
    seed: u64,
    /// Random starts of the search [default: 12]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    starts: Option<u64>,
    /// Begin new starts for this long instead, s
    #[arg(help_heading = "Search", long, value_name = "S", conflicts_with = "starts")]
    budget_s: Option<f64>,
    /// Threads [default: one a processor]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Rows a second of the recording, Hz
    #[arg(help_heading = "Prediction", long, default_value_t = 250.0, value_name = "HZ")]
    rate_hz: f64,
    /// Standard deviation of every torque signal, Nm (N) [default: the description's]
    #[arg(help_heading = "Prediction", long, value_name = "NM")]
    noise_nm: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ObjectiveArg {
    /// Condition number of the observation matrix, SI units
    Condition,
    /// The same with columns scaled to unit norm
    ScaledCondition,
    /// Volume of the confidence ellipsoid of the parameters
    LogDeterminant,
    /// Standard deviations of the parameters, each in units of its nominal size
    StandardDeviation,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ColumnsArg {
    /// Inertia of links and motors, as in the published design
    Inertial,
    /// All base parameters, with friction
    All,
}

fn share(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|part| *part > 0.0 && *part <= 1.0).ok_or_else(|| "above 0 to 1".into())
}

fn share_or_none(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|part| *part >= 0.0 && *part <= 1.0).ok_or_else(|| "0 to 1".into())
}

pub(in crate::cli) fn design(global: &Global, args: &DesignArgs) -> Result<u8, CliError> {
    let robot = arm(global, &args.robot)?;
    args.check()?;
    let refused = |error: crate::numerics::NumericsError| CliError::Usage(format!("{}: {error}", args.robot));
    let base = base_parameters(&robot).map_err(refused)?;
    let problem = SearchProblem::new(&robot, &base, args.settings(&robot, &base)?).map_err(refused)?;
    let found = args.search(&problem)?;
    let chosen = &problem.settings().parameters;
    let conditions = conditioning(&robot, &base, chosen, &found.series, args.rate_hz).map_err(refused)?;
    let programme = Programme {
        model: robot.model.clone(),
        kinds: robot.joints.iter().map(|joint| joint.kind).collect(),
        series: found.series.clone(),
        search: Some(args.record(&base, chosen, &found, &conditions)),
    };
    let breaches = broken_by_series(&robot, &found.series);
    let prediction = args.recording(&robot)?.map(|recording| {
        predict(&robot, &base, &found.series, &recording).map(|found| (recording, found)).map_err(refused)
    });
    let prediction = prediction.transpose()?;
    let predicted = prediction.as_ref().map(|(recording, found)| (recording, found));
    if global.json {
        output::json(&as_value(&robot, &base, &programme, &conditions, predicted));
    } else {
        args.print(&robot, &base, &found, &conditions, predicted);
    }
    if !breaches.is_empty() {
        breaches.iter().for_each(|breach| output::print_hint(&sentence(&robot, breach)));
        output::print_hint("nothing is written: the motion breaks limits");
        return Ok(EXIT_FOUND);
    }
    match &args.output {
        Some(path) => {
            let text = programme.json().map_err(CliError::Internal)?;
            write_lines(path, text.lines().map(str::to_owned))?;
        }
        None if !global.json => output::print_hint("nothing is written; -o FILE keeps the programme"),
        None => {}
    }
    Ok(EXIT_DONE)
}

impl DesignArgs {
    fn check(&self) -> Result<(), CliError> {
        let positive = [
            ("--seconds", self.seconds, 0.1, 1000.0, "s"),
            ("--rate-hz", self.rate_hz, 1.0, 100_000.0, "Hz"),
            ("--budget-s", self.budget_s.unwrap_or(1.0), 0.0, 1e6, "s"),
            ("--noise-nm", self.noise_nm.unwrap_or(1.0), 1e-9, 1e5, "Nm"),
        ];
        if let Some((option, value, low, high, unit)) =
            positive.into_iter().find(|(_, value, low, high, _)| !(value >= low && value <= high))
        {
            return Err(CliError::Usage(format!("{option} {value}: {low} to {high} {unit} is possible")));
        }
        // fewer rows than two a wave show a motion that is not there
        let least = 2.0 * f64::from(self.harmonics) / self.seconds;
        if self.rate_hz <= least {
            return Err(CliError::Usage(format!(
                "--rate-hz {}: a motion with waves of {:.2} Hz needs more than {least} Hz",
                self.rate_hz,
                f64::from(self.harmonics) / self.seconds
            )));
        }
        if self.reached() > self.speed_share {
            return Err(CliError::Usage(format!(
                "--reach-speed-share {}: more than --speed-share {} allows",
                self.reached(),
                self.speed_share
            )));
        }
        Ok(())
    }

    fn reached(&self) -> f64 {
        let usual = match self.objective {
            ObjectiveArg::ScaledCondition => REACHED_WHERE_SCALED.min(self.speed_share),
            _ => 0.0,
        };
        self.reach_speed_share.unwrap_or(usual)
    }

    fn settings(&self, robot: &Robot, base: &BaseParameters) -> Result<SearchSettings, CliError> {
        let is_chosen = |k: &usize| match self.columns {
            ColumnsArg::All => true,
            ColumnsArg::Inertial => {
                matches!(base.kept[*k].kind, ParameterKind::Inertial(_) | ParameterKind::MotorInertia)
            }
        };
        let parameters: Vec<usize> = (0..base.kept.len()).filter(is_chosen).collect();
        let nominal = nominal_base(robot, base);
        let noise = self.noise(robot);
        let statistical =
            matches!(self.objective, ObjectiveArg::LogDeterminant | ObjectiveArg::StandardDeviation);
        let row_scales = match (&noise, statistical) {
            (Some(noise), true) => noise.iter().map(|noise| 1.0 / noise).collect(),
            _ => vec![1.0; robot.joint_count()],
        };
        let shares = Shares {
            position: self.position_share,
            velocity: self.speed_share,
            acceleration: self.acceleration_share,
        };
        Ok(SearchSettings {
            period: self.seconds,
            harmonics: usize::from(self.harmonics),
            objective: match self.objective {
                ObjectiveArg::Condition => Objective::Condition,
                ObjectiveArg::ScaledCondition => Objective::ScaledCondition,
                ObjectiveArg::LogDeterminant => Objective::LogDeterminant,
                ObjectiveArg::StandardDeviation => Objective::StandardDeviation,
            },
            scales: sizes(base, &parameters, &nominal),
            parameters,
            row_scales,
            limits: robot.joints.iter().map(|joint| MotionLimits::of(joint, &shares)).collect(),
            torque: self.torque_limits(robot, &nominal),
            // the search counts in what the motion may reach
            reached_speed: self.reached() / self.speed_share,
        })
    }

    /// Limits of torques, where parameters and rated torques are known.
    fn torque_limits(&self, robot: &Robot, nominal: &[Option<f64>]) -> Option<TorqueLimits> {
        let parameters: Option<Vec<f64>> = nominal.iter().copied().collect();
        let rated = rated_torques(robot);
        let limited = self.torque_share > 0.0 && rated.iter().any(Option::is_some);
        parameters.filter(|_| limited).map(|parameters| TorqueLimits {
            parameters,
            mean_square_root: rated
                .into_iter()
                .map(|rated| rated.map(|rated| TORQUE_CLEARANCE * self.torque_share * rated))
                .collect(),
            peak: vec![None; robot.joint_count()],
        })
    }

    /// Noise of each torque signal, where it is known.
    fn noise(&self, robot: &Robot) -> Option<Vec<f64>> {
        let of_joint = |joint: &crate::robot::Joint| {
            let known = joint.nominal.as_ref().map(|nominal| nominal.torque_noise);
            self.noise_nm.or(known).filter(|noise| *noise > 0.0)
        };
        robot.joints.iter().map(of_joint).collect()
    }

    fn recording(&self, robot: &Robot) -> Result<Option<Recording>, CliError> {
        let noise = self.noise(robot);
        if noise.is_none() {
            output::print_hint(
                "the description has no noise of every torque signal, so nothing is predicted; give it with --noise-nm",
            );
        }
        Ok(noise.map(|noise| Recording { sample_rate_hz: self.rate_hz, periods: 1, noise }))
    }

    fn search(&self, problem: &SearchProblem<'_>) -> Result<Found, CliError> {
        let begin = Instant::now();
        let budget = match self.budget_s {
            Some(seconds) => Budget::Until(begin + Duration::from_secs_f64(seconds)),
            None => Budget::Starts(self.starts.unwrap_or(STARTS)),
        };
        let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = self.threads.map_or(processors, usize::from);
        let bar = match budget {
            Budget::Starts(starts) => ProgressBar::new(starts),
            Budget::Until(_) => ProgressBar::no_length(),
        };
        if !std::io::stderr().is_terminal() {
            bar.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        let template = match budget {
            Budget::Starts(_) => "[{bar:30}] {pos}/{len} starts, {msg}, {elapsed}, eta {eta}",
            Budget::Until(_) => "{spinner} {pos} starts, {msg}, {elapsed}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message("nothing yet");
        bar.enable_steady_tick(Duration::from_millis(200));
        let found = search(problem, self.seed, budget, threads, &|progress| {
            bar.set_position(progress.starts);
            bar.set_message(format!("best {:.4}", progress.best));
        });
        bar.finish_and_clear();
        found.ok_or_else(|| {
            CliError::Usage(
                "no motion within the limits shows every parameter; check the ranges of the joints, or allow more \
                 harmonics and seconds"
                    .into(),
            )
        })
    }

    fn record(
        &self,
        base: &BaseParameters,
        chosen: &[usize],
        found: &Found,
        conditions: &Conditioning,
    ) -> SearchRecord {
        SearchRecord {
            armwatch: env!("CARGO_PKG_VERSION").to_owned(),
            objective: self.objective.name(),
            parameters: chosen.iter().map(|&k| base.kept[k].to_string()).collect(),
            seed: self.seed,
            starts: found.values.len() as u64,
            best_start: found.best_start,
            evaluations: found.evaluations,
            values: found.values.iter().map(|value| value.is_finite().then_some(*value)).collect(),
            position_share: self.position_share,
            speed_share: self.speed_share,
            acceleration_share: self.acceleration_share,
            condition_number: conditions.condition_number,
            scaled_condition_number: conditions.scaled_condition_number,
            sample_rate_hz: self.rate_hz,
        }
    }

    fn print(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        found: &Found,
        conditions: &Conditioning,
        predicted: Option<(&Recording, &Prediction)>,
    ) {
        output::line(&format!(
            "Condition number {:.3}, with scaled columns {:.3} ({} parameters, {} Hz, {} s); start {} of {}, {} \
             evaluations",
            conditions.condition_number,
            conditions.scaled_condition_number,
            match self.columns {
                ColumnsArg::All => "all".to_owned(),
                ColumnsArg::Inertial => "inertial and motor".to_owned(),
            },
            self.rate_hz,
            self.seconds,
            found.best_start + 1,
            found.values.len(),
            found.evaluations,
        ));
        output::line("\nHow near the motion comes to the limits");
        print_nearness(robot, &found.series);
        let Some((recording, prediction)) = predicted else { return };
        output::line(&format!(
            "\nStandard deviations that a recording of one period at {} Hz will have (white noise of {})",
            self.rate_hz,
            if self.noise_nm.is_some() { "--noise-nm" } else { "the description" },
        ));
        let nominal = nominal_base(robot, base);
        let rows: Vec<Vec<String>> = base
            .kept
            .iter()
            .zip(&prediction.standard_deviations)
            .zip(&nominal)
            .map(|((id, std), nominal)| {
                vec![
                    id.to_string(),
                    id.unit(robot.joints[id.joint.index()].kind).to_owned(),
                    format!("{std:.3e}"),
                    nominal.map_or_else(|| "-".to_owned(), |value| format!("{value:.3e}")),
                ]
            })
            .collect();
        output::print_table(&["parameter", "unit", "standard deviation", "nominal value"], &rows, &[]);
        output::line(&format!(
            "\nSmallest changes that one period shows with probability {DETECTION}, at a false alarm in {:.0} tests, where \
             noise is all that differs",
            1.0 / FALSE_ALARM
        ));
        let factor = smallest_change();
        let mut rows: Vec<Vec<String>> = robot
            .joint_indices()
            .map(|joint| {
                let change = prediction.friction_change[joint.index()];
                let noise = recording.noise[joint.index()];
                let unit = if robot.joints[joint.index()].kind == JointKind::Revolute { "Nm" } else { "N" };
                vec![
                    format!("friction of joint {joint}"),
                    format!("{noise} {unit}"),
                    change.map_or_else(|| "-".to_owned(), |std| format!("{:.2} %", 100.0 * factor * std)),
                ]
            })
            .collect();
        let load =
            prediction.load_change.map_or_else(|| "-".to_owned(), |std| format!("{:.3} kg", factor * std));
        rows.push(vec!["load at the tool frame".to_owned(), String::new(), load]);
        output::print_table(&["what changes", "torque noise", "smallest change"], &rows, &[]);
    }
}

impl ObjectiveArg {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Standard deviations of the smallest change that is found with probability [`DETECTION`] at [`FALSE_ALARM`], in both
/// directions.
fn smallest_change() -> f64 {
    normal_quantile(1.0 - 0.5 * FALSE_ALARM) + normal_quantile(DETECTION)
}

/// What standard deviations are compared with: the nominal value, or the root mean square of those of the same unit if
/// that is more; 1 where nothing is known.
fn sizes(base: &BaseParameters, chosen: &[usize], nominal: &[Option<f64>]) -> Vec<f64> {
    let unit = |k: usize| base.kept[k].unit(JointKind::Revolute);
    let of = |&k: &usize| {
        let like: Vec<f64> = (0..nominal.len())
            .filter(|&other| unit(other) == unit(k))
            .filter_map(|other| nominal[other])
            .collect();
        let squares: f64 = like.iter().map(|value| value * value).sum();
        let usual = (squares / like.len().max(1) as f64).sqrt();
        let size = nominal[k].map_or(usual, |value| usual.max(value.abs()));
        if size > 0.0 { size } else { 1.0 }
    };
    chosen.iter().map(of).collect()
}

fn as_value(
    robot: &Robot,
    base: &BaseParameters,
    programme: &Programme,
    conditions: &Conditioning,
    predicted: Option<(&Recording, &Prediction)>,
) -> Value {
    let parameters = |prediction: &Prediction| -> Vec<Value> {
        let each = base.kept.iter().zip(&prediction.standard_deviations);
        each.map(|(id, std)| {
            json!({
                "parameter": id.to_string(),
                "unit": id.unit(robot.joints[id.joint.index()].kind),
                "standard_deviation": std,
            })
        })
        .collect()
    };
    let changes = |prediction: &Prediction| {
        let factor = smallest_change();
        json!({
            "false_alarm_probability": FALSE_ALARM,
            "detection_probability": DETECTION,
            "friction_fraction": prediction.friction_change.iter().map(|of| of.map(|of| factor * of)).collect::<Vec<_>>(),
            "load_kg": prediction.load_change.map(|of| factor * of),
        })
    };
    json!({
        "robot": robot.model,
        "condition_number": conditions.condition_number,
        "scaled_condition_number": conditions.scaled_condition_number,
        "limits": nearness(robot, &programme.series),
        "search": programme.search,
        "parameters": predicted.map(|(_, prediction)| parameters(prediction)),
        "smallest_changes": predicted.map(|(_, prediction)| changes(prediction)),
    })
}
