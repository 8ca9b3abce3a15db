//! Shares of data and of assumptions in an estimated body.

use faer::MatRef;
use nalgebra::{Matrix3, Vector3};

use armwatch_model::robot::StandardParameters;

/// Smallest share of the variance that data must remove for a number to count as decided by them: its standard
/// deviation is then less than a third of that without data.
pub const DECIDED: f64 = 0.9;

/// Number with its standard deviation, with and without data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimated {
    /// The number.
    pub value: f64,
    /// Standard deviation from data and assumption together.
    pub std: f64,
    /// Standard deviation from the assumption alone, about the same value.
    pub std_without_data: f64,
}

impl Estimated {
    /// Share of the variance that data remove: 1 all data, 0 all assumption.
    #[must_use]
    pub fn data_share(&self) -> f64 {
        (1.0 - (self.std / self.std_without_data).powi(2)).clamp(0.0, 1.0)
    }

    /// Returns true if data decide the number, by [`DECIDED`].
    #[must_use]
    pub fn is_decided(&self) -> bool {
        self.data_share() >= DECIDED
    }
}

/// Link as a body, in the link's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyEstimate {
    /// Mass, kg; centre of mass `x, y, z`, m; inertia about that centre `xx, xy, xz, yy, yz, zz`,
    /// kg m², axes of the link's frame; in the order of [`BodyEstimate::NAMES`].
    pub values: [Estimated; 10],
}

impl BodyEstimate {
    /// Names with units, in order; inertia is about the centre of mass.
    pub const NAMES: [&'static str; 10] = [
        "mass_kg",
        "centre_x_m",
        "centre_y_m",
        "centre_z_m",
        "ixx_kg_m2",
        "ixy_kg_m2",
        "ixz_kg_m2",
        "iyy_kg_m2",
        "iyz_kg_m2",
        "izz_kg_m2",
    ];
}

/// Mass, centre and inertia about it with their standard deviations, to first order.
///
/// `slopes` `[10]` are the derivatives of the ten parameters with respect to each coordinate `x`; `root` `[10 x any]`
/// gives the covariance of `x` as `root rootᵀ`; `pull` `[10]` is the inverse of the standard deviation of each `x`
/// without data.
pub(super) fn body_estimate(
    body: &StandardParameters,
    slopes: &[StandardParameters; 10],
    root: MatRef<'_, f64>,
    pull: &[f64],
) -> BodyEstimate {
    let moves: [[f64; 10]; 10] = slopes.map(|slope| about_centre(body, &slope));
    let value = of_body(body);
    let estimated = |k: usize| {
        let along = |column: usize| -> f64 { (0..10).map(|x| moves[x][k] * root[(x, column)]).sum() };
        let variance: f64 = (0..root.ncols()).map(|column| along(column).powi(2)).sum();
        let without: f64 = (0..10).map(|x| (moves[x][k] / pull[x]).powi(2)).sum();
        Estimated { value: value[k], std: variance.sqrt(), std_without_data: without.sqrt() }
    };
    BodyEstimate { values: std::array::from_fn(estimated) }
}

fn of_body(body: &StandardParameters) -> [f64; 10] {
    packed(body.mass(), &body.centre_of_mass(), &body.inertia_about_centre())
}

/// Change of mass, centre and inertia about it for a change of the ten parameters: `dc = (dh - c dm) / m`,
/// `dI_c = dI - dm S(c) - m dS(c)` with `S(c) = cᵀc 1 - c cᵀ`.
fn about_centre(body: &StandardParameters, change: &StandardParameters) -> [f64; 10] {
    let (m, c, dm) = (body.mass(), body.centre_of_mass(), change.mass());
    let dc = (change.first_moment() - c * dm) / m;
    let shift = Matrix3::identity() * c.norm_squared() - c * c.transpose();
    let turned = Matrix3::identity() * (2.0 * c.dot(&dc)) - dc * c.transpose() - c * dc.transpose();
    packed(dm, &dc, &(change.inertia() - shift * dm - turned * m))
}

fn packed(mass: f64, centre: &Vector3<f64>, i: &Matrix3<f64>) -> [f64; 10] {
    [mass, centre.x, centre.y, centre.z, i.m11, i.m12, i.m13, i.m22, i.m23, i.m33]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn change_about_the_centre_is_that_of_finite_differences() {
        /// Tolerance of second-order differences of smooth functions of size one.
        const DIFFERENCES: f64 = 1e-7;
        const STEP: f64 = 1e-4;
        let body = StandardParameters([2.0, 0.3, -0.2, 0.5, 0.9, 0.05, -0.1, 0.8, 0.04, 0.7]);
        for k in 0..10 {
            let mut change = StandardParameters::default();
            change.0[k] = 1.0;
            let moved = |step: f64| {
                of_body(&StandardParameters(std::array::from_fn(|i| body.0[i] + step * change.0[i])))
            };
            let (after, before) = (moved(STEP), moved(-STEP));
            for (i, exact) in about_centre(&body, &change).into_iter().enumerate() {
                let slope = (after[i] - before[i]) / (2.0 * STEP);
                assert!((slope - exact).abs() < DIFFERENCES, "{k} {i}: {slope} {exact}");
            }
        }
    }
}
