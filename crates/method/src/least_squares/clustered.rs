//! Standard errors that remain correct if residuals are correlated in time and between joints.
//!
//! Filtered residuals are autocorrelated: the low-pass correlates neighbours, unmodelled effects add errors of low
//! frequency, and differentiating the velocity adds errors of high frequency. The sandwich estimate with blocks of time
//! as clusters requires only that the sums over *blocks* are independent (Liang & Zeger 1986; Cameron & Miller 2015).
//! All joints at one instant are in the same block. Blocks overlap by half and have a sine taper: hard edges would
//! count fast noise that they cut off, as a rectangular window leaks in a spectrum (Percival & Walden 1993, 6).

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Mat, Scale, Side};

use super::rows::RowSource;
use super::weighted::WeightRule;
use crate::NumericsError;
use crate::lanes::dot;

/// Largest leverage of a block, so that a block that alone decides a parameter gives a large, but finite error.
const MAX_LEVERAGE: f64 = 0.99;

/// Share of the scatter that is each block's own, `1 / (1 + 2 / pi²)`: with independent rows, two blocks that overlap
/// by half share `1 / pi` of their scatter.
const OWN_SHARE: f64 = 0.831_4;

/// Number of block lengths per record. Longer blocks are closer to independent, more blocks give a more certain error:
/// twenty, which overlap, give it to an eighth.
const LENGTHS: usize = 20;

/// Covariance of an estimate.
#[derive(Debug, Clone)]
pub struct ClusteredCovariance {
    /// Covariance of the parameters, `[b x b]`.
    pub matrix: Mat<f64>,
    /// Degrees of freedom of each standard error, `[b]`, from the shares of the blocks in it (Satterthwaite 1946).
    pub freedom: Vec<f64>,
    /// Variance of each joint's share in the estimate if all its rows were independent, over that variance from blocks,
    /// `[n]`; 1 without rows.
    pub independent_share: Vec<f64>,
}

/// Sandwich covariance of a least-squares or M-estimate `theta` with blocks of time as clusters:
/// `(wᵀw)⁻¹ (sum over blocks of w_bᵀ e_b e_bᵀ w_b) (wᵀw)⁻¹`, rows weighted by `rule`. For an M-estimate
/// `wᵀw` weights the rows by the slope of its influence (Huber 1981, 6.3).
///
/// The residuals of fitted blocks scatter too little, and after a correction for the fit too much. The bias for
/// independent rows with the variance of `rule` follows from `w` alone for each parameter. It is removed, so errors are
/// unbiased (as CR2; Bell & McCaffrey 2002).
///
/// The function reads the rows twice: the first pass counts them, the second adds them up by blocks. It stores only the
/// sums.
///
/// # Errors
/// [`NumericsError::TooShort`] with fewer than two blocks or fewer rows than columns, [`NumericsError::NotFinite`] if
/// `w` does not have full rank.
pub fn clustered(
    source: &dyn RowSource,
    theta: &[f64],
    rule: &WeightRule,
) -> Result<ClusteredCovariance, NumericsError> {
    let half_rows = source.record_length().div_ceil(2 * LENGTHS).max(1);
    let sums = BlockSums::over(source, theta, rule, half_rows);
    let (b, blocks) = (source.columns(), sums.blocks.len());
    if sums.rows <= b {
        return Err(NumericsError::TooShort {
            what: "the observation matrix",
            rows: sums.rows,
            needed: b + 1,
        });
    }
    if blocks < 2 {
        return Err(NumericsError::TooShort { what: "the record, in blocks,", rows: blocks, needed: 2 });
    }
    let information = BlockInformation::of(&sums)?;
    let mut scatter = BlockScatter::new(source.joint_count(), b);
    for block in sums.blocks.values() {
        scatter.add(block, &information)?;
    }
    let bias = scatter.bias(&information);
    let matrix = Mat::from_fn(b, b, |i, k| scatter.matrix[(i, k)] / (bias[i] * bias[k]).sqrt());
    if !(0..b).all(|k| matrix[(k, k)].sqrt().is_finite()) {
        return Err(NumericsError::NotFinite("the standard errors"));
    }
    let mean_bias = bias.iter().sum::<f64>() / b as f64;
    let share = |(joint, from_blocks): (&JointSums, &f64)| {
        let share = joint.variance_if_independent(&information) * mean_bias / from_blocks;
        if share > 0.0 && share.is_finite() { share } else { 1.0 }
    };
    Ok(ClusteredCovariance {
        freedom: scatter.freedom(),
        independent_share: sums.joints.iter().zip(&scatter.of_joints).map(share).collect(),
        matrix,
    })
}

/// Sums over one block.
struct RowBlock {
    /// `wᵀ h² w` with the taper `h`, `[b x b]`.
    information: Mat<f64>,
    /// `wᵀ h w`, `[b x b]`.
    tapered: Mat<f64>,
    /// `wᵀ h e` of each joint's rows, `[b x n]`.
    scores: Mat<f64>,
}

/// Scatter of the estimate over all blocks.
struct BlockScatter {
    /// Sum of squares and products of the shifts by the blocks, `[b x b]`.
    matrix: Mat<f64>,
    /// Expected diagonal for independent rows of variance 1, `[b]`.
    expected: Vec<f64>,
    /// Sum of squares of the shifts of each joint in units of the information, `[n]`.
    of_joints: Vec<f64>,
    /// Sum and sum of squares over blocks of their share in each variance, `[b]`.
    parts: Vec<[f64; 2]>,
}

impl BlockScatter {
    fn new(n: usize, b: usize) -> Self {
        Self {
            matrix: Mat::zeros(b, b),
            expected: vec![0.0; b],
            of_joints: vec![0.0; n],
            parts: vec![[0.0; 2]; b],
        }
    }

    fn add(&mut self, block: &RowBlock, information: &BlockInformation) -> Result<(), NumericsError> {
        let spread = &block.information * &information.inverse;
        let to_shift = information.to_shift(block, &spread)?;
        let shifts = &to_shift * &block.scores;
        let b = shifts.nrows();
        let shift = Mat::from_fn(b, 1, |k, _| shifts.row(k).iter().sum::<f64>());
        self.matrix += &shift * shift.transpose();
        let seen = &information.whole * &shifts;
        for (j, sum) in self.of_joints.iter_mut().enumerate() {
            *sum += dot(seen.col_as_slice(j), shifts.col_as_slice(j));
        }
        // independent rows of variance 1 leave residuals with the covariance 1 - w (wᵀw)⁻¹ wᵀ; all factors
        // except the spread are symmetric, so columns serve as rows
        let own = &block.information * &to_shift;
        let fitted = &block.tapered * &to_shift;
        let taken = &information.inverse * &fitted;
        for k in 0..b {
            let own = dot(own.col_as_slice(k), to_shift.col_as_slice(k));
            let taken = dot(taken.col_as_slice(k), fitted.col_as_slice(k));
            self.expected[k] += own - taken;
            let part = dot(information.inverse.col_as_slice(k), spread.col_as_slice(k));
            self.parts[k] = [self.parts[k][0] + part, self.parts[k][1] + part * part];
        }
        Ok(())
    }

    /// Ratio of scatter to variance for independent rows, `[b]`.
    fn bias(&self, information: &BlockInformation) -> Vec<f64> {
        let bias = |(k, expected): (usize, &f64)| {
            let bias = expected / information.inverse[(k, k)];
            if bias > 0.0 && bias.is_finite() { bias } else { 1.0 }
        };
        self.expected.iter().enumerate().map(bias).collect()
    }

    fn freedom(&self) -> Vec<f64> {
        self.parts.iter().map(|[sum, squares]| (OWN_SHARE * sum * sum / squares - 1.0).max(1.0)).collect()
    }
}

/// Sums over all rows of one joint.
struct JointSums {
    /// `wᵀw` without weights, `[b x b]`.
    plain: Mat<f64>,
    /// Sum of squared weighted residuals.
    squares: f64,
    rows: usize,
}

impl JointSums {
    /// Trace of the variance of this joint's part of the estimate in units of the information, for independent
    /// residuals.
    fn variance_if_independent(&self, information: &BlockInformation) -> f64 {
        let b = self.plain.ncols();
        let trace: f64 = (0..b).map(|k| -> f64 { self.plain.row(k) * information.inverse.col(k) }).sum();
        self.squares / self.rows.max(1) as f64 * trace
    }
}

/// Sums of one pass over the rows.
struct BlockSums {
    /// Blocks with rows, by number.
    blocks: BTreeMap<usize, RowBlock>,
    joints: Vec<JointSums>,
    rows: usize,
}

impl BlockSums {
    /// Adds up all rows. Block `k` rises over the half `k - 1` of the record and falls over the half `k`. The squared
    /// tapers of a row in its two blocks add up to one.
    fn over(source: &dyn RowSource, theta: &[f64], rule: &WeightRule, half_rows: usize) -> Self {
        let (n, b) = (source.joint_count(), source.columns());
        let joint = || JointSums { plain: Mat::zeros(b, b), squares: 0.0, rows: 0 };
        let mut sums = Self { blocks: BTreeMap::new(), joints: (0..n).map(|_| joint()).collect(), rows: 0 };
        let mut open: Vec<HalfBlockRows> = (0..n).map(|_| HalfBlockRows::default()).collect();
        let (mut current, mut first) = (0, None);
        source.each(&mut |sample| {
            let at = sample.row - *first.get_or_insert(sample.row);
            if at / half_rows != current {
                sums.close(&mut open, current);
                current = at / half_rows;
            }
            let rise = FRAC_PI_2 * ((at % half_rows) as f64 + 0.5) / half_rows as f64;
            for (j, rows) in open.iter_mut().enumerate().filter(|(j, _)| sample.used[*j]) {
                let e = sample.residual(j, theta);
                rows.w.extend_from_slice(sample.of_joint(j));
                rows.slopes.push(rule.slope(j, e));
                rows.weighted.push(rule.weight(j, e) * e);
                rows.tapers.push([rise.cos(), rise.sin()]);
            }
        });
        sums.close(&mut open, current);
        sums.complete();
        sums
    }

    /// Adds up and clears the rows of a half block.
    fn close(&mut self, open: &mut [HalfBlockRows], half: usize) {
        let rows: usize = open.iter().map(|rows| rows.weighted.len()).sum();
        if rows == 0 {
            return;
        }
        self.rows += rows;
        let (n, b) = (open.len(), self.joints.first().map_or(0, |joint| joint.plain.ncols()));
        for (j, (rows, joint)) in open.iter_mut().zip(&mut self.joints).enumerate() {
            if rows.weighted.is_empty() {
                continue;
            }
            let grams = Grams::of(rows, b);
            joint.add(rows, &grams);
            for side in 0..2 {
                let empty = || RowBlock {
                    information: Mat::zeros(b, b),
                    tapered: Mat::zeros(b, b),
                    scores: Mat::zeros(b, n),
                };
                self.blocks.entry(half + side).or_insert_with(empty).add(j, rows, side, &grams);
            }
            rows.clear();
        }
    }

    /// Fills the upper triangles of all sums from the lower ones.
    fn complete(&mut self) {
        self.blocks.values_mut().flat_map(|of| [&mut of.information, &mut of.tapered]).for_each(mirror);
        self.joints.iter_mut().for_each(|of| mirror(&mut of.plain));
    }
}

/// Makes a matrix symmetric from its lower triangle.
fn mirror(matrix: &mut Mat<f64>) {
    for k in 0..matrix.ncols() {
        for i in k + 1..matrix.nrows() {
            matrix[(k, i)] = matrix[(i, k)];
        }
    }
}

/// Rows of one joint in half a block.
#[derive(Default)]
struct HalfBlockRows {
    /// Entries of `w`, row by row.
    w: Vec<f64>,
    /// Weight of each row in the information.
    slopes: Vec<f64>,
    /// Residuals times their weights.
    weighted: Vec<f64>,
    /// Taper of each row in the falling and in the rising block.
    tapers: Vec<[f64; 2]>,
}

impl HalfBlockRows {
    /// Clears the rows and keeps their memory.
    fn clear(&mut self) {
        self.w.clear();
        self.slopes.clear();
        self.weighted.clear();
        self.tapers.clear();
    }

    /// Slope of all rows, if they have the same: true for least squares, not for robust estimates.
    fn common_slope(&self) -> Option<f64> {
        let first = *self.slopes.first()?;
        (first > 0.0 && self.slopes.iter().all(|slope| (slope - first).abs() <= 0.0)).then_some(first)
    }

    /// Columns that are not zero (a joint depends on its link and the outer links), and `w` of these,
    /// `[rows x columns]`.
    fn felt(&self, b: usize) -> (Vec<usize>, Mat<f64>) {
        let column = |k: usize| self.w[k..].iter().step_by(b);
        let columns: Vec<usize> = (0..b).filter(|&k| column(k).any(|w| *w != 0.0)).collect();
        let mut w = Mat::zeros(self.weighted.len(), columns.len());
        for (place, &k) in columns.iter().enumerate() {
            w.col_as_slice_mut(place).iter_mut().zip(column(k)).for_each(|(to, from)| *to = *from);
        }
        (columns, w)
    }
}

/// Sums of squares and products of the rows of one joint in half a block, over its `k` columns that are not zero.
struct Grams {
    /// Indices of these columns, ascending.
    columns: Vec<usize>,
    /// `[rows x k]`.
    w: Mat<f64>,
    /// `wᵀ diag(weights) w` for several weights side by side, `[k x parts k]`: information and taper of the falling
    /// block, the same of the rising one, and the unweighted product unless it follows from these.
    all: Mat<f64>,
    /// Slope of all rows, if they have the same.
    common_slope: Option<f64>,
}

impl Grams {
    /// Uses one product, which takes half the time of several small ones.
    fn of(rows: &HalfBlockRows, b: usize) -> Self {
        let (columns, w) = rows.felt(b);
        let common_slope = rows.common_slope();
        let mut weights: Vec<Vec<f64>> = Vec::new();
        for side in 0..2 {
            let of_taper = |power: i32| {
                let weight = |(taper, slope): (&[f64; 2], &f64)| taper[side].powi(power) * slope;
                rows.tapers.iter().zip(&rows.slopes).map(weight).collect()
            };
            weights.extend([of_taper(2), of_taper(1)]);
        }
        if common_slope.is_none() {
            weights.push(vec![1.0; w.nrows()]);
        }
        let k = columns.len();
        let mut counted = Mat::zeros(w.nrows(), weights.len() * k);
        for (part, weights) in weights.iter().enumerate() {
            for column in 0..k {
                let counted = counted.col_as_slice_mut(part * k + column).iter_mut();
                let of = w.col_as_slice(column).iter().zip(weights);
                counted.zip(of).for_each(|(counted, (w, weight))| *counted = w * weight);
            }
        }
        Self { all: w.transpose() * counted, columns, w, common_slope }
    }

    /// Column `k` of a part.
    fn column(&self, part: usize, k: usize) -> &[f64] {
        self.all.col_as_slice(part * self.columns.len() + k)
    }
}

/// Adds the rows from `k` on of a part's column to a column of a sum, below the diagonal.
fn add_below(sum: &mut [f64], column: &[f64], rows: &[usize], k: usize) {
    for (&row, value) in rows[k..].iter().zip(&column[k..]) {
        sum[row] += value;
    }
}

impl JointSums {
    fn add(&mut self, rows: &HalfBlockRows, grams: &Grams) {
        self.rows += rows.weighted.len();
        self.squares += dot(&rows.weighted, &rows.weighted);
        for (k, &column) in grams.columns.iter().enumerate() {
            let sum = self.plain.col_as_slice_mut(column);
            match grams.common_slope {
                // the squares of the two tapers add up to one
                Some(slope) => {
                    let (falling, rising) = (grams.column(0, k), grams.column(2, k));
                    for (&row, i) in grams.columns.iter().zip(0..).skip(k) {
                        sum[row] += (falling[i] + rising[i]) / slope;
                    }
                }
                None => add_below(sum, grams.column(4, k), &grams.columns, k),
            }
        }
    }
}

impl RowBlock {
    fn add(&mut self, j: usize, rows: &HalfBlockRows, side: usize, grams: &Grams) {
        let tapered: Vec<f64> = rows.tapers.iter().zip(&rows.weighted).map(|(h, e)| h[side] * e).collect();
        for (k, &column) in grams.columns.iter().enumerate() {
            let information = self.information.col_as_slice_mut(column);
            add_below(information, grams.column(2 * side, k), &grams.columns, k);
            add_below(
                self.tapered.col_as_slice_mut(column),
                grams.column(2 * side + 1, k),
                &grams.columns,
                k,
            );
            self.scores[(column, j)] += dot(grams.w.col_as_slice(k), &tapered);
        }
    }
}

/// `wᵀw` of all rows, with the means to leave a block out.
struct BlockInformation {
    whole: Mat<f64>,
    inverse: Mat<f64>,
}

impl BlockInformation {
    fn of(sums: &BlockSums) -> Result<Self, NumericsError> {
        let b = sums.joints.first().map_or(0, |joint| joint.plain.ncols());
        let mut whole = Mat::<f64>::zeros(b, b);
        sums.blocks.values().for_each(|block| whole += &block.information);
        // columns of equal length, because a small one would be lost next to a large one
        let norms: Vec<f64> = (0..b).map(|k| whole[(k, k)].sqrt()).collect();
        let scaled = Mat::from_fn(b, b, |i, k| whole[(i, k)] / (norms[i] * norms[k]));
        let singular = |_| NumericsError::NotFinite("the observation matrix");
        let inverse = scaled.llt(Side::Lower).map_err(singular)?.solve(Mat::<f64>::identity(b, b));
        let inverse = Mat::from_fn(b, b, |i, k| inverse[(i, k)] / (norms[i] * norms[k]));
        match inverse.is_all_finite() {
            true => Ok(Self { whole, inverse }),
            false => Err(NumericsError::NotFinite("the observation matrix")),
        }
    }

    /// Matrix from scores of a block to shifts of the estimate without it, `[b x b]`, symmetric: the jackknife, which
    /// leaves out each block in turn (CR3). `spread` is the block's information times the inverse.
    fn to_shift(&self, block: &RowBlock, spread: &Mat<f64>) -> Result<Mat<f64>, NumericsError> {
        match self.left_out(block, spread) {
            Some(without) => Ok(without.inverse()),
            None => self.by_leverage(block),
        }
    }

    /// Information of all rows except the block's; `None` if the block has too much leverage.
    fn left_out(&self, block: &RowBlock, spread: &Mat<f64>) -> Option<Llt<f64>> {
        // the leverages are the eigenvalues of the spread: if the sum of their squares is small, each is small
        let b = spread.nrows();
        let squares: f64 = (0..b).flat_map(|k| (0..b).map(move |i| spread[(i, k)] * spread[(k, i)])).sum();
        if squares.is_nan() || squares >= MAX_LEVERAGE * MAX_LEVERAGE {
            let clear = Scale(MAX_LEVERAGE) * &self.whole - &block.information;
            clear.llt(Side::Lower).ok()?;
        }
        (&self.whole - &block.information).llt(Side::Lower).ok()
    }

    /// `(1 - h)⁻¹` by the leverages `h`: the eigenvalues of the block's information in coordinates that make all
    /// information the identity.
    fn by_leverage(&self, block: &RowBlock) -> Result<Mat<f64>, NumericsError> {
        let b = self.whole.nrows();
        let unclear = |_| NumericsError::NotFinite("the leverage of a block");
        let eigen = self.inverse.self_adjoint_eigen(Side::Lower).map_err(unclear)?;
        let roots = eigen.S().column_vector();
        let root = Mat::from_fn(b, b, |i, k| eigen.U()[(i, k)] * roots[k].max(0.0).sqrt());
        let leverage = root.transpose() * &block.information * &root;
        let unclear = |_| NumericsError::NotFinite("the leverage of a block");
        let eigen = leverage.self_adjoint_eigen(Side::Lower).map_err(unclear)?;
        let values = eigen.S().column_vector();
        let turned = root * eigen.U();
        let scaled =
            Mat::from_fn(b, b, |i, k| turned[(i, k)] * (1.0 - values[k].clamp(0.0, MAX_LEVERAGE)).recip());
        Ok(scaled * turned.transpose())
    }
}
