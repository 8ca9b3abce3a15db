//! Options of `armwatch identify`.

use clap::builder::PossibleValue;
use clap::{ArgGroup, Args, ValueEnum};

use crate::cli::context::CliError;
use armwatch_model::analysis::estimator_kind::EstimatorKind;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch identify --run 3
  armwatch identify --run 3 --cycles 10,15,20
  armwatch identify --robot Left --cycles 6-24 --estimator weighted \\
      --save left-warm
  armwatch identify --run 3 --run 4 --json | \\
      jq '.parameters[] | select(.joint == 1)'
  armwatch identify --run 3 --estimator prior --prior description
  armwatch identify --run 9 --cycles 1 --estimator prior --prior left-warm \\
      --prior-std-fraction 0.1
  armwatch identify --run 3 --essential
  armwatch identify --run 3 --choose-friction
  armwatch identify --robot Left --each-cycle --estimator weighted \\
      --save left-weighted

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

Of whole runs, refused and doubtful cycles are passed over and named on standard error, except cycles that were refused
for their motion alone. A cycle that --cycles names is always taken, and so are all cycles of a run that --run names if
none of them counts; their remarks are printed. A parameter that the motion does not show has no value (-).

From 8 cycles on, standard errors come from the scatter between the cycles; with fewer, from the residual and the share
of rows that are independent. Both contain the error that all cycles repeat, because they have one motion. Parameters with a standard error above 30 % are marked with *. Exit status 1 if the
motion does not show every parameter (they are named), or with --each-cycle if a cycle gave none.

--choose-friction identifies with each value of load_friction of the description in turn, holds one cycle out after the
other (parts of cycles, where there are fewer than three), and prints the error on the held-out rows. A joint needs a law
if it lowers that error by 3 % and the information criterion too. Nothing is changed: write the chosen value into the
description.

--each-cycle identifies each chosen cycle alone, prints one line a parameter, or with --json one object a
cycle, and the statistics of each run as in the view parameter_statistics. --save keeps it for the views
reestimated_parameters, reestimated_cycles and reestimated_statistics. `armwatch parameters` lists and
deletes what is kept.")]
#[command(group(ArgGroup::new("recordings").args(["runs", "robots"]).required(true).multiple(true)))]
pub(in crate::cli) struct IdentifyArgs {
    /// Run whose cycles are taken; may be given several times
    #[arg(help_heading = "What is taken", long = "run", value_name = "RUN")]
    pub(in crate::cli) runs: Vec<i64>,
    /// Robot of which all complete runs are taken; may be given several times
    #[arg(help_heading = "What is taken", long = "robot", value_name = "NAME")]
    pub(in crate::cli) robots: Vec<String>,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(help_heading = "What is taken", long, value_name = "CYCLES")]
    pub(in crate::cli) cycles: Option<String>,
    /// How rows become parameters [default: `[analysis] estimator` of the configuration]
    #[arg(help_heading = "Estimator", long, value_enum)]
    pub(in crate::cli) estimator: Option<EstimatorArg>,
    /// What is known beforehand: parameters of a run, of some of its cycles, of a saved set, or the
    /// nominal ones of the robot's description
    #[arg(
        help_heading = "Estimator",
        long,
        value_name = "RUN[:CYCLES]|SET|description",
        required_if_eq("estimator", "prior")
    )]
    pub(in crate::cli) prior: Option<String>,
    /// Standard deviation of the prior as a part of its values, above 0 [default: chosen by
    /// cross-validation]
    #[arg(help_heading = "Estimator", long, value_name = "FRACTION", requires = "prior")]
    pub(in crate::cli) prior_std_fraction: Option<f64>,
    /// Leave out parameters that are not worth their uncertainty
    #[arg(help_heading = "Estimator", long)]
    pub(in crate::cli) essential: bool,
    /// Identify each cycle alone
    #[arg(help_heading = "Estimator", long, conflicts_with = "essential")]
    pub(in crate::cli) each_cycle: bool,
    /// Compare how friction may depend on load, and say which joints need it; reads the exports again
    #[arg(help_heading = "Estimator", long, conflicts_with_all = ["estimator", "essential", "each_cycle", "save"])]
    pub(in crate::cli) choose_friction: bool,
    /// Print the sum of link parameters that each parameter stands for
    #[arg(help_heading = "Results", long)]
    pub(in crate::cli) groupings: bool,
    /// Keep the parameters under this name
    #[arg(help_heading = "Results", long, value_name = "NAME")]
    pub(in crate::cli) save: Option<String>,
}

/// An estimator as it is typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::cli) struct EstimatorArg(pub(in crate::cli) EstimatorKind);

impl ValueEnum for EstimatorArg {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [EstimatorArg; EstimatorKind::ALL.len()] = {
            let [first, second, third, fourth, fifth] = EstimatorKind::ALL;
            [
                EstimatorArg(first),
                EstimatorArg(second),
                EstimatorArg(third),
                EstimatorArg(fourth),
                EstimatorArg(fifth),
            ]
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = match self.0 {
            EstimatorKind::Ordinary => "Every row alike",
            EstimatorKind::Weighted => "Each joint by its residual variance",
            EstimatorKind::PerJoint => "Each joint alone",
            EstimatorKind::Huber => "Weighted, cycles that do not fit the others with less weight",
            EstimatorKind::Prior => "Weighted, towards what is known beforehand",
        };
        Some(PossibleValue::new(self.0.name()).help(help))
    }
}

pub(in crate::cli) fn name_taken(name: &str) -> CliError {
    CliError::Usage(format!(
        "there is a parameter set \"{name}\"; choose another name, or `armwatch parameters delete {name}` first"
    ))
}
