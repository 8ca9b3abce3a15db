//! `armwatch trajectory design`: an excitation trajectory for an arm, and what it will tell.

mod settings;
mod told;

use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use self::settings::sizes;
use self::told::{Predicted, Told};
use super::arm::arm;
use super::beside::{Beside, BesideArgs, Precision};
use super::judged::Judged;
use super::surroundings::SurroundingsArgs;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::plot::write_lines;
use crate::cli::shared::programme::programme;
use crate::design::programme::{BesideRecord, Programme, SearchRecord};
use crate::design::search::{Budget, Earlier, Found, search};
use crate::numerics::model::base_parameters::{BaseParameters, base_parameters};
use crate::numerics::pooled::nominal_prior::nominal_base;
use crate::numerics::trajectory::prediction::{Conditioning, Recording, conditioning};
use crate::numerics::trajectory::problem::{INSTANTS_PER_HARMONIC, SearchProblem, SearchSettings};
use crate::robot::Robot;

/// Share of the top speeds that each joint reaches at least where the scaled condition number is searched: the columns
/// of a joint that hardly moves can be scaled too, and tell nothing.
const REACHED_WHERE_SCALED: f64 = 0.5;

/// Starts of a search where nothing else is asked for.
const STARTS: u64 = 12;

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
  armwatch trajectory design --robot er3a --columns all \\
      --objective standard-deviation --precise friction-3 -o joint3.json
  armwatch trajectory design --robot er3a --resume er3a.json -o er3a.json
  armwatch trajectory design --robot er3a --beside-run 12 --seconds 10 \\
      -o addition.json

The motion is a finite Fourier series that starts and ends at rest, without acceleration, and keeps the position, speed
and acceleration limits of the description between its samples too. Where the description has nominal parameters and
rated torques, the root mean square of each joint's torque stays below its rated torque; where it has limits of jerk and
peak torque, they are kept, and so is the clearance of its capsules (docs/trajectories.md).

The same seed and number of starts give the same file on any number of threads; with --budget-s the file says how many
starts there were, and --starts with that number gives it again. With --beside-run, the motion is the shortest one that
shows what ordinary work does not. Standard deviations hold for white noise of the torque
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
    /// Part of the rated torque that the root mean square of a joint's torque may be; 0 for no limit of torques
    #[arg(help_heading = "Motion", long, default_value_t = 1.0, value_name = "PART", value_parser = share_or_none)]
    torque_share: f64,
    /// What is made small
    #[arg(
        help_heading = "Search",
        long,
        value_enum,
        default_value = "condition",
        conflicts_with = "beside_run"
    )]
    objective: ObjectiveArg,
    /// Parameters that the objective is of
    #[arg(
        help_heading = "Search",
        long,
        value_enum,
        default_value = "inertial",
        conflicts_with = "beside_run"
    )]
    columns: ColumnsArg,
    /// Weight of the scaled condition number in --objective mixed; the rest is that of the volume
    #[arg(help_heading = "Search", long, default_value_t = 0.5, value_name = "PART", value_parser = share_or_none)]
    condition_share: f64,
    /// Parameters whose standard deviations count, where not all do: names such as J3_f1, friction-3 for all friction of
    /// joint 3, link-6 for link 6 and its motor, separated by commas; others are estimated along
    #[arg(
        help_heading = "Search",
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        conflicts_with = "beside_run"
    )]
    precise: Vec<String>,
    /// Everything random follows from it
    #[arg(help_heading = "Search", long, default_value_t = 1)]
    seed: u64,
    /// Random starts of the search [default: 12]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    starts: Option<u64>,
    /// Begin new starts for this long instead, s
    #[arg(help_heading = "Search", long, value_name = "S", conflicts_with = "starts")]
    budget_s: Option<f64>,
    /// Go on with the search of this programme, which had the same settings: more starts, and its motion if none is better
    #[arg(help_heading = "Search", long, value_name = "PROGRAMME", conflicts_with = "beside_run")]
    resume: Option<PathBuf>,
    /// Threads [default: one a processor]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Rows a second of the recording, Hz
    #[arg(help_heading = "Prediction", long, default_value_t = 250.0, value_name = "HZ")]
    rate_hz: f64,
    /// Standard deviation of every torque signal, Nm (N) [default: the description's]
    #[arg(help_heading = "Prediction", long, value_name = "NM")]
    noise_nm: Option<f64>,
    #[command(flatten)]
    beside: BesideArgs,
    #[command(flatten)]
    surroundings: SurroundingsArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ObjectiveArg {
    /// Condition number of the observation matrix, SI units
    Condition,
    /// The same with columns scaled to unit norm
    ScaledCondition,
    /// Volume of the confidence ellipsoid of the parameters
    LogDeterminant,
    /// The last two together, weighted by --condition-share
    Mixed,
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
    let limit = args.surroundings.limit(&robot)?;
    let recording = args.recording(&robot)?;
    let all: Vec<usize> = (0..base.kept.len()).collect();
    let sizes = sizes(&base, &all, &nominal_base(&robot, &base));
    let beside = args.beside.read(global, &robot, &base, recording.as_ref(), sizes)?;
    let settings = SearchSettings { clearance: limit.clone(), ..args.settings(&robot, &base)? };
    let chosen = settings.parameters.clone();
    let (found, precision) = match (&beside, &recording) {
        (Some(beside), Some(recording)) => {
            let (found, precision) = args.least_addition(&robot, &base, settings, beside, recording)?;
            (found, Some(precision))
        }
        _ => {
            let problem = SearchProblem::new(&robot, &base, settings).map_err(refused)?;
            (args.search(&problem, args.earlier(&robot, &base, &chosen)?.as_ref())?, None)
        }
    };
    let conditions = conditioning(&robot, &base, &chosen, &found.series, args.rate_hz).map_err(refused)?;
    let programme = Programme {
        model: robot.model.clone(),
        kinds: robot.joints.iter().map(|joint| joint.kind).collect(),
        series: found.series.clone(),
        search: Some(args.record(&base, &chosen, &found, &conditions, beside.as_ref())),
    };
    let judged = Judged::of_series(&robot, &found.series, limit.as_ref())?;
    let told = Told {
        robot: &robot,
        base: &base,
        programme: &programme,
        conditions: &conditions,
        judged: &judged,
        prediction: recording
            .as_ref()
            .map(|of| Predicted::new(&robot, &base, &found.series, of))
            .transpose()?,
        beside: beside.as_ref().zip(precision.as_ref()),
    };
    match global.json {
        true => output::json(&told.as_value()),
        false => told.print(),
    }
    let broken = judged.broken();
    if !broken.is_empty() {
        broken.iter().for_each(|sentence| output::print_hint(sentence));
        output::print_hint(
            "nothing is written: the best motion that was found breaks limits; try more --starts, or wider limits",
        );
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
        let usual = match self.objective() {
            ObjectiveArg::ScaledCondition => REACHED_WHERE_SCALED.min(self.speed_share),
            _ => 0.0,
        };
        self.reach_speed_share.unwrap_or(usual)
    }

    /// What is made small; of an addition to ordinary work the standard deviations.
    fn objective(&self) -> ObjectiveArg {
        if self.beside.is_asked() { ObjectiveArg::StandardDeviation } else { self.objective }
    }

    /// The search of --resume, whose settings have to be these.
    fn earlier(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        chosen: &[usize],
    ) -> Result<Option<Earlier>, CliError> {
        let Some(path) = &self.resume else { return Ok(None) };
        let found = programme(path, robot)?;
        let other = |what: &str| {
            Err(CliError::Usage(format!(
                "--resume {}: its search had another {what}; give the same options, or search anew",
                path.display()
            )))
        };
        let Some(search) = found.search else { return other("origin: nothing is known of it") };
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
        let names: Vec<String> = chosen.iter().map(|&k| base.kept[k].to_string()).collect();
        let harmonics = found.series.a.first().map_or(0, Vec::len);
        let same = [
            ("objective", search.objective == self.objective().name()),
            ("choice of parameters", search.parameters == names),
            ("seed", search.seed == self.seed),
            ("duration", near(1.0 / found.series.base_frequency, self.seconds)),
            ("number of harmonics", harmonics == usize::from(self.harmonics)),
            ("share of the range", near(search.position_share, self.position_share)),
            ("share of the speeds", near(search.speed_share, self.speed_share)),
            ("share of the accelerations", near(search.acceleration_share, self.acceleration_share)),
        ];
        if let Some((what, _)) = same.iter().find(|(_, same)| !same) {
            return other(what);
        }
        Ok(Some(Earlier {
            series: found.series,
            best_start: search.best_start,
            values: search.values.iter().map(|value| value.unwrap_or(f64::INFINITY)).collect(),
            evaluations: search.evaluations,
        }))
    }

    fn search(&self, problem: &SearchProblem<'_>, earlier: Option<&Earlier>) -> Result<Found, CliError> {
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
        let found = search(problem, self.seed, budget, threads, earlier, &|progress| {
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

    /// The shortest motion with which every parameter is known well enough, or the longest one that is allowed.
    fn least_addition(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        settings: SearchSettings,
        beside: &Beside,
        recording: &Recording,
    ) -> Result<(Found, Precision), CliError> {
        let refused =
            |error: crate::numerics::NumericsError| CliError::Usage(format!("{}: {error}", self.robot));
        let durations = Beside::durations(self.seconds);
        for (k, &duration) in durations.iter().enumerate() {
            let settings = SearchSettings { period: duration, ..settings.clone() };
            let instants = INSTANTS_PER_HARMONIC * settings.harmonics;
            let known = Some(beside.known(recording, duration, instants));
            let problem =
                SearchProblem::new(robot, base, SearchSettings { known, ..settings }).map_err(refused)?;
            let found = self.search(&problem, None)?;
            let precision = beside.precision(robot, base, &found.series, recording)?;
            if beside.missed(&precision) == 0 || k + 1 == durations.len() {
                return Ok((found, precision));
            }
        }
        Err(CliError::Internal("no duration to try".into()))
    }

    fn record(
        &self,
        base: &BaseParameters,
        chosen: &[usize],
        found: &Found,
        conditions: &Conditioning,
        beside: Option<&Beside>,
    ) -> SearchRecord {
        SearchRecord {
            armwatch: env!("CARGO_PKG_VERSION").to_owned(),
            objective: self.objective().name(),
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
            beside: beside.map(|of| BesideRecord { run: of.run, seconds: of.seconds }),
        }
    }
}

impl ObjectiveArg {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}
