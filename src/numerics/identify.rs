//! Base parameters of one cycle by scaled least squares over all joints stacked [3.22].

use super::NumericsError;
use super::triangular::TriangularFactor;
use crate::analysis::{Identification, IdentifiedParameter};
use crate::robot::{MAX_JOINTS, ParameterId};

/// Largest scaled condition number that still gives parameters. Torque noise enters parameters
/// multiplied by it; at a thousand, one percent of noise is ten times the parameter. The thesis's
/// excitation has 9.1.
pub const MAX_SCALED_CONDITION: f64 = 1e3;

/// Fewest rows per column: below, residuals say nothing of the noise.
const MIN_ROWS_PER_COLUMN: usize = 4;

/// Scratch for one sample: `q`, `qd`, `qdd`, `tau`.
pub(super) fn state() -> ([f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS]) {
    ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS])
}

/// Solves for the parameters `kept` `[b]` from the factor of `[w | tau]` with a column for each.
///
/// `sigma_k = s sqrt((wᵀw)⁻¹_kk)` with `s² = rss / (independent rows - b)`. `independent_fraction`
/// says how many rows are independent after the low-pass
/// ([`independent_fraction`](super::cross::independent_fraction)): neighbours share their noise.
///
/// # Errors
/// [`NumericsError::TooShort`], and [`NumericsError::RankDeficient`] if the motion does not excite
/// every parameter.
pub fn identify(
    kept: &[ParameterId],
    factor: &TriangularFactor,
    joint_count: usize,
    independent_fraction: f64,
) -> Result<Identification, NumericsError> {
    let b = kept.len();
    let needed = MIN_ROWS_PER_COLUMN * b;
    if factor.rows() < needed {
        return Err(NumericsError::TooShort {
            what: "the excitation stage, joints stacked,",
            rows: factor.rows(),
            needed,
        });
    }
    let solved = factor.solve(MAX_SCALED_CONDITION, |column| kept[column].to_string())?;
    let rows = solved.rows as f64;
    let independent = (rows * independent_fraction).max(b as f64 + 1.0);
    let residual_variance = solved.residual_sum_of_squares / (rows - b as f64);
    // (wᵀw)⁻¹ counts every row; the independent ones are fewer by the fraction
    let variance_of_rows = solved.residual_sum_of_squares / (independent - b as f64);
    let parameters = kept
        .iter()
        .zip(solved.theta.iter().zip(&solved.unscaled_variance))
        .map(|(&id, (&value, &unscaled))| IdentifiedParameter {
            id,
            value,
            std_error: (variance_of_rows * unscaled).sqrt(),
        })
        .collect::<Vec<_>>();
    if !parameters.iter().all(|p| p.value.is_finite() && p.std_error.is_finite()) {
        return Err(NumericsError::NotFinite("the parameters"));
    }
    Ok(Identification {
        parameters,
        samples: solved.rows / joint_count,
        condition_number: solved.condition_number,
        scaled_condition_number: solved.scaled_condition_number,
        residual_std: residual_variance.sqrt(),
    })
}
