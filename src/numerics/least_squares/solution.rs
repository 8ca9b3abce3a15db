//! The solution of a least-squares problem, and what is said where there is none.

use faer::{Mat, MatRef};

use crate::numerics::NumericsError;

/// Largest scaled condition number that still gives parameters. Torque noise enters parameters
/// multiplied by it; at a thousand, one percent of noise is ten times the parameter. The thesis's
/// excitation has 9.1.
pub const MAX_SCALED_CONDITION: f64 = 1e3;

/// Largest scaled condition number of weighted rows. Whether the motion shows every parameter is judged on the rows as
/// they are ([`MAX_SCALED_CONDITION`]); this bounds what rounding does, and leaves joints whose noise differs ten
/// thousandfold their weights.
pub const MAX_WEIGHTED_CONDITION: f64 = 1e8;

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

/// As many columns as there are too small singular values: in turn the one that has most part in the
/// singular vectors of these and is least explained by those taken before it.
pub(super) fn weak_columns(v: MatRef<'_, f64>, s: &[f64], floor: f64) -> Vec<usize> {
    let small: Vec<usize> = (0..s.len()).filter(|&k| s[k].is_nan() || s[k] <= floor).collect();
    // parts of the columns in what cannot be seen, [b x small]
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

pub(super) fn rank_deficient(columns: &[usize], of: usize, names: impl Fn(usize) -> String) -> NumericsError {
    /// Enough to see which joint is meant; the whole list would drown the sentence.
    const NAMED: usize = 12;
    let mut listed: Vec<String> = columns.iter().take(NAMED).map(|&c| names(c)).collect();
    if columns.len() > NAMED {
        listed.push("...".into());
    }
    NumericsError::RankDeficient { count: columns.len(), columns: of, names: listed.join(", ") }
}
