//! Bodies of positive density as positive definite matrices.
//!
//! Ten parameters belong to a body of positive density if its pseudo-inertia
//! `J = [[Sigma, h], [hᵀ, m]]` is positive definite, with `h` the first moment and
//! `Sigma = tr(I)/2 - I` (Wensing, Kim & Slotine 2018). `J` is linear in the parameters.

use nalgebra::{Matrix3, Matrix4, Vector3};

use armwatch_model::robot::StandardParameters;

/// Smallest eigenvalue of a pseudo-inertia relative to its largest that counts as positive.
#[cfg(test)]
pub const POSITIVE: f64 = 1e-10;
/// Smallest eigenvalue, relative to the largest, of a start that was not physical and is lifted: a radius of a few mm
/// against one of 100 mm.
const LIFT: f64 = 1e-4;

/// Pseudo-inertia `[[Sigma, h], [hᵀ, m]]` of ten parameters, `[4 x 4]`.
#[must_use]
pub fn pseudo_inertia(parameters: &StandardParameters) -> Matrix4<f64> {
    let inertia = parameters.inertia();
    let sigma = Matrix3::identity() * (0.5 * inertia.trace()) - inertia;
    let h = parameters.first_moment();
    let mut j = Matrix4::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&sigma);
    j.fixed_view_mut::<3, 1>(0, 3).copy_from(&h);
    j.fixed_view_mut::<1, 3>(3, 0).copy_from(&h.transpose());
    j[(3, 3)] = parameters.mass();
    j
}

/// Smallest over largest eigenvalue of a link's pseudo-inertia; above 1e-10 the link is physical.
///
/// Lengths enter the ratio in m; its sign does not depend on them.
#[must_use]
pub fn definiteness(parameters: &StandardParameters) -> f64 {
    let values = pseudo_inertia(parameters).symmetric_eigenvalues();
    values.min() / values.max().abs().max(f64::MIN_POSITIVE)
}

/// Nearby physical body: the pseudo-inertia with the smallest sufficient addition to its diagonal.
pub(super) fn lifted(parameters: &StandardParameters) -> StandardParameters {
    let mut j = pseudo_inertia(parameters);
    let values = j.symmetric_eigenvalues();
    let largest = values.max().max(LIFT);
    let missing = LIFT * largest - values.min();
    if missing > 0.0 {
        j += Matrix4::identity() * missing;
    }
    parameters_of(&j)
}

pub(super) fn parameters_of(j: &Matrix4<f64>) -> StandardParameters {
    let sigma: Matrix3<f64> = j.fixed_view::<3, 3>(0, 0).into_owned();
    let h: Vector3<f64> = j.fixed_view::<3, 1>(0, 3).into_owned();
    let i = Matrix3::identity() * sigma.trace() - sigma;
    StandardParameters([
        j[(3, 3)],
        h.x,
        h.y,
        h.z,
        i[(0, 0)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 1)],
        i[(1, 2)],
        i[(2, 2)],
    ])
}

/// Directions of change of a body, `[10]`: `L E Lᵀ` for `J = L Lᵀ` and the ten symmetric `E` of unit norm. In these
/// coordinates `s` the curvature of `-log det J` is one in all directions, and `J + sum s_k L E_k Lᵀ` is physical
/// while `1 + sum s_k E_k` is positive definite.
pub(super) fn directions(l: &Matrix4<f64>) -> [StandardParameters; 10] {
    BASIS.map(|place| parameters_of(&(l * basis_matrix(place) * l.transpose())))
}

/// Coordinates of a symmetric matrix in the ten `E` of [`directions`].
pub(super) fn coordinates(symmetric: &Matrix4<f64>) -> [f64; 10] {
    BASIS.map(|(i, k)| if i == k { symmetric[(i, k)] } else { std::f64::consts::SQRT_2 * symmetric[(i, k)] })
}

/// Symmetric matrix with these coordinates.
pub(super) fn symmetric(coordinates: &[f64]) -> Matrix4<f64> {
    BASIS.into_iter().zip(coordinates).map(|(place, s)| basis_matrix(place) * *s).sum()
}

const BASIS: [(usize, usize); 10] =
    [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

fn basis_matrix((i, k): (usize, usize)) -> Matrix4<f64> {
    let mut e = Matrix4::zeros();
    let entry = if i == k { 1.0 } else { std::f64::consts::FRAC_1_SQRT_2 };
    e[(i, k)] = entry;
    e[(k, i)] = entry;
    e
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    /// Rounding of a few dozen operations on numbers of about one.
    const ROUNDING: f64 = 1e-12;

    #[test]
    fn there_and_back_is_the_same_body() {
        for joint in &er3a().joints {
            let body = joint.nominal.expect("nominal").inertial;
            let back = parameters_of(&pseudo_inertia(&body));
            assert!(body.0.iter().zip(back.0).all(|(a, b)| (a - b).abs() < ROUNDING), "{body:?} {back:?}");
            assert!(definiteness(&body) > POSITIVE);
        }
    }

    #[test]
    fn a_negative_moment_is_no_body_until_it_is_lifted() {
        let none = StandardParameters([1.0, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0, 0.1, 0.0, 0.1]);
        assert!(definiteness(&none) < 0.0);
        assert!(definiteness(&lifted(&none)) > POSITIVE);
    }

    #[test]
    fn coordinates_are_those_of_a_change_of_the_body() {
        let body = er3a().joints[1].nominal.expect("nominal").inertial;
        let l = pseudo_inertia(&body).cholesky().expect("a body").l();
        let s = [0.1, -0.2, 0.3, 0.05, 0.2, -0.1, 0.15, 0.02, 0.07, -0.3];
        assert!(coordinates(&symmetric(&s)).iter().zip(s).all(|(a, b)| (a - b).abs() < ROUNDING));
        let moved = l * (Matrix4::identity() + symmetric(&s)) * l.transpose();
        let along = directions(&l);
        for (k, expected) in parameters_of(&moved).0.into_iter().enumerate() {
            let found = body.0[k] + (0..10).map(|d| s[d] * along[d].0[k]).sum::<f64>();
            assert!((found - expected).abs() < ROUNDING, "{k}: {found} {expected}");
        }
    }
}
