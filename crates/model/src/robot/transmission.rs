//! The transmission `R` between joints and motors, `theta_motor = R q`.

use nalgebra::DMatrix;

/// Smallest singular value of a regular transmission with columns scaled to unit norm: below it, one motor only repeats
/// the motion of others.
const SINGULAR: f64 = 1e-9;

/// Inverse `[n x n]` of the transmission `R`: joint turns per motor turn. `None` if `R` is not square, has an entry
/// that is not finite, or is singular.
#[must_use]
pub fn joint_per_motor(r: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    if !r.is_square() || r.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let mut scaled = r.clone();
    for mut column in scaled.column_iter_mut() {
        let norm = column.norm();
        if norm == 0.0 {
            return None;
        }
        column /= norm;
    }
    if scaled.singular_values().min() < SINGULAR {
        return None;
    }
    r.clone().try_inverse()
}
