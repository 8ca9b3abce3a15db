//! `armwatch benchmark coverage`: whether intervals hold the truth as often as they say.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::{CliError, EXIT_DONE, EXIT_FOUND, Global, output};
use crate::config::read_robot;
use crate::numerics::NumericsError;
use crate::numerics::base::{BaseParameters, base_parameters};
use crate::numerics::covariance::{ClusterSettings, clustered};
use crate::numerics::estimate::weighted;
use crate::numerics::identify::MAX_SCALED_CONDITION;
use crate::numerics::regressor::KeptColumns;
use crate::numerics::rows::{CycleRows, joint_factors, reversal_guard};
use crate::numerics::signal::condition;
use crate::robot::{FrictionTerm, ParameterId, ParameterKind, Robot};
use crate::run::Stage;
use crate::simulate::exact::{ExactSettings, record_excitation};

/// Coverage that counts as honest for nominal 95 %.
const HONEST: [f64; 2] = [0.93, 0.97];
/// Nominal probability of the intervals.
const LEVEL: f64 = 0.95;
/// Cut-off of the analysis, Hz.
const CUTOFF_HZ: f64 = 12.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Simulates excitation stages whose true parameters are known, identifies each with weighted least squares,
and counts how often the 95 % intervals hold the truth. Exit status 1 if that is not 93 to 97 %.

Examples:
  armwatch benchmark coverage config/robots/er3a.toml
  armwatch benchmark coverage config/robots/er3a.toml --correlation 0.9")]
pub(super) struct CoverageArgs {
    /// Robot description with nominal parameters
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Simulated excitation stages
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Rows a second, Hz
    #[arg(long, default_value_t = 100.0)]
    rate_hz: f64,
    /// Correlation of the torque noise from row to row, 0 to below 1; 0 is white noise
    #[arg(long, default_value_t = 0.0)]
    correlation: f64,
    /// Torque noise relative to the description's
    #[arg(long, default_value_t = 1.0)]
    noise: f64,
}

pub(super) fn coverage(global: &Global, args: &CoverageArgs) -> Result<u8, CliError> {
    let robot = read_robot(&args.file)?;
    if !(0.0..1.0).contains(&args.correlation) {
        return Err(CliError::Usage("--correlation takes 0 to below 1".into()));
    }
    let settings = ExactSettings {
        sample_rate_hz: args.rate_hz,
        torque_noise_scale: args.noise,
        torque_noise_correlation: args.correlation,
        ..ExactSettings::default()
    };
    let counted = count(&robot, &settings, args.seeds, &ClusterSettings::default())
        .map_err(|error| CliError::Usage(format!("{}: {error}", args.file.display())))?;
    let share = counted.share(|_| true);
    if global.json {
        output::json(&json!({
            "robot": robot.model, "seeds": args.seeds, "coverage": share,
            "block_rows": counted.block_rows, "blocks": counted.blocks,
            "parameters": counted.ids.iter().zip(&counted.inside).zip(&counted.bias).map(|((id, inside), bias)| json!({
                "joint": id.joint.number(), "parameter": id.name(),
                "coverage": *inside as f64 / counted.seeds as f64, "bias_in_sigma": bias,
            })).collect::<Vec<_>>(),
        }));
    } else {
        output::line(&counted.table());
    }
    let honest = (HONEST[0]..=HONEST[1]).contains(&share);
    Ok(if honest { EXIT_DONE } else { EXIT_FOUND })
}

/// Which parameters a line of the table is about.
type Class = fn(ParameterKind) -> bool;

/// How often intervals held the truth.
#[derive(Debug)]
struct Coverage {
    ids: Vec<ParameterId>,
    /// Seeds whose interval held the truth, by parameter.
    inside: Vec<u64>,
    /// Mean deviation in standard errors, by parameter: what is left of bias.
    bias: Vec<f64>,
    /// Mean standard error over the scatter of the values, by parameter; 1 if honest.
    error_ratio: Vec<f64>,
    seeds: u64,
    block_rows: usize,
    blocks: usize,
}

impl Coverage {
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
        let classes: [(&str, Class); 6] = [
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
            "{}\n{} seeds, {} blocks of {} rows",
            output::table(
                &["parameters", "count", "in 95 % interval", "stated / true error", "|bias| / error"],
                &rows
            ),
            self.seeds,
            self.blocks,
            self.block_rows
        )
    }
}

/// Identifies `seeds` simulated excitation stages and counts.
fn count(
    robot: &Robot,
    settings: &ExactSettings,
    seeds: u64,
    clusters: &ClusterSettings,
) -> Result<Coverage, CountError> {
    let base = base_parameters(robot)?;
    let truth = base.group(&natural_values(robot));
    let b = truth.len();
    let mut found = Coverage {
        ids: base.kept.clone(),
        inside: vec![0; b],
        bias: vec![0.0; b],
        error_ratio: vec![0.0; b],
        seeds,
        block_rows: 0,
        blocks: 0,
    };
    let (mut deviations, mut squares, mut errors) = (vec![0.0; b], vec![0.0; b], vec![0.0; b]);
    for seed in 1..=seeds {
        let one = identify_one(robot, &base, &ExactSettings { seed, ..*settings }, clusters)?;
        (found.block_rows, found.blocks) = (one.block_rows, one.blocks);
        for k in 0..b {
            let deviation = one.theta[k] - truth[k];
            found.inside[k] += u64::from(deviation.abs() <= one.half_width[k]);
            found.bias[k] += deviation / one.sigma[k] / seeds as f64;
            deviations[k] += deviation;
            squares[k] += deviation * deviation;
            errors[k] += one.sigma[k] * one.sigma[k];
        }
    }
    let count = seeds as f64;
    for k in 0..b {
        let scatter = (squares[k] - deviations[k] * deviations[k] / count) / (count - 1.0).max(1.0);
        found.error_ratio[k] = (errors[k] / count / scatter).sqrt();
    }
    Ok(found)
}

/// One identification with its intervals, by parameter.
struct One {
    theta: Vec<f64>,
    sigma: Vec<f64>,
    half_width: Vec<f64>,
    block_rows: usize,
    blocks: usize,
}

fn identify_one(
    robot: &Robot,
    base: &BaseParameters,
    settings: &ExactSettings,
    clusters: &ClusterSettings,
) -> Result<One, CountError> {
    let samples = record_excitation(robot, settings)?;
    let conditioned = condition(&samples, CUTOFF_HZ)?;
    let columns = KeptColumns::new(&base.kept_columns);
    let rows = conditioned.usable.iter().flat_map(Clone::clone);
    let in_excitation = rows.filter(|row| samples.stage[*row] == Stage::Excitation);
    let source = CycleRows::new(robot, &columns, &conditioned, in_excitation, reversal_guard(CUTOFF_HZ));
    let estimate = weighted(&joint_factors(&source), MAX_SCALED_CONDITION, |k| base.kept[k].to_string())?;
    let covariance = clustered(&source, &estimate.solution.theta, &estimate.rule, clusters)?;
    Ok(One {
        half_width: (0..base.kept.len()).map(|k| covariance.half_width(k, LEVEL)).collect(),
        theta: estimate.solution.theta,
        sigma: covariance.sigma,
        block_rows: covariance.block_rows,
        blocks: covariance.blocks,
    })
}

/// Nominal parameters in natural order; zero where a joint has none, which the simulator refuses.
fn natural_values(robot: &Robot) -> Vec<f64> {
    let ids = ParameterId::natural_order(robot);
    let value = |id: &ParameterId| {
        robot.joints[id.joint.index()].nominal.map_or(0.0, |nominal| match id.kind {
            ParameterKind::Inertial(k) => nominal.inertial.0[usize::from(k)],
            ParameterKind::Friction(term) => {
                let place = robot.friction.terms().iter().position(|of| *of == term);
                place.map_or(0.0, |place| nominal.friction[place])
            }
            ParameterKind::MotorInertia => nominal.motor_inertia,
            ParameterKind::Coupling(_) => 0.0,
        })
    };
    ids.iter().map(value).collect()
}

/// Why nothing could be counted.
#[derive(Debug, thiserror::Error)]
enum CountError {
    #[error(transparent)]
    Numerics(#[from] NumericsError),
    #[error(transparent)]
    Simulate(#[from] crate::simulate::SimulateError),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::er3a;

    #[test]
    fn intervals_hold_the_truth_as_often_as_they_say() {
        let settings = ExactSettings { sample_rate_hz: 50.0, ..ExactSettings::default() };
        let found = count(&er3a(), &settings, 20, &ClusterSettings::default()).expect("identifies");
        let share = found.share(|_| true);
        // 20 seeds of 64 parameters, which share their noise within a seed: as if 20 times 16 were
        // independent, 95 % scatter by 1.2 %; three times that.
        assert!((share - LEVEL).abs() < 0.036, "{}", found.table());
    }
}
