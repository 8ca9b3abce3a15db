//! Friction under load needs the load, which follows from the parameters that are sought: solved by iteration.
//!
//! The first pass leaves the terms of load out and is linear. Each further pass computes the torque that the gears carry
//! from the parameters of the pass before, makes the columns of load from it, and solves again. An error `e` of the load
//! changes the torque by `mu e`, so the error shrinks by about `mu` from pass to pass.

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

/// Largest change of a column from one pass to the next, relative to the column: with a `mu` of 0.1 it is 0.01 % of the
/// carried torque.
const SETTLED: f64 = 1e-3;

/// Most passes after the linear one. With a `mu` of 0.2, far beyond any gear, five suffice.
const MOST_PASSES: usize = 8;

/// Whether the load settled.
#[derive(Debug, Clone, PartialEq)]
pub enum LoadIteration {
    /// After this many passes behind the linear one.
    Settled(usize),
    /// The columns still change after the last pass. Holds the largest relative change of a column in it.
    Unsettled(f64),
    /// The rows identify no parameters.
    Failed(NumericsError),
}

impl LoadIteration {
    /// What is said of an iteration that gives no load to rely on.
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

/// Adds the columns of friction under load to `columns`, which has the other columns that jump. Without a load to start
/// from, nothing is added.
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

/// Parameters from the excitation, without the terms of load in the first pass.
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
    // single rows are not weighed here: the load of the final estimate differs by a part of its errors
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
