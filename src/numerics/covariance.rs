//! Standard errors that stay honest when residuals are correlated in time and between joints.
//!
//! Residuals after a low-pass are neighbours' copies of each other, and what the model leaves out is
//! slow. The sandwich estimate with blocks of time as clusters asks only that *blocks* be independent
//! (Liang & Zeger 1986; Cameron & Miller 2015). All joints of a moment are in one block.

use faer::{Mat, Side};

use super::NumericsError;
use super::estimate::WeightRule;
use super::rows::{RowFolder, RowSource};
use super::triangular::TriangularFactor;

/// Below this the autocorrelation has died out: twice the scatter of an estimate from 1,600 rows.
const DIED_OUT: f64 = 0.05;
/// Part of the record over which autocorrelation is looked for.
const LONGEST_LAG: f64 = 0.1;
/// Leverage of a block is kept below this, so that a block that alone decides a parameter gives a
/// large and not an endless error.
const MAX_LEVERAGE: f64 = 0.99;

/// How a block's residuals are corrected for having been fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LeverageCorrection {
    /// Not at all; too small errors with few blocks.
    None,
    /// `(1 - h)^(-1/2)`: free of bias for independent rows (CR2; Bell & McCaffrey 2002).
    SquareRoot,
    /// `(1 - h)^(-1)`: leaving out one block after the other (CR3, the jackknife); too large rather
    /// than too small.
    Jackknife,
}

/// What the covariance may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClusterSettings {
    /// Length of a block in correlation times of the residual.
    pub correlation_times: f64,
    /// Fewest blocks: where the record is too short for that many, blocks are cut shorter.
    pub min_blocks: usize,
    /// Correction for fitting.
    pub correction: LeverageCorrection,
}

impl Default for ClusterSettings {
    fn default() -> Self {
        Self { correlation_times: 5.0, min_blocks: 20, correction: LeverageCorrection::Jackknife }
    }
}

/// Covariance of an estimate.
#[derive(Debug, Clone)]
pub struct ClusteredCovariance {
    /// Covariance of the parameters, `[b x b]`.
    pub matrix: Mat<f64>,
    /// Standard errors, `[b]`.
    pub sigma: Vec<f64>,
    /// Degrees of freedom of each standard error, `[b]`: from how many blocks of which share it comes
    /// (Satterthwaite 1946).
    pub freedom: Vec<f64>,
    /// Correlation time of the residual, rows: `1 + 2 sum rho`, the longest of all joints.
    pub correlation_rows: f64,
    /// Rows of the recording in a block.
    pub block_rows: usize,
    /// Blocks with rows.
    pub blocks: usize,
}

impl ClusteredCovariance {
    /// Half the width of the two-sided interval that holds parameter `k` with the probability
    /// `level`, such as 0.95.
    #[must_use]
    pub fn half_width(&self, k: usize, level: f64) -> f64 {
        student_quantile(0.5 + 0.5 * level, self.freedom[k]) * self.sigma[k]
    }
}

/// Sandwich covariance of a least-squares or M-estimate `theta` with blocks of time as clusters:
/// `(wᵀw)⁻¹ (sum over blocks of w_bᵀ e_b e_bᵀ w_b) (wᵀw)⁻¹`, rows weighted by `rule`.
///
/// Three passes over the rows: residuals give the correlation time and with it the length of a
/// block, then the factor of `w`, then the blocks. Only sums over a block are held.
///
/// # Errors
/// [`NumericsError::TooShort`] with fewer than two blocks or fewer rows than columns,
/// [`NumericsError::NotFinite`] if `w` has not full rank.
pub fn clustered(
    source: &dyn RowSource,
    theta: &[f64],
    rule: &WeightRule,
    settings: &ClusterSettings,
) -> Result<ClusteredCovariance, NumericsError> {
    let residuals = residuals(source, theta);
    let length = residuals.first().map_or(0, Vec::len);
    let correlation_rows = residuals.iter().map(|series| correlation_time(series)).fold(1.0, f64::max);
    let wanted = (settings.correlation_times * correlation_rows).ceil() as usize;
    let block_rows = wanted.min(length / settings.min_blocks.max(1)).max(1);

    let factor = weighted_factor(source, theta, rule);
    let b = factor.columns();
    if factor.rows() <= b {
        return Err(NumericsError::TooShort {
            what: "the observation matrix",
            rows: factor.rows(),
            needed: b + 1,
        });
    }
    let inverse = inverse_of_upper(&factor)?;
    let blocks = blocks(source, theta, rule, &inverse, block_rows);
    if blocks.len() < 2 {
        return Err(NumericsError::TooShort {
            what: "the record, in blocks,",
            rows: blocks.len(),
            needed: 2,
        });
    }
    let count = blocks.len();
    let Sandwich { matrix, freedom } = sandwich(&inverse, blocks, settings.correction)?;
    Ok(ClusteredCovariance {
        sigma: (0..b).map(|k| matrix[(k, k)].sqrt()).collect(),
        freedom,
        matrix,
        correlation_rows,
        block_rows,
        blocks: count,
    })
}

/// What blocks say of an estimate's scatter.
pub(super) struct Sandwich {
    /// Covariance, `[b x b]`.
    pub(super) matrix: Mat<f64>,
    /// Degrees of freedom of each parameter, `[b]`.
    pub(super) freedom: Vec<f64>,
}

/// Covariance of an estimate from its blocks, at least two. `inverse` is `r11⁻¹` of the factor that
/// gave the estimate.
pub(super) fn sandwich(
    inverse: &Mat<f64>,
    blocks: impl IntoIterator<Item = Block>,
    correction: LeverageCorrection,
) -> Result<Sandwich, NumericsError> {
    let b = inverse.ncols();
    let mut matrix = Mat::<f64>::zeros(b, b);
    let (mut total, mut squares, mut count) = (vec![0.0; b], vec![0.0; b], 0.0);
    for block in blocks {
        let score = corrected(&block, correction)?;
        let moved = inverse * score;
        matrix += &moved * moved.transpose();
        let spread = inverse * &block.information;
        for k in 0..b {
            let share: f64 = (0..b).map(|i| spread[(k, i)] * inverse[(k, i)]).sum();
            total[k] += share;
            squares[k] += share * share;
        }
        count += 1.0;
    }
    let small_sample = match correction {
        LeverageCorrection::Jackknife => (count - 1.0) / count,
        _ => count / (count - 1.0),
    };
    matrix *= faer::Scale(small_sample);
    let freedom = (0..b).map(|k| (total[k] * total[k] / squares[k] - 1.0).max(1.0)).collect();
    Ok(Sandwich { matrix, freedom })
}

/// Residual of each joint by row of the recording, from the first to the last row; not a number where
/// a row takes no part.
fn residuals(source: &dyn RowSource, theta: &[f64]) -> Vec<Vec<f64>> {
    let mut series = vec![Vec::new(); source.joint_count()];
    let mut first = None;
    source.each(&mut |sample| {
        let at = sample.row - *first.get_or_insert(sample.row);
        for (j, series) in series.iter_mut().enumerate() {
            series.resize(at, f64::NAN);
            series.push(if sample.used[j] { sample.residual(j, theta) } else { f64::NAN });
        }
    });
    series
}

/// Integrated correlation time `1 + 2 sum rho_l` in rows, the sum ending where the autocorrelation
/// has died out. `series` may have gaps of values that are not a number. 1 for white noise.
#[must_use]
pub fn correlation_time(series: &[f64]) -> f64 {
    let longest = (series.len() as f64 * LONGEST_LAG) as usize;
    let product = |lag: usize| {
        let pairs = series.iter().zip(&series[lag..]).map(|(a, b)| a * b).filter(|p| p.is_finite());
        let (sum, count) = pairs.fold((0.0, 0_usize), |(sum, count), p| (sum + p, count + 1));
        if count > 0 { sum / count as f64 } else { 0.0 }
    };
    let variance = if series.is_empty() { 0.0 } else { product(0) };
    if variance <= 0.0 {
        return 1.0;
    }
    let correlations = (1..=longest).map(|lag| product(lag) / variance);
    1.0 + 2.0 * correlations.take_while(|rho| *rho > DIED_OUT).sum::<f64>()
}

fn weighted_factor(source: &dyn RowSource, theta: &[f64], rule: &WeightRule) -> TriangularFactor {
    let mut folder = RowFolder::new(source.columns());
    source.each(&mut |sample| {
        for j in (0..sample.tau.len()).filter(|&j| sample.used[j]) {
            folder.push(sample.of_joint(j), sample.tau[j], rule.weight_of(sample, j, theta).sqrt());
        }
    });
    folder.finish()
}

/// `r11⁻¹` of a factor.
pub(super) fn inverse_of_upper(factor: &TriangularFactor) -> Result<Mat<f64>, NumericsError> {
    let b = factor.columns();
    let r11 = factor.upper().submatrix(0, 0, b, b);
    let mut inverse = Mat::<f64>::identity(b, b);
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(r11, inverse.as_mut(), faer::Par::Seq);
    if inverse.is_all_finite() {
        Ok(inverse)
    } else {
        Err(NumericsError::NotFinite("the observation matrix"))
    }
}

/// Sums over one block in coordinates in which `wᵀw` is the identity.
pub(super) struct Block {
    /// `wᵀw` of the block, `[b x b]`: its eigenvalues are leverages.
    pub(super) information: Mat<f64>,
    /// `wᵀe` of the block, `[b x 1]`.
    pub(super) score: Mat<f64>,
}

fn blocks(
    source: &dyn RowSource,
    theta: &[f64],
    rule: &WeightRule,
    inverse: &Mat<f64>,
    block_rows: usize,
) -> Vec<Block> {
    let b = source.columns();
    let mut found = Vec::new();
    let mut rows: Vec<f64> = Vec::new();
    let mut errors: Vec<f64> = Vec::new();
    let mut current = 0;
    let mut first = None;
    let mut close = |rows: &mut Vec<f64>, errors: &mut Vec<f64>| {
        if !errors.is_empty() {
            let w = faer::MatRef::from_row_major_slice(rows, errors.len(), b) * inverse;
            let e = faer::MatRef::from_column_major_slice(errors, errors.len(), 1);
            found.push(Block { information: w.transpose() * &w, score: w.transpose() * e });
        }
        rows.clear();
        errors.clear();
    };
    source.each(&mut |sample| {
        let block = (sample.row - *first.get_or_insert(sample.row)) / block_rows;
        if block != current {
            close(&mut rows, &mut errors);
            current = block;
        }
        for j in (0..sample.tau.len()).filter(|&j| sample.used[j]) {
            let e = sample.residual(j, theta);
            let root = rule.weight(j, e).sqrt();
            rows.extend(sample.of_joint(j).iter().map(|w| root * w));
            errors.push(root * e);
        }
    });
    close(&mut rows, &mut errors);
    found
}

/// The block's score with its residuals corrected for leverage: `w_bᵀ f(w_b w_bᵀ) = f(w_bᵀ w_b) w_bᵀ`,
/// so that a matrix of `b` rows is enough.
fn corrected(block: &Block, correction: LeverageCorrection) -> Result<Mat<f64>, NumericsError> {
    let power = match correction {
        LeverageCorrection::None => return Ok(block.score.clone()),
        LeverageCorrection::SquareRoot => -0.5,
        LeverageCorrection::Jackknife => -1.0,
    };
    let eigen = block
        .information
        .self_adjoint_eigen(Side::Lower)
        .map_err(|_| NumericsError::NotFinite("the leverage of a block"))?;
    let leverage = eigen.S().column_vector();
    let along = eigen.U().transpose() * &block.score;
    let scaled = Mat::from_fn(along.nrows(), 1, |i, _| {
        along[(i, 0)] * (1.0 - leverage[i].clamp(0.0, MAX_LEVERAGE)).powf(power)
    });
    Ok(eigen.U() * scaled)
}

/// Quantile of Student's distribution with `freedom` degrees of freedom at `probability` (0.5 to
/// 1): expansion about the normal quantile (Abramowitz & Stegun 26.7.5), good to 1 % from four degrees
/// of freedom on; fewer than three count as three.
#[must_use]
pub fn student_quantile(probability: f64, freedom: f64) -> f64 {
    let z = normal_quantile(probability);
    let v = freedom.max(3.0);
    let (z3, z5, z7) = (z.powi(3), z.powi(5), z.powi(7));
    let z9 = z.powi(9);
    z + (z3 + z) / (4.0 * v)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * v * v)
        + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * v.powi(3))
        + (79.0 * z9 + 776.0 * z7 + 1482.0 * z5 - 1920.0 * z3 - 945.0 * z) / (92160.0 * v.powi(4))
}

/// Quantile of the standard normal distribution at `probability` in (0, 1), absolute error below
/// 4.5e-4 (Abramowitz & Stegun 26.2.23).
#[must_use]
pub fn normal_quantile(probability: f64) -> f64 {
    let tail = probability.min(1.0 - probability).max(f64::MIN_POSITIVE);
    let t = (-2.0 * tail.ln()).sqrt();
    let x = t
        - (2.515_517 + 0.802_853 * t + 0.010_328 * t * t)
            / (1.0 + 1.432_788 * t + 0.189_269 * t * t + 0.001_308 * t.powi(3));
    if probability < 0.5 { -x } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (freedom, table) in [(5.0, 2.571), (10.0, 2.228), (30.0, 2.042), (1e6, 1.960)] {
            let found = student_quantile(0.975, freedom);
            assert!((found - table).abs() < 0.002, "{freedom}: {found} {table}");
        }
    }

    #[test]
    fn correlation_time_of_a_moving_mean_is_its_length() {
        // A triangle of autocorrelation of half-width 20 has an area of 20.
        let mut state = 12345_u64;
        let mut white = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let raw: Vec<f64> = (0..40_020).map(|_| white()).collect();
        let smooth: Vec<f64> = raw.windows(20).map(|w| w.iter().sum::<f64>()).collect();
        assert!((correlation_time(&raw) - 1.0).abs() < 0.2, "{}", correlation_time(&raw));
        let found = correlation_time(&smooth);
        assert!((found - 20.0).abs() < 3.0, "{found}");
        assert_eq!(correlation_time(&[]), 1.0);
    }
}
