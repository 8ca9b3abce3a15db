//! Bodies of positive density as ten free numbers.
//!
//! Ten parameters belong to a body of positive density if its pseudo-inertia
//! `J = [[Sigma, h], [hᵀ, m]]` is positive definite, with `h` the first moment and
//! `Sigma = tr(I)/2 - I` (Wensing, Kim & Slotine 2018). Written as `J = U Uᵀ` with an upper
//! triangular `U` of positive diagonal, every real vector of ten is such a body, and least squares need
//! no bounds (Rucker & Wensing 2022).

use nalgebra::{Matrix3, Matrix4, Vector3};

use crate::robot::StandardParameters;

/// Log-Cholesky parameters of a body: `alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3` of
/// `U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]`.
/// `t` is the centre of mass in m, `e^alpha` the root of the mass.
pub type LogCholesky = [f64; 10];

/// Smallest eigenvalue of a pseudo-inertia relative to its largest that counts as positive.
pub const POSITIVE: f64 = 1e-10;
/// A start that is no body is lifted until the smallest eigenvalue is this part of the largest: a
/// radius of a few mm against one of 100 mm.
const LIFT: f64 = 1e-4;

/// The ten standard parameters of a log-Cholesky vector.
#[must_use]
pub fn from_log_cholesky(x: &LogCholesky) -> StandardParameters {
    let u = upper(x);
    parameters_of(&(u * u.transpose()))
}

/// The log-Cholesky vector of a body; `None` if the parameters are no body.
#[must_use]
pub fn to_log_cholesky(parameters: &StandardParameters) -> Option<LogCholesky> {
    let j = pseudo_inertia(parameters);
    // An upper factor is a lower one with rows and columns in reverse order.
    let reversed = Matrix4::from_fn(|i, k| j[(3 - i, 3 - k)]);
    let lower = reversed.cholesky()?.l();
    let u = Matrix4::from_fn(|i, k| lower[(3 - i, 3 - k)]);
    let scale = u[(3, 3)];
    let entry = |i: usize, k: usize| u[(i, k)] / scale;
    let x = [
        scale.ln(),
        entry(0, 0).ln(),
        entry(1, 1).ln(),
        entry(2, 2).ln(),
        entry(0, 1),
        entry(1, 2),
        entry(0, 2),
        entry(0, 3),
        entry(1, 3),
        entry(2, 3),
    ];
    x.iter().all(|value| value.is_finite()).then_some(x)
}

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

/// Smallest over largest eigenvalue of a link's pseudo-inertia; above [`POSITIVE`] it is a body.
///
/// Lengths enter the ratio in m; its sign does not depend on them.
#[must_use]
pub fn definiteness(parameters: &StandardParameters) -> f64 {
    let values = pseudo_inertia(parameters).symmetric_eigenvalues();
    values.min() / values.max().abs().max(f64::MIN_POSITIVE)
}

/// The nearest-by body: the pseudo-inertia with as much added to its diagonal as it takes.
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

fn parameters_of(j: &Matrix4<f64>) -> StandardParameters {
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

fn upper(x: &LogCholesky) -> Matrix4<f64> {
    let [alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3] = *x;
    let body = Matrix4::new(
        d1.exp(),
        s12,
        s13,
        t1,
        0.0,
        d2.exp(),
        s23,
        t2,
        0.0,
        0.0,
        d3.exp(),
        t3,
        0.0,
        0.0,
        0.0,
        1.0,
    );
    body * alpha.exp()
}

/// Derivative of the ten parameters by each log-Cholesky parameter: `dJ = dU Uᵀ + U dUᵀ`.
pub(super) fn slopes(x: &LogCholesky) -> [StandardParameters; 10] {
    /// Place in `U` of the parameters after `alpha`.
    const PLACES: [(usize, usize); 9] =
        [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)];
    let u = upper(x);
    std::array::from_fn(|k| {
        let mut du = Matrix4::zeros();
        match k {
            0 => du = u,
            1..=3 => du[PLACES[k - 1]] = u[PLACES[k - 1]],
            _ => du[PLACES[k - 1]] = x[0].exp(),
        }
        let half = du * u.transpose();
        parameters_of(&(half + half.transpose()))
    })
}
