//! `armwatch-lab benchmark coverage`: how often intervals contain the true value, compared with their nominal
//! probability.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;

use crate::context::LabOptions;
use armwatch::cli::context::{CliError, EXIT_DONE, EXIT_FOUND};
use armwatch::cli::shared::output;
use armwatch::cli::shared::programme::programme;
use armwatch::pipeline::take::cycles::read_cycle;
use armwatch_config::{Config, Layout, read_robot};
use armwatch_ingest::rejection::Rejection;
use armwatch_method::NumericsError;
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::pooled::nominal_prior::nominal_value;
use armwatch_method::statistics::descriptive::median;
use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::interval::half_width;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{FourierExcitation, FrictionTerm, ParameterId, ParameterKind, Robot};
use armwatch_model::run::Cycle;
use armwatch_simulate::arm::friction::FrictionShape;
use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
use armwatch_simulate::run::recording::SensorSettings;
use armwatch_simulate::{SimulationSettings, simulate_run};
use armwatch_trajectory::prediction::predict;
use armwatch_trajectory::recorded_rows::RecordingPlan;

/// Accepted coverage of nominal 95 % intervals.
const HONEST: [f64; 2] = [0.93, 0.97];
/// Time after which no effect of a cold start remains, s.
const LONG_WARM_S: f64 = 1e7;
/// Nominal probability of the intervals.
const LEVEL: f64 = 0.95;

#[derive(Debug, Args)]
#[command(after_help = "\
Simulates excitation stages whose true parameters are known, analyses each as a cycle of an export is
analysed, and counts how often the 95 % intervals hold the truth. Exit status 1 if that is not 93 to 97 %.

Examples:
  armwatch-lab benchmark coverage config/robots/er3a.toml
  armwatch-lab benchmark coverage config/robots/er3a.toml --correlation 0.9
  armwatch-lab benchmark coverage config/robots/scara.toml --estimator ordinary \\
      --json
  armwatch-lab benchmark coverage config/robots/er3a.toml --trajectory er3a.json
  armwatch-lab benchmark coverage config/robots/er3a.toml --series-alone \\
      --trajectory er3a.json
  armwatch-lab benchmark coverage config/robots/er3a.toml --exports
  armwatch-lab benchmark coverage config/robots/er3a.toml --exports --gearbox \\
      --seeds 30")]
pub(crate) struct CoverageArgs {
    /// Robot description with nominal parameters
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Simulated excitation stages
    #[arg(help_heading = "What is simulated", long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Rows a second, Hz
    #[arg(help_heading = "What is simulated", long, default_value_t = 100.0)]
    rate_hz: f64,
    /// Correlation of the torque noise from row to row, 0 to below 1; 0 is white noise
    #[arg(help_heading = "What is simulated", long, default_value_t = 0.0)]
    correlation: f64,
    /// How rows become parameters: ordinary, weighted or huber
    #[arg(help_heading = "Estimator", long, default_value = "weighted", value_parser = estimator)]
    estimator: Estimator,
    /// Whole exports, written and read as CSV, instead of excitation stages alone
    #[arg(help_heading = "What is simulated", long, conflicts_with_all = ["correlation", "noise"])]
    exports: bool,
    /// Exports of an arm whose friction has a bump at low speed and a ripple, which the model has not: what
    /// intervals are worth where the model is wrong
    #[arg(help_heading = "What is simulated", long, requires = "exports")]
    gearbox: bool,
    /// Torque noise relative to the description's
    #[arg(help_heading = "What is simulated", long, default_value_t = 1.0)]
    noise: f64,
    /// Noise of the positions, rad (m) [default: 2e-5]
    #[arg(help_heading = "What is simulated", long, conflicts_with = "exports", value_name = "RAD")]
    position_noise: Option<f64>,
    /// Noise of the velocities, rad/s (m/s) [default: 2e-3]
    #[arg(help_heading = "What is simulated", long, conflicts_with = "exports", value_name = "RAD_S")]
    velocity_noise: Option<f64>,
    /// The series alone, without the motion over the ranges near full speed behind it; scatters are then compared with
    /// what `armwatch trajectory design` predicts
    #[arg(help_heading = "What is simulated", long, conflicts_with = "exports")]
    series_alone: bool,
    /// Programme of `armwatch trajectory design`, driven in place of the description's excitation; true errors are then
    /// compared with those of the description's, if it has one, of series alone at equal time
    #[arg(help_heading = "What is simulated", long, value_name = "PROGRAMME")]
    trajectory: Option<PathBuf>,
}

pub(crate) fn coverage(global: &LabOptions, args: &CoverageArgs) -> Result<u8, CliError> {
    let described = read_robot(&args.file)?;
    if !(0.0..1.0).contains(&args.correlation) {
        return Err(CliError::Usage("--correlation takes 0 to below 1".into()));
    }
    let own_excitation = described.excitation.clone();
    let mut robot = described;
    if let Some(path) = &args.trajectory {
        robot.excitation = Some(programme(path, &robot)?.series);
    }
    let refused = |error: CountError| CliError::Usage(format!("{}: {error}", args.file.display()));
    let analysis = AnalysisSettings { estimator: args.estimator, ..AnalysisSettings::default() };
    let mut method = Method::new(robot, analysis).map_err(|error| refused(error.into()))?;
    let layout = shipped_layout()?;
    let found = counted(args, &method, &layout).map_err(refused)?;
    let predicted = predicted_over_scatter(args, &method, &found).map_err(refused)?;
    let against_own = match (&args.trajectory, own_excitation) {
        (Some(_), Some(own)) => {
            let time = equal_time(args, &method.robot, &own);
            method.robot.excitation = Some(own);
            let own = counted(args, &method, &layout).map_err(refused)?;
            Some(found.errors_over(&own).map(|ratio| time * ratio))
        }
        _ => None,
    };
    let share = found.share(|_| true);
    if global.json {
        output::json(&json!({
            "robot": method.robot.model, "seeds": args.seeds, "coverage": share,
            "estimator": args.estimator.name(),
            "errors_over_own_excitation": against_own.map(|[smallest, median, largest]| json!({
                "smallest": smallest, "median": median, "largest": largest,
            })),
            "predicted_over_scatter": predicted.as_ref().map(|ratios| json!({
                "median": median(ratios), "within_10_percent": within(ratios),
            })),
            "parameters": found.ids.iter().enumerate().map(|(k, id)| json!({
                "joint": id.joint.number(), "parameter": id.name(),
                "coverage": found.inside[k] as f64 / found.seeds as f64, "bias_in_sigma": found.bias[k],
                "stated_over_scatter": found.error_ratio[k],
                "predicted_over_scatter": predicted.as_ref().map(|ratios| ratios[k]),
            })).collect::<Vec<_>>(),
        }));
    } else {
        output::line(&found.table());
        if let Some(ratios) = &predicted {
            output::line(&format!(
                "predicted standard deviations are {:.3} of the scatter (median), {:.0} % of them within 10 %",
                median(ratios).unwrap_or(f64::NAN),
                100.0 * within(ratios)
            ));
        }
        if let Some([smallest, median, largest]) = against_own {
            output::line(&format!(
                "true errors are {median:.2} of those with the description's own excitation (median; {smallest:.2} to \
                 {largest:.2})"
            ));
        }
    }
    let honest = (HONEST[0]..=HONEST[1]).contains(&share);
    Ok(if honest { EXIT_DONE } else { EXIT_FOUND })
}

/// Factor of errors relative to those of the description's own motion, so that both have the same time: only this makes
/// series of other durations comparable.
fn equal_time(args: &CoverageArgs, driven: &Robot, own: &FourierExcitation) -> f64 {
    match &driven.excitation {
        Some(series) if args.series_alone => (own.base_frequency / series.base_frequency).sqrt(),
        _ => 1.0,
    }
}

/// Predicted standard deviations divided by the scatter of the values, by parameter; `None` if there is more than one
/// period, or noise is not white.
fn predicted_over_scatter(
    args: &CoverageArgs,
    method: &Method,
    found: &Coverage,
) -> Result<Option<Vec<f64>>, CountError> {
    let series = method.robot.excitation.as_ref().filter(|_| args.series_alone && args.correlation == 0.0);
    let noise: Option<Vec<f64>> =
        method.robot.joints.iter().map(|joint| Some(args.noise * joint.nominal?.torque_noise)).collect();
    let Some((series, noise)) = series.zip(noise) else { return Ok(None) };
    let cutoff_hz = AnalysisSettings::default().cutoff;
    let recording = RecordingPlan { sample_rate_hz: args.rate_hz, periods: 1, cutoff_hz, noise };
    let prediction = predict(&method.robot, &method.base, series, &recording)?;
    let pairs = prediction.standard_deviations.iter().zip(&found.scatter);
    Ok(Some(pairs.map(|(predicted, scatter)| predicted / scatter).collect()))
}

/// Share of the ratios that are within 10 % of 1.
fn within(ratios: &[f64]) -> f64 {
    let near = ratios.iter().filter(|ratio| (0.9..=1.1).contains(*ratio));
    near.count() as f64 / ratios.len() as f64
}

/// Simulates and counts, with a progress bar.
fn counted(args: &CoverageArgs, method: &Method, layout: &Layout) -> Result<Coverage, CountError> {
    let shipped = SensorSettings::default();
    let settings = ExactSettings {
        sample_rate_hz: args.rate_hz,
        torque_noise_scale: args.noise,
        torque_noise_correlation: args.correlation,
        sensors: SensorSettings {
            position_noise: args.position_noise.unwrap_or(shipped.position_noise),
            velocity_noise: args.velocity_noise.unwrap_or(shipped.velocity_noise),
            ..shipped
        },
        additional: !args.series_alone,
        ..ExactSettings::default()
    };
    let bar = progress_bar(args.seeds);
    let counted = if args.exports {
        let friction = if args.gearbox { FrictionShape::Gearbox } else { FrictionShape::Polynomial };
        let cycle = |seed| exported_cycle(&method.robot, args.rate_hz, friction, layout, seed);
        count(method, args.seeds, &cycle, &|| bar.inc(1))?
    } else {
        count(method, args.seeds, &|seed| exact_cycle(&method.robot, &settings, seed), &|| bar.inc(1))?
    };
    bar.finish_and_clear();
    Ok(counted)
}

fn shipped_layout() -> Result<Arc<Layout>, CliError> {
    let shipped = Config::shipped().map_err(|errors| CliError::Internal(errors.to_string()))?;
    let layout = shipped.fleet.first().map(|entry| Arc::clone(&entry.layout));
    layout.ok_or_else(|| CliError::Internal("no layout is shipped".into()))
}

fn progress_bar(seeds: u64) -> ProgressBar {
    if std::io::stderr().is_terminal() { ProgressBar::new(seeds) } else { ProgressBar::hidden() }
}

fn estimator(name: &str) -> Result<Estimator, String> {
    let found = Estimator::ALL.into_iter().find(|estimator| estimator.name() == name);
    found.ok_or_else(|| "takes ordinary, weighted or huber".into())
}

/// Selects the parameters of a table line.
type ParameterClass = fn(ParameterKind) -> bool;

/// Result of counting.
#[derive(Debug)]
struct Coverage {
    ids: Vec<ParameterId>,
    /// Number of seeds whose interval contained the true value, by parameter.
    inside: Vec<u64>,
    /// Mean deviation in standard errors, by parameter: the bias.
    bias: Vec<f64>,
    /// Mean standard error divided by the scatter of the values, by parameter; 1 if correct.
    error_ratio: Vec<f64>,
    /// Standard deviation of the values, by parameter, in its own unit.
    scatter: Vec<f64>,
    /// Root mean square of the deviations from the truth, by parameter, in its own unit.
    true_error: Vec<f64>,
    seeds: u64,
}

impl Coverage {
    /// True errors relative to those of another motion, by parameter: smallest, median and largest.
    fn errors_over(&self, other: &Self) -> [f64; 3] {
        let pairs = self.true_error.iter().zip(&other.true_error);
        let mut ratios: Vec<f64> = pairs.map(|(own, other)| own / other).collect();
        ratios.sort_by(f64::total_cmp);
        [ratios[0], ratios[ratios.len() / 2], ratios[ratios.len() - 1]]
    }

    fn share(&self, wanted: impl Fn(ParameterKind) -> bool) -> f64 {
        let chosen: Vec<u64> =
            self.ids.iter().zip(&self.inside).filter(|(id, _)| wanted(id.kind)).map(|(_, c)| *c).collect();
        chosen.iter().sum::<u64>() as f64 / (chosen.len() as u64 * self.seeds).max(1) as f64
    }

    fn mean(&self, values: &[f64], wanted: impl Fn(ParameterKind) -> bool) -> f64 {
        let chosen: Vec<f64> =
            self.ids.iter().zip(values).filter(|(id, _)| wanted(id.kind)).map(|(_, v)| *v).collect();
        chosen.iter().sum::<f64>() / chosen.len().max(1) as f64
    }

    fn table(&self) -> String {
        let classes: [(&str, ParameterClass); 6] = [
            ("first moments", |kind| matches!(kind, ParameterKind::Inertial(0..=3))),
            ("inertias", |kind| matches!(kind, ParameterKind::Inertial(4..))),
            ("motor inertias", |kind| matches!(kind, ParameterKind::MotorInertia)),
            ("friction f1", |kind| matches!(kind, ParameterKind::Friction(FrictionTerm::F1))),
            (
                "friction f2..f4",
                |kind| matches!(kind, ParameterKind::Friction(term) if term != FrictionTerm::F1),
            ),
            ("all", |_| true),
        ];
        let magnitude: Vec<f64> = self.bias.iter().map(|bias| bias.abs()).collect();
        let rows: Vec<Vec<String>> = classes
            .into_iter()
            .map(|(name, wanted)| {
                vec![
                    name.to_owned(),
                    self.ids.iter().filter(|id| wanted(id.kind)).count().to_string(),
                    format!("{:.2} %", 100.0 * self.share(wanted)),
                    format!("{:.2}", self.mean(&self.error_ratio, wanted)),
                    format!("{:.2}", self.mean(&magnitude, wanted)),
                ]
            })
            .collect();
        format!(
            "{}\n{} seeds",
            output::table(
                &["parameters", "count", "in 95 % interval", "stated / true error", "|bias| / error"],
                &rows
            ),
            self.seeds
        )
    }
}

/// Analyses the cycles for the seeds 1 to `seeds` and counts. `progress` is called for each.
fn count(
    method: &Method,
    seeds: u64,
    cycle: &dyn Fn(u64) -> Result<Cycle, CountError>,
    progress: &dyn Fn(),
) -> Result<Coverage, CountError> {
    let truth = method.base.group(&natural_values(&method.robot));
    let b = truth.len();
    let mut found = Coverage {
        ids: method.base.kept.clone(),
        inside: vec![0; b],
        bias: vec![0.0; b],
        error_ratio: vec![0.0; b],
        scatter: vec![0.0; b],
        true_error: vec![0.0; b],
        seeds,
    };
    let (mut deviations, mut squares, mut errors) = (vec![0.0; b], vec![0.0; b], vec![0.0; b]);
    for seed in 1..=seeds {
        let identification = analyse_cycle(method, &cycle(seed)?).identification;
        let parameters = identification.map_err(CountError::Refused)?.parameters;
        for (k, (parameter, truth)) in parameters.iter().zip(&truth).enumerate() {
            let deviation = parameter.value - truth;
            found.inside[k] += u64::from(deviation.abs() <= half_width(parameter, LEVEL));
            found.bias[k] += deviation / parameter.std_error / seeds as f64;
            deviations[k] += deviation;
            squares[k] += deviation * deviation;
            errors[k] += parameter.std_error * parameter.std_error;
        }
        progress();
    }
    let count = seeds as f64;
    for k in 0..b {
        let scatter = (squares[k] - deviations[k] * deviations[k] / count) / (count - 1.0).max(1.0);
        found.true_error[k] = (squares[k] / count).sqrt();
        found.scatter[k] = scatter.sqrt();
        found.error_ratio[k] = (errors[k] / count / scatter).sqrt();
    }
    Ok(found)
}

/// An excitation stage that the identifier's model fits exactly.
fn exact_cycle(robot: &Robot, settings: &ExactSettings, seed: u64) -> Result<Cycle, CountError> {
    let samples = record_excitation(robot, &ExactSettings { seed, ..*settings })?;
    Ok(Cycle { number: 1, samples })
}

/// The cycle of an export as the daemon would read it, from an arm that has been warm for long.
fn exported_cycle(
    robot: &Robot,
    rate_hz: f64,
    friction: FrictionShape,
    layout: &Layout,
    seed: u64,
) -> Result<Cycle, CountError> {
    let folder = tempfile::tempdir().map_err(|error| CountError::Folder(error.to_string()))?;
    let settings = SimulationSettings {
        seed,
        sample_rate_hz: rate_hz,
        cycles: 1,
        warming_s: 0.0,
        initial_warm_s: LONG_WARM_S,
        ambient_std_k: 0.0,
        friction,
        ..SimulationSettings::default()
    };
    let export = simulate_run(robot, &settings, 0, folder.path(), &mut |_| ())?.export;
    let cycle = read_cycle(&export, layout, robot, 1)?;
    cycle.ok_or_else(|| CountError::Refused("the export holds no cycle".into()))
}

/// Nominal parameters in natural order; zero if a joint has none, which the simulator refuses.
fn natural_values(robot: &Robot) -> Vec<f64> {
    let value = |id| nominal_value(robot, id).unwrap_or(0.0);
    ParameterId::natural_order(robot).into_iter().map(value).collect()
}

/// Why counting failed.
#[derive(Debug, thiserror::Error)]
enum CountError {
    #[error(transparent)]
    Numerics(#[from] NumericsError),
    #[error(transparent)]
    Rejected(#[from] Rejection),
    #[error("no temporary folder: {0}")]
    Folder(String),
    #[error("a simulated cycle is refused: {0}")]
    Refused(String),
    #[error(transparent)]
    Simulate(#[from] armwatch_simulate::error::SimulateError),
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    #[test]
    fn intervals_hold_the_truth_as_often_as_they_say() {
        let settings = ExactSettings { sample_rate_hz: 50.0, ..ExactSettings::default() };
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let cycle = |seed| exact_cycle(&method.robot, &settings, seed);
        let found = count(&method, 20, &cycle, &|| ()).expect("identifies");
        let share = found.share(|_| true);
        // 20 seeds of 64 parameters, which share their noise within a seed: if 20 times 16 were independent, 95 %
        // scatter by 1.2 %; three times that.
        assert!((share - LEVEL).abs() < 0.036, "{}", found.table());
    }
}
