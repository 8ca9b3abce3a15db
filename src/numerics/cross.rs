//! One parameter set from the stored factors of many cycles (unit identification, thesis 5.1.4).

use super::NumericsError;
use super::factors::{JointColumns, JointFactor, identifies};
use super::identify::identify;
use super::signal::row_step;
use super::triangular::TriangularFactor;
use crate::analysis::Identification;

/// The rows of chosen cycles that serve identification, joined as cycles come in.
#[derive(Debug, Clone)]
pub struct Union {
    columns: JointColumns,
    by_joint: Vec<TriangularFactor>,
    independent_rows: f64,
}

impl Union {
    /// Of no cycles yet; all must have these columns.
    #[must_use]
    pub fn new(columns: JointColumns) -> Self {
        let by_joint = columns.by_joint().iter().map(|of| TriangularFactor::new(of.len())).collect();
        Self { columns, by_joint, independent_rows: 0.0 }
    }

    /// Joins the rows of a cycle in which joints move during excitation; other factors are passed
    /// over. `independent_fraction` says how many of its rows are independent after the low-pass
    /// ([`Conditioned::independent_fraction`](super::signal::Conditioned::independent_fraction)).
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] if the cycle's columns are not those of the union.
    pub fn add(
        &mut self,
        columns: &JointColumns,
        factors: &[JointFactor],
        independent_fraction: f64,
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
            self.by_joint[of.joint.index()].join(&of.factor);
            self.independent_rows += of.factor.rows() as f64 * independent_fraction;
        }
        Ok(())
    }

    /// Identifies all joints stacked [3.22], each row of each cycle with the same weight.
    ///
    /// # Errors
    /// Those of [`identify`].
    pub fn identify(&self) -> Result<Identification, NumericsError> {
        let parts = self.by_joint.iter().zip((0..).map(crate::robot::JointIndex::new));
        let factor = TriangularFactor::stacked(
            self.columns.kept().len(),
            parts.map(|(factor, joint)| (factor, self.columns.places(joint))),
        );
        let fraction = self.independent_rows / (factor.rows() as f64).max(1.0);
        identify(self.columns.kept(), &factor, self.columns.joint_count(), fraction)
    }
}

/// Fraction of the observed rows of a recording at `sample_rate` Hz that are independent after a
/// low-pass at `cutoff` Hz.
#[must_use]
pub fn independent_fraction(cutoff: f64, sample_rate: f64) -> f64 {
    (2.0 * cutoff * row_step(cutoff, sample_rate) as f64 / sample_rate).min(1.0)
}
