//! Base parameters and their errors by scaled least squares over all joints stacked [3.22].

use faer::{Mat, Scale};

use crate::NumericsError;
use crate::least_squares::clustered::clustered;
use crate::least_squares::conditioning::{ShownColumns, shown_columns};
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::huber::{RobustSettings, huber};
use crate::least_squares::rows::{RowSource, SampleRows};
use crate::least_squares::solution::{LeastSquares, MAX_SCALED_CONDITION, MAX_WEIGHTED_CONDITION};
use crate::least_squares::weighted::{WeightRule, joined, weighted};
use armwatch_model::analysis::{Estimator, Identification, IdentifiedParameter, JointResidual};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Smallest number of rows per column; with fewer, residuals do not show the noise.
const MIN_ROWS_PER_COLUMN: usize = 4;

/// Identifies the parameters `kept` `[b]` from rows, with clustered errors (`clustered`). `factors` `[n]` are those of
/// the joints' rows of `source`, `b` columns each.
///
/// Parameters that the motion does not show are in the result; see [`IdentifiedParameter::is_shown`].
///
/// # Errors
/// [`NumericsError::TooShort`], and [`NumericsError::RankDeficient`] if the motion excites less than three quarters of
/// the parameters; [`NumericsError::NotFinite`] if the residual of a joint is not finite, or is zero in a robust
/// estimate.
pub fn identify_rows(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    source: &dyn RowSource,
    estimator: Estimator,
) -> Result<Identification, NumericsError> {
    of_shown(kept, factors, |kept, factors, columns| match columns {
        None => identify_all_rows(kept, factors, source, estimator),
        Some(columns) => identify_all_rows(kept, factors, &ChosenColumns { source, columns }, estimator),
    })
}

/// Result of `identify` for all columns or, if the motion does not show all, for those that it shows.
fn of_shown(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    identify: impl Fn(
        &[ParameterId],
        &[TriangularFactor],
        Option<&[usize]>,
    ) -> Result<Identification, NumericsError>,
) -> Result<Identification, NumericsError> {
    let error = match identify(kept, factors, None) {
        Err(error @ NumericsError::RankDeficient { .. }) => error,
        done => return done,
    };
    let Some(shown) = shown_columns(&stacked(kept, factors)?.0)? else { return Err(error) };
    let own: Vec<ParameterId> = shown.kept.iter().map(|&k| kept[k]).collect();
    let restricted: Vec<TriangularFactor> = factors.iter().map(|of| of.restricted(&shown.kept)).collect();
    let mut found = identify(&own, &restricted, Some(&shown.kept))?;
    found.parameters = spread(kept, &shown, found.parameters);
    Ok(found)
}

/// Parameters of the shown columns, among all: omitted ones are zero, and those that contain parts of omitted ones have
/// no error.
fn spread(
    kept: &[ParameterId],
    shown: &ShownColumns,
    found: Vec<IdentifiedParameter>,
) -> Vec<IdentifiedParameter> {
    let mut all: Vec<IdentifiedParameter> =
        kept.iter().map(|&id| IdentifiedParameter::left_out(id)).collect();
    for ((&place, alone), parameter) in shown.kept.iter().zip(&shown.alone).zip(found) {
        all[place].value = parameter.value;
        if *alone {
            all[place] = parameter;
        }
    }
    all
}

/// Rows of a source with a selection of columns.
struct ChosenColumns<'a> {
    source: &'a dyn RowSource,
    columns: &'a [usize],
}

impl RowSource for ChosenColumns<'_> {
    fn columns(&self) -> usize {
        self.columns.len()
    }

    fn joint_count(&self) -> usize {
        self.source.joint_count()
    }

    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>)) {
        let mut w = Vec::new();
        self.source.each(&mut |sample| {
            w.clear();
            for joint in 0..sample.tau.len() {
                let row = sample.of_joint(joint);
                w.extend(self.columns.iter().map(|&k| row[k]));
            }
            visit(&SampleRows { w: &w, ..*sample });
        });
    }
}

fn identify_all_rows(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    source: &dyn RowSource,
    estimator: Estimator,
) -> Result<Identification, NumericsError> {
    let motion = solve_ordinary(kept, factors)?;
    let name = |column: usize| kept[column].to_string();
    let (theta, rule) = match estimator {
        Estimator::Huber => {
            let found = huber(source, &RobustSettings::default(), name)?;
            (found.solution.theta, found.rule)
        }
        _ => estimate(kept, factors, &motion, estimator)?,
    };
    let covariance = clustered(source, &theta, &rule)?;
    identified_parameters(
        kept,
        factors,
        &motion,
        theta,
        Errors {
            covariance: covariance.matrix,
            freedom: covariance.freedom,
            shares: covariance.independent_share,
        },
    )
}

/// Identifies the parameters `kept` `[b]` from the joints' factors `[n]`, `b` columns each, without rows.
///
/// `independent_shares` `[n]` are the shares of each joint's rows that count as independent
/// ([`JointResidual::independent_share`]). The covariance is `A⁻¹ (sum_j w_j² s_j² / share_j W_jᵀW_j) A⁻¹`
/// with `A = sum_j w_j W_jᵀW_j`, weights `w_j` and a joint's residual variance `s_j²`.
///
/// # Errors
/// Those of [`identify_rows`]; [`NumericsError::Unsupported`] for an estimator that needs rows.
pub fn identify_factors(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    independent_shares: &[f64],
    estimator: Estimator,
) -> Result<Identification, NumericsError> {
    of_shown(kept, factors, |kept, factors, _| {
        let motion = solve_ordinary(kept, factors)?;
        let (theta, rule) = estimate(kept, factors, &motion, estimator)?;
        let errors = errors_by_joint(factors, &theta, &rule, independent_shares)?;
        identified_parameters(kept, factors, &motion, theta, errors)
    })
}

/// Same as [`identify_factors`], with given noise of each joint.
///
/// # Errors
/// Those of [`identify_rows`].
pub(crate) fn identify_weighted(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    independent_shares: &[f64],
    rule: &WeightRule,
) -> Result<Identification, NumericsError> {
    let motion = solve_ordinary(kept, factors)?;
    let weighed = joined(factors, rule, kept.len());
    let theta = weighed.solve_bounded(MAX_WEIGHTED_CONDITION, |column| kept[column].to_string())?.theta;
    let errors = errors_by_joint(factors, &theta, rule, independent_shares)?;
    identified_parameters(kept, factors, &motion, theta, errors)
}

/// Standard errors `[b]` for a correct model whose rows depend on each other only through the low-pass, which leaves
/// `independent_fraction` of them independent.
///
/// A doubt about the model uses these errors: clustered errors grow with the errors of the model, and would excuse any
/// geometry. NaN for a parameter that the motion does not show.
///
/// # Errors
/// Those of [`identify_factors`].
pub(crate) fn noise_errors(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    residual_std: f64,
    independent_fraction: f64,
) -> Result<Vec<f64>, NumericsError> {
    let (stacked, rows) = stacked(kept, factors)?;
    let (rows, b) = (rows as f64, kept.len() as f64);
    let independent = (rows * independent_fraction).max(b + 1.0);
    let variance = residual_std * residual_std * (rows - b) / (independent - b);
    let solve = |of: &TriangularFactor| of.solve_bounded(MAX_SCALED_CONDITION, |k| kept[k].to_string());
    let error = |unscaled: &f64| (variance * unscaled).sqrt();
    let deficient = match solve(&stacked) {
        Ok(motion) => return Ok(motion.unscaled_variance.iter().map(error).collect()),
        Err(error @ NumericsError::RankDeficient { .. }) => error,
        Err(error) => return Err(error),
    };
    let Some(shown) = shown_columns(&stacked)? else { return Err(deficient) };
    let motion = solve(&stacked.restricted(&shown.kept))?;
    let mut errors = vec![f64::NAN; kept.len()];
    for ((&place, alone), unscaled) in shown.kept.iter().zip(&shown.alone).zip(&motion.unscaled_variance) {
        if *alone {
            errors[place] = error(unscaled);
        }
    }
    Ok(errors)
}

/// Ordinary solution, the basis for judging the motion with every estimator.
fn solve_ordinary(kept: &[ParameterId], factors: &[TriangularFactor]) -> Result<LeastSquares, NumericsError> {
    let (stacked, rows) = stacked(kept, factors)?;
    Ok(LeastSquares { rows, ..stacked.solve(MAX_SCALED_CONDITION, |column| kept[column].to_string())? })
}

/// All joints' rows with equal weight, and their number.
fn stacked(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
) -> Result<(TriangularFactor, usize), NumericsError> {
    let b = kept.len();
    let rows = factors.iter().map(TriangularFactor::rows).sum();
    let needed = MIN_ROWS_PER_COLUMN * b;
    if rows < needed {
        return Err(NumericsError::TooShort { what: "the excitation stage, joints stacked,", rows, needed });
    }
    Ok((joined(factors, &WeightRule::equal(factors.len()), b), rows))
}

fn estimate(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    ordinary: &LeastSquares,
    estimator: Estimator,
) -> Result<(Vec<f64>, WeightRule), NumericsError> {
    match estimator {
        Estimator::Ordinary => Ok((ordinary.theta.clone(), WeightRule::equal(factors.len()))),
        Estimator::Weighted => {
            let found = weighted(factors, MAX_WEIGHTED_CONDITION, |column| kept[column].to_string())?;
            Ok((found.theta, found.rule))
        }
        Estimator::Huber => Err(NumericsError::Unsupported(
            "a robust estimate from stored factors: it weighs single rows; choose ordinary or weighted",
        )),
    }
}

/// Uncertainty of parameters.
struct Errors {
    /// Covariance of the parameters, `[b x b]`.
    covariance: Mat<f64>,
    /// Degrees of freedom of each standard error, `[b]`.
    freedom: Vec<f64>,
    /// Independent share of each joint's rows, `[n]`.
    shares: Vec<f64>,
}

/// Errors from factors: the sum of the joints' parts, with the degrees of freedom of Satterthwaite (1946).
fn errors_by_joint(
    factors: &[TriangularFactor],
    theta: &[f64],
    rule: &WeightRule,
    independent_shares: &[f64],
) -> Result<Errors, NumericsError> {
    let b = theta.len();
    let inverse = joined(factors, rule, b).inverse_of_upper()?;
    let inverse = &inverse * inverse.transpose();
    let mut covariance = Mat::<f64>::zeros(b, b);
    let mut of_variance = vec![0.0; b];
    let share = |j: usize| independent_shares.get(j).copied().unwrap_or(1.0);
    for (j, factor) in factors.iter().enumerate().filter(|(_, factor)| factor.rows() > 0) {
        let independent = factor.rows() as f64 * share(j);
        let deviation = (factor.residual_sum_of_squares(theta) / independent).sqrt();
        let weight = 1.0 / (rule.sigma[j] * rule.sigma[j]);
        let part = factor.upper().submatrix(0, 0, b, b) * &inverse * Scale(weight * deviation);
        let part = part.transpose() * &part;
        covariance += &part;
        for (k, of_variance) in of_variance.iter_mut().enumerate() {
            *of_variance += part[(k, k)] * part[(k, k)] / independent;
        }
    }
    let freedom = |k: usize| (covariance[(k, k)] * covariance[(k, k)] / of_variance[k]).max(1.0);
    Ok(Errors {
        freedom: (0..b).map(freedom).collect(),
        shares: (0..factors.len()).map(share).collect(),
        covariance,
    })
}

fn identified_parameters(
    kept: &[ParameterId],
    factors: &[TriangularFactor],
    motion: &LeastSquares,
    theta: Vec<f64>,
    errors: Errors,
) -> Result<Identification, NumericsError> {
    let squares: Vec<f64> = factors.iter().map(|factor| factor.residual_sum_of_squares(&theta)).collect();
    let parameter = |(k, (&id, value)): (usize, (&ParameterId, f64))| IdentifiedParameter {
        id,
        value,
        std_error: errors.covariance[(k, k)].sqrt(),
        degrees_of_freedom: errors.freedom[k],
    };
    let parameters: Vec<IdentifiedParameter> = kept.iter().zip(theta).enumerate().map(parameter).collect();
    if !parameters.iter().all(|p| p.value.is_finite() && p.std_error.is_finite()) {
        return Err(NumericsError::NotFinite("the parameters"));
    }
    let residual = |(j, (factor, squares)): (usize, (&TriangularFactor, &f64))| JointResidual {
        joint: JointIndex::new(j),
        // zero without rows
        std: (squares / factor.rows().max(1) as f64).sqrt(),
        independent_share: errors.shares[j],
    };
    Ok(Identification {
        parameters,
        residuals: factors.iter().zip(&squares).enumerate().map(residual).collect(),
        samples: motion.rows / factors.len(),
        condition_number: motion.condition_number,
        scaled_condition_number: motion.scaled_condition_number,
        residual_std: (squares.iter().sum::<f64>() / (motion.rows - kept.len()) as f64).sqrt(),
    })
}
