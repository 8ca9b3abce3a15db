//! `armwatch identify`: one parameter set from chosen cycles, or one from each, without their exports.

use clap::{Args, ValueEnum};

use super::identify_output::{Report, print};
use super::prior_choice::{prior_choice, sources_overlap};
use super::selection::{cycle_numbers, note_passed_over, runs_of};
use super::{CliError, EXIT_DONE, EXIT_FOUND, Global, each_cycle, open_store, output, runtime};
use crate::analysis::{Estimator, TorqueRmsd};
use crate::config::Config;
use crate::numerics::least_squares::essential::EssentialSettings;
use crate::numerics::pooled::estimate::{EstimatorKind, HistoryEstimate};
use crate::numerics::pooled::per_joint::JointView;
use crate::pipeline::reestimate::{Choice, Outcome, Together, estimate_together};
use crate::pipeline::stored::{Candidate, Chosen, Taken, rmsd_of_views, rmsd_on, take};
use crate::robot::JointIndex;
use crate::store::{ParameterSet, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch identify --run 3
  armwatch identify --run 3 --cycles 10,15,20
  armwatch identify --robot Left --cycles 6-24 --estimator weighted --save left-warm
  armwatch identify --run 3 --run 4 --json | jq '.parameters[] | select(.joint == 1)'
  armwatch identify --run 3 --estimator prior --prior description
  armwatch identify --run 9 --cycles 1 --estimator prior --prior left-warm --prior-std-fraction 0.1
  armwatch identify --run 3 --essential
  armwatch identify --robot Left --each-cycle --estimator weighted --save left-weighted

One set of base parameters is identified on the excitation stages of all chosen cycles together, rows of
slow joints left out. What is needed of the rows was stored with the cycles: no export is read, and the
result is that of identifying on all rows at once. Units are SI. A saved set is named in
`armwatch verify --parameters`, and is shown by the views parameter_sets and parameter_set_sources.

Estimators: the configured one if --estimator does not name another, so that a single cycle comes out as the
pipeline stored it. ordinary gives every row the same weight, weighted weighs each joint by its residual variance.
per-joint takes each joint's rows alone and prints what it sees of each parameter; a parameter that it tells
apart from others only elsewhere is in the value of these. huber starts from weighted and compares whole
cycles, since single rows are not stored: a joint's rows of a cycle whose residual is more than 1.345
robust standard deviations above that of the median cycle lose weight in proportion; it takes 5 cycles or
more. prior draws weighted towards --prior, where the motion says little; data_share is 1 where a value is
all data and 0 where it is all prior. Where huber is configured, weighted stands for it.

Of whole runs, cycles that were refused when they were read are passed over and named on standard error; a refused
cycle that --cycles names is taken if its factors are stored.

From 8 cycles on, standard errors come from the scatter between the cycles, which needs no assumption on what
happens inside them; with fewer, from the residual and the share of rows that are independent. Intervals hold
the truth with 95 %. Parameters with a standard error above 30 % are marked with *. Exit status 1 if the
motion does not show every parameter (they are named), or with --each-cycle if a cycle gave none.

--each-cycle identifies each chosen cycle alone, prints one line a parameter, or with --json one object a
cycle, and the statistics of each run as in the view parameter_statistics. --save keeps it for the views
reestimated_parameters, reestimated_cycles and reestimated_statistics. `armwatch parameters` lists and
deletes what is kept.")]
pub(super) struct IdentifyArgs {
    /// Run whose cycles are taken; may be given several times
    #[arg(long = "run", value_name = "RUN", required_unless_present = "robots")]
    runs: Vec<i64>,
    /// Robot of which all complete runs are taken; may be given several times
    #[arg(long = "robot", value_name = "NAME")]
    robots: Vec<String>,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(long, value_name = "CYCLES")]
    cycles: Option<String>,
    /// How rows become parameters [default: `[analysis] estimator` of the configuration]
    #[arg(long, value_enum)]
    estimator: Option<EstimatorArg>,
    /// What is known beforehand: parameters of a run, of some of its cycles, of a saved set, or the
    /// nominal ones of the robot's description
    #[arg(long, value_name = "RUN[:CYCLES]|SET|description", required_if_eq("estimator", "prior"))]
    pub(super) prior: Option<String>,
    /// Standard deviation of the prior as a part of its values, above 0 [default: chosen by
    /// cross-validation]
    #[arg(long, value_name = "FRACTION", requires = "prior")]
    pub(super) prior_std_fraction: Option<f64>,
    /// Leave out parameters that are not worth their uncertainty
    #[arg(long)]
    essential: bool,
    /// Identify each cycle alone
    #[arg(long, conflicts_with = "essential")]
    each_cycle: bool,
    /// Print the sum of link parameters that each parameter stands for
    #[arg(long)]
    groupings: bool,
    /// Keep the parameters under this name
    #[arg(long, value_name = "NAME")]
    pub(super) save: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum EstimatorArg {
    /// Every row alike
    Ordinary,
    /// Each joint by its residual variance
    Weighted,
    /// Each joint alone
    PerJoint,
    /// Weighted, cycles that do not fit the others with less weight
    Huber,
    /// Weighted, towards what is known beforehand
    Prior,
}

pub(super) fn identify(global: &Global, args: &IdentifyArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let cycles = args.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
    let estimator = args.estimator.unwrap_or_else(|| configured(&config));
    check(args, estimator)?;
    runtime()?.block_on(async {
        let store = open_store(&config).await?;
        let done = identify_stored(global, args, (estimator, cycles), &config, &store).await;
        store.close().await?;
        done
    })
}

/// The configured estimator, or what stands for it on factors.
fn configured(config: &Config) -> EstimatorArg {
    let configured = config.analysis.estimator;
    if configured.of_factors() != configured {
        output::note(&format!(
            "the configured estimator {} weighs single rows, which are not stored: {} is taken; --estimator names \
             another",
            configured.name(),
            configured.of_factors().name()
        ));
    }
    match configured.of_factors() {
        Estimator::Ordinary => EstimatorArg::Ordinary,
        Estimator::Weighted | Estimator::Huber => EstimatorArg::Weighted,
    }
}

/// What cannot be together.
fn check(args: &IdentifyArgs, of: EstimatorArg) -> Result<(), CliError> {
    args.save.as_deref().map_or(Ok(()), check_name)?;
    let refuse = |what: &str| Err(CliError::Usage(what.to_owned()));
    if args.prior.is_some() && of != EstimatorArg::Prior {
        return refuse("--prior goes with --estimator prior");
    }
    if args.essential && matches!(of, EstimatorArg::PerJoint | EstimatorArg::Prior) {
        return refuse("--essential goes with the estimators ordinary, weighted and huber");
    }
    if args.save.is_some() && of == EstimatorArg::PerJoint && !args.each_cycle {
        return refuse(
            "the joints' own views are not one set of parameters, so they cannot be kept as one; --estimator \
             weighted brings them together, and --each-cycle keeps them apart",
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
    (estimator, cycles): (EstimatorArg, Option<Vec<u32>>),
    config: &Config,
    store: &Store,
) -> Result<u8, CliError> {
    let mut run_ids = args.runs.clone();
    let known = store.runs().await?;
    for robot in &args.robots {
        run_ids.extend(runs_of(&known, robot)?.iter().map(|run| run.run_id));
    }
    let chosen: Vec<Chosen> =
        run_ids.iter().map(|&run_id| Chosen { run_id, cycles: cycles.clone() }).collect();
    let robot = known.iter().find(|run| run_ids.contains(&run.run_id)).map(|run| run.robot.clone());
    let (choice, prior_sources) = match estimator {
        EstimatorArg::Ordinary => (Choice::Ordinary, Vec::new()),
        EstimatorArg::Weighted => (Choice::Weighted, Vec::new()),
        EstimatorArg::PerJoint => (Choice::PerJoint, Vec::new()),
        EstimatorArg::Huber => (Choice::Huber, Vec::new()),
        EstimatorArg::Prior => prior_choice(args, &chosen, robot.as_deref(), config, store).await?,
    };
    if args.each_cycle {
        let expected = each_cycle::expected(&known, &chosen);
        return each_cycle::each_cycle(global, args, &chosen, &choice, expected, store).await;
    }
    let taken = take(store, &chosen).await?;
    note_passed_over(&taken.passed_over);
    if let Some(cycle) = sources_overlap(&taken.sources, &prior_sources) {
        return Err(CliError::Usage(format!(
            "cycle {} of run {} is behind the prior and among those chosen: it would count twice; choose \
             other cycles for one of them",
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
    chosen: &[Chosen],
    estimator: EstimatorKind,
    taken: &Taken,
    together: Together,
    store: &Store,
) -> Result<u8, CliError> {
    let (rmsd, rmsd_full) = match &together.outcome {
        Outcome::Set(found) => rmsd_of_set(store, taken, found, chosen).await?,
        Outcome::Views(views) => (rmsd_of_views(store, &parameters_of(views), chosen).await?, None),
        Outcome::TooPoor => (Vec::new(), None),
    };
    if let (Some(name), Outcome::Set(found)) = (&args.save, &together.outcome) {
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
        saved: args.save.as_deref().filter(|_| matches!(together.outcome, Outcome::Set(_))),
    };
    print(&report, global.json);
    if !global.json
        && let Some(name) = report.saved
    {
        output::note(&format!("saved as {name}"));
    }
    let complete = match &together.outcome {
        Outcome::Set(_) => true,
        Outcome::Views(views) => views.iter().all(|(_, view)| view.is_ok()),
        Outcome::TooPoor => false,
    };
    Ok(if complete { EXIT_DONE } else { EXIT_FOUND })
}

type RmsdBeforeAndAfter = (Vec<TorqueRmsd>, Option<Vec<TorqueRmsd>>);

/// RMSD of the set and, if parameters were taken away, of the full one.
async fn rmsd_of_set(
    store: &Store,
    taken: &Taken,
    found: &HistoryEstimate,
    chosen: &[Chosen],
) -> Result<RmsdBeforeAndAfter, CliError> {
    let candidate =
        |parameters: &[_]| Candidate { model: taken.model.clone(), parameters: parameters.to_vec() };
    let rmsd = rmsd_on(store, &candidate(&found.identification.parameters), chosen).await?;
    let full = match &found.essential {
        Some(report) => Some(rmsd_on(store, &candidate(&report.full), chosen).await?),
        None => None,
    };
    Ok((rmsd, full))
}

fn parameters_of<E>(
    views: &[(JointIndex, Result<JointView, E>)],
) -> Vec<(JointIndex, Vec<crate::analysis::IdentifiedParameter>)> {
    let of = |(joint, view): &(JointIndex, Result<JointView, E>)| {
        Some((*joint, view.as_ref().ok()?.identification.parameters.clone()))
    };
    views.iter().filter_map(of).collect()
}

async fn save(
    store: &Store,
    name: &str,
    taken: &Taken,
    found: &HistoryEstimate,
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

pub(super) fn name_taken(name: &str) -> CliError {
    CliError::Usage(format!(
        "there is a parameter set \"{name}\"; choose another name, or `armwatch parameters delete {name}` first"
    ))
}

/// Names that `verify --parameters` or `--prior` would take for something else are none.
fn check_name(name: &str) -> Result<(), CliError> {
    let ambiguous =
        name.is_empty() || name.contains(':') || name.parse::<i64>().is_ok() || name == "description";
    if ambiguous {
        return Err(CliError::Usage(format!(
            "\"{name}\" cannot name a parameter set: it is empty, a number, has a colon, or is the word description"
        )));
    }
    Ok(())
}
