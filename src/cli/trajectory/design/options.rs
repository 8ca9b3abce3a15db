//! Options of `armwatch trajectory design`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::cli::context::{CliError, Global};
use crate::cli::shared::result_file::result_file;
use crate::cli::trajectory::beside::BesideArgs;
use crate::cli::trajectory::surroundings::SurroundingsArgs;
use armwatch_method::detect::rate::budget::Budget;
use armwatch_model::robot::Robot;
use armwatch_trajectory::problem::SeriesForm;

/// Share of the top speeds that each joint reaches at least in a search for the scaled condition number: scaling also
/// hides that the columns of a joint that hardly moves carry no information.
const REACHED_WHERE_SCALED: f64 = 0.5;

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
      --objective standard-deviation --precise friction-3,load -o joint3.json
  armwatch trajectory design --robot er3a --form harmonic-sine -o sines.json
  armwatch trajectory design --robot er3a --wear 0.02 --load-kg 0.2 \\
      --tests-per-year 52 -o er3a.json
  armwatch trajectory design --robot er3a --resume er3a.json -o er3a.json
  armwatch trajectory design --robot er3a --beside-run 12 --seconds 10 \\
      -o addition.json

The motion is a finite Fourier series that starts and ends at rest, without acceleration. It keeps the position,
speed and acceleration limits of the description also between its samples. If the description has nominal
parameters and rated torques, the root mean square of each joint's torque stays below its rated torque. If it has
limits of jerk, peak torque or the clearance of its capsules, the motion keeps them too (docs/trajectories.md).

The same seed and number of starts give the same file on any number of threads. --budget-s writes the number of
starts into the file; --starts with that number gives the same file again. --beside-run finds the shortest motion
that shows the parameters that production does not show. Standard deviations are valid for white noise of the
torque signal and one period; docs/trajectories.md has the limits of this.

Exit status 1 if the best motion breaks a limit, and the command writes nothing; also if a joint does not reach
the required speed (--reach-speed-share), and the command writes the programme.")]
pub(in crate::cli) struct DesignArgs {
    /// Arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    pub(super) robot: String,
    /// File for the programme, JSON
    #[arg(short, long, visible_alias = "out", value_name = "FILE", value_parser = result_file())]
    pub(super) output: Option<PathBuf>,
    /// Duration of the motion, s
    #[arg(help_heading = "Motion", long, default_value_t = 10.0, value_name = "S")]
    pub(super) seconds: f64,
    /// Harmonics of the series, 2 to 20
    #[arg(help_heading = "Motion", long, default_value_t = 5, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=20))]
    pub(super) harmonics: u8,
    /// Wave form of the motion
    #[arg(help_heading = "Motion", long, value_enum, default_value = "fourier")]
    pub(super) form: FormArg,
    /// Allowed fraction of each joint's range, about its middle
    #[arg(help_heading = "Motion", long, default_value_t = 1.0, value_name = "FRACTION", value_parser = share)]
    pub(super) position_share: f64,
    /// Allowed fraction of the largest speeds
    #[arg(help_heading = "Motion", long, default_value_t = 0.95, value_name = "FRACTION", value_parser = share)]
    pub(super) speed_share: f64,
    /// Allowed fraction of the largest accelerations
    #[arg(help_heading = "Motion", long, default_value_t = 0.95, value_name = "FRACTION", value_parser = share)]
    pub(super) acceleration_share: f64,
    /// Fraction of its top speed that each joint must reach [default: 0, with --objective scaled-condition 0.5]
    #[arg(help_heading = "Motion", long, value_name = "FRACTION", value_parser = share_or_none)]
    pub(super) reach_speed_share: Option<f64>,
    /// Allowed root mean square of a joint's torque, as a fraction of the rated torque; 0 for no such limit
    #[arg(help_heading = "Motion", long, default_value_t = 1.0, value_name = "FRACTION", value_parser = share_or_none)]
    pub(super) torque_share: f64,
    /// Quantity to minimise
    #[arg(
        help_heading = "Search",
        long,
        value_enum,
        default_value = "condition",
        conflicts_with = "beside_run"
    )]
    pub(super) objective: ObjectiveArg,
    /// Parameters in the objective
    #[arg(
        help_heading = "Search",
        long,
        value_enum,
        default_value = "inertial",
        conflicts_with = "beside_run"
    )]
    pub(super) columns: ColumnsArg,
    /// Weight of the scaled condition number in --objective mixed; the rest is the weight of the volume
    #[arg(help_heading = "Search", long, default_value_t = 0.5, value_name = "FRACTION", value_parser = share_or_none)]
    pub(super) condition_share: f64,
    /// Parameters whose standard deviations count, separated by commas: names such as J3_f1, friction-3 for all
    /// friction of joint 3, link-6 for link 6 and its motor, load for all parameters changed by a mass at the tool
    /// frame, essential for all that are worth their uncertainty. The other parameters are estimated too [default:
    /// all]
    #[arg(
        help_heading = "Search",
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        conflicts_with = "beside_run"
    )]
    pub(super) precise: Vec<String>,
    /// Seed of all random numbers
    #[arg(help_heading = "Search", long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Random starts of the search [default: 12]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) starts: Option<u64>,
    /// Begin new starts for this time instead, s
    #[arg(help_heading = "Search", long, value_name = "S", conflicts_with = "starts")]
    pub(super) budget_s: Option<f64>,
    /// Continue the search of this programme, which had the same settings: more starts, and its motion if none is
    /// better
    #[arg(help_heading = "Search", long, value_name = "PROGRAMME", conflicts_with = "beside_run")]
    pub(super) resume: Option<PathBuf>,
    /// Number of threads [default: one per processor]
    #[arg(help_heading = "Search", long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) threads: Option<u16>,
    /// Rows per second of the recording, Hz
    #[arg(help_heading = "Prediction", long, default_value_t = 250.0, value_name = "HZ")]
    pub(super) rate_hz: f64,
    /// Standard deviation of every torque signal, Nm (N) [default: that of the description]
    #[arg(help_heading = "Prediction", long, value_name = "NM")]
    pub(super) noise_nm: Option<f64>,
    /// Allowed false alarms per robot and year, for the smallest detectable changes [default: that of the
    /// configuration]
    #[arg(help_heading = "Prediction", long, value_name = "RATE")]
    pub(super) false_alarms_per_robot_year: Option<f64>,
    /// Tests per robot and year, which share its false alarms
    #[arg(help_heading = "Prediction", long, default_value_t = 365.25, value_name = "N")]
    pub(super) tests_per_year: f64,
    /// Growth of a joint's friction for the predicted probability of detection, a fraction
    #[arg(help_heading = "Prediction", long, default_value_t = 0.04, value_name = "FRACTION")]
    pub(super) wear: f64,
    /// Load for the predicted probability of detection, kg
    #[arg(help_heading = "Prediction", long, default_value_t = 0.5, value_name = "KG")]
    pub(super) load_kg: f64,
    #[command(flatten)]
    pub(super) beside: BesideArgs,
    #[command(flatten)]
    pub(super) surroundings: SurroundingsArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ObjectiveArg {
    /// Condition number of the observation matrix, SI units
    Condition,
    /// Condition number with columns scaled to unit norm
    ScaledCondition,
    /// Volume of the confidence ellipsoid of the parameters
    LogDeterminant,
    /// Scaled condition number and volume, weighted by --condition-share
    Mixed,
    /// Standard deviations of the parameters, each in units of its nominal size
    StandardDeviation,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ColumnsArg {
    /// Inertia of links and motors, as in the published design
    Inertial,
    /// All base parameters, including friction
    All,
}

fn share(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|part| *part > 0.0 && *part <= 1.0).ok_or_else(|| "above 0 to 1".into())
}

fn share_or_none(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|part| *part >= 0.0 && *part <= 1.0).ok_or_else(|| "0 to 1".into())
}

impl DesignArgs {
    pub(super) fn check(&self) -> Result<(), CliError> {
        let positive = [
            ("--seconds", self.seconds, 0.1, 1000.0, "s"),
            ("--rate-hz", self.rate_hz, 1.0, 100_000.0, "Hz"),
            ("--budget-s", self.budget_s.unwrap_or(1.0), 0.0, 1e6, "s"),
            ("--noise-nm", self.noise_nm.unwrap_or(1.0), 1e-9, 1e5, "Nm"),
            (
                "--false-alarms-per-robot-year",
                self.false_alarms_per_robot_year.unwrap_or(1.0),
                0.001,
                1000.0,
                "a year",
            ),
            ("--tests-per-year", self.tests_per_year, 1.0, 52_600.0, "a year"),
            ("--wear", self.wear, 1e-6, 10.0, "(a fraction)"),
            ("--load-kg", self.load_kg, 1e-6, 1e4, "kg"),
        ];
        if let Some((option, value, low, high, unit)) =
            positive.into_iter().find(|(_, value, low, high, _)| !(value >= low && value <= high))
        {
            return Err(CliError::Usage(format!("{option} {value}: {low} to {high} {unit} is possible")));
        }
        // fewer than two rows per wave show a wrong motion
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

    pub(super) fn reached(&self) -> f64 {
        let usual = match self.objective() {
            ObjectiveArg::ScaledCondition => REACHED_WHERE_SCALED.min(self.speed_share),
            _ => 0.0,
        };
        self.reach_speed_share.unwrap_or(usual)
    }

    /// The minimised objective; for an addition to production, the standard deviations.
    pub(super) fn objective(&self) -> ObjectiveArg {
        if self.beside.is_asked() { ObjectiveArg::StandardDeviation } else { self.objective }
    }
}

impl DesignArgs {
    /// Share of the yearly false alarms that one channel of a test may use.
    pub(super) fn budget(&self, global: &Global, robot: &Robot) -> Result<Budget, CliError> {
        let rate = match self.false_alarms_per_robot_year {
            Some(rate) => rate,
            None => global.read_config()?.detect.false_alarms_per_robot_year,
        };
        let usual = Budget::new(rate, robot.joint_count(), &[]);
        Ok(Budget { tests_per_year: self.tests_per_year, ..usual })
    }
}

/// Which waves a motion has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FormArg {
    /// Sines and cosines: a finite Fourier series
    Fourier,
    /// Sines of the position only, about a centre: half as many numbers, and a motion that returns along its path
    HarmonicSine,
}

impl FormArg {
    pub(super) fn form(self) -> SeriesForm {
        match self {
            Self::Fourier => SeriesForm::Fourier,
            Self::HarmonicSine => SeriesForm::HarmonicSine,
        }
    }

    /// Its notation in a programme.
    pub(super) fn recorded(self) -> Option<String> {
        (self == Self::HarmonicSine).then(|| "harmonic-sine".to_owned())
    }
}

impl ObjectiveArg {
    pub(super) fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}
