//! Full standard parameters that a body can have, from the factor of base parameters.

use faer::Mat;

use super::NumericsError;
use super::base::BaseParameters;
use super::covariance::inverse_of_upper;
use super::dynamics::DynamicModel;
use super::estimate::residual_sum_of_squares;
use super::physical_share::{BodyEstimate, Estimated, body_estimate};
use super::pseudo_inertia::{LogCholesky, definiteness, from_log_cholesky, lifted, slopes, to_log_cholesky};
use super::triangular::TriangularFactor;
use crate::robot::{ParameterId, ParameterKind, Robot, StandardParameters};

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
/// Standard deviation about zero of friction and coupling parameters, in their SI units: far beyond
/// any arm's, so that it decides only what neither data nor anything else does.
const FREE_STD: f64 = 1e4;

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
    /// All parameters: links are bodies, motor inertias positive, friction and couplings free.
    pub model: DynamicModel,
    /// The same in natural order, `phi` `[p]`.
    pub phi: Vec<f64>,
    /// Mass, centre of mass and inertia about it of the links `[n]`, and how far data decide them.
    pub bodies: Vec<BodyEstimate>,
    /// Motor inertias `[n]`, and how far data decide them.
    pub motor_inertia: Vec<Estimated>,
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
/// Minimises `|r11 G phi - r12|² + |(x - x_nominal) / s|²`, where `phi(x)` `[p]` are all parameters in
/// natural order, `x` `[p]` the log-Cholesky parameters of the links, the friction and coupling
/// parameters themselves and the logarithms of the motor inertias, and `G` groups full into base
/// parameters. Off-diagonal and centre entries of `x` are measured in the link's own nominal radius.
/// Friction and couplings are free: they are drawn to zero by 1e4 of their unit, which is nowhere.
/// Levenberg-Marquardt steps with the analytic Jacobian; each is solved by folding its rows into a
/// triangular factor.
///
/// # Errors
/// [`NumericsError::TooShort`] unless the nominal model has the robot's joints,
/// [`NumericsError::NotFinite`] if it has a motor inertia that is not positive or the data are not
/// finite.
pub fn physical(
    robot: &Robot,
    base: &BaseParameters,
    factor: &TriangularFactor,
    nominal: &NominalModel,
    settings: &PhysicalSettings,
) -> Result<PhysicalEstimate, NumericsError> {
    let n = robot.joint_count();
    let given = nominal.inertial.len().min(nominal.motor_inertia.len());
    if given != n || n == 0 {
        return Err(NumericsError::TooShort { what: "the nominal model", rows: given, needed: n.max(1) });
    }
    if !nominal.motor_inertia.iter().all(|inertia| inertia.is_finite() && *inertia > 0.0) {
        return Err(NumericsError::NotFinite("the logarithm of a nominal motor inertia"));
    }
    let mut problem = Problem::new(robot, base, factor, nominal, settings)?;
    let mut x = problem.nominal.clone();
    let (mut steps, mut settled) = (0, false);
    for share in DATA_SHARES {
        problem.data_share = share;
        (x, settled) = problem.descend(x, settings, &mut steps)?;
    }
    problem.estimate(robot, &x, steps, settled)
}

/// `r11 G` `[b x p]`: what the factor's rows see of each parameter in natural order.
pub(super) fn seen_by_factor(base: &BaseParameters, factor: &TriangularFactor, p: usize) -> Mat<f64> {
    let (r, b) = (factor.upper(), factor.columns());
    let mut map = Mat::zeros(b, p);
    for k in 0..b {
        for i in 0..=k {
            map[(i, base.kept_columns[k])] += r[(i, k)];
            for term in &base.grouping[k] {
                map[(i, term.column)] += r[(i, k)] * term.coefficient;
            }
        }
    }
    map
}

/// The least-squares problem in `x` `[p]`: ten a link, then whatever the robot has beside links.
struct Problem<'a> {
    factor: &'a TriangularFactor,
    base: &'a BaseParameters,
    n: usize,
    /// Whether `x` is the logarithm of the parameter, `[p]`.
    logarithmic: Vec<bool>,
    /// `r11 G` times the root of the independent share, `[b x p]`, and `r12` likewise.
    map: Mat<f64>,
    right: Vec<f64>,
    /// Nominal `x` and one over its spread.
    nominal: Vec<f64>,
    pull: Vec<f64>,
    /// One over the longest step; 0 where any is fine.
    reach: Vec<f64>,
    data_share: f64,
}

impl<'a> Problem<'a> {
    fn new(
        robot: &Robot,
        base: &'a BaseParameters,
        factor: &'a TriangularFactor,
        nominal: &NominalModel,
        settings: &PhysicalSettings,
    ) -> Result<Self, NumericsError> {
        let (n, b) = (robot.joint_count(), factor.columns());
        let ids = ParameterId::natural_order(robot);
        let root = settings.independent_fraction.sqrt();
        let map = seen_by_factor(base, factor, ids.len()) * faer::Scale(root);
        let right = (0..b).map(|i| root * factor.upper()[(i, b)]).collect();
        let (mut x, mut pull) = (Vec::with_capacity(ids.len()), Vec::with_capacity(ids.len()));
        for link in &nominal.inertial {
            let start = to_log_cholesky(link)
                .or_else(|| to_log_cholesky(&lifted(link)))
                .ok_or(NumericsError::NotFinite("the nominal inertia of a link"))?;
            let radius = ((start[1] + start[2] + start[3]) / 3.0).exp();
            x.extend(start);
            pull.extend([1.0 / settings.prior_std; 4]);
            pull.extend([1.0 / (radius * settings.prior_std); 6]);
        }
        for id in &ids[x.len()..] {
            let motor = id.kind == ParameterKind::MotorInertia;
            x.push(if motor { nominal.motor_inertia[id.joint.index()].ln() } else { 0.0 });
            pull.push(if motor { 1.0 / settings.prior_std } else { 1.0 / FREE_STD });
        }
        let stepped =
            |kind: ParameterKind| matches!(kind, ParameterKind::Inertial(_) | ParameterKind::MotorInertia);
        let reach = pull
            .iter()
            .zip(&ids)
            .map(|(pull, id)| if stepped(id.kind) { pull * settings.prior_std / LONGEST_STEP } else { 0.0 });
        let reach = reach.collect();
        let logarithmic = ids.iter().map(|id| id.kind == ParameterKind::MotorInertia).collect();
        Ok(Self { factor, base, n, logarithmic, map, right, nominal: x, pull, reach, data_share: 1.0 })
    }

    fn link(&self, x: &[f64], link: usize) -> LogCholesky {
        std::array::from_fn(|k| x[StandardParameters::COUNT * link + k])
    }

    /// All parameters in natural order, `[p]`.
    fn phi(&self, x: &[f64]) -> Vec<f64> {
        let links = StandardParameters::COUNT * self.n;
        let mut phi: Vec<f64> =
            (0..self.n).flat_map(|link| from_log_cholesky(&self.link(x, link)).0).collect();
        let beside = x.iter().zip(&self.logarithmic).skip(links);
        phi.extend(beside.map(|(x, logarithmic)| if *logarithmic { x.exp() } else { *x }));
        phi
    }

    fn residuals(&self, x: &[f64]) -> Vec<f64> {
        let phi = self.phi(x);
        let data = self.right.iter().enumerate().map(|(i, right)| {
            let row = self.map.row(i);
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

    /// Slopes of data and pull, `[(b + p) x p]`; the residuals fall by them.
    fn jacobian(&self, x: &[f64]) -> Mat<f64> {
        let (b, p) = (self.right.len(), x.len());
        let links = StandardParameters::COUNT * self.n;
        let mut jacobian = Mat::zeros(b + p, p);
        for link in 0..self.n {
            let first = StandardParameters::COUNT * link;
            for (k, slope) in slopes(&self.link(x, link)).iter().enumerate() {
                for i in 0..b {
                    let along = (0..slope.0.len()).map(|m| slope.0[m] * self.map[(i, first + m)]);
                    jacobian[(i, first + k)] = self.data_share * along.sum::<f64>();
                }
            }
        }
        for k in links..p {
            let slope = if self.logarithmic[k] { x[k].exp() } else { 1.0 };
            for i in 0..b {
                jacobian[(i, k)] = self.data_share * slope * self.map[(i, k)];
            }
        }
        for (k, pull) in self.pull.iter().enumerate() {
            jacobian[(b + k, k)] = *pull;
        }
        jacobian
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

    fn estimate(
        &self,
        robot: &Robot,
        x: &[f64],
        steps: usize,
        settled: bool,
    ) -> Result<PhysicalEstimate, NumericsError> {
        let phi = self.phi(x);
        if !phi.iter().all(|value| value.is_finite()) {
            return Err(NumericsError::NotFinite("the physically consistent parameters"));
        }
        let b = self.factor.columns();
        let ids = ParameterId::natural_order(robot);
        let model = DynamicModel::from_parameters(robot, ids.iter().copied().zip(phi.iter().copied()));
        // Columns of (J'J)^-1/2: the squares of a row's entries add up to the variance of its `x`.
        let root = self.covariance_root(x)?;
        let bodies = (0..self.n).map(|link| {
            let first = StandardParameters::COUNT * link;
            let own = root.as_ref().subrows(first, StandardParameters::COUNT);
            let pull = &self.pull[first..first + StandardParameters::COUNT];
            body_estimate(&model.inertial[link], &slopes(&self.link(x, link)), own, pull)
        });
        let motors = (0..x.len()).filter(|k| self.logarithmic[*k]).map(|k| Estimated {
            value: phi[k],
            std: phi[k] * root.row(k).norm_l2(),
            std_without_data: phi[k] / self.pull[k],
        });
        Ok(PhysicalEstimate {
            bodies: bodies.collect(),
            motor_inertia: motors.collect(),
            definiteness: model.inertial.iter().map(definiteness).collect(),
            residual_sum_of_squares: residual_sum_of_squares(self.factor, &self.base.group(&phi)),
            unconstrained_sum_of_squares: self.factor.upper()[(b, b)].powi(2),
            model,
            phi,
            steps,
            settled,
        })
    }

    fn covariance_root(&self, x: &[f64]) -> Result<Mat<f64>, NumericsError> {
        let jacobian = self.jacobian(x);
        let mut factor = TriangularFactor::new(x.len());
        let right = x.len();
        let rows =
            Mat::from_fn(jacobian.nrows(), right + 1, |i, k| if k < right { jacobian[(i, k)] } else { 0.0 });
        factor.fold(rows.as_ref());
        inverse_of_upper(&factor)
    }
}
