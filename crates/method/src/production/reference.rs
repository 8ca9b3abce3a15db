//! The parameters of a test with which production is compared.

use std::collections::BTreeMap;

use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::work_evidence::WorkDirection;
use armwatch_model::robot::{ParameterId, shares_of_link};

/// Parameters of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Run of the identification.
    pub run_id: i64,
    /// Estimator of the parameters.
    pub estimator: Estimator,
    /// Base parameters, including friction.
    pub parameters: Vec<(ParameterId, f64)>,
    /// Coefficients of the last link's mass and first moments in each parameter; empty if unknown.
    pub last_link: BTreeMap<ParameterId, [f64; WorkDirection::LOAD]>,
}

impl Reference {
    /// Coefficients of the last link's mass and first moments in a parameter.
    pub(super) fn of_last_link(&self, id: ParameterId) -> [f64; WorkDirection::LOAD] {
        self.last_link.get(&id).copied().unwrap_or_default()
    }
}

/// Coefficients of the last link's mass and first moments in base parameters, each given with its sum of standard
/// parameters.
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
