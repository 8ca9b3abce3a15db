//! Iteration for friction under load, which depends on the load and so on the unknown parameters.
//!
//! The first pass omits the load terms and is linear. Each further pass computes the torque on the gears from the
//! parameters of the previous pass, computes the load columns from it, and solves again. An error `e` of the load
//! changes the torque by `mu e`, so each pass reduces the error by a factor of about `mu`.

use super::Method;
use crate::NumericsError;
use crate::identify::cycle::identify_factors;
use crate::identify::filtered_columns::{FilteredColumn, filtered_load_columns};
use crate::identify::joint_factors::{FactoredRows, embedded, used_for_identification};
use crate::identify::load_visibility::is_of_load;
use crate::least_squares::factor::TriangularFactor;
use crate::model::dynamics::DynamicModel;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::{Estimator, Identification};
use armwatch_model::robot::ParameterId;
use armwatch_model::run::Samples;

/// Largest change of a column between passes, relative to the column, of a converged load: with a `mu` of 0.1 it is
/// 0.01 % of the load torque.
const SETTLED: f64 = 1e-3;

/// Largest number of passes after the linear one. Five are enough for a `mu` of 0.2, which exceeds that of any gear.
const MOST_PASSES: usize = 8;

/// Outcome of the iteration.
#[derive(Debug, Clone, PartialEq)]
pub enum LoadIteration {
    /// Converged after this many passes, not counting the linear one.
    Settled(usize),
    /// The columns still change after the last pass. Holds the largest relative change of a column in it.
    Unsettled(f64),
    /// The rows identify no parameters.
    Failed(NumericsError),
}

impl LoadIteration {
    /// Remark about an iteration without a reliable load.
    #[must_use]
    pub fn remark(&self) -> Option<String> {
        match self {
            Self::Settled(_) => None,
            Self::Unsettled(change) => Some(format!(
                "friction under load did not settle in {MOST_PASSES} passes, the last one still changed it by {:.1} %: \
                 load and speed hardly vary apart in this motion; choose load_friction = \"none\", or a motion in which \
                 each joint carries different loads at equal speed",
                100.0 * change
            )),
            Self::Failed(error) => Some(format!(
                "friction under load has no load to start from, as the excitation identifies no parameters: {error}"
            )),
        }
    }
}

/// Adds the columns of friction under load to `columns`, which contains the other columns with jumps. Adds nothing if
/// there is no load to start from.
pub(crate) fn add_load_columns(
    method: &Method,
    filtered: &FilteredSignals,
    samples: &Samples,
    columns: &mut Vec<FilteredColumn>,
) -> LoadIteration {
    let others = columns.len();
    let mut before: Option<Vec<FilteredColumn>> = None;
    let mut change = f64::INFINITY;
    for pass in 0..=MOST_PASSES {
        let found = match solved(method, filtered, samples, columns, before.is_some()) {
            Ok(found) => found,
            Err(error) => return LoadIteration::Failed(error),
        };
        let parameters = found.parameters.iter().map(|of| (of.id, of.value));
        let model = DynamicModel::from_parameters(&method.robot, parameters);
        let next = filtered_load_columns(&method.robot, filtered, &model);
        if let Some(before) = &before {
            change = largest_change(before, &next);
        }
        filtered.give_back(columns.drain(others..).map(|column| column.values));
        columns.extend(next.iter().cloned());
        if change < SETTLED {
            return LoadIteration::Settled(pass);
        }
        before = Some(next);
    }
    LoadIteration::Unsettled(change)
}

/// Parameters from the excitation, without the load terms in the first pass.
fn solved(
    method: &Method,
    filtered: &FilteredSignals,
    samples: &Samples,
    columns: &[FilteredColumn],
    with_load: bool,
) -> Result<Identification, NumericsError> {
    let rows = FactoredRows {
        robot: &method.robot,
        columns: &method.columns,
        regressor_columns: &method.base.kept_columns,
        filtered,
        filtered_coulomb_columns: columns,
        samples,
    };
    let factored = rows.factored_excitation();
    let chosen = factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion));
    let factors = embedded(&method.columns, chosen);
    let independent = vec![1.0; factors.len()];
    let kept = &method.base.kept;
    // without weights of single rows: the load of the final estimate differs by a part of its errors
    let identify = |kept: &[ParameterId], factors: &[TriangularFactor]| {
        identify_factors(kept, factors, &independent, Estimator::Weighted)
    };
    if with_load {
        return identify(kept, &factors);
    }
    let (places, kept): (Vec<usize>, Vec<ParameterId>) =
        kept.iter().copied().enumerate().filter(|(_, id)| !is_of_load(*id)).unzip();
    let factors: Vec<TriangularFactor> = factors.iter().map(|of| of.restricted(&places)).collect();
    identify(&kept, &factors)
}

fn largest_change(before: &[FilteredColumn], after: &[FilteredColumn]) -> f64 {
    let square = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>();
    let change = |(before, after): (&FilteredColumn, &FilteredColumn)| {
        let pairs = before.values.iter().zip(&after.values);
        let whole = square(&mut after.values.iter().copied());
        let change = square(&mut pairs.map(|(before, after)| after - before));
        if whole > 0.0 { (change / whole).sqrt() } else { 0.0 }
    };
    before.iter().zip(after).map(change).fold(0.0, f64::max)
}
