//! Full standard parameters that a body can have.
//!
//! Ten numbers belong to a body of positive density if its pseudo-inertia
//! `J = [[Sigma, h], [hᵀ, m]]` is positive definite, with `h` the first moment and
//! `Sigma = tr(I)/2 - I` (Wensing, Kim & Slotine 2018). Written as `J = U Uᵀ` with an upper
//! triangular `U` of positive diagonal, every real vector of ten is such a body, and least squares need
//! no bounds (Rucker & Wensing 2022).

use faer::Mat;
use nalgebra::{Matrix3, Matrix4, Vector3};

use super::NumericsError;
use super::base::BaseParameters;
use super::covariance::inverse_of_upper;
use super::estimate::residual_sum_of_squares;
use super::triangular::TriangularFactor;
use crate::robot::{FRICTION_COUNT, FrictionModel, ParameterKind, StandardParameters};

/// Log-Cholesky parameters of a body: `alpha, d1, d2, d3, s12, s23, s13, t1, t2, t3` of
/// `U = e^alpha [[e^d1, s12, s13, t1], [0, e^d2, s23, t2], [0, 0, e^d3, t3], [0, 0, 0, 1]]`.
/// `t` is the centre of mass in m, `e^alpha` the root of the mass.
pub type LogCholesky = [f64; 10];

/// Smallest eigenvalue of a pseudo-inertia relative to its largest that counts as positive.
pub const POSITIVE: f64 = 1e-10;
/// A start that is no body is lifted until the smallest eigenvalue is this part of the largest: a
/// radius of a few mm against one of 100 mm.
const LIFT: f64 = 1e-4;
/// Factor by which the damping changes.
const DAMPING_STEP: f64 = 5.0;

/// Weight of the data, in the order of the fits, each from the one before. Precise data from a far
/// start drive a link to the border of bodies, where its diagonal vanishes and the fit stalls; the
/// nominal bodies hold it back until it is near.
const DATA_SHARES: [f64; 7] = [1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0];
/// Longest step of a logarithm, and of the other parameters in the nominal radius.
const LONGEST_STEP: f64 = 0.5;
/// Cosine between residual and each column of the Jacobian below which no direction is left.
const ORTHOGONAL: f64 = 1e-3;

/// What the fit may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhysicalSettings {
    /// Standard deviation of the log-Cholesky parameters and log motor inertias about the nominal ones.
    /// Data do not decide all of the full set; this does the rest. 1 is a factor of e in mass's root.
    pub prior_std: f64,
    /// Share of the data's rows that are independent.
    pub independent_fraction: f64,
    /// Most steps at each of seven weights of the data.
    pub max_steps: usize,
    /// Relative change of the cost at which the fit has settled.
    pub settled: f64,
}

impl Default for PhysicalSettings {
    fn default() -> Self {
        Self { prior_std: 1.0, independent_fraction: 1.0, max_steps: 200, settled: 1e-6 }
    }
}

/// Where the fit starts and what it leans on.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalModel {
    /// Inertial parameters of the links `[n]`; those that are no body are lifted to one.
    pub inertial: Vec<StandardParameters>,
    /// Motor inertias `[n]`, positive.
    pub motor_inertia: Vec<f64>,
}

/// A fit of full parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalEstimate {
    /// Inertial parameters of the links `[n]`, each a body.
    pub inertial: Vec<StandardParameters>,
    /// Friction coefficients `[n]`, free.
    pub friction: Vec<[f64; FRICTION_COUNT]>,
    /// Motor inertias `[n]`, positive.
    pub motor_inertia: Vec<f64>,
    /// Smallest over largest eigenvalue of each link's pseudo-inertia, `[n]`.
    pub definiteness: Vec<f64>,
    /// Residual sum of squares of the data.
    pub residual_sum_of_squares: f64,
    /// Residual sum of squares of unconstrained base parameters: what physics costs is the difference.
    pub unconstrained_sum_of_squares: f64,
    /// Steps taken.
    pub steps: usize,
    /// Whether the fit settled: the cost no longer falls, and its gradient has vanished.
    pub settled: bool,
}

/// Fits the full set of standard parameters, physically consistent, to the factor of
/// `[w | tau]` of the base parameters, in units of the noise.
///
/// Minimises `|r11 G phi - r12|² + |(x - x_nominal) / s|²`, where `phi(x)` are the `15n` parameters,
/// `x` the log-Cholesky parameters of the links, the friction coefficients and the logarithms of the
/// motor inertias, and `G` groups full into base parameters. Off-diagonal and centre entries of `x` are
/// measured in the link's own nominal radius. Friction is not drawn anywhere. Levenberg-Marquardt steps
/// with the analytic Jacobian; each is solved by folding its rows into a triangular factor.
///
/// # Errors
/// [`NumericsError::TooShort`] if the nominal model has too few joints, [`NumericsError::NotFinite`] if
/// it has a motor inertia that is not positive or the data are not finite.
pub fn physical(
    base: &BaseParameters,
    factor: &TriangularFactor,
    nominal: &NominalModel,
    settings: &PhysicalSettings,
) -> Result<PhysicalEstimate, NumericsError> {
    let n = nominal.inertial.len();
    let polynomial = |kind: ParameterKind| match kind {
        ParameterKind::Friction(term) => FrictionModel::POLYNOMIAL.terms().contains(&term),
        ParameterKind::Coupling(_) => false,
        ParameterKind::Inertial(_) | ParameterKind::MotorInertia => true,
    };
    if !base.kept.iter().all(|id| polynomial(id.kind)) {
        return Err(NumericsError::Unsupported(
            "physically consistent parameters of an arm with couplings, or with friction other than the polynomial f1 to f4",
        ));
    }
    if n == 0 || nominal.motor_inertia.len() != n {
        return Err(NumericsError::TooShort { what: "the nominal model", rows: n, needed: n.max(1) });
    }
    if !nominal.motor_inertia.iter().all(|inertia| inertia.is_finite() && *inertia > 0.0) {
        return Err(NumericsError::NotFinite("the logarithm of a nominal motor inertia"));
    }
    let mut problem = Problem::new(base, factor, nominal, settings)?;
    let mut x = problem.start();
    let (mut steps, mut settled) = (0, false);
    for share in DATA_SHARES {
        problem.data_share = share;
        (x, settled) = problem.descend(x, settings, &mut steps)?;
    }
    problem.estimate(&x, steps, settled)
}

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
fn lifted(parameters: &StandardParameters) -> StandardParameters {
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
fn slopes(x: &LogCholesky) -> [StandardParameters; 10] {
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

/// The least-squares problem in `x` `[15n]`: ten a link, four frictions a joint, one motor a joint.
struct Problem<'a> {
    factor: &'a TriangularFactor,
    /// `r11 G` times the root of the independent share, `[b][15n]`, and `r12` likewise.
    map: Vec<Vec<f64>>,
    right: Vec<f64>,
    base: &'a BaseParameters,
    n: usize,
    /// Nominal `x` and one over its spread; 0 where nothing draws.
    nominal: Vec<f64>,
    pull: Vec<f64>,
    /// One over the longest step; 0 where any is fine.
    reach: Vec<f64>,
    data_share: f64,
}

impl<'a> Problem<'a> {
    fn new(
        base: &'a BaseParameters,
        factor: &'a TriangularFactor,
        nominal: &NominalModel,
        settings: &PhysicalSettings,
    ) -> Result<Self, NumericsError> {
        let (n, b) = (nominal.inertial.len(), factor.columns());
        let width = (StandardParameters::COUNT + FRICTION_COUNT + 1) * n;
        let root = settings.independent_fraction.sqrt();
        let r = factor.upper();
        let mut map = vec![vec![0.0; width]; b];
        for (i, row) in map.iter_mut().enumerate() {
            for k in i..b {
                let share = root * r[(i, k)];
                row[base.kept_columns[k]] += share;
                for term in &base.grouping[k] {
                    row[term.column] += share * term.coefficient;
                }
            }
        }
        let (mut x, mut pull) = (Vec::with_capacity(width), Vec::with_capacity(width));
        for link in &nominal.inertial {
            let start = to_log_cholesky(link)
                .or_else(|| to_log_cholesky(&lifted(link)))
                .ok_or(NumericsError::NotFinite("the nominal inertia of a link"))?;
            let radius = ((start[1] + start[2] + start[3]) / 3.0).exp();
            x.extend(start);
            pull.extend([1.0; 4].map(|pull| pull / settings.prior_std));
            pull.extend([1.0 / (radius * settings.prior_std); 6]);
        }
        x.extend(vec![0.0; FRICTION_COUNT * n]);
        pull.extend(vec![0.0; FRICTION_COUNT * n]);
        x.extend(nominal.motor_inertia.iter().map(|inertia| inertia.ln()));
        pull.extend(vec![1.0 / settings.prior_std; n]);
        let right = (0..b).map(|i| root * r[(i, b)]).collect();
        let reach = pull.iter().map(|pull| pull * settings.prior_std / LONGEST_STEP).collect();
        Ok(Self { factor, map, right, base, n, nominal: x, pull, reach, data_share: 1.0 })
    }

    fn start(&self) -> Vec<f64> {
        self.nominal.clone()
    }

    fn link(&self, x: &[f64], link: usize) -> LogCholesky {
        std::array::from_fn(|k| x[10 * link + k])
    }

    /// All parameters in natural order, `[15n]`.
    fn phi(&self, x: &[f64]) -> Vec<f64> {
        let mut phi: Vec<f64> =
            (0..self.n).flat_map(|link| from_log_cholesky(&self.link(x, link)).0).collect();
        phi.extend(&x[10 * self.n..14 * self.n]);
        phi.extend(x[14 * self.n..].iter().map(|log| log.exp()));
        phi
    }

    fn residuals(&self, x: &[f64]) -> Vec<f64> {
        let phi = self.phi(x);
        let data = self.map.iter().zip(&self.right).map(|(row, right)| {
            self.data_share * (right - row.iter().zip(&phi).map(|(map, phi)| map * phi).sum::<f64>())
        });
        let pulled =
            self.pull.iter().zip(x).zip(&self.nominal).map(|((pull, x), nominal)| pull * (nominal - x));
        data.chain(pulled).collect()
    }

    fn cost(&self, x: &[f64]) -> f64 {
        self.residuals(x).iter().map(|residual| residual * residual).sum()
    }

    /// Levenberg-Marquardt from `x`; the end, and whether it settled there.
    fn descend(
        &self,
        mut x: Vec<f64>,
        settings: &PhysicalSettings,
        steps: &mut usize,
    ) -> Result<(Vec<f64>, bool), NumericsError> {
        let mut cost = self.cost(&x);
        let mut damping = 1e-3;
        let mut jacobian = self.jacobian(&x);
        for _ in 0..settings.max_steps {
            *steps += 1;
            let step = self.step(&x, &jacobian, damping)?;
            let trial: Vec<f64> = x.iter().zip(&step).map(|(x, step)| x + step).collect();
            let trial_cost = self.cost(&trial);
            if trial_cost.is_finite() && trial_cost <= cost {
                let still = cost - trial_cost <= settings.settled * cost.max(f64::MIN_POSITIVE);
                (x, cost) = (trial, trial_cost);
                jacobian = self.jacobian(&x);
                damping = (damping / DAMPING_STEP).max(1e-12);
                if still && self.is_stationary(&x, &jacobian) {
                    return Ok((x, true));
                }
            } else {
                damping *= DAMPING_STEP;
                if damping > 1e12 {
                    break;
                }
            }
        }
        let settled = self.is_stationary(&x, &jacobian);
        Ok((x, settled))
    }

    /// Whether no parameter can lower the cost: the residual is orthogonal to each column. A cost that
    /// no longer falls is not enough, as it also stalls at the border of bodies.
    fn is_stationary(&self, x: &[f64], jacobian: &Mat<f64>) -> bool {
        let residuals = self.residuals(x);
        let norm = residuals.iter().map(|residual| residual * residual).sum::<f64>().sqrt();
        (0..x.len()).all(|k| {
            let column = jacobian.col(k);
            let along: f64 = column.iter().zip(&residuals).map(|(slope, residual)| slope * residual).sum();
            along.abs() <= ORTHOGONAL * (column.norm_l2() * norm).max(f64::MIN_POSITIVE)
        })
    }

    /// Slopes of data and pull, `[(b + 15n) x 15n]`; the residuals fall by them.
    fn jacobian(&self, x: &[f64]) -> Mat<f64> {
        let (b, width) = (self.map.len(), x.len());
        let slopes: Vec<[StandardParameters; 10]> =
            (0..self.n).map(|link| slopes(&self.link(x, link))).collect();
        Mat::from_fn(b + width, width, |i, k| {
            if i >= b {
                return if i - b == k { self.pull[k] } else { 0.0 };
            }
            let row = &self.map[i];
            let slope: f64 = if k < 10 * self.n {
                let (link, slope) = (k / 10, &slopes[k / 10][k % 10]);
                slope.0.iter().zip(&row[10 * link..]).map(|(slope, map)| slope * map).sum()
            } else if k < 14 * self.n {
                row[k]
            } else {
                row[k] * x[k].exp()
            };
            self.data_share * slope
        })
    }

    /// One damped Gauss-Newton step, shortened to the longest that is trusted.
    fn step(&self, x: &[f64], jacobian: &Mat<f64>, damping: f64) -> Result<Vec<f64>, NumericsError> {
        let (height, width) = (jacobian.nrows(), x.len());
        let residuals = self.residuals(x);
        let scales: Vec<f64> = (0..width).map(|k| jacobian.col(k).norm_l2().max(1e-9)).collect();
        let rows = Mat::from_fn(height + width, width + 1, |i, k| match (i < height, k < width) {
            (true, true) => jacobian[(i, k)],
            (true, false) => residuals[i],
            (false, true) if i - height == k => damping.sqrt() * scales[k],
            (false, _) => 0.0,
        });
        let mut factor = TriangularFactor::new(width);
        factor.fold(rows.as_ref());
        // The damping keeps the factor regular; no singular values are needed.
        let step = inverse_of_upper(&factor)? * factor.upper().submatrix(0, width, width, 1);
        let length = (0..width).map(|k| (self.reach[k] * step[(k, 0)]).abs()).fold(1.0, f64::max);
        Ok((0..width).map(|k| step[(k, 0)] / length).collect())
    }

    fn estimate(&self, x: &[f64], steps: usize, settled: bool) -> Result<PhysicalEstimate, NumericsError> {
        let phi = self.phi(x);
        if !phi.iter().all(|value| value.is_finite()) {
            return Err(NumericsError::NotFinite("the physically consistent parameters"));
        }
        let b = self.factor.columns();
        let inertial: Vec<StandardParameters> =
            (0..self.n).map(|link| from_log_cholesky(&self.link(x, link))).collect();
        Ok(PhysicalEstimate {
            definiteness: inertial.iter().map(definiteness).collect(),
            inertial,
            friction: (0..self.n).map(|j| std::array::from_fn(|k| x[10 * self.n + 4 * j + k])).collect(),
            motor_inertia: phi[14 * self.n..].to_vec(),
            residual_sum_of_squares: residual_sum_of_squares(self.factor, &self.base.group(&phi)),
            unconstrained_sum_of_squares: self.factor.upper()[(b, b)].powi(2),
            steps,
            settled,
        })
    }
}
