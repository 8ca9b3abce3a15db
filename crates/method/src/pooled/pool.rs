//! Stored factors of many cycles together (unit identification, thesis 5.1.4).

use crate::NumericsError;
use crate::identify::cycle::identify_factors;
use crate::identify::joint_factors::{FactorColumns, JointFactor, used_for_identification};
use crate::least_squares::factor::TriangularFactor;
use crate::model::base_parameters::BaseParameters;
use armwatch_model::analysis::{Estimator, Identification};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Rows of chosen cycles for identification, joined as cycles are added.
#[derive(Debug, Clone)]
pub struct PooledFactors {
    columns: FactorColumns,
    by_joint: Vec<TriangularFactor>,
    cycles: Vec<CycleParts>,
}

/// Rows of one cycle for identification.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleParts {
    /// Factor of each joint over its own columns, `[n]`; without rows if the joint has none.
    pub by_joint: Vec<TriangularFactor>,
    /// Share of each joint's rows that are independent, `[n]`.
    pub independent_shares: Vec<f64>,
}

/// Weights of squared rows, by joint and, for some estimators, by cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct RowWeights {
    /// Weight of each joint's squares, `[n]`, 1/Nm².
    pub by_joint: Vec<f64>,
    /// Share of this weight for each joint in each cycle, `[cycles][n]`; all of it if `None`.
    pub kept: Option<Vec<Vec<f64>>>,
}

impl RowWeights {
    /// Equal weight for all rows.
    #[must_use]
    pub fn equal(joint_count: usize) -> Self {
        Self { by_joint: vec![1.0; joint_count], kept: None }
    }

    /// Weight of each joint by its noise `sigma` `[n]`, Nm.
    #[must_use]
    pub fn of_noise(sigma: &[f64]) -> Self {
        Self { by_joint: sigma.iter().map(|s| 1.0 / (s * s)).collect(), kept: None }
    }

    /// Weight of the squares of a joint's rows in a cycle.
    #[must_use]
    pub fn of(&self, cycle: usize, joint: usize) -> f64 {
        self.by_joint[joint] * self.kept.as_ref().map_or(1.0, |kept| kept[cycle][joint])
    }
}

impl PooledFactors {
    /// Creates a pool without cycles; all cycles must have these columns.
    #[must_use]
    pub fn new(columns: FactorColumns) -> Self {
        let by_joint = columns.by_joint().iter().map(|of| TriangularFactor::new(of.len())).collect();
        Self { columns, by_joint, cycles: Vec::new() }
    }

    /// Joins the rows of a cycle with moving joints during excitation, and ignores other factors. `independent_shares`
    /// `[n]` are the shares of each joint's rows that count as independent
    /// ([`JointResidual::independent_share`](armwatch_model::analysis::JointResidual::independent_share)); a
    /// missing one counts as 1.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] if the cycle's columns are not those of the union.
    pub fn add(
        &mut self,
        columns: &FactorColumns,
        factors: &[JointFactor],
        independent_shares: &[f64],
    ) -> Result<(), NumericsError> {
        if columns.by_joint() != self.columns.by_joint() {
            return Err(NumericsError::ColumnsDiffer(
                "the cycles were factored over different parameters: their robot's description, or the \
                 program, has changed between them; choose cycles of one description, or ingest the older \
                 exports again into a new database"
                    .into(),
            ));
        }
        let mut cycle = CycleParts {
            by_joint: columns.by_joint().iter().map(|of| TriangularFactor::new(of.len())).collect(),
            independent_shares: (0..columns.joint_count())
                .map(|j| independent_shares.get(j).copied().unwrap_or(1.0))
                .collect(),
        };
        for of in factors.iter().filter(|of| used_for_identification(of.stage, of.motion)) {
            self.by_joint[of.joint.index()].join(&of.factor);
            let own = &mut cycle.by_joint[of.joint.index()];
            match own.rows() {
                0 => own.clone_from(&of.factor),
                _ => own.join(&of.factor),
            }
        }
        self.cycles.push(cycle);
        Ok(())
    }

    /// Columns of each joint's factor.
    #[must_use]
    pub fn columns(&self) -> &FactorColumns {
        &self.columns
    }

    /// Cycles in the order of addition.
    #[must_use]
    pub fn cycles(&self) -> &[CycleParts] {
        &self.cycles
    }

    /// Factor of each joint over its own columns, all cycles together, `[n]`.
    #[must_use]
    pub fn by_joint(&self) -> &[TriangularFactor] {
        &self.by_joint
    }

    /// Share of the rows of all cycles and joints that are independent.
    #[must_use]
    pub fn independent_fraction(&self) -> f64 {
        let joints = 0..self.by_joint.len();
        let independent: f64 = joints.map(|j| self.independent_rows(j)).sum();
        independent / (self.by_joint.iter().map(TriangularFactor::rows).sum::<usize>() as f64).max(1.0)
    }

    /// Share of each joint's rows of all cycles that are independent, `[n]`.
    #[must_use]
    pub fn independent_shares(&self) -> Vec<f64> {
        let share = |(j, factor): (usize, &TriangularFactor)| match factor.rows() {
            0 => 1.0,
            rows => self.independent_rows(j) / rows as f64,
        };
        self.by_joint.iter().enumerate().map(share).collect()
    }

    fn independent_rows(&self, j: usize) -> f64 {
        let of_cycle = |cycle: &CycleParts| cycle.by_joint[j].rows() as f64 * cycle.independent_shares[j];
        self.cycles.iter().map(of_cycle).sum()
    }

    /// Factor of all joints stacked [3.22] with weighted rows, `b` columns.
    #[must_use]
    pub fn stacked(&self, weights: &RowWeights) -> TriangularFactor {
        let weighted: Vec<TriangularFactor> =
            (0..self.by_joint.len()).map(|j| self.of_joint(j, weights)).collect();
        let parts = weighted.iter().zip((0..).map(JointIndex::new));
        TriangularFactor::embedded(
            self.columns.kept().len(),
            parts.map(|(factor, joint)| (factor, self.columns.places(joint))),
        )
    }

    /// Each joint's factor over the base parameters of a description, in their order, `[n]`.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] unless the base parameters are those of the columns.
    pub fn embedded_in(&self, base: &BaseParameters) -> Result<Vec<TriangularFactor>, NumericsError> {
        if base.kept.len() != self.columns.kept().len() {
            return Err(NumericsError::ColumnsDiffer(format!(
                "the description has {} base parameters, the stored factors {}: they were made with another",
                base.kept.len(),
                self.columns.kept().len()
            )));
        }
        let place = |id: &ParameterId| {
            base.kept.iter().position(|kept| kept == id).ok_or_else(|| {
                NumericsError::ColumnsDiffer(format!("the description has no base parameter {id}"))
            })
        };
        let of_joint = |(factor, ids): (&TriangularFactor, &Vec<ParameterId>)| {
            let places = ids.iter().map(place).collect::<Result<Vec<usize>, _>>()?;
            Ok(TriangularFactor::embedded(base.kept.len(), [(factor, &places[..])]))
        };
        self.by_joint.iter().zip(self.columns.by_joint().iter()).map(of_joint).collect()
    }

    /// Each joint's factor over all `b` columns, with the share of each cycle, `[n]`; without the weights from the
    /// joints' noise.
    #[must_use]
    pub fn embedded_shares(&self, weights: &RowWeights) -> Vec<TriangularFactor> {
        if weights.kept.is_none() {
            return self.embedded_by_joint();
        }
        let weights = RowWeights { by_joint: vec![1.0; self.by_joint.len()], kept: weights.kept.clone() };
        let b = self.columns.kept().len();
        let spread = |j: usize| {
            let factor = self.of_joint(j, &weights);
            TriangularFactor::embedded(b, [(&factor, self.columns.places(JointIndex::new(j)))])
        };
        (0..self.by_joint.len()).map(spread).collect()
    }

    /// Each joint's factor over all `b` columns, unweighted, `[n]`.
    #[must_use]
    pub fn embedded_by_joint(&self) -> Vec<TriangularFactor> {
        let b = self.columns.kept().len();
        let parts = self.by_joint.iter().zip((0..).map(JointIndex::new));
        parts
            .map(|(factor, joint)| TriangularFactor::embedded(b, [(factor, self.columns.places(joint))]))
            .collect()
    }

    /// Identifies all joints stacked [3.22], with equal weight for all rows.
    ///
    /// # Errors
    /// Those of [`identify_factors`].
    pub fn identify(&self) -> Result<Identification, NumericsError> {
        identify_factors(
            self.columns.kept(),
            &self.embedded_by_joint(),
            &self.independent_shares(),
            Estimator::Ordinary,
        )
    }

    fn of_joint(&self, j: usize, weights: &RowWeights) -> TriangularFactor {
        if weights.kept.is_none() {
            return self.by_joint[j].scaled(weights.by_joint[j].sqrt());
        }
        let own: Vec<usize> = (0..self.by_joint[j].columns()).collect();
        let parts: Vec<TriangularFactor> = self
            .cycles
            .iter()
            .enumerate()
            .map(|(c, cycle)| cycle.by_joint[j].scaled(weights.of(c, j).sqrt()))
            .collect();
        TriangularFactor::embedded(own.len(), parts.iter().map(|part| (part, own.as_slice())))
    }
}
