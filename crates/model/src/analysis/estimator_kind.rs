//! Names of estimators of parameters over several cycles, and of the source of their standard errors.

/// Estimator of parameters from the rows of several cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimatorKind {
    /// Least squares with equal weight for all rows.
    Ordinary,
    /// Least squares, rows weighted by the residual variance of their joint.
    Weighted,
    /// Each joint from its own rows alone.
    PerJoint,
    /// Huber's M-estimate.
    Huber,
    /// Least squares with a prior.
    Prior,
}

crate::serialize_by_name!(EstimatorKind);

impl EstimatorKind {
    /// All estimators.
    pub const ALL: [Self; 5] = [Self::Ordinary, Self::Weighted, Self::PerJoint, Self::Huber, Self::Prior];

    /// Name as stored and as typed.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ordinary => "ordinary",
            Self::Weighted => "weighted",
            Self::PerJoint => "per-joint",
            Self::Huber => "huber",
            Self::Prior => "prior",
        }
    }
}

/// Source of standard errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorSource {
    /// The scatter between cycles.
    Cycles,
    /// The residual, and the share of rows that are independent.
    IndependentRows,
}

impl ErrorSource {
    /// Both sources.
    pub const ALL: [Self; 2] = [Self::Cycles, Self::IndependentRows];

    /// Name as stored.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cycles => "cycles",
            Self::IndependentRows => "independent_rows",
        }
    }
}
