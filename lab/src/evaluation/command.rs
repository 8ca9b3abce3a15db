//! `armwatch-lab evaluate`: performance of the detectors on simulated fleets.

use std::io::IsTerminal;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use super::exports::{ExportSettings, evaluate_exports};
use super::tables::{as_json, as_text, figure};
use crate::context::LabOptions;
use crate::evaluate::fleet::{DetectorScore, FleetSettings, evaluate as judge};
use crate::evaluate::scenario::Scenario;
use armwatch::cli::context::{CliError, EXIT_DONE};
use armwatch::cli::shared::output;
use armwatch::cli::shared::plot::PlotFile;

#[derive(Debug, Args)]
#[command(after_help = "\
Draws robots, what happens to them and the figures of their tests, and gives them to the detectors. Beside
armwatch stand detectors that alarm always, never, at three standard deviations of the friction index, and
by CUSUM of it. An alarm is an anomaly of severity warning or critical.

With --through-exports, each test is an export of a simulated arm, which the whole program reads. Arms differ from the
shipped ER3A by what is drawn for each joint. This is slow: some seconds of a core for each robot. The scenarios are
those that the simulator has; a robot is watched for a test a day.

Examples:
  armwatch-lab evaluate
  armwatch-lab evaluate --robots 200 --years 2
  armwatch-lab evaluate --scenario wear --scenario healthy --robots 100 --seed 7
  armwatch-lab evaluate --size payload=0.8 --size step-inside=0.25 --robots 100
  armwatch-lab evaluate --robots 300 --plot detection.svg
  armwatch-lab evaluate --through-exports --robots 4
  armwatch-lab evaluate --through-exports --size backlash=0.002 --robots 10
  armwatch-lab evaluate --json")]
pub(crate) struct EvaluateArgs {
    /// Robots of each scenario [default: 20, with --through-exports 2]
    #[arg(help_heading = "What is simulated", long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    robots: Option<u32>,
    /// Simulate exports, and read them with the whole program
    #[arg(help_heading = "What is simulated", long)]
    through_exports: bool,
    /// Tests of each robot
    #[arg(help_heading = "What is simulated", long, default_value_t = 12, requires = "through_exports", value_parser = clap::value_parser!(u32).range(10..=1000))]
    tests: u32,
    /// Years that each robot is watched
    #[arg(help_heading = "What is simulated", long, default_value_t = 1.0, value_parser = years, conflicts_with = "through_exports")]
    years: f64,
    /// Seed of all that is drawn; the same seed gives the same figures
    #[arg(help_heading = "What is simulated", long, default_value_t = 1)]
    seed: u64,
    /// One scenario, several times for more; all of them unless one is given here or with --size
    #[arg(help_heading = "What is simulated", long, value_name = "NAME", value_parser = scenario)]
    scenario: Vec<Scenario>,
    /// Size that every event of a scenario has, instead of drawn ones, in the unit that `--json` tells;
    /// several times for more
    #[arg(help_heading = "What is simulated", long, value_name = "NAME=SIZE", value_parser = size)]
    size: Vec<(Scenario, f64)>,
    /// Writes probability and delay of detection over size as a picture, .svg or .html
    #[arg(help_heading = "Results", long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
}

fn years(text: &str) -> Result<f64, String> {
    let years: f64 = text.parse().map_err(|_| "takes a number of years, such as 1.5".to_owned())?;
    if (0.5..=20.0).contains(&years) {
        Ok(years)
    } else {
        Err("takes 0.5 to 20 years: a shorter history has no baseline before the event".into())
    }
}

fn scenario(name: &str) -> Result<Scenario, String> {
    Scenario::ALL
        .into_iter()
        .find(|of| of.name() == name)
        .ok_or_else(|| format!("takes one of {}", Scenario::ALL.map(Scenario::name).join(", ")))
}

fn size(text: &str) -> Result<(Scenario, f64), String> {
    let (name, size) = text.split_once('=').ok_or("takes a scenario and a size, such as payload=0.8")?;
    let of = scenario(name)?;
    if of.size().is_empty() {
        return Err(format!("{name} has no size"));
    }
    let size: f64 = size.parse().map_err(|_| format!("{size:?} is no number: {name} takes {}", of.size()))?;
    match size.is_finite() && size != 0.0 {
        true => Ok((of, size)),
        false => Err(format!("takes a number other than zero: {}", of.size())),
    }
}

/// Default number of robots of each scenario.
const ROBOTS: u32 = 20;
const ROBOTS_WITH_EXPORTS: u32 = 2;

pub(crate) fn evaluate(global: &LabOptions, args: &EvaluateArgs) -> Result<u8, CliError> {
    let usual = if args.through_exports { ROBOTS_WITH_EXPORTS } else { ROBOTS };
    let robots = args.robots.unwrap_or(usual) as usize;
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let scenarios = args.scenarios()?;
    let bar = progress_bar(robots * scenarios.len());
    let (scores, fleet) = if args.through_exports {
        let fleet =
            format!("{robots} robots a fault, {} tests each through files, seed {}", args.tests, args.seed);
        let settings = ExportSettings {
            robots,
            tests: args.tests,
            seed: args.seed,
            threads,
            scenarios,
            sizes: args.size.clone(),
        };
        (vec![evaluate_exports(&settings, &|| bar.inc(1))?], fleet)
    } else {
        let years = if args.years == 1.0 { "one year".into() } else { format!("{} years", args.years) };
        let fleet = format!("{robots} robots a fault, each watched for {years}, seed {}", args.seed);
        let settings = FleetSettings {
            robots,
            years: args.years,
            seed: args.seed,
            threads,
            scenarios,
            sizes: args.size.clone(),
        };
        let scores = judge(&settings, &|| bar.inc(1));
        (scores.map_err(|error| CliError::Internal(format!("a drawn arm: {error}")))?, fleet)
    };
    bar.finish_and_clear();
    print(&scores, args, global.json, fleet)
}

fn print(scores: &[DetectorScore], args: &EvaluateArgs, json: bool, fleet: String) -> Result<u8, CliError> {
    if let (Some(file), Some(own)) = (&args.plot, scores.first()) {
        file.write(&figure(own, fleet))?;
    }
    if json {
        scores.iter().for_each(|score| output::json(&as_json(score, args.seed)));
    } else {
        output::line(&as_text(scores));
    }
    Ok(EXIT_DONE)
}

impl EvaluateArgs {
    /// The requested scenarios, or all that can be simulated in this way.
    fn scenarios(&self) -> Result<Vec<Scenario>, CliError> {
        let can = |of: &Scenario| if self.through_exports { of.has_exports() } else { of.has_figures() };
        let mut scenarios = self.scenario.clone();
        scenarios.extend(self.size.iter().map(|(of, _)| *of));
        if let Some(other) = scenarios.iter().find(|of| !can(of)) {
            let way = if self.through_exports { "only without" } else { "only with" };
            return Err(CliError::Usage(format!(
                "{} can be simulated {way} --through-exports",
                other.name()
            )));
        }
        if scenarios.is_empty() {
            scenarios = Scenario::ALL.into_iter().filter(can).collect();
        }
        scenarios.sort_unstable();
        scenarios.dedup();
        Ok(scenarios)
    }
}

fn progress_bar(count: usize) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} robots, {eta} left");
    ProgressBar::new(count as u64).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
