//! Solution of a least-squares problem, and the error if there is none.

use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, MatRef, Par};

use super::factor::TriangularFactor;
use crate::NumericsError;

/// Largest scaled condition number that still gives parameters. It multiplies torque noise in the parameters: at a
/// thousand, one percent of noise is ten times the parameter. The thesis's excitation has 9.1.
pub const MAX_SCALED_CONDITION: f64 = 1e3;

/// Largest scaled condition number of weighted rows. The unweighted rows determine if the motion shows every parameter
/// ([`MAX_SCALED_CONDITION`]). This limit bounds rounding, and allows the weights of joints whose noise differs by a
/// factor of ten thousand.
pub(crate) const MAX_WEIGHTED_CONDITION: f64 = 1e8;

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
    /// Number of rows of `w`.
    pub rows: usize,
}

/// Solution of a least-squares problem whose condition number is known only to be small enough.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundedSolution {
    /// Solution `theta`, `[b]`.
    pub theta: Vec<f64>,
    /// Diagonal of `(wᵀw)⁻¹`, `[b]`.
    pub unscaled_variance: Vec<f64>,
}

impl TriangularFactor {
    /// Solves `min |w theta - tau|` with the columns scaled to unit norm [2.10-2.16].
    ///
    /// # Errors
    /// [`NumericsError::RankDeficient`] if the scaled condition number exceeds `max_condition`, with the name
    /// `names(i)` of each weak column `i`; [`NumericsError::TooShort`] with fewer rows than columns.
    pub fn solve(
        &self,
        max_condition: f64,
        names: impl Fn(usize) -> String,
    ) -> Result<LeastSquares, NumericsError> {
        let b = self.columns();
        let columns = ScaledColumns::of(self)?;
        let unclear = |_| NumericsError::NotFinite("the singular values");
        let s = columns.scaled.singular_values().map_err(unclear)?;
        let (largest, smallest) = (s[0], s[b - 1]);
        if !(smallest > 0.0 && largest / smallest <= max_condition) {
            let svd = columns.scaled.svd().map_err(|_| NumericsError::NotFinite("the singular values"))?;
            let weak = weak_columns(svd.V(), &s, largest / max_condition);
            return Err(rank_deficient(&weak, b, names));
        }
        let raw = self.upper().submatrix(0, 0, b, b).singular_values().map_err(unclear)?;
        let BoundedSolution { theta, unscaled_variance } = columns.solution(&columns.inverse());
        let rest = self.upper()[(b, b)];
        Ok(LeastSquares {
            theta,
            unscaled_variance,
            residual_sum_of_squares: rest * rest,
            condition_number: raw[0] / raw[b - 1],
            scaled_condition_number: largest / smallest,
            rows: self.rows(),
        })
    }

    /// Same as [`TriangularFactor::solve`], without the condition numbers, which take most of its time. Singular values
    /// are computed only if the norms of the scaled columns and of their inverse do not prove that the condition number
    /// is at most `max_condition`. Their product is an upper bound of it.
    ///
    /// # Errors
    /// Those of [`TriangularFactor::solve`].
    pub fn solve_bounded(
        &self,
        max_condition: f64,
        names: impl Fn(usize) -> String,
    ) -> Result<BoundedSolution, NumericsError> {
        let columns = ScaledColumns::of(self)?;
        let inverse = columns.inverse();
        if columns.scaled.norm_l2() * inverse.norm_l2() <= max_condition {
            return Ok(columns.solution(&inverse));
        }
        let LeastSquares { theta, unscaled_variance, .. } = self.solve(max_condition, names)?;
        Ok(BoundedSolution { theta, unscaled_variance })
    }
}

/// Columns of a triangular factor, scaled to length one.
struct ScaledColumns<'a> {
    factor: &'a TriangularFactor,
    /// Lengths, `[b]`.
    norms: Vec<f64>,
    /// `[b x b]`; a zero column remains zero, and its singular value is zero.
    scaled: Mat<f64>,
}

impl<'a> ScaledColumns<'a> {
    fn of(factor: &'a TriangularFactor) -> Result<Self, NumericsError> {
        let b = factor.columns();
        if factor.rows() <= b {
            let (what, rows) = ("the observation matrix", factor.rows());
            return Err(NumericsError::TooShort { what, rows, needed: b + 1 });
        }
        let r11 = factor.upper().submatrix(0, 0, b, b);
        let norms: Vec<f64> = (0..b).map(|j| r11.col(j).norm_l2()).collect();
        if norms.iter().any(|norm| !norm.is_finite()) {
            return Err(NumericsError::NotFinite("the observation matrix"));
        }
        let scaled = Mat::from_fn(b, b, |i, j| if norms[j] > 0.0 { r11[(i, j)] / norms[j] } else { 0.0 });
        Ok(Self { factor, norms, scaled })
    }

    /// Inverse of the scaled columns, `[b x b]`; not finite if they are dependent.
    fn inverse(&self) -> Mat<f64> {
        let b = self.norms.len();
        let mut inverse = Mat::<f64>::identity(b, b);
        solve_upper_triangular_in_place(self.scaled.as_ref(), inverse.as_mut(), Par::Seq);
        inverse
    }

    fn solution(&self, inverse: &Mat<f64>) -> BoundedSolution {
        let (b, norms) = (self.norms.len(), &self.norms);
        let mut theta = Mat::from_fn(b, 1, |i, _| self.factor.upper()[(i, b)]);
        solve_upper_triangular_in_place(self.scaled.as_ref(), theta.as_mut(), Par::Seq);
        let squares = |i: usize| inverse.row(i).iter().map(|v| v * v).sum::<f64>();
        BoundedSolution {
            theta: (0..b).map(|i| theta[(i, 0)] / norms[i]).collect(),
            unscaled_variance: (0..b).map(|i| squares(i) / (norms[i] * norms[i])).collect(),
        }
    }
}

/// Columns that cannot be solved for, one per singular value that is too small: in turn the column with the largest
/// part in the singular vectors of these that the previous ones do not explain.
fn weak_columns(v: MatRef<'_, f64>, s: &[f64], floor: f64) -> Vec<usize> {
    let small: Vec<usize> = (0..s.len()).filter(|&k| s[k].is_nan() || s[k] <= floor).collect();
    // parts of the columns in the invisible directions, [b x small]
    let mut part = Mat::from_fn(v.nrows(), small.len(), |i, k| v[(i, small[k])]);
    let mut weak = Vec::new();
    for _ in &small {
        let Some(next) = (0..part.nrows())
            .filter(|column| !weak.contains(column))
            .max_by(|&a, &b| part.row(a).norm_l2().total_cmp(&part.row(b).norm_l2()))
        else {
            break;
        };
        let along = part.row(next).to_owned();
        let length = along.squared_norm_l2();
        if length > 0.0 {
            let taken = &part * along.transpose() * along / length;
            part -= taken;
        }
        weak.push(next);
    }
    weak.sort_unstable();
    weak
}

fn rank_deficient(columns: &[usize], of: usize, names: impl Fn(usize) -> String) -> NumericsError {
    /// Number of columns in the message: enough to show the joint; the whole list would be too long.
    const NAMED: usize = 12;
    let mut listed: Vec<String> = columns.iter().take(NAMED).map(|&c| names(c)).collect();
    if columns.len() > NAMED {
        listed.push("...".into());
    }
    NumericsError::RankDeficient { count: columns.len(), columns: of, names: listed.join(", ") }
}
