//! The parameters of a test that ordinary work is held against.

use std::collections::BTreeMap;

use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::work_evidence::WorkDirection;
use armwatch_model::robot::{ParameterId, shares_of_link};

/// Parameters of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The run that they were identified on.
    pub run_id: i64,
    /// How its rows became parameters.
    pub estimator: Estimator,
    /// Base parameters, friction among them.
    pub parameters: Vec<(ParameterId, f64)>,
    /// What mass and first moments of the last link add to each of them; empty where that is not known.
    pub last_link: BTreeMap<ParameterId, [f64; WorkDirection::LOAD]>,
}

impl Reference {
    /// What mass and first moments of the last link add to a parameter.
    pub(super) fn of_last_link(&self, id: ParameterId) -> [f64; WorkDirection::LOAD] {
        self.last_link.get(&id).copied().unwrap_or_default()
    }
}

/// What mass and first moments of the last link add to base parameters, each given with the sum of standard parameters
/// that it stands for.
#[must_use]
pub fn last_link_shares<'a>(
    groupings: impl IntoIterator<Item = (ParameterId, &'a [(f64, ParameterId)])>,
) -> BTreeMap<ParameterId, [f64; WorkDirection::LOAD]> {
    let groupings: Vec<(ParameterId, &[(f64, ParameterId)])> = groupings.into_iter().collect();
    let Some(last) = groupings.iter().flat_map(|(_, terms)| *terms).map(|(_, of)| of.joint).max() else {
        return BTreeMap::new();
    };
    let shares = |(id, terms): (ParameterId, &[(f64, ParameterId)])| {
        let of = shares_of_link(terms, last);
        (id, std::array::from_fn(|place| of[place]))
    };
    groupings.into_iter().map(shares).collect()
}
