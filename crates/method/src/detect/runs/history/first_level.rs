//! Usual level of the first tests if something changed among them and did not change back.
//!
//! A change while a baseline is learnt is not part of it: the tests before it count, if there are two. Medians alone
//! would follow most of these tests and show the first ones as wrong.

use nalgebra::DVector;

use crate::statistics::descriptive::median;

/// Change of a joint's friction between two tests, in logarithms and beyond the common part of all joints, that ends a
/// baseline.
pub(in crate::detect::runs) const LEVEL_CHANGE: f64 = 0.06;

/// Fewest tests of a level, before and after a change.
const FEWEST: usize = 2;

/// Levels of the first tests' values, oldest first.
#[derive(Debug)]
pub(in crate::detect::runs) struct FirstLevels<'t> {
    /// Tests that count: those before the change.
    pub(in crate::detect::runs) usual: &'t [DVector<f64>],
    /// Those after it; empty without a change.
    pub(in crate::detect::runs) changed: &'t [DVector<f64>],
}

impl<'t> FirstLevels<'t> {
    /// Levels of tests, each a row of values in their standard deviations. The level has changed if two conditions
    /// hold. The mean square of the difference is at least `least` times that of the tests of one level, which is no
    /// less than chance. `is_change` returns true for the medians before and after.
    pub(in crate::detect::runs) fn of(
        tests: &'t [DVector<f64>],
        least: f64,
        is_change: impl Fn(&DVector<f64>, &DVector<f64>) -> bool,
    ) -> Self {
        let ratio = |at: usize| {
            let (before, behind) = tests.split_at(at);
            let (usual, changed) = (medians(before), medians(behind));
            let sides = before.iter().map(|row| row - &usual).chain(behind.iter().map(|row| row - &changed));
            let within = sides.map(|rest| mean_square(&rest)).sum::<f64>() / (tests.len() - 2) as f64;
            let between = mean_square(&(&changed - &usual));
            is_change(&usual, &changed).then_some((at, between / within.max(1.0)))
        };
        let clearest = (FEWEST..=tests.len().saturating_sub(FEWEST))
            .filter_map(ratio)
            .max_by(|(_, a), (_, b)| a.total_cmp(b))
            .filter(|(_, ratio)| *ratio >= least);
        let (usual, changed) = tests.split_at(clearest.map_or(tests.len(), |(at, _)| at));
        Self { usual, changed }
    }

    /// Mean square of each test's values about the medians of its level.
    pub(in crate::detect::runs) fn mean_squares(&self) -> Vec<f64> {
        let of_level = |tests: &[DVector<f64>]| {
            let level = medians(tests);
            tests.iter().map(|row| mean_square(&(row - &level))).collect::<Vec<f64>>()
        };
        [self.usual, self.changed].into_iter().flat_map(of_level).collect()
    }

    /// Part of the variance that these squares show, since the medians are of the same tests; one without tests.
    pub(in crate::detect::runs) fn freedom(&self) -> f64 {
        let tests = (self.usual.len() + self.changed.len()).max(1) as f64;
        let levels = [self.usual, self.changed].iter().filter(|level| !level.is_empty()).count() as f64;
        ((tests - levels) / tests).max(0.5)
    }
}

/// Median of each value; empty without tests.
fn medians(tests: &[DVector<f64>]) -> DVector<f64> {
    let column = |at: usize| tests.iter().map(|row| row[at]).collect::<Vec<f64>>();
    DVector::from_fn(tests.first().map_or(0, DVector::len), |at, _| median(&column(at)).unwrap_or(f64::NAN))
}

fn mean_square(row: &DVector<f64>) -> f64 {
    row.norm_squared() / row.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn usual(figures: &[f64]) -> usize {
        let tests: Vec<DVector<f64>> = figures.iter().map(|of| DVector::from_element(1, *of)).collect();
        FirstLevels::of(&tests, 64.0, |_, _| true).usual.len()
    }

    #[test]
    fn tests_before_a_change_that_stays_are_the_usual_ones() {
        assert_eq!(usual(&[0.0, 0.5, 20.0, 20.3, 19.8]), 2);
        assert_eq!(usual(&[0.0, 0.5, -0.4, 20.3, 19.8]), 3);
        assert_eq!(usual(&[0.0, 0.5, -0.4, 0.3, 0.1]), 5, "chance");
        assert_eq!(usual(&[0.0, 0.5, 7.0, 7.2, 6.9]), 5, "too little");
        assert_eq!(usual(&[20.0, 0.5, 0.1, -0.3, 0.2]), 5, "one odd test");
        assert_eq!(usual(&[0.0, 20.0, 0.1, 20.3, 0.2]), 5, "to and fro");
        assert_eq!(usual(&[0.0, 10.0, 20.0, 30.0, 40.0]), 5, "a ramp");
        assert_eq!(usual(&[0.0, 20.0]), 2, "too few");
        assert_eq!(usual(&[]), 0);
    }

    #[test]
    fn scatter_is_that_about_each_level() {
        let tests: Vec<DVector<f64>> =
            [0.0, 2.0, 50.0, 51.0, 52.0].map(|of| DVector::from_element(1, of)).to_vec();
        let levels = FirstLevels::of(&tests, 64.0, |_, _| true);
        assert_eq!(levels.mean_squares(), [1.0, 1.0, 1.0, 0.0, 1.0]);
        assert!((levels.freedom() - 0.6).abs() < 1e-12);
    }
}
