//! One parameter set from the stored factors of many cycles (unit identification, thesis 5.1.4).

use super::NumericsError;
use super::factors::{JointColumns, JointFactor, identifies};
use super::identify::identify_factors;
use super::signal::row_step;
use super::triangular::TriangularFactor;
use crate::analysis::{Estimator, Identification};

/// The rows of chosen cycles that serve identification, joined as cycles come in.
#[derive(Debug, Clone)]
pub struct Union {
    columns: JointColumns,
    by_joint: Vec<TriangularFactor>,
    independent_rows: Vec<f64>,
}

impl Union {
    /// Of no cycles yet; all must have these columns.
    #[must_use]
    pub fn new(columns: JointColumns) -> Self {
        let by_joint: Vec<TriangularFactor> =
            columns.by_joint().iter().map(|of| TriangularFactor::new(of.len())).collect();
        Self { columns, independent_rows: vec![0.0; by_joint.len()], by_joint }
    }

    /// Joins the rows of a cycle in which joints move during excitation; other factors are passed
    /// over. `independent_shares` `[n]` say for each joint how many of these rows count as independent
    /// ([`JointResidual::independent_share`](crate::analysis::JointResidual::independent_share)); a
    /// missing one counts as 1.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] if the cycle's columns are not those of the union.
    pub fn add(
        &mut self,
        columns: &JointColumns,
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
        for of in factors.iter().filter(|of| identifies(of.stage, of.motion)) {
            let j = of.joint.index();
            self.by_joint[j].join(&of.factor);
            let share = independent_shares.get(j).copied().unwrap_or(1.0);
            self.independent_rows[j] += of.factor.rows() as f64 * share;
        }
        Ok(())
    }

    /// Identifies all joints stacked [3.22], each row of each cycle with the same weight.
    ///
    /// # Errors
    /// Those of [`identify_factors`].
    pub fn identify(&self) -> Result<Identification, NumericsError> {
        let b = self.columns.kept().len();
        let parts = self.by_joint.iter().zip((0..).map(crate::robot::JointIndex::new));
        let wide: Vec<TriangularFactor> = parts
            .map(|(factor, joint)| TriangularFactor::stacked(b, [(factor, self.columns.places(joint))]))
            .collect();
        let share = |(factor, rows): (&TriangularFactor, &f64)| rows / (factor.rows() as f64).max(1.0);
        let shares: Vec<f64> = wide.iter().zip(&self.independent_rows).map(share).collect();
        identify_factors(self.columns.kept(), &wide, &shares, Estimator::Ordinary)
    }
}

/// Fraction of the observed rows of a recording at `sample_rate` Hz that are independent after a
/// low-pass at `cutoff` Hz.
#[must_use]
pub fn independent_fraction(cutoff: f64, sample_rate: f64) -> f64 {
    (2.0 * cutoff * row_step(cutoff, sample_rate) as f64 / sample_rate).min(1.0)
}
