//! Base parameters of one cycle by scaled least squares over all joints stacked [3.22].

use faer::MatRef;

use super::NumericsError;
use super::base::BaseParameters;
use super::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use super::signal::Conditioned;
use super::triangular::{BLOCK_ROWS, TriangularFactor};
use crate::analysis::{Identification, IdentifiedParameter};
use crate::robot::{MAX_JOINTS, Robot};

/// Largest scaled condition number that still gives parameters. Torque noise enters parameters
/// multiplied by it; at a thousand, one percent of noise is ten times the parameter. The thesis's
/// excitation has 9.1.
pub const MAX_SCALED_CONDITION: f64 = 1e3;

/// Fewest rows per column: below, residuals say nothing of the noise.
const MIN_ROWS_PER_COLUMN: usize = 4;

/// Folds the given rows of a cycle into a triangular factor of `[w | tau]`, block by block: the
/// observation matrix of the whole cycle is never held.
///
/// A joint's row is left out while the joint moves slower than its low-speed threshold: at rest
/// friction takes any value up to breakaway, which no column describes (thesis 5.1.3).
#[must_use]
pub fn observe(
    robot: &Robot,
    columns: &KeptColumns,
    conditioned: &Conditioned,
    rows: impl Iterator<Item = usize>,
) -> TriangularFactor {
    let n = robot.joint_count();
    let width = columns.len() + 1;
    let block_rows = BLOCK_ROWS;
    let mut factor = TriangularFactor::new(columns.len());
    let mut block = vec![0.0; block_rows * width];
    let mut y = Regressor::new(robot);
    let (mut q, mut qd, mut qdd, mut tau) = state();
    let mut filled = 0;
    for row in rows {
        conditioned.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
        columns.write(&y, &mut block, block_rows, filled);
        let torque = columns.len() * block_rows + filled;
        block[torque..torque + n].copy_from_slice(&tau[..n]);
        let moves = |j: usize| qd[j].abs() >= robot.joints[j].low_speed;
        filled += keep_rows(&mut block, block_rows, filled, (0..n).filter(|&j| moves(j)));
        if filled + n > block_rows {
            factor.fold(MatRef::from_column_major_slice(&block, block_rows, width).subrows(0, filled));
            filled = 0;
        }
    }
    if filled > 0 {
        factor.fold(MatRef::from_column_major_slice(&block, block_rows, width).subrows(0, filled));
    }
    factor
}

/// Moves the chosen rows of a sample that begins at `first` together and returns their number.
fn keep_rows(
    block: &mut [f64],
    block_rows: usize,
    first: usize,
    chosen: impl Iterator<Item = usize>,
) -> usize {
    let mut kept = 0;
    for j in chosen {
        if kept != j {
            for column in block.chunks_exact_mut(block_rows) {
                column[first + kept] = column[first + j];
            }
        }
        kept += 1;
    }
    kept
}

/// Scratch for one sample: `q`, `qd`, `qdd`, `tau`.
pub(super) fn state() -> ([f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS]) {
    ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS])
}

/// Solves for the base parameters from the factor of `[w | tau]`.
///
/// `sigma_k = s sqrt((wᵀw)⁻¹_kk)` with `s² = rss / (independent rows - b)`. `independent_fraction`
/// says how many rows are independent after the low-pass
/// ([`Conditioned::independent_fraction`]): neighbours share their noise.
///
/// # Errors
/// [`NumericsError::TooShort`], and [`NumericsError::RankDeficient`] if the motion does not excite
/// every parameter.
pub fn identify(
    base: &BaseParameters,
    factor: &TriangularFactor,
    joint_count: usize,
    independent_fraction: f64,
) -> Result<Identification, NumericsError> {
    let b = base.kept.len();
    let needed = MIN_ROWS_PER_COLUMN * b;
    if factor.rows() < needed {
        return Err(NumericsError::TooShort {
            what: "the excitation stage, joints stacked,",
            rows: factor.rows(),
            needed,
        });
    }
    let solved = factor.solve(MAX_SCALED_CONDITION, |column| base.kept[column].to_string())?;
    let rows = solved.rows as f64;
    let independent = (rows * independent_fraction).max(b as f64 + 1.0);
    let residual_variance = solved.residual_sum_of_squares / (rows - b as f64);
    // (wᵀw)⁻¹ counts every row; the independent ones are fewer by the fraction
    let variance_of_rows = solved.residual_sum_of_squares / (independent - b as f64);
    let parameters = base
        .kept
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
