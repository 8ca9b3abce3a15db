//! Names of estimators of parameters over several cycles, and of the source of their standard errors.

crate::named_enum! {
    /// Estimator of parameters from the rows of several cycles.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum EstimatorKind {
        /// Least squares with equal weight for all rows.
        Ordinary = "ordinary",
        /// Least squares, rows weighted by the residual variance of their joint.
        Weighted = "weighted",
        /// Each joint from its own rows alone.
        PerJoint = "per-joint",
        /// Huber's M-estimate.
        Huber = "huber",
        /// Least squares with a prior.
        Prior = "prior",
    }
}

crate::serialize_by_name!(EstimatorKind);

crate::named_enum! {
    /// Source of standard errors.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum ErrorSource {
        /// The scatter between cycles.
        Cycles = "cycles",
        /// The residual, and the share of rows that are independent.
        IndependentRows = "independent_rows",
    }
}
