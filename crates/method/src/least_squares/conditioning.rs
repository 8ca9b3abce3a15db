//! Information in a recorded motion: condition numbers, and the parameters that the motion does not distinguish.

use faer::Mat;

use super::factor::{TriangularFactor, ZERO_COLUMN_THRESHOLD};
use super::solution::MAX_SCALED_CONDITION;
use crate::NumericsError;

/// Largest standard error over value of a parameter without a flag; beyond it, the sign is uncertain. The customary
/// limit of essential parameters (Pham & Gautier 1991).
pub const FLAGGED_RELATIVE_ERROR: f64 = 0.3;

/// Smallest entry of a singular vector, relative to the leading one, of a column in the combination.
const PARTNER: f64 = 0.3;

/// Information about the columns of a factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Identifiability {
    /// Condition number of the observation matrix; infinite if a column is zero.
    pub condition_number: f64,
    /// Condition number with columns scaled to unit norm, without zero columns.
    pub scaled_condition_number: f64,
    /// Zero columns: their parameters never changed a torque.
    pub unseen: Vec<usize>,
    /// Columns that the motion does not distinguish from others, worst first.
    pub indistinct: Vec<Indistinct>,
}

/// Column that others explain except for one part in [`MAX_SCALED_CONDITION`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Indistinct {
    /// The column.
    pub column: usize,
    /// Columns that the motion does not distinguish from it.
    pub from: Vec<usize>,
}

impl Identifiability {
    /// Returns true if every column can be solved for.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.unseen.is_empty() && self.indistinct.is_empty()
    }
}

/// Examines the columns of a factor. First, zero columns are removed. Then, while the scaled condition number exceeds
/// [`MAX_SCALED_CONDITION`], the column with the largest entry in the singular vector of the smallest singular value is
/// removed.
///
/// # Errors
/// [`NumericsError::NotFinite`] if the singular values cannot be computed.
pub fn identifiability(factor: &TriangularFactor) -> Result<Identifiability, NumericsError> {
    let b = factor.columns();
    let r = factor.upper().submatrix(0, 0, b, b);
    let norms: Vec<f64> = (0..b).map(|k| r.col(k).norm_l2()).collect();
    let longest = norms.iter().copied().fold(0.0, f64::max);
    let (mut left, unseen): (Vec<usize>, Vec<usize>) =
        (0..b).partition(|&k| norms[k] > ZERO_COLUMN_THRESHOLD * longest);
    let raw = r.singular_values().map_err(|_| NumericsError::NotFinite("the singular values"))?;
    let mut found = Identifiability {
        condition_number: ratio(&raw),
        scaled_condition_number: 1.0,
        unseen,
        indistinct: Vec::new(),
    };
    if left.is_empty() {
        return Ok(found);
    }
    for round in 0.. {
        let scaled = Mat::from_fn(b, left.len(), |i, k| r[(i, left[k])] / norms[left[k]]);
        let svd = scaled.thin_svd().map_err(|_| NumericsError::NotFinite("the singular values"))?;
        let values: Vec<f64> = svd.S().column_vector().iter().copied().collect();
        let condition = ratio(&values);
        if round == 0 {
            found.scaled_condition_number = condition;
        }
        if condition <= MAX_SCALED_CONDITION || left.len() < 2 {
            break;
        }
        let last = svd.V().col(left.len() - 1);
        let size = |k: usize| last[k].abs();
        let Some(lead) = (0..left.len()).max_by(|&a, &b| size(a).total_cmp(&size(b))) else { break };
        let partner = |k: &usize| *k != lead && size(*k) >= PARTNER * size(lead);
        let from = (0..left.len()).filter(partner).map(|k| left[k]).collect();
        found.indistinct.push(Indistinct { column: left[lead], from });
        left.remove(lead);
    }
    Ok(found)
}

/// Largest part of an omitted column's torque that a column may carry while it still represents only its own parameter.
const CARRIED: f64 = 0.1;

/// Smallest share of all columns that a motion must show to count as excitation.
const LEAST_SHOWN: f64 = 0.75;

/// Columns that a motion shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShownColumns {
    /// Columns that can be solved for together, ascending.
    pub kept: Vec<usize>,
    /// For each of them, true if it represents only its own parameter, and no parts of omitted ones.
    pub alone: Vec<bool>,
}

/// Columns of a factor that its rows show, if they do not show all; `None` if they show too few for parameters. An
/// omitted column counts as zero, so related columns carry its torque. Its fit by the kept columns, all scaled to unit
/// norm, shows which ones.
///
/// # Errors
/// [`NumericsError::NotFinite`] if the singular values cannot be computed.
pub fn shown_columns(factor: &TriangularFactor) -> Result<Option<ShownColumns>, NumericsError> {
    let found = identifiability(factor)?;
    let indistinct: Vec<usize> = found.indistinct.iter().map(|of| of.column).collect();
    let is_kept = |k: &usize| !found.unseen.contains(k) && !indistinct.contains(k);
    let kept: Vec<usize> = (0..factor.columns()).filter(is_kept).collect();
    if (kept.len() as f64) < LEAST_SHOWN * factor.columns() as f64 || factor.rows() <= kept.len() {
        return Ok(None);
    }
    let norm = |k: usize| factor.upper().col(k).norm_l2();
    let mut alone = vec![true; kept.len()];
    for left_out in indistinct {
        let fit = factor.selected(&kept, left_out).solve_bounded(f64::INFINITY, |k| k.to_string())?;
        for ((alone, &k), coefficient) in alone.iter_mut().zip(&kept).zip(fit.theta) {
            *alone &= (coefficient * norm(k) / norm(left_out)).abs() < CARRIED;
        }
    }
    Ok(Some(ShownColumns { kept, alone }))
}

fn ratio(values: &[f64]) -> f64 {
    let smallest = values.last().copied().unwrap_or(1.0);
    let largest = values.first().copied().unwrap_or(1.0);
    if smallest > 0.0 { largest / smallest } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factor(columns: usize, entry: impl Fn(f64, usize) -> f64) -> TriangularFactor {
        let mut factor = TriangularFactor::new(columns);
        factor.fold(
            Mat::from_fn(400, columns + 1, |i, k| if k < columns { entry(0.01 * i as f64, k) } else { 1.0 })
                .as_ref(),
        );
        factor
    }

    #[test]
    fn zeros_and_copies_are_named_and_the_rest_is_kept() {
        let found = identifiability(&factor(5, |t, k| match k {
            0 => t.sin(),
            1 => 0.0,
            2 => (3.0 * t).cos(),
            3 => 50.0 * t.sin() * (1.0 + 1e-6 * t),
            _ => (7.0 * t).sin(),
        }))
        .expect("singular values");
        assert_eq!(found.unseen, vec![1]);
        assert_eq!(found.indistinct.len(), 1, "{found:?}");
        let copies = &found.indistinct[0];
        let mut both = copies.from.clone();
        both.push(copies.column);
        both.sort_unstable();
        assert_eq!(both, vec![0, 3]);
        assert!(!found.is_complete() && found.scaled_condition_number > MAX_SCALED_CONDITION);
    }

    #[test]
    fn columns_next_to_a_left_out_one_do_not_stand_alone() {
        let of = |t: f64, k: usize| match k {
            0 => t.sin(),
            1 => (3.0 * t).cos(),
            2 => 50.0 * t.sin() * (1.0 + 1e-6 * t),
            3 => 0.0,
            k => (k as f64 * 2.3 * t).sin(),
        };
        let shown = shown_columns(&factor(12, of)).expect("singular values").expect("enough columns");
        let alone: Vec<usize> =
            shown.kept.iter().zip(&shown.alone).filter(|(_, alone)| **alone).map(|(k, _)| *k).collect();
        assert_eq!(shown.kept.len(), 10);
        assert_eq!(alone, [1, 4, 5, 6, 7, 8, 9, 10, 11]);
        assert_eq!(shown_columns(&factor(5, of)).expect("singular values"), None, "two of five are too many");
    }

    #[test]
    fn a_rich_motion_is_complete_with_the_condition_numbers_of_the_solution() {
        let rich = factor(3, |t, k| (2.0 * t * (k + 1) as f64).sin() * [1.0, 10.0, 100.0][k]);
        let found = identifiability(&rich).expect("singular values");
        let solved = rich.solve(1e6, |k| k.to_string()).expect("solves");
        assert!(found.is_complete());
        let same = |a: f64, b: f64| (a / b - 1.0).abs() < 1e-9;
        assert!(same(found.condition_number, solved.condition_number));
        assert!(same(found.scaled_condition_number, solved.scaled_condition_number));
    }
}
