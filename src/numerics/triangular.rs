//! A growing triangular factor: the memory of a least-squares problem that is never held whole.
//!
//! For an observation matrix `w` and a right-hand side `tau`, the factor `r` of
//! `[w | tau] = q r` holds all that least squares needs: `r = [r11 r12; 0 r22]` gives
//! `theta = r11⁻¹ r12`, the residual sum of squares `r22²`, and the singular values of `w`.
//! New rows are folded in by factoring `[r; rows]` again (Golub & Van Loan, Matrix Computations,
//! 6.5; the sequential form of TSQR, Demmel et al. 2012).

use faer::{Mat, MatRef, Par};

use super::NumericsError;

/// Rows folded in at a time: enough to amortise copying the factor, little enough for the cache.
pub const BLOCK_ROWS: usize = 1536;

/// Triangular factor of all rows of `[w | tau]` seen so far; `(b+1) x (b+1)`.
#[derive(Debug, Clone)]
pub struct TriangularFactor {
    r: Mat<f64>,
    rows: usize,
}

/// Solution of a least-squares problem.
#[derive(Debug, Clone, PartialEq)]
pub struct LeastSquares {
    /// Solution `theta`, `[b]`.
    pub theta: Vec<f64>,
    /// Diagonal of `(wᵀw)⁻¹`, `[b]`: times the residual variance, the squared standard errors.
    pub unscaled_variance: Vec<f64>,
    /// Sum of squared residuals.
    pub residual_sum_of_squares: f64,
    /// Condition number of `w`.
    pub condition_number: f64,
    /// Condition number after scaling the columns of `w` to unit norm.
    pub scaled_condition_number: f64,
    /// Rows of `w`.
    pub rows: usize,
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

    /// The factor `r` itself, upper triangular `[(b+1) x (b+1)]`; its last column belongs to `tau`.
    #[must_use]
    pub fn upper(&self) -> MatRef<'_, f64> {
        self.r.as_ref()
    }

    /// Folds in `block`, rows of `[w | tau]`, `[any x (b+1)]`.
    pub fn fold(&mut self, block: MatRef<'_, f64>) {
        let k = self.r.ncols();
        let mut stacked = Mat::zeros(k + block.nrows(), k);
        stacked.as_mut().subrows_mut(0, k).copy_from(self.r.as_ref());
        stacked.as_mut().subrows_mut(k, block.nrows()).copy_from(block);
        let qr = stacked.qr();
        let upper = qr.thin_R();
        self.r = Mat::from_fn(k, k, |i, j| if i <= j { upper[(i, j)] } else { 0.0 });
        self.rows += block.nrows();
    }

    /// Joins the rows of `other`, as if they had been folded in here.
    pub fn join(&mut self, other: &Self) {
        let rows = self.rows + other.rows;
        self.fold(other.r.as_ref());
        self.rows = rows;
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
        let unseen: Vec<usize> = (0..b).filter(|&j| !(norms[j] > 0.0 && norms[j].is_finite())).collect();
        if !unseen.is_empty() {
            return Err(rank_deficient(&unseen, b, names));
        }
        let scaled = Mat::from_fn(b, b, |i, j| r11[(i, j)] / norms[j]);
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

fn solve_upper(upper: MatRef<'_, f64>, right: &mut Mat<f64>) {
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(upper, right.as_mut(), Par::Seq);
}

/// Columns that lead the singular vectors of too small singular values.
fn weak_columns(v: MatRef<'_, f64>, s: &[f64], floor: f64) -> Vec<usize> {
    let mut weak: Vec<usize> = s
        .iter()
        .enumerate()
        .filter(|(_, value)| !(**value > floor))
        .filter_map(|(k, _)| (0..v.nrows()).max_by(|&a, &b| v[(a, k)].abs().total_cmp(&v[(b, k)].abs())))
        .collect();
    weak.sort_unstable();
    weak.dedup();
    weak
}

fn rank_deficient(columns: &[usize], of: usize, names: impl Fn(usize) -> String) -> NumericsError {
    /// Enough to see which joint is meant; the whole list would drown the sentence.
    const NAMED: usize = 6;
    let mut listed: Vec<String> = columns.iter().take(NAMED).map(|&c| names(c)).collect();
    if columns.len() > NAMED {
        listed.push("...".into());
    }
    NumericsError::RankDeficient { count: columns.len(), columns: of, names: listed.join(", ") }
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
            for i in 0..4 {
                assert!((solved.theta[i] - expected[i]).abs() < ROUNDING * expected[i].abs());
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
    fn a_column_that_repeats_another_is_named() {
        let all = Mat::from_fn(500, 4, |i, j| match j {
            2 => 2.0 * value(i, 0) - value(i, 1),
            3 => 1.0,
            _ => value(i, j),
        });
        let mut factor = TriangularFactor::new(3);
        factor.fold(all.as_ref());
        let error = factor.solve(1e8, |i| format!("p{i}")).expect_err("rank two of three");
        assert!(matches!(error, NumericsError::RankDeficient { columns: 3, .. }), "{error}");
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
