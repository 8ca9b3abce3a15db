//! The prior that `--prior` selects.

use super::args::IdentifyArgs;
use crate::cli::context::CliError;
use crate::cli::shared::selection::find_set;
use crate::pipeline::stored::chosen_cycles::RunCycles;
use crate::pipeline::stored::reestimate::EstimatorChoice;
use armwatch_config::Config;
use armwatch_method::least_squares::prior::{ParameterPrior, PriorStrength};
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::pooled::estimate::StackedEstimator;
use armwatch_method::pooled::nominal_prior::{PRIOR_STD_FRACTION, nominal_base, with_fraction};
use armwatch_model::robot::ParameterId;
use armwatch_store::{FactorsWanted, ParameterSet, SourceCycle, Store, StoredModel};

/// The selected prior, and the cycles that it comes from.
pub(in crate::cli) async fn prior_choice(
    args: &IdentifyArgs,
    chosen: &[RunCycles],
    robot: Option<&str>,
    config: &Config,
    store: &Store,
) -> Result<(EstimatorChoice, Vec<SourceCycle>), CliError> {
    let Some(word) = args.prior.as_deref() else {
        return Err(CliError::Usage("--estimator prior needs --prior".into()));
    };
    let model = model_of(chosen, store).await?;
    let strength = match args.prior_std_fraction {
        Some(_) => PriorStrength::AsGiven,
        None => PriorStrength::CrossValidated,
    };
    let (priors, sources) = if word == "description" {
        (of_description(args, robot, model.as_ref(), config)?, Vec::new())
    } else {
        let set = find_set(store, word, config.analysis.estimator).await?;
        if let Some(model) = model.filter(|model| *model != set.model) {
            return Err(CliError::Usage(format!(
                "the prior {word} belongs to another description (model {}) than the chosen cycles (model \
                {}): base parameters of different descriptions are not comparable",
                set.model.name, model.name
            )));
        }
        (of_set(args, &set), set.sources)
    };
    if priors.is_empty() {
        return Err(CliError::Usage(format!(
            "the prior {word} is empty: the description has no nominal parameters; name a run or a saved set"
        )));
    }
    Ok((EstimatorChoice::Stacked(StackedEstimator::Prior { priors, strength }), sources))
}

/// The first cycle that both come from.
pub(in crate::cli) fn sources_overlap<'a>(
    taken: &'a [SourceCycle],
    prior: &[SourceCycle],
) -> Option<&'a SourceCycle> {
    taken.iter().find(|cycle| prior.contains(cycle))
}

async fn model_of(chosen: &[RunCycles], store: &Store) -> Result<Option<StoredModel>, CliError> {
    let Some(first) = chosen.first() else { return Ok(None) };
    let cycles = store.factors_of_run(first.run_id, FactorsWanted::Identification).await?;
    Ok(cycles.into_iter().next().map(|cycle| cycle.model))
}

/// Nominal parameters, grouped; those without a nominal value have no prior.
fn of_description(
    args: &IdentifyArgs,
    robot: Option<&str>,
    model: Option<&StoredModel>,
    config: &Config,
) -> Result<Vec<(ParameterId, ParameterPrior)>, CliError> {
    let name = robot.unwrap_or("of the chosen runs");
    let entry = robot.and_then(|robot| config.robot_entry(robot));
    let described =
        entry.map(|entry| &entry.description).filter(|robot| model.is_none_or(|of| of.describes(robot)));
    let Some(described) = described else {
        return Err(CliError::Usage(format!(
            "the configuration no longer has the description of robot {name} that its cycles were analysed \
            with; name a run or a saved set as --prior"
        )));
    };
    let base = base_parameters(described).map_err(|error| CliError::Usage(error.to_string()))?;
    let values: Vec<(ParameterId, Option<f64>)> =
        base.kept.iter().copied().zip(nominal_base(described, &base)).collect();
    Ok(known(&values, args.prior_std_fraction.unwrap_or(PRIOR_STD_FRACTION)))
}

/// Values of a set; without a fraction, their own standard errors are their uncertainty.
fn of_set(args: &IdentifyArgs, set: &ParameterSet) -> Vec<(ParameterId, ParameterPrior)> {
    let parameters = &set.identification.parameters;
    let own = |p: &armwatch_model::analysis::IdentifiedParameter| {
        (p.std_error > 0.0 && p.std_error.is_finite())
            .then_some((p.id, ParameterPrior { value: p.value, std: p.std_error }))
    };
    match args.prior_std_fraction {
        Some(fraction) => {
            let values: Vec<_> = parameters.iter().map(|p| (p.id, Some(p.value))).collect();
            known(&values, fraction)
        }
        None => parameters.iter().filter_map(own).collect(),
    }
}

fn known(values: &[(ParameterId, Option<f64>)], fraction: f64) -> Vec<(ParameterId, ParameterPrior)> {
    let priors = with_fraction(values, fraction);
    values.iter().zip(priors).filter_map(|((id, _), prior)| Some((*id, prior?))).collect()
}
