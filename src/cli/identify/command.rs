//! `armwatch identify`: one parameter set from chosen cycles, or one from each, without their exports.

use super::args::{IdentifyArgs, name_taken};
use super::choose_friction::choose_friction;
use super::each_cycle;
use super::output::{Report, print};
use super::prior_choice::{prior_choice, sources_overlap};
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, open_to_change, open_to_read, runtime};
use crate::cli::shared::output;
use crate::cli::shared::selection::{cycle_numbers, note_cycles, runs_of};
use crate::pipeline::stored::chosen_cycles::{
    ParameterCandidate, PooledCycles, RunCycles, rmsd_of_views, rmsd_on, take,
};
use crate::pipeline::stored::reestimate::{EstimatorChoice, PooledOutcome, PooledResult, estimate_together};
use armwatch_config::Config;
use armwatch_method::least_squares::essential::EssentialSettings;
use armwatch_method::pooled::estimate::{PooledEstimate, StackedEstimator};
use armwatch_method::pooled::per_joint::PerJointEstimate;
use armwatch_model::analysis::estimator_kind::EstimatorKind;
use armwatch_model::analysis::{Estimator, TorqueRmsd};
use armwatch_model::robot::JointIndex;
use armwatch_store::{ParameterSet, Store};

pub(in crate::cli) fn identify(global: &Global, args: &IdentifyArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let cycles = args.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
    let estimator = args.estimator.map_or_else(|| configured(&config), |of| of.0);
    check(args, estimator)?;
    runtime()?.block_on(async {
        let store = match args.save {
            Some(_) => open_to_change(&config).await?,
            None => open_to_read(&config).await?,
        };
        let done = identify_stored(global, args, (estimator, cycles), &config, &store).await;
        store.close().await?;
        done
    })
}

/// The configured estimator, or its counterpart on factors.
fn configured(config: &Config) -> EstimatorKind {
    let configured = config.analysis.estimator;
    if configured.of_factors() != configured {
        output::print_hint(&format!(
            "the configured estimator {} weights single rows, which are not stored: {} is used instead; \
            choose another with --estimator",
            configured.name(),
            configured.of_factors().name()
        ));
    }
    match configured.of_factors() {
        Estimator::Ordinary => EstimatorKind::Ordinary,
        Estimator::Weighted | Estimator::Huber => EstimatorKind::Weighted,
    }
}

/// Refuses arguments that exclude each other.
fn check(args: &IdentifyArgs, of: EstimatorKind) -> Result<(), CliError> {
    args.save.as_deref().map_or(Ok(()), check_name)?;
    let refuse = |what: &str| Err(CliError::Usage(what.to_owned()));
    if args.prior.is_some() && of != EstimatorKind::Prior {
        return refuse("--prior requires --estimator prior");
    }
    if args.essential && matches!(of, EstimatorKind::PerJoint | EstimatorKind::Prior) {
        return refuse("--essential requires the estimator ordinary, weighted or huber");
    }
    if args.save.is_some() && of == EstimatorKind::PerJoint && !args.each_cycle {
        return refuse(
            "the results of single joints are not one parameter set, so they cannot be saved as one; \
            --estimator weighted combines them, and --each-cycle saves them separately",
        );
    }
    match args.prior_std_fraction {
        Some(fraction) if !(fraction > 0.0 && fraction.is_finite()) => {
            refuse("--prior-std-fraction must be above 0")
        }
        _ => Ok(()),
    }
}

async fn identify_stored(
    global: &Global,
    args: &IdentifyArgs,
    (estimator, cycles): (EstimatorKind, Option<Vec<u32>>),
    config: &Config,
    store: &Store,
) -> Result<u8, CliError> {
    let mut run_ids: Vec<(i64, bool)> = args.runs.iter().map(|run| (*run, true)).collect();
    let known = store.runs().await?;
    for robot in &args.robots {
        run_ids.extend(runs_of(&known, robot)?.iter().map(|run| (run.run_id, false)));
    }
    let chosen: Vec<RunCycles> = run_ids
        .into_iter()
        .map(|(run_id, named)| RunCycles { run_id, cycles: cycles.clone(), named })
        .collect();
    let is_chosen = |run_id: i64| chosen.iter().any(|of| of.run_id == run_id);
    let robot = known.iter().find(|run| is_chosen(run.run_id)).map(|run| run.robot.clone());
    let (choice, prior_sources) = match estimator {
        EstimatorKind::Ordinary => (EstimatorChoice::Stacked(StackedEstimator::Ordinary), Vec::new()),
        EstimatorKind::Weighted => (EstimatorChoice::Stacked(StackedEstimator::Weighted), Vec::new()),
        EstimatorKind::PerJoint => (EstimatorChoice::PerJoint, Vec::new()),
        EstimatorKind::Huber => (EstimatorChoice::Stacked(StackedEstimator::Huber), Vec::new()),
        EstimatorKind::Prior => prior_choice(args, &chosen, robot.as_deref(), config, store).await?,
    };
    if args.choose_friction {
        return choose_friction(global, &chosen, config, store).await;
    }
    if args.each_cycle {
        let expected = each_cycle::expected(&known, &chosen);
        return each_cycle::each_cycle(global, args, &chosen, &choice, expected, store).await;
    }
    let taken = take(store, &chosen).await?;
    note_cycles(&taken.passed_over, &taken.in_spite);
    if let Some(cycle) = sources_overlap(&taken.sources, &prior_sources) {
        return Err(CliError::Usage(format!(
            "cycle {} of run {} is both in the prior and among the chosen cycles: it would count twice; \
            choose other cycles for one of them",
            cycle.cycle, cycle.run_id
        )));
    }
    let fewest = args.essential.then(EssentialSettings::default);
    let together = estimate_together(&taken, &choice, fewest).await?;
    report(global, args, &chosen, choice.kind(), &taken, together, store).await
}

async fn report(
    global: &Global,
    args: &IdentifyArgs,
    chosen: &[RunCycles],
    estimator: EstimatorKind,
    taken: &PooledCycles,
    together: PooledResult,
    store: &Store,
) -> Result<u8, CliError> {
    let (rmsd, rmsd_full) = match &together.outcome {
        PooledOutcome::Set(found) => rmsd_of_set(store, taken, found, chosen).await?,
        PooledOutcome::Views(views) => (rmsd_of_views(store, &parameters_of(views), chosen).await?, None),
        PooledOutcome::TooPoor => (Vec::new(), None),
    };
    if let (Some(name), PooledOutcome::Set(found)) = (&args.save, &together.outcome) {
        save(store, name, taken, found, estimator).await?;
    }
    let parameters = store.model_parameters(&taken.model).await?;
    let report = Report {
        taken,
        estimator,
        together: &together,
        parameters: &parameters,
        rmsd: &rmsd,
        rmsd_full: rmsd_full.as_deref(),
        groupings: args.groupings,
        saved: args.save.as_deref().filter(|_| matches!(together.outcome, PooledOutcome::Set(_))),
    };
    print(&report, global.json);
    if !global.json
        && let Some(name) = report.saved
    {
        output::print_hint(&format!("saved as {name}"));
    }
    let complete = match &together.outcome {
        PooledOutcome::Set(found) => {
            let removed = found.essential.as_ref().map_or(0, |of| of.removed.len());
            let unshown = found.identification.parameters.iter().filter(|of| !of.is_shown()).count();
            unshown == removed
        }
        PooledOutcome::Views(views) => views.iter().all(|(_, view)| view.is_ok()),
        PooledOutcome::TooPoor => false,
    };
    Ok(if complete { EXIT_DONE } else { EXIT_FOUND })
}

type RmsdBeforeAndAfter = (Vec<TorqueRmsd>, Option<Vec<TorqueRmsd>>);

/// RMSD of the set and, if parameters were removed, of the full one.
async fn rmsd_of_set(
    store: &Store,
    taken: &PooledCycles,
    found: &PooledEstimate,
    chosen: &[RunCycles],
) -> Result<RmsdBeforeAndAfter, CliError> {
    let candidate =
        |parameters: &[_]| ParameterCandidate { model: taken.model.clone(), parameters: parameters.to_vec() };
    let rmsd = rmsd_on(store, &candidate(&found.identification.parameters), chosen).await?;
    let full = match &found.essential {
        Some(report) => Some(rmsd_on(store, &candidate(&report.full), chosen).await?),
        None => None,
    };
    Ok((rmsd, full))
}

fn parameters_of<E>(
    views: &[(JointIndex, Result<PerJointEstimate, E>)],
) -> Vec<(JointIndex, Vec<armwatch_model::analysis::IdentifiedParameter>)> {
    let of = |(joint, view): &(JointIndex, Result<PerJointEstimate, E>)| {
        Some((*joint, view.as_ref().ok()?.identification.parameters.clone()))
    };
    views.iter().filter_map(of).collect()
}

async fn save(
    store: &Store,
    name: &str,
    taken: &PooledCycles,
    found: &PooledEstimate,
    estimator: EstimatorKind,
) -> Result<(), CliError> {
    let set = ParameterSet {
        model: taken.model.clone(),
        identification: found.identification.clone(),
        sources: taken.sources.clone(),
        estimator,
        errors: found.errors.source(),
    };
    match store.save_parameter_set(name, &set).await? {
        true => Ok(()),
        false => Err(name_taken(name)),
    }
}

/// Refuses names that `verify --parameters` or `--prior` would interpret differently.
fn check_name(name: &str) -> Result<(), CliError> {
    let ambiguous =
        name.is_empty() || name.contains(':') || name.parse::<i64>().is_ok() || name == "description";
    if ambiguous {
        return Err(CliError::Usage(format!(
            "\"{name}\" is not a valid name for a parameter set: it is empty or a number, contains a colon, \
            or is the word description"
        )));
    }
    Ok(())
}
