//! Essential parameters: the fewest base parameters that explain the torque equally well.

use super::factor::TriangularFactor;
use super::solution::LeastSquares;
use crate::NumericsError;
use crate::statistics::distributions::f_quantile;

/// Conditions for the removal of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EssentialSettings {
    /// Smallest standard error over value of a parameter that may be removed. The customary threshold is ten times the
    /// smallest of all parameters, or 0.1 to 0.3 (Pham & Gautier 1991).
    pub relative_error: f64,
    /// Probability of rejecting an equally good fit as worse.
    pub significance: f64,
    /// Largest scaled condition number.
    pub max_condition: f64,
}

impl Default for EssentialSettings {
    fn default() -> Self {
        Self { relative_error: 0.3, significance: 0.05, max_condition: super::solution::MAX_SCALED_CONDITION }
    }
}

/// Result of the elimination.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct EssentialParameters {
    /// Columns kept, ascending.
    pub kept: Vec<usize>,
    /// Columns removed, the least certain first.
    pub removed: Vec<usize>,
    /// Solution for the kept columns.
    pub solution: LeastSquares,
    /// F statistic of the removed columns against the full set; 0 if none is removed.
    pub f_statistic: f64,
    /// Largest F that counts as equally good for this number of removed parameters; 0 if none is removed.
    pub f_limit: f64,
}

/// Backwards elimination: removes the parameter with the largest relative standard error, while that exceeds the
/// threshold and the remaining residual is not significantly larger than that of the full set:
/// `F = ((rss - rss_full) / removed) / (rss_full / (rows - b))` (Draper & Smith 1998, chapter 15).
///
/// `independent_fraction` of the factor's rows are independent. A removed parameter counts as zero; it is not zero in
/// the arm, only not worth its uncertainty.
///
/// # Errors
/// Those of [`TriangularFactor::solve`].
pub(crate) fn essential(
    factor: &TriangularFactor,
    rows: usize,
    independent_fraction: f64,
    settings: &EssentialSettings,
) -> Result<EssentialParameters, NumericsError> {
    let b = factor.columns();
    let solve = |kept: &[usize]| {
        let name = |column: usize| kept[column].to_string();
        factor.restricted(kept).solve(settings.max_condition, name)
    };
    let all: Vec<usize> = (0..b).collect();
    let full = solve(&all)?;
    let independent = (rows as f64 * independent_fraction - b as f64).max(1.0);
    // Sums of squares include every row; those of independent rows are smaller by the fraction.
    let full_rss = full.residual_sum_of_squares * independent_fraction;
    let noise = full_rss / independent;
    let mut found = EssentialParameters {
        kept: all,
        removed: Vec::new(),
        solution: full,
        f_statistic: 0.0,
        f_limit: 0.0,
    };
    while found.kept.len() > 1 {
        let relative = |k: usize| {
            let variance = noise * found.solution.unscaled_variance[k] / independent_fraction;
            variance.sqrt() / found.solution.theta[k].abs()
        };
        let weakest = (0..found.kept.len()).max_by(|&a, &b| relative(a).total_cmp(&relative(b)));
        let Some(weakest) = weakest.filter(|&k| relative(k) > settings.relative_error) else { break };
        let mut kept = found.kept.clone();
        let removed = kept.remove(weakest);
        let solution = solve(&kept)?;
        let count = (found.removed.len() + 1) as f64;
        let rss = solution.residual_sum_of_squares * independent_fraction;
        let f_statistic = (rss - full_rss) / count / noise;
        let f_limit = f_quantile(1.0 - settings.significance, count, independent);
        if f_statistic > f_limit {
            break;
        }
        found.removed.push(removed);
        found = EssentialParameters { kept, removed: found.removed, solution, f_statistic, f_limit };
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use armwatch_testing::noise::Noise;
    use faer::Mat;

    use super::*;

    #[test]
    fn parameters_that_are_zero_go_and_the_others_stay() {
        let truth = [2.0, 0.0, -1.0, 0.0, 0.5];
        let mut factor = TriangularFactor::new(5);
        let mut white = Noise(99);
        let mut rows = Mat::<f64>::zeros(2000, 6);
        for i in 0..2000 {
            for k in 0..5 {
                rows[(i, k)] = (0.01 * i as f64 * (k as f64 + 1.3)).sin();
            }
            rows[(i, 5)] = (0..5).map(|k| truth[k] * rows[(i, k)]).sum::<f64>() + white.even() - 0.5;
        }
        factor.fold(rows.as_ref());
        let found = essential(&factor, 2000, 1.0, &EssentialSettings::default()).expect("essential");
        assert_eq!(found.kept, vec![0, 2, 4]);
        for (k, &column) in found.kept.iter().enumerate() {
            assert!((found.solution.theta[k] - truth[column]).abs() < 0.05);
        }
    }
}
