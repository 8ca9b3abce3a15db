//! A growing triangular factor: the memory of a least-squares problem that is never held whole.
//!
//! For an observation matrix `w` and a right-hand side `tau`, the factor `r` of
//! `[w | tau] = q r` holds all that least squares needs: `r = [r11 r12; 0 r22]` gives
//! `theta = r11⁻¹ r12`, the residual sum of squares `r22²`, and the singular values of `w`.
//! New rows are folded in by factoring `[r; rows]` again (Golub & Van Loan, Matrix Computations,
//! 6.5; the sequential form of TSQR, Demmel et al. 2012).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch};
use faer::{Mat, MatMut, MatRef, Par};

use crate::numerics::NumericsError;
use crate::numerics::least_squares::solution::{LeastSquares, rank_deficient, weak_columns};

/// A column shorter than this, relative to the longest, shows nothing: it is zero but for rounding.
pub const ZERO_COLUMN_THRESHOLD: f64 = 1e-12;

/// Rows that a [`FactorBuilder`] collects before it folds them: enough to make factoring the triangle
/// above them a small part of the work, little enough to stay in a core's cache with forty columns (0.7 MB).
pub const BLOCK_ROWS: usize = 2048;

/// Columns that a reflection block of the QR takes at once. A factor is some forty columns wide:
/// wider blocks spend more on building the block than its product saves.
const REFLECTOR_BLOCK: usize = 8;

/// Triangular factor of all rows of `[w | tau]` seen so far; `(b+1) x (b+1)`.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangularFactor {
    r: Mat<f64>,
    rows: usize,
}

impl TriangularFactor {
    /// Factor of no rows for `columns` columns of `w`.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self { r: Mat::zeros(columns + 1, columns + 1), rows: 0 }
    }

    /// Columns `b` of `w`, without the right-hand side.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.r.ncols() - 1
    }

    /// Rows folded in so far.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The factor, upper triangular, `[(b+1) x (b+1)]`; the last column is that of the torque.
    #[must_use]
    pub fn upper(&self) -> MatRef<'_, f64> {
        self.r.as_ref()
    }

    /// The upper triangle column after column, `r[0,0], r[0,1], r[1,1], r[0,2]..`:
    /// `(b+1) (b+2) / 2` numbers, all that [`TriangularFactor::from_packed`] needs beside the rows.
    #[must_use]
    pub fn packed(&self) -> Vec<f64> {
        (0..self.r.ncols()).flat_map(|j| (0..=j).map(move |i| self.r[(i, j)])).collect()
    }

    /// A factor from what [`TriangularFactor::packed`] gave.
    ///
    /// # Errors
    /// [`NumericsError::NotATriangle`] if there are not `(b+1) (b+2) / 2` numbers,
    /// [`NumericsError::NotFinite`] if one is not finite.
    pub fn from_packed(columns: usize, rows: usize, packed: &[f64]) -> Result<Self, NumericsError> {
        let k = columns + 1;
        if packed.len() != k * (k + 1) / 2 {
            return Err(NumericsError::NotATriangle { numbers: packed.len(), columns });
        }
        if !packed.iter().all(|x| x.is_finite()) {
            return Err(NumericsError::NotFinite("a triangular factor"));
        }
        let r = Mat::from_fn(k, k, |i, j| if i <= j { packed[j * (j + 1) / 2 + i] } else { 0.0 });
        Ok(Self { r, rows })
    }

    /// Whether every number of the factor is finite; that of rows with an absurd value is not.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.r.is_all_finite()
    }

    /// Sum of squares of `w theta - tau` over all rows, for any `theta` `[b]`: reflections keep
    /// lengths, so it is that of `r [theta; -1]`.
    ///
    /// # Panics
    /// If `theta` has fewer than `b` entries.
    #[must_use]
    pub fn residual_sum_of_squares(&self, theta: &[f64]) -> f64 {
        let b = self.columns();
        (0..=b)
            .map(|i| {
                let estimated: f64 = (i..b).map(|j| self.r[(i, j)] * theta[j]).sum();
                (estimated - self.r[(i, b)]).powi(2)
            })
            .sum()
    }

    /// `r11⁻¹` of the columns of `w`, upper triangular, `[b x b]`: with it `(wᵀw)⁻¹ = r11⁻¹ r11⁻ᵀ`.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] where the columns are dependent.
    pub fn inverse_of_upper(&self) -> Result<Mat<f64>, NumericsError> {
        let b = self.columns();
        let mut inverse = Mat::<f64>::identity(b, b);
        let r11 = self.r.as_ref().submatrix(0, 0, b, b);
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(
            r11,
            inverse.as_mut(),
            faer::Par::Seq,
        );
        if inverse.is_all_finite() {
            Ok(inverse)
        } else {
            Err(NumericsError::NotFinite("the observation matrix"))
        }
    }

    /// Sum of squares of `tau` over all rows.
    #[must_use]
    pub fn torque_sum_of_squares(&self) -> f64 {
        self.r.col(self.columns()).iter().map(|x| x * x).sum()
    }

    /// Folds in `block`, rows of `[w | tau]`, `[any x (b+1)]`.
    pub fn fold(&mut self, block: MatRef<'_, f64>) {
        let k = self.r.ncols();
        let mut stacked = Mat::zeros(k + block.nrows(), k);
        stacked.as_mut().subrows_mut(0, k).copy_from(self.r.as_ref());
        stacked.as_mut().subrows_mut(k, block.nrows()).copy_from(block);
        QrScratch::new(k).triangularise(stacked.as_mut());
        self.r = stacked.as_ref().subrows(0, k).to_owned();
        self.rows += block.nrows();
    }

    /// Joins the rows of `other`, as if they had been folded in here.
    pub fn join(&mut self, other: &Self) {
        let rows = self.rows + other.rows;
        self.fold(other.r.as_ref());
        self.rows = rows;
    }

    /// The factor of the same rows, each multiplied by `by`: its square is the weight of their squares.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Self {
        Self { r: &self.r * faer::Scale(by), rows: self.rows }
    }

    /// The factor of the same rows with only the columns `kept` of `w`, in that order.
    ///
    /// # Panics
    /// If `kept` names a column that there is not.
    #[must_use]
    pub fn restricted(&self, kept: &[usize]) -> Self {
        self.selected(kept, self.columns())
    }

    /// The same with the column `right` of `[w | tau]` in place of the torque.
    ///
    /// # Panics
    /// If a column is named that there is not.
    #[must_use]
    pub fn selected(&self, kept: &[usize], right: usize) -> Self {
        let columns: Vec<usize> = kept.iter().copied().chain([right]).collect();
        let mut own = Self::new(kept.len());
        own.fold(Mat::from_fn(self.r.nrows(), columns.len(), |i, k| self.r[(i, columns[k])]).as_ref());
        own.rows = self.rows;
        own
    }

    /// The factor of several together, each with its columns at `places` of a wider `w` with `columns`
    /// columns that are zero elsewhere. So the rows of single joints make up the stacked problem
    /// [3.22].
    ///
    /// # Panics
    /// If `places` of a part has fewer entries than the part columns, or one beyond `columns`.
    #[must_use]
    pub fn embedded<'a>(columns: usize, parts: impl IntoIterator<Item = (&'a Self, &'a [usize])>) -> Self {
        let mut folder = FactorBuilder::new(columns);
        let mut rows = 0;
        for (part, places) in parts {
            let b = part.columns();
            for i in 0..=b {
                let place = |j: usize| if j < b { places[j] } else { columns };
                folder.push_at((i..=b).map(|j| (place(j), part.r[(i, j)])));
            }
            rows += part.rows;
        }
        let mut factor = folder.take();
        factor.rows = rows;
        factor
    }

    /// Solves `min |w theta - tau|` with the columns scaled to unit norm [2.10-2.16].
    ///
    /// # Errors
    /// `names(i)` names column `i` in [`NumericsError::RankDeficient`], given when the scaled
    /// condition number exceeds `max_condition`; [`NumericsError::TooShort`] with fewer rows than
    /// columns.
    pub fn solve(
        &self,
        max_condition: f64,
        names: impl Fn(usize) -> String,
    ) -> Result<LeastSquares, NumericsError> {
        let b = self.columns();
        if self.rows <= b {
            return Err(NumericsError::TooShort {
                what: "the observation matrix",
                rows: self.rows,
                needed: b + 1,
            });
        }
        let r11 = self.r.as_ref().submatrix(0, 0, b, b);
        let norms: Vec<f64> = (0..b).map(|j| r11.col(j).norm_l2()).collect();
        if norms.iter().any(|norm| !norm.is_finite()) {
            return Err(NumericsError::NotFinite("the observation matrix"));
        }
        // a column of zeros stays one, and its singular value is zero
        let scaled = Mat::from_fn(b, b, |i, j| if norms[j] > 0.0 { r11[(i, j)] / norms[j] } else { 0.0 });
        let svd = scaled.svd().map_err(|_| NumericsError::NotFinite("the singular values"))?;
        let s: Vec<f64> = svd.S().column_vector().iter().copied().collect();
        let (largest, smallest) = (s[0], s[b - 1]);
        if !(smallest > 0.0 && largest / smallest <= max_condition) {
            let weak = weak_columns(svd.V(), &s, largest / max_condition);
            return Err(rank_deficient(&weak, b, names));
        }
        let raw = r11.singular_values().map_err(|_| NumericsError::NotFinite("the singular values"))?;

        let mut theta = Mat::from_fn(b, 1, |i, _| self.r[(i, b)]);
        solve_upper(scaled.as_ref(), &mut theta);
        let mut inverse = Mat::<f64>::identity(b, b);
        solve_upper(scaled.as_ref(), &mut inverse);
        Ok(LeastSquares {
            theta: (0..b).map(|i| theta[(i, 0)] / norms[i]).collect(),
            unscaled_variance: (0..b)
                .map(|i| inverse.row(i).iter().map(|v| v * v).sum::<f64>() / (norms[i] * norms[i]))
                .collect(),
            residual_sum_of_squares: self.r[(b, b)] * self.r[(b, b)],
            condition_number: raw[0] / raw[b - 1],
            scaled_condition_number: largest / smallest,
            rows: self.rows,
        })
    }
}

/// Takes rows of `[w | tau]` one by one and folds them, a block at a time, into a triangular factor.
/// The factor lies above the block in one piece of memory and is factored in place with it, so that
/// nothing is copied or allocated while rows come in.
pub struct FactorBuilder {
    /// Column-major, `height` rows a column: the factor, then the block.
    stacked: Vec<f64>,
    height: usize,
    width: usize,
    filled: usize,
    rows: usize,
    scratch: QrScratch,
}

impl FactorBuilder {
    /// Of no rows yet, for `columns` columns of `w`.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        let width = columns + 1;
        let height = odd_lines(width + BLOCK_ROWS);
        let stacked = vec![0.0; height * width];
        Self { stacked, height, width, filled: 0, rows: 0, scratch: QrScratch::new(width) }
    }

    /// Takes one row: its `b` entries of `w`, then its torque.
    ///
    /// # Panics
    /// If there are more than `b + 1` numbers; missing ones count as zero.
    #[inline]
    pub fn push(&mut self, row: impl Iterator<Item = f64>) {
        self.push_at(row.enumerate());
    }

    /// Takes one row by its places and numbers; all other places are zero, that of the torque is `b`.
    #[inline]
    fn push_at(&mut self, entries: impl Iterator<Item = (usize, f64)>) {
        let at = self.width + self.filled;
        for (column, value) in entries {
            self.stacked[column * self.height + at] = value;
        }
        self.filled += 1;
        self.rows += 1;
        if at + 1 == self.height {
            self.fold();
        }
    }

    /// The factor of all rows so far; the folder is empty afterwards and can be used again.
    #[must_use]
    pub fn take(&mut self) -> TriangularFactor {
        if self.filled > 0 {
            self.fold();
        }
        let (width, height) = (self.width, self.height);
        let r = Mat::from_fn(width, width, |i, j| self.stacked[j * height + i]);
        self.stacked.fill(0.0);
        TriangularFactor { r, rows: std::mem::take(&mut self.rows) }
    }

    fn fold(&mut self) {
        let rows = self.width + self.filled;
        let whole = MatMut::from_column_major_slice_mut(&mut self.stacked, self.height, self.width);
        self.scratch.triangularise(whole.subrows_mut(0, rows));
        for column in self.stacked.chunks_exact_mut(self.height) {
            column[self.width..].fill(0.0);
        }
        self.filled = 0;
    }
}

/// The next number of rows that makes a column an odd number of cache lines: with an even one, the
/// same row of all columns falls on few places of the cache.
fn odd_lines(rows: usize) -> usize {
    /// Numbers in a cache line of 64 bytes.
    const LINE: usize = 8;
    (rows.div_ceil(LINE) | 1) * LINE
}

/// Memory of a QR that is done again and again at one width.
struct QrScratch {
    reflectors: Mat<f64>,
    memory: MemBuffer,
}

impl QrScratch {
    fn new(width: usize) -> Self {
        let block = REFLECTOR_BLOCK.min(width);
        let needed = qr_in_place_scratch::<f64>(width, width, block, Par::Seq, Default::default());
        Self { reflectors: Mat::zeros(block, width), memory: MemBuffer::new(needed) }
    }

    /// Leaves the triangular factor of `stacked` in its upper triangle and zeros below it in the
    /// first rows; the rows after the triangle hold nothing of use. At least as many rows as columns.
    fn triangularise(&mut self, mut stacked: MatMut<'_, f64>) {
        let stack = MemStack::new(&mut self.memory);
        qr_in_place(stacked.as_mut(), self.reflectors.as_mut(), Par::Seq, stack, Default::default());
        for j in 0..stacked.ncols() {
            for i in j + 1..stacked.ncols() {
                stacked[(i, j)] = 0.0;
            }
        }
    }
}

fn solve_upper(upper: MatRef<'_, f64>, right: &mut Mat<f64>) {
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(upper, right.as_mut(), Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a QR of a few thousand rows.
    const ROUNDING: f64 = 1e-10;

    fn value(i: usize, j: usize) -> f64 {
        // badly scaled on purpose: columns differ by five decades
        let x = (i as f64) * 0.01;
        [x.sin(), (1.7 * x).cos(), x, 1.0][j] * decade(j)
    }

    fn decade(j: usize) -> f64 {
        10f64.powi(2 * i32::try_from(j).expect("small") - 3)
    }

    fn problem(rows: usize) -> Mat<f64> {
        let theta = [3.0, -2.0, 0.5, 7.0];
        Mat::from_fn(rows, 5, |i, j| {
            if j < 4 {
                value(i, j)
            } else {
                (0..4).map(|k| value(i, k) * theta[k] / decade(k)).sum::<f64>()
                    + 1e-3 * ((i * 7919 % 101) as f64 - 50.0)
            }
        })
    }

    /// The same problem by another road: normal equations of the columns brought to one scale.
    fn by_normal_equations(all: &Mat<f64>) -> Vec<f64> {
        use faer::linalg::solvers::Solve;
        let whole = Mat::from_fn(all.nrows(), 4, |i, j| all[(i, j)] / decade(j));
        let rhs = all.as_ref().subcols(4, 1);
        let normal = whole.transpose() * &whole;
        let solved = normal.llt(faer::Side::Lower).expect("positive definite").solve(whole.transpose() * rhs);
        (0..4).map(|j| solved[(j, 0)] / decade(j)).collect()
    }

    #[test]
    fn blocks_in_any_size_give_the_solution_of_the_whole() {
        let all = problem(5000);
        let expected = by_normal_equations(&all);
        for block in [1, 7, 100, 5000] {
            let mut factor = TriangularFactor::new(4);
            let mut at = 0;
            while at < 5000 {
                let n = block.min(5000 - at);
                factor.fold(all.as_ref().subrows(at, n));
                at += n;
            }
            let solved = factor.solve(1e8, |i| i.to_string()).expect("solves");
            for (found, expected) in solved.theta.iter().zip(&expected) {
                assert!((found - expected).abs() < ROUNDING * expected.abs());
            }
            let residual: f64 = (0..5000)
                .map(|i| ((0..4).map(|k| all[(i, k)] * solved.theta[k]).sum::<f64>() - all[(i, 4)]).powi(2))
                .sum();
            assert!((solved.residual_sum_of_squares - residual).abs() < ROUNDING * residual);
        }
    }

    #[test]
    fn joining_two_factors_equals_folding_all_rows() {
        let all = problem(2000);
        let mut one = TriangularFactor::new(4);
        one.fold(all.as_ref());
        let mut left = TriangularFactor::new(4);
        left.fold(all.as_ref().subrows(0, 700));
        let mut right = TriangularFactor::new(4);
        right.fold(all.as_ref().subrows(700, 1300));
        left.join(&right);
        assert_eq!(left.rows(), 2000);
        let (a, b) = (one.solve(1e8, |i| i.to_string()), left.solve(1e8, |i| i.to_string()));
        let (a, b) = (a.expect("solves"), b.expect("solves"));
        for i in 0..4 {
            assert!((a.theta[i] - b.theta[i]).abs() < ROUNDING * a.theta[i].abs());
        }
    }

    #[test]
    fn rows_pushed_one_by_one_make_the_factor_of_the_blocks() {
        let all = problem(5000);
        let mut expected = TriangularFactor::new(4);
        expected.fold(all.as_ref());
        let mut folder = FactorBuilder::new(4);
        for _twice in 0..2 {
            (0..5000).for_each(|i| folder.push((0..5).map(|j| all[(i, j)])));
            let found = folder.take();
            assert_eq!(found.rows(), 5000);
            // reflections leave the sign of a row open
            for (a, b) in found.packed().iter().zip(expected.packed()) {
                assert!((a.abs() - b.abs()).abs() < ROUNDING * all.norm_max() * 5000.0_f64.sqrt(), "{a} {b}");
            }
            let again = TriangularFactor::from_packed(4, 5000, &found.packed()).expect("a triangle");
            assert_eq!(again, found);
        }
        assert_eq!(folder.take(), TriangularFactor::new(4));
    }

    #[test]
    fn a_factor_gives_the_sums_of_squares_of_its_rows() {
        let all = problem(3000);
        let mut factor = TriangularFactor::new(4);
        factor.fold(all.as_ref());
        // any parameters, not only those that fit best
        for theta in [[0.0; 4], [100.0, -3.0, 0.25, 0.001]] {
            let deviation = |i: usize| (0..4).map(|k| all[(i, k)] * theta[k]).sum::<f64>() - all[(i, 4)];
            let expected: f64 = (0..3000).map(|i| deviation(i).powi(2)).sum();
            let found = factor.residual_sum_of_squares(&theta);
            assert!((found - expected).abs() < ROUNDING * expected, "{found} {expected}");
        }
        let measured: f64 = (0..3000).map(|i| all[(i, 4)].powi(2)).sum();
        assert!((factor.torque_sum_of_squares() - measured).abs() < ROUNDING * measured);
    }

    #[test]
    fn columns_that_are_zero_at_first_lose_nothing() {
        // the last columns come to life after the first block, as for a joint that rests at first
        let all = Mat::from_fn(3000, 5, |i, j| match j {
            0 if i < 2500 => 0.0,
            _ => problem_entry(i, j),
        });
        let mut factor = TriangularFactor::new(4);
        for at in [0, 3, 1000, 2000] {
            let end = [3, 1000, 2000, 3000].into_iter().find(|&end| end > at).expect("a block");
            factor.fold(all.as_ref().subrows(at, end - at));
        }
        let theta = [2.0 / decade(0), 1.0 / decade(1), -1.0 / decade(2), 3.0 / decade(3)];
        let deviation = |i: usize| (0..4).map(|k| all[(i, k)] * theta[k]).sum::<f64>() - all[(i, 4)];
        let expected: f64 = (0..3000).map(|i| deviation(i).powi(2)).sum();
        let found = factor.residual_sum_of_squares(&theta);
        assert!((found - expected).abs() < ROUNDING * expected, "{found} {expected}");
    }

    fn problem_entry(i: usize, j: usize) -> f64 {
        if j < 4 { value(i, j) } else { (i * 7919 % 101) as f64 - 50.0 }
    }

    #[test]
    fn what_is_no_triangle_is_refused() {
        assert!(matches!(
            TriangularFactor::from_packed(2, 10, &[1.0; 5]),
            Err(NumericsError::NotATriangle { numbers: 5, columns: 2 })
        ));
        let error = TriangularFactor::from_packed(1, 10, &[1.0, f64::NAN, 1.0]).expect_err("not finite");
        assert!(matches!(error, NumericsError::NotFinite(_)));
    }

    #[test]
    fn a_column_that_repeats_another_is_named() {
        let all = Mat::from_fn(500, 4, |i, j| match j {
            2 => 2.0 * value(i, 0) - value(i, 1),
            3 => 1.0,
            _ => value(i, j),
        });
        let mut factor = TriangularFactor::new(3);
        factor.fold(all.as_ref());
        let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank two of three");
        assert!(matches!(error, NumericsError::RankDeficient { count: 1, columns: 3, .. }), "{error}");
    }

    #[test]
    fn all_that_a_motion_hides_is_named_and_nothing_else() {
        // two columns of zeros, one that repeats another, and one that stands alone
        let all = Mat::from_fn(500, 6, |i, j| match j {
            1 | 3 => 0.0,
            4 => 3.0 * value(i, 0),
            _ => value(i, j.min(2)),
        });
        let mut factor = TriangularFactor::new(5);
        factor.fold(all.as_ref());
        let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank two of five");
        let NumericsError::RankDeficient { count, columns, names } = error else { panic!("{error}") };
        assert_eq!((count, columns), (3, 5));
        // of p0 and p4 either may stand for the pair
        assert!(["p0, p1, p3", "p1, p3, p4"].contains(&names.as_str()), "{names}");
    }

    #[test]
    fn a_column_of_zeros_is_named() {
        let all = Mat::from_fn(500, 3, |i, j| if j == 1 { 0.0 } else { value(i, j) });
        let mut factor = TriangularFactor::new(2);
        factor.fold(all.as_ref());
        let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank one of two");
        assert!(error.to_string().contains("p1"), "{error}");
    }
}
