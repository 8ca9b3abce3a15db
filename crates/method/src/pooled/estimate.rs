//! Estimators that use the stored factors of cycles and need no recording.
//!
//! Estimators differ in their weights: a joint's residual variance scales its factors, a robust estimate weights whole
//! cycles, and a prior adds rows. The method for the interval is the same for all: with enough cycles, the interval
//! follows from their scatter (`cycle_errors`).

use super::cycle_errors::{FEWEST_CYCLES, ProblemColumns, Sandwich, Variance, between_cycles, over_cycles};
use super::pool::{PooledFactors, RowWeights};
use crate::NumericsError;
use crate::identify::cycle::identify_weighted;
use crate::least_squares::conditioning::{identifiability, shown_columns};
use crate::least_squares::essential::{EssentialSettings, essential};
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::huber::{HUBER_CONSTANT, torque_change};
use crate::least_squares::prior::{ParameterPrior, PriorStrength, with_prior, with_prior_rows};
use crate::least_squares::solution::MAX_WEIGHTED_CONDITION;
use crate::least_squares::weighted::{WeightRule, joined, per_joint, weighted};
use crate::statistics::descriptive::{median, robust_deviation};
use crate::statistics::distributions::student_quantile;
use armwatch_model::analysis::estimator_kind::{ErrorSource, EstimatorKind};
use armwatch_model::analysis::interval::LEVEL;
use armwatch_model::analysis::{Identification, IdentifiedParameter};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Fewest cycles for a robust estimate: with fewer, the median is one of them.
const FEWEST_FOR_HUBER: usize = 5;
/// Largest number of iterations of the cycle weights; about ten are usual.
const MAX_ROUNDS: usize = 100;
/// Largest change of the estimated torque, relative to the noise, of a converged estimate.
const SETTLED: f64 = 1e-6;

/// Estimator of parameters from the stacked rows of all joints.
#[derive(Debug, Clone, PartialEq)]
pub enum StackedEstimator {
    /// All rows have equal weight [3.22].
    Ordinary,
    /// The weight of a row follows from the residual variance of its joint [3.22].
    Weighted,
    /// Like `Weighted`, with less weight for a joint's rows of a cycle whose residual is more than `HUBER_CONSTANT`
    /// robust spreads above the median cycle's.
    Huber,
    /// Estimate with a prior. The weight of a row follows from the residual variance of its joint.
    Prior {
        /// Priors by parameter.
        priors: Vec<(ParameterId, ParameterPrior)>,
        /// Strength of the priors.
        strength: PriorStrength,
    },
}

impl StackedEstimator {
    /// Kind of the estimator.
    #[must_use]
    pub fn kind(&self) -> EstimatorKind {
        match self {
            Self::Ordinary => EstimatorKind::Ordinary,
            Self::Weighted => EstimatorKind::Weighted,
            Self::Huber => EstimatorKind::Huber,
            Self::Prior { .. } => EstimatorKind::Prior,
        }
    }
}

/// Source of the standard errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ErrorBasis {
    /// The scatter between cycles, and the error that they repeat.
    Cycles {
        /// Number of cycles.
        count: usize,
        /// Part of the variance within cycles that all of them repeat, 0 to 1.
        repeated: f64,
    },
    /// The residual, the share of rows that are independent, and the error that cycles repeat.
    IndependentRows {
        /// Share of independent rows.
        fraction: f64,
        /// Part of the variance within cycles that all of them repeat, 0 to 1; 0 of a single cycle.
        repeated: f64,
    },
}

impl ErrorBasis {
    /// Of `count` cycles.
    pub(super) fn new(count: usize, fraction: f64, repeated: f64) -> Self {
        match count >= FEWEST_CYCLES {
            true => Self::Cycles { count, repeated },
            false => Self::IndependentRows { fraction, repeated },
        }
    }

    /// Its name alone.
    #[must_use]
    pub fn source(self) -> ErrorSource {
        match self {
            Self::Cycles { .. } => ErrorSource::Cycles,
            Self::IndependentRows { .. } => ErrorSource::IndependentRows,
        }
    }
}

/// Parameters estimated from cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct PooledEstimate {
    /// Values with standard errors. Parameters removed as not essential are 0 and have no error.
    pub identification: Identification,
    /// Half the width of the 95 % interval of each parameter.
    pub half_width: Vec<f64>,
    /// Source of the standard errors.
    pub errors: ErrorBasis,
    /// Weights of the rows.
    pub weights: RowWeights,
    /// True if the iterated weights have converged.
    pub settled: bool,
    /// Effect of a prior.
    pub prior: Option<PriorReport>,
    /// Parameters removed as not essential, if requested.
    pub essential: Option<EssentialReport>,
}

/// Effect of a prior on an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct PriorReport {
    /// Share of data in each parameter: 1 all data, 0 all prior.
    pub data_share: Vec<f64>,
    /// Factor on the prior's standard deviations.
    pub spread: f64,
}

/// Parameters that are not worth their uncertainty.
#[derive(Debug, Clone, PartialEq)]
pub struct EssentialReport {
    /// Removed parameters, the least certain first.
    pub removed: Vec<ParameterId>,
    /// F statistic of the smaller set against the full one.
    pub f_statistic: f64,
    /// Largest F of an equally good smaller set.
    pub f_limit: f64,
    /// Estimate with all parameters.
    pub full: Vec<IdentifiedParameter>,
}

/// Identifies one parameter set from all cycles, joints stacked. It includes parameters that the motion does not show;
/// see [`IdentifiedParameter::is_shown`].
///
/// # Errors
/// [`NumericsError::RankDeficient`] if the motion shows less than three quarters of the parameters and no prior covers
/// the others, [`NumericsError::TooShort`] with too few rows, or too few cycles for [`StackedEstimator::Huber`]; the
/// errors of `weighted` and `with_prior`.
pub fn estimate(
    union: &PooledFactors,
    estimator: &StackedEstimator,
) -> Result<PooledEstimate, NumericsError> {
    let all: Vec<usize> = (0..union.columns().kept().len()).collect();
    match estimator {
        StackedEstimator::Prior { priors, strength } => {
            let of = |id: &ParameterId| priors.iter().find(|(of, _)| of == id).map(|(_, prior)| *prior);
            let priors: Vec<Option<ParameterPrior>> = union.columns().kept().iter().map(of).collect();
            towards_prior(union, &priors, *strength)
        }
        _ => match of_columns(union, estimator, &all) {
            Err(error @ NumericsError::RankDeficient { .. }) => {
                let equal = RowWeights::equal(union.columns().joint_count());
                let Some(shown) = shown_columns(&union.stacked(&equal))? else { return Err(error) };
                let mut found = of_columns(union, estimator, &shown.kept)?;
                for (&place, _) in shown.kept.iter().zip(&shown.alone).filter(|(_, alone)| !**alone) {
                    let parameter = &mut found.identification.parameters[place];
                    *parameter = IdentifiedParameter {
                        value: parameter.value,
                        ..IdentifiedParameter::left_out(parameter.id)
                    };
                    found.half_width[place] = f64::NAN;
                }
                Ok(found)
            }
            done => done,
        },
    }
}

fn of_columns(
    union: &PooledFactors,
    estimator: &StackedEstimator,
    kept: &[usize],
) -> Result<PooledEstimate, NumericsError> {
    let (weights, settled) = weights(union, estimator, kept)?;
    least_squares(union, kept, weights, settled)
}

/// Same as [`estimate`], with the fewest parameters that explain the torque equally well.
///
/// # Errors
/// Those of [`estimate`]; [`NumericsError::Unsupported`] with a prior, which removes no parameter.
pub fn estimate_essential(
    union: &PooledFactors,
    estimator: &StackedEstimator,
    settings: &EssentialSettings,
) -> Result<PooledEstimate, NumericsError> {
    if matches!(estimator, StackedEstimator::Prior { .. }) {
        return Err(NumericsError::Unsupported("essential parameters together with a prior"));
    }
    let full = estimate(union, estimator)?;
    let factor = union.stacked(&full.weights);
    let fewest = essential(&factor, factor.rows(), union.independent_fraction(), settings)?;
    let mut found = least_squares(union, &fewest.kept, full.weights, full.settled)?;
    let ids = union.columns().kept();
    found.essential = Some(EssentialReport {
        removed: fewest.removed.iter().map(|&k| ids[k]).collect(),
        f_statistic: fewest.f_statistic,
        f_limit: fewest.f_limit,
        full: full.identification.parameters,
    });
    Ok(found)
}

fn weights(
    union: &PooledFactors,
    estimator: &StackedEstimator,
    columns: &[usize],
) -> Result<(RowWeights, bool), NumericsError> {
    let n = union.columns().joint_count();
    match estimator {
        StackedEstimator::Weighted => {
            let found = weighted(&restricted(union, columns), MAX_WEIGHTED_CONDITION, names(union, columns))?;
            Ok((RowWeights::of_noise(&found.rule.sigma), found.settled))
        }
        StackedEstimator::Huber => huber_weights(union, columns),
        StackedEstimator::Ordinary | StackedEstimator::Prior { .. } => Ok((RowWeights::equal(n), true)),
    }
}

fn names(union: &PooledFactors, columns: &[usize]) -> impl Fn(usize) -> String {
    |column| union.columns().kept()[columns[column]].to_string()
}

fn restricted(union: &PooledFactors, columns: &[usize]) -> Vec<TriangularFactor> {
    union.embedded_by_joint().into_iter().map(|factor| only(factor, columns)).collect()
}

fn only(factor: TriangularFactor, columns: &[usize]) -> TriangularFactor {
    if columns.len() == factor.columns() { factor } else { factor.restricted(columns) }
}

/// Solves for the columns `kept` with given weights; the others are zero.
fn least_squares(
    union: &PooledFactors,
    kept: &[usize],
    weights: RowWeights,
    settled: bool,
) -> Result<PooledEstimate, NumericsError> {
    let ids = union.columns().kept();
    let fraction = union.independent_fraction();
    let own: Vec<ParameterId> = kept.iter().map(|&k| ids[k]).collect();
    let by_joint: Vec<TriangularFactor> =
        union.embedded_shares(&weights).iter().map(|factor| factor.restricted(kept)).collect();
    let sigma = weights.by_joint.iter().map(|weight| weight.sqrt().recip()).collect();
    let rule = WeightRule { sigma, huber: None };
    let mut solved = identify_weighted(&own, &by_joint, &union.independent_shares(), &rule)?;
    let theta: Vec<f64> = solved.parameters.iter().map(|p| p.value).collect();
    let design = ProblemColumns::stacked(union.columns(), kept);
    let count = design.cycles(union.cycles());
    let mut repeated = 0.0;
    if count > 1 {
        let inverse = joined(&by_joint, &rule, kept.len()).inverse_of_upper()?;
        let scatter = between_cycles(union.cycles(), &design, &weights, &theta, &inverse)?;
        repeated = widen(&mut solved.parameters, &scatter, count);
    }
    let half_width: Vec<f64> =
        solved.parameters.iter().map(|p| half(p.std_error, p.degrees_of_freedom)).collect();
    let errors = ErrorBasis::new(count, fraction, repeated);
    let mut found = PooledEstimate {
        identification: Identification { parameters: Vec::new(), ..solved },
        half_width: vec![f64::NAN; ids.len()],
        errors,
        weights,
        settled,
        prior: None,
        essential: None,
    };
    found.identification.parameters = ids.iter().map(|&id| IdentifiedParameter::left_out(id)).collect();
    for ((&place, parameter), half) in kept.iter().zip(solved.parameters).zip(half_width) {
        found.identification.parameters[place] = parameter;
        found.half_width[place] = half;
    }
    found.identification.residual_std = residual_std(union, &found.identification.parameters, kept.len());
    Ok(found)
}

/// Gives parameters whose errors follow from rows those over `count` cycles; the part that all cycles repeat.
pub(super) fn widen(parameters: &mut [IdentifiedParameter], scatter: &Sandwich, count: usize) -> f64 {
    let within: Vec<Variance> =
        parameters.iter().map(|of| (of.std_error * of.std_error, of.degrees_of_freedom)).collect();
    let ids: Vec<ParameterId> = parameters.iter().map(|of| of.id).collect();
    let (variances, repeated) = over_cycles(&within, scatter, &ids, count);
    for (parameter, (variance, freedom)) in parameters.iter_mut().zip(variances) {
        parameter.std_error = variance.sqrt();
        parameter.degrees_of_freedom = freedom;
    }
    repeated
}

/// Half the width of the interval with the probability [`LEVEL`].
pub(super) fn half(std_error: f64, freedom: f64) -> f64 {
    student_quantile(0.5 + 0.5 * LEVEL, freedom) * std_error
}

/// Standard deviation of the unweighted torque residual, Nm.
fn residual_std(union: &PooledFactors, parameters: &[IdentifiedParameter], count: usize) -> f64 {
    let theta: Vec<f64> = parameters.iter().map(|p| p.value).collect();
    let (mut squares, mut rows) = (0.0, 0);
    for (factor, joint) in union.by_joint().iter().zip((0..).map(JointIndex::new)) {
        squares += factor.residual_sum_of_squares(&union.columns().select(joint, &theta));
        rows += factor.rows();
    }
    (squares / (rows as f64 - count as f64).max(1.0)).sqrt()
}

/// Iterates the weights of joints and of their cycles. A joint's noise is the median over the cycles of the RMS
/// residual. A cycle whose residual exceeds the median by more than Huber's constant times the robust spread has the
/// weight limit / residual.
fn huber_weights(union: &PooledFactors, columns: &[usize]) -> Result<(RowWeights, bool), NumericsError> {
    let cycles = union.cycles();
    if cycles.len() < FEWEST_FOR_HUBER {
        return Err(NumericsError::TooShort {
            what: "the choice of cycles, which a robust estimate weighs against each other,",
            rows: cycles.len(),
            needed: FEWEST_FOR_HUBER,
        });
    }
    let names = names(union, columns);
    let start = weighted(&restricted(union, columns), MAX_WEIGHTED_CONDITION, &names)?;
    let all = |theta: &[f64]| {
        let mut all = vec![0.0; union.columns().kept().len()];
        columns.iter().zip(theta).for_each(|(&place, value)| all[place] = *value);
        all
    };
    let mut theta = start.theta;
    for _ in 0..MAX_ROUNDS {
        let weights = reweighted(union, &all(&theta))?;
        let factor = only(union.stacked(&weights), columns);
        let next = factor.solve_bounded(MAX_WEIGHTED_CONDITION, &names)?.theta;
        let step: Vec<f64> = next.iter().zip(&theta).map(|(a, b)| a - b).collect();
        theta = next;
        if torque_change(&factor, &step) < SETTLED {
            return Ok((weights, true));
        }
    }
    Ok((reweighted(union, &all(&theta))?, false))
}

fn reweighted(union: &PooledFactors, theta: &[f64]) -> Result<RowWeights, NumericsError> {
    let (cycles, n) = (union.cycles(), union.columns().joint_count());
    let mut noise = vec![1.0; n];
    let mut kept = vec![vec![1.0; n]; cycles.len()];
    for j in 0..n {
        let own = union.columns().select(JointIndex::new(j), theta);
        let of_cycle: Vec<(usize, f64)> = cycles
            .iter()
            .enumerate()
            .filter(|(_, cycle)| cycle.by_joint[j].rows() > 0)
            .map(|(c, cycle)| {
                let part = &cycle.by_joint[j];
                (c, (part.residual_sum_of_squares(&own) / part.rows() as f64).sqrt())
            })
            .collect();
        let values: Vec<f64> = of_cycle.iter().map(|(_, value)| *value).collect();
        let (Some(middle), Some(spread)) = (median(&values), robust_deviation(&values)) else { continue };
        if !(middle > 0.0 && middle.is_finite()) {
            return Err(NumericsError::NotFinite("a joint's median residual"));
        }
        noise[j] = middle;
        let limit = middle + HUBER_CONSTANT * spread;
        for (c, value) in of_cycle {
            kept[c][j] = (limit / value).min(1.0);
        }
    }
    Ok(RowWeights { kept: Some(kept), ..RowWeights::of_noise(&noise) })
}

/// Estimates with a prior. The fit of each joint gives its noise, because a poor motion has no stacked solution.
fn towards_prior(
    union: &PooledFactors,
    priors: &[Option<ParameterPrior>],
    strength: PriorStrength,
) -> Result<PooledEstimate, NumericsError> {
    let ids = union.columns().kept();
    let weights = RowWeights::of_noise(&own_noise(union)?);
    let factor = union.stacked(&weights);
    let (fraction, rows) = (union.independent_fraction(), factor.rows());
    let found = with_prior(&factor, fraction, rows, priors, strength)?;
    let mut sigma = found.sigma;
    let rows_freedom = (rows as f64 * fraction - found.data_share.iter().sum::<f64>()).max(1.0);
    let mut freedom = vec![rows_freedom; ids.len()];
    let all: Vec<usize> = (0..ids.len()).collect();
    let count = ProblemColumns::stacked(union.columns(), &all).cycles(union.cycles());
    let mut repeated = 0.0;
    if count > 1 {
        let both = with_prior_rows(&factor, fraction, priors, found.spread);
        let within = (sigma, rows_freedom);
        (sigma, freedom, repeated) =
            prior_scatter(union, &weights, &both, (&found.theta, within), priors, found.spread)?;
    }
    let errors = ErrorBasis::new(count, fraction, repeated);
    let of_parameter = |(k, &id): (usize, &ParameterId)| IdentifiedParameter {
        id,
        value: found.theta[k],
        std_error: sigma[k],
        degrees_of_freedom: freedom[k],
    };
    let parameters: Vec<IdentifiedParameter> = ids.iter().enumerate().map(of_parameter).collect();
    let shown = identifiability(&factor)?;
    Ok(PooledEstimate {
        identification: Identification {
            residual_std: residual_std(union, &parameters, ids.len()),
            parameters,
            residuals: Vec::new(),
            samples: rows / union.columns().joint_count().max(1),
            condition_number: shown.condition_number,
            scaled_condition_number: shown.scaled_condition_number,
        },
        half_width: sigma.iter().zip(&freedom).map(|(s, f)| half(*s, *f)).collect(),
        errors,
        weights,
        settled: true,
        prior: Some(PriorReport { data_share: found.data_share, spread: found.spread }),
        essential: None,
    })
}

/// Standard errors and degrees of freedom of an estimate with a prior, and the part of the error that all cycles repeat: the
/// errors of the cycles ([`over_cycles`]) beside the variance of the prior's own rows, which is 1 each. `sigma` are the
/// standard errors as rows and prior have them.
fn prior_scatter(
    union: &PooledFactors,
    weights: &RowWeights,
    both: &TriangularFactor,
    (theta, (sigma, rows_freedom)): (&[f64], (Vec<f64>, f64)),
    priors: &[Option<ParameterPrior>],
    spread: f64,
) -> Result<(Vec<f64>, Vec<f64>, f64), NumericsError> {
    let (b, fraction) = (theta.len(), union.independent_fraction());
    let all: Vec<usize> = (0..b).collect();
    let inverse = both.inverse_of_upper()?;
    let by_joint = weights.by_joint.iter().map(|w| w * fraction).collect();
    let weights = RowWeights { by_joint, kept: None };
    let design = ProblemColumns::stacked(union.columns(), &all);
    let count = design.cycles(union.cycles());
    let scatter = between_cycles(union.cycles(), &design, &weights, theta, &inverse)?;
    let covariance = &inverse * inverse.transpose();
    let of_prior = |k: usize| -> f64 {
        let row = |(i, prior): (usize, &Option<ParameterPrior>)| {
            prior.map_or(0.0, |prior| (covariance[(k, i)] / (spread * prior.std)).powi(2))
        };
        priors.iter().enumerate().map(row).sum()
    };
    let of_priors: Vec<f64> = (0..b).map(of_prior).collect();
    let of_rows = |(sigma, prior): (&f64, &f64)| ((sigma * sigma - prior).max(0.0), rows_freedom);
    let within: Vec<Variance> = sigma.iter().zip(&of_priors).map(of_rows).collect();
    let (variances, repeated) = over_cycles(&within, &scatter, union.columns().kept(), count);
    let combined = |((data, freedom), prior): (Variance, f64)| {
        // what the prior adds is known, and leaves the scatter's degrees of freedom their share
        let freedom = freedom * ((data + prior) / data.max(f64::MIN_POSITIVE)).powi(2);
        ((data + prior).sqrt(), freedom)
    };
    let (sigma, freedom) = variances.into_iter().zip(of_priors).map(combined).unzip();
    Ok((sigma, freedom, repeated))
}

/// Noise of each joint, `[n]`: the residual of the joint's own fit.
fn own_noise(union: &PooledFactors) -> Result<Vec<f64>, NumericsError> {
    let of_joint = |factor: &TriangularFactor| match factor.rows() {
        0 => Ok(1.0),
        _ => per_joint(factor, f64::INFINITY, |k| k.to_string()).map(|found| found.sigma),
    };
    let noise: Vec<f64> = union.by_joint().iter().map(of_joint).collect::<Result<_, _>>()?;
    match noise.iter().all(|sigma| *sigma > 0.0 && sigma.is_finite()) {
        true => Ok(noise),
        false => Err(NumericsError::NotFinite("a joint's residual standard deviation")),
    }
}

#[cfg(test)]
mod tests;
