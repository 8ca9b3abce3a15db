//! Refinement of separable least-squares fits on their gradient.
//!
//! A search ends when the sum of squares no longer falls. Its parameters are then accurate only to the root of the
//! rounding, and the exact end depends on the order of a sum. Gauss-Newton steps continue from there until they are as
//! small as rounding, so that the fit depends only on its data.

use nalgebra::{DMatrix, DVector};

/// Largest number of steps; each is at least a tenth smaller than the previous one.
const MOST_STEPS: usize = 300;
const SHRINKS_TO: f64 = 0.9;

/// Largest distance from the end of the search to the minimum; beyond it, the search did not end in a minimum.
const NEAR: f64 = 0.01;

/// Size of a step below which it is rounding.
const ROUNDING: f64 = 1e-10;

/// Terms that are linear in their coefficients, at given nonlinear parameters; rows are weighted.
pub(super) struct Terms {
    /// One column per term.
    pub(super) terms: DMatrix<f64>,
    /// For each nonlinear parameter, the term that depends on it and the slope of that term.
    pub(super) slopes: Vec<(usize, DVector<f64>)>,
}

/// Nonlinear parameters near `start` with Gauss-Newton steps as small as rounding (Kaufman 1975: each step solves for
/// the coefficients again); `start` itself if they do not converge.
pub(super) fn on_gradient(
    start: &[f64],
    right: &DVector<f64>,
    terms: impl Fn(&[f64]) -> Option<Terms>,
) -> Vec<f64> {
    let mut at = start.to_vec();
    let mut last = NEAR / SHRINKS_TO;
    for _ in 0..MOST_STEPS {
        let Some(step) = terms(&at).and_then(|terms| step(&terms, right)) else { return start.to_vec() };
        let size = step.amax();
        if size.is_nan() || size >= SHRINKS_TO * last {
            return if last < ROUNDING { at } else { start.to_vec() };
        }
        at.iter_mut().zip(step.iter()).for_each(|(at, step)| *at += step);
        if size == 0.0 {
            return at;
        }
        last = size;
    }
    at
}

/// Gauss-Newton step of the nonlinear parameters.
fn step(of: &Terms, right: &DVector<f64>) -> Option<DVector<f64>> {
    let linear = of.terms.ncols();
    let coefficients = least_squares(of.terms.clone(), right)?;
    let residual = right - &of.terms * &coefficients;
    let mut tangent = of.terms.clone().resize_horizontally(linear + of.slopes.len(), 0.0);
    for (k, (term, slope)) in of.slopes.iter().enumerate() {
        tangent.set_column(linear + k, &(slope * coefficients[*term]));
    }
    Some(least_squares(tangent, &residual)?.rows(linear, of.slopes.len()).into_owned())
}

fn least_squares(matrix: DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let columns = matrix.ncols();
    if matrix.nrows() < columns {
        return None;
    }
    let qr = matrix.qr();
    let mut turned = right.clone();
    qr.q_tr_mul(&mut turned);
    let solved = qr.r().solve_upper_triangular(&turned.rows(0, columns).into_owned())?;
    solved.iter().all(|x| x.is_finite()).then_some(solved)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decay(minutes: &DVector<f64>, log: f64) -> Terms {
        let time = log.exp();
        let terms = DMatrix::from_fn(minutes.len(), 2, |i, k| match k {
            0 => 1.0,
            _ => (-minutes[i] / time).exp(),
        });
        let slope = minutes.map(|t| t / time * (-t / time).exp());
        Terms { terms, slopes: vec![(1, slope)] }
    }

    fn record(noise: f64) -> (DVector<f64>, DVector<f64>) {
        let minutes = DVector::from_fn(48, |i, _| 1.0 + 2.5 * i as f64);
        let scatter = |i: usize| noise * ((i * 7919 % 101) as f64 / 50.0 - 1.0);
        let torque = minutes.map_with_location(|i, _, t| 3.0 + 2.0 * (-t / 20.0_f64).exp() + scatter(i));
        (minutes, torque)
    }

    #[test]
    fn where_a_search_stopped_no_longer_matters() {
        let (minutes, torque) = record(0.3);
        let from = |start: f64| on_gradient(&[start], &torque, |at| Some(decay(&minutes, at[0])))[0];
        // minimum by another method: bisection for zero slope of the sum of squares
        let slope = |log: f64| {
            let of = decay(&minutes, log);
            let coefficients = least_squares(of.terms.clone(), &torque).expect("full rank");
            let residual = &torque - &of.terms * &coefficients;
            residual.dot(&of.slopes[0].1) * coefficients[1]
        };
        let (mut low, mut high) = (18.0_f64.ln(), 30.0_f64.ln());
        assert!(slope(low) > 0.0 && slope(high) < 0.0, "{} {}", slope(low), slope(high));
        for _ in 0..60 {
            let middle = f64::midpoint(low, high);
            if slope(middle) > 0.0 { low = middle } else { high = middle }
        }
        for off in [-2e-3, -1e-7, 0.0, 1e-8, 1e-3] {
            let found = from(low + off);
            assert!((found - low).abs() < 1e-13, "{off}: {found} {low}");
        }
    }

    #[test]
    fn a_start_without_a_minimum_near_it_stays() {
        let (minutes, torque) = record(0.0);
        let far = 3.0_f64.ln();
        assert_eq!(on_gradient(&[far], &torque, |at| Some(decay(&minutes, at[0]))), [far]);
        assert_eq!(on_gradient(&[1.0], &torque, |_| None), [1.0]);
    }
}
