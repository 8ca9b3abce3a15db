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

The command identifies one set of base parameters on the excitation stages of all chosen cycles together, without
rows of slow joints. It uses factors stored with the cycles and reads no export; the result is the same as from
all rows at once. Units are SI. `armwatch verify --parameters` accepts the name of a saved set. The views
parameter_sets and parameter_set_sources show saved sets.

The default estimator is the configured one, so that a single cycle has the parameters that the daemon stored.
ordinary gives every row the same weight. weighted weights each joint by its residual variance. per-joint uses
only the rows of each joint and prints the result of each joint. If the joint cannot separate a parameter from
others, the value of these others contains it. huber starts from weighted and compares whole cycles, because
single rows are not stored. It reduces the weight of a joint in a cycle if the residual is more than 1.345 robust
standard deviations above that of the median cycle, in proportion; it needs at least 5 cycles. prior draws
weighted towards --prior if the motion shows little; data_share is 1 if a value comes only from data and 0 if it
comes only from the prior. If the configuration has huber, this command uses weighted by default.

In whole runs, the command skips refused and doubtful cycles and names them on standard error. It keeps cycles
that were refused only for their motion. It always uses cycles named by --cycles, and uses all cycles of a run
named by --run if none of them is accepted; it then prints their remarks. A parameter that the motion does not
show has no value (-).

Standard errors from 8 or more cycles come from the scatter between the cycles. Standard errors from fewer cycles
come from the residual and the share of independent rows. Both contain the error that all cycles repeat because
they have one motion. Intervals contain the true value with a probability of 95 %. A * marks parameters with a
standard error above 30 % of the value. Exit status 1 if the motion does not show every parameter (the command
names them), or if a cycle gave no result with --each-cycle.

--choose-friction identifies with each value of load_friction of the description in turn. It holds out one cycle
after the other (parts of cycles if there are fewer than three), and prints the error on the held-out rows. A
joint needs a law of load-dependent friction if the law lowers this error by 3 % and also lowers the information
criterion. The command changes nothing: write the chosen value into the description.

--each-cycle identifies each chosen cycle alone and prints one line per parameter, or one object per cycle with
--json. It also prints the statistics of each run, as in the view parameter_statistics. --save stores the result
for the views reestimated_parameters, reestimated_cycles and reestimated_statistics. `armwatch parameters` lists
and deletes saved results.")]
#[command(group(ArgGroup::new("recordings").args(["runs", "robots"]).required(true).multiple(true)))]
pub(in crate::cli) struct IdentifyArgs {
    /// Run whose cycles are used; may be repeated
    #[arg(help_heading = "Selection", long = "run", value_name = "RUN")]
    pub(in crate::cli) runs: Vec<i64>,
    /// Robot, with all its complete runs; may be repeated
    #[arg(help_heading = "Selection", long = "robot", value_name = "NAME")]
    pub(in crate::cli) robots: Vec<String>,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(help_heading = "Selection", long, value_name = "CYCLES")]
    pub(in crate::cli) cycles: Option<String>,
    /// Method of estimation [default: `[analysis] estimator` of the configuration]
    #[arg(help_heading = "Estimator", long, value_enum)]
    pub(in crate::cli) estimator: Option<EstimatorArg>,
    /// Prior: parameters of a run, of some of its cycles, of a saved set, or the nominal ones of the robot's
    /// description
    #[arg(
        help_heading = "Estimator",
        long,
        value_name = "RUN[:CYCLES]|SET|description",
        required_if_eq("estimator", "prior")
    )]
    pub(in crate::cli) prior: Option<String>,
    /// Standard deviation of the prior as a fraction of its values, above 0 [default: chosen by cross-validation]
    #[arg(help_heading = "Estimator", long, value_name = "FRACTION", requires = "prior")]
    pub(in crate::cli) prior_std_fraction: Option<f64>,
    /// Omit parameters that are not worth their uncertainty
    #[arg(help_heading = "Estimator", long)]
    pub(in crate::cli) essential: bool,
    /// Identify each cycle alone
    #[arg(help_heading = "Estimator", long, conflicts_with = "essential")]
    pub(in crate::cli) each_cycle: bool,
    /// Compare models of load-dependent friction and name the joints that need one; reads the exports again
    #[arg(help_heading = "Estimator", long, conflicts_with_all = ["estimator", "essential", "each_cycle", "save"])]
    pub(in crate::cli) choose_friction: bool,
    /// Print the sum of link parameters in each base parameter
    #[arg(help_heading = "Results", long)]
    pub(in crate::cli) groupings: bool,
    /// Save the parameters under this name
    #[arg(help_heading = "Results", long, value_name = "NAME")]
    pub(in crate::cli) save: Option<String>,
}

/// An estimator as an argument.
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
            EstimatorKind::Ordinary => "Equal weight for every row",
            EstimatorKind::Weighted => "Weight of each joint from its residual variance",
            EstimatorKind::PerJoint => "Each joint from its own rows only",
            EstimatorKind::Huber => "Weighted, with less weight for cycles that do not fit the others",
            EstimatorKind::Prior => "Weighted, drawn towards the values of --prior",
        };
        Some(PossibleValue::new(self.0.name()).help(help))
    }
}

pub(in crate::cli) fn name_taken(name: &str) -> CliError {
    CliError::Usage(format!(
        "the parameter set \"{name}\" already exists; choose another name, or `armwatch parameters delete \
        {name}` first"
    ))
}
