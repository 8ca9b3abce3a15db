//! Full standard parameters that are physically possible, from the factor of base parameters.
//!
//! The problem is convex. Its cost is the data's sum of squares plus, for each link, the log-det (entropic) divergence
//! of its pseudo-inertia from the nominal one, which grows without bound at the border of physical bodies (Lee, Wensing
//! & Park 2020). So the solution is unique, independent of the start, and a physical body.

use faer::Mat;
use nalgebra::Matrix4;

use super::data_share::{BodyEstimate, Estimated, body_estimate};
use super::pseudo_inertia::{coordinates, definiteness, directions, lifted, pseudo_inertia, symmetric};
use crate::NumericsError;
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::orthonormal::dot;
use crate::model::base_parameters::BaseParameters;
use crate::model::dynamics::DynamicModel;
use armwatch_model::robot::{ParameterId, ParameterKind, Robot, StandardParameters};

/// Factor of the data's weight from one descent to the next, which starts at the end of the previous one: near a
/// solution Newton's method takes full steps.
const SHARE_STEP: f64 = 3.0;
/// Smallest initial weight of the data.
const LEAST_SHARE: f64 = 1e-9;
/// Largest part of the distance to the border of physical bodies that a step covers.
const TO_THE_BORDER: f64 = 0.99;
/// Halvings in the search for the minimum along a step.
const HALVINGS: usize = 40;
/// Largest length of Newton's step for the decrement to estimate the distance of the cost from its minimum (Nesterov &
/// Nemirovskii 1994). The unit makes the prior's curvature one.
const LOCAL: f64 = 0.25;
/// Standard deviation about zero of friction and coupling parameters, in their SI units. It is far above the values of
/// any arm, so it decides only parameters that nothing else decides.
const FREE_STD: f64 = 1e4;

/// Settings of the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PhysicalSettings {
    /// Relative standard deviation of a nominal pseudo-inertia in each direction, such as that of a mass, and of a
    /// nominal motor inertia. It decides the part of the full set that data do not decide.
    pub prior_std: f64,
    /// Share of the data's rows that are independent.
    pub independent_fraction: f64,
    /// Largest number of steps at each weight of the data.
    pub max_steps: usize,
    /// Largest Newton decrement of a converged fit, unless the step is long. Its unit is the noise variance; it is
    /// relative to the cost if that exceeds one.
    pub settled: f64,
}

impl Default for PhysicalSettings {
    fn default() -> Self {
        Self { prior_std: 2.0, independent_fraction: 1.0, max_steps: 200, settled: 1e-6 }
    }
}

/// Start and prior of the fit.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalModel {
    /// Inertial parameters of the links `[n]`. Those that are not physical are moved to a physical body.
    pub inertial: Vec<StandardParameters>,
    /// Motor inertias `[n]`, positive.
    pub motor_inertia: Vec<f64>,
}

/// Result of a fit of full parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalEstimate {
    /// All parameters: links are bodies, motor inertias positive, friction and couplings free.
    pub model: DynamicModel,
    /// All parameters in natural order, `phi` `[p]`.
    pub phi: Vec<f64>,
    /// Mass, centre of mass and inertia about it of the links `[n]`, with their uncertainty with and without data.
    pub bodies: Vec<BodyEstimate>,
    /// Motor inertias `[n]`, with their uncertainty with and without data.
    pub motor_inertia: Vec<Estimated>,
    /// Smallest over largest eigenvalue of each link's pseudo-inertia, `[n]`.
    pub definiteness: Vec<f64>,
    /// Residual sum of squares of the data.
    pub residual_sum_of_squares: f64,
    /// Residual sum of squares of unconstrained base parameters. The difference is the cost of the physical
    /// constraints.
    pub unconstrained_sum_of_squares: f64,
    /// Number of steps.
    pub steps: usize,
    /// True if the fit has converged: the gain of another step is far below the noise.
    pub settled: bool,
}

/// Fits the full set of standard parameters, physically consistent, to the factor of
/// `[w | tau]` of the base parameters, in units of the noise.
///
/// Minimises over all parameters `phi` `[p]` in natural order
/// `|r11 G phi - r12|² + 2/s² sum_links D(J, J0) + 2/s² sum_motors (k - ln k - 1)`. `G` groups full
/// into base parameters. `D = tr(J0⁻¹ J) - ln det(J0⁻¹ J) - 4` for the pseudo-inertia `J` of a link and its
/// nominal one. `k` is a motor's inertia over its nominal one, and `s` the prior's standard deviation. Friction
/// and couplings are free except for a very weak prior about zero with the standard deviation 1e4 in their unit.
/// Newton's method minimises the cost along each step while the weight of the data grows. Each step is a
/// least-squares problem in the coordinates of `directions`, solved by folding its rows into a triangular factor.
///
/// # Errors
/// [`NumericsError::TooShort`] unless the nominal model has the robot's joints, [`NumericsError::NotFinite`] if it has
/// a motor inertia that is not positive or the data are not finite.
pub(crate) fn physical(
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
    let mut problem = ConvexProblem::new(robot, base, factor, nominal, settings)?;
    let mut phi = problem.nominal.clone();
    // at the start, data cost no more than a single row of noise
    let residuals = problem.data_residuals(&phi);
    problem.data_share = (1.0 / dot(&residuals, &residuals).sqrt().max(1.0)).max(LEAST_SHARE);
    let mut steps = 0;
    loop {
        let (end, settled) = problem.descend(phi, settings, &mut steps)?;
        if problem.data_share >= 1.0 {
            return problem.estimate(robot, end, steps, settled);
        }
        phi = end;
        problem.data_share = (SHARE_STEP * problem.data_share).min(1.0);
    }
}

/// `r11 G` `[b x p]`: sensitivity of the factor's rows to each parameter in natural order.
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

/// Convex problem in `phi` `[p]`: ten parameters per link, then all others.
struct ConvexProblem<'a> {
    factor: &'a TriangularFactor,
    base: &'a BaseParameters,
    ids: Vec<ParameterId>,
    /// `r11 G` times the root of the independent share, `[b x p]`, and `r12` times the same.
    map: Mat<f64>,
    right: Vec<f64>,
    /// Nominal `phi`, and the inverses of the links' nominal pseudo-inertias `[n]`.
    nominal: Vec<f64>,
    inverse: Vec<Matrix4<f64>>,
    /// Inverse of the prior's standard deviation.
    firmness: f64,
    data_share: f64,
}

/// Coordinates about a point such that the prior's curvature is the same in all directions.
struct Local {
    /// Lower factors of the links' pseudo-inertias `[n]`.
    lower: Vec<Matrix4<f64>>,
    /// Change of each link's parameters per coordinate, `[n][10]`.
    links: Vec<[StandardParameters; 10]>,
    /// Change of the other parameters per coordinate, `[p - 10n]`.
    beside: Vec<f64>,
}

impl<'a> ConvexProblem<'a> {
    fn new(
        robot: &Robot,
        base: &'a BaseParameters,
        factor: &'a TriangularFactor,
        nominal: &NominalModel,
        settings: &PhysicalSettings,
    ) -> Result<Self, NumericsError> {
        let b = factor.columns();
        let ids = ParameterId::natural_order(robot);
        let root = settings.independent_fraction.sqrt();
        let map = seen_by_factor(base, factor, ids.len()) * faer::Scale(root);
        let right = (0..b).map(|i| root * factor.upper()[(i, b)]).collect();
        let (mut phi, mut inverse) = (Vec::with_capacity(ids.len()), Vec::new());
        for link in &nominal.inertial {
            let body = if definiteness(link) > 0.0 { *link } else { lifted(link) };
            let cholesky = pseudo_inertia(&body).cholesky();
            inverse
                .push(cholesky.ok_or(NumericsError::NotFinite("the nominal inertia of a link"))?.inverse());
            phi.extend(body.0);
        }
        for id in &ids[phi.len()..] {
            let motor = id.kind == ParameterKind::MotorInertia;
            phi.push(if motor { nominal.motor_inertia[id.joint.index()] } else { 0.0 });
        }
        let firmness = 1.0 / settings.prior_std;
        Ok(Self { factor, base, ids, map, right, nominal: phi, inverse, firmness, data_share: 1.0 })
    }

    fn link(&self, phi: &[f64], link: usize) -> StandardParameters {
        StandardParameters(std::array::from_fn(|k| phi[StandardParameters::COUNT * link + k]))
    }

    fn links(&self) -> usize {
        self.inverse.len()
    }

    fn is_motor(&self, k: usize) -> bool {
        self.ids[k].kind == ParameterKind::MotorInertia
    }

    /// Returns the local coordinates; `None` if a link is not physical or a motor's inertia is not positive.
    fn local(&self, phi: &[f64]) -> Option<Local> {
        let lower: Option<Vec<Matrix4<f64>>> = (0..self.links())
            .map(|link| Some(pseudo_inertia(&self.link(phi, link)).cholesky()?.l()))
            .collect();
        let first = StandardParameters::COUNT * self.links();
        let beside = (first..phi.len()).map(|k| if self.is_motor(k) { phi[k] } else { 1.0 });
        let beside: Vec<f64> = beside.collect();
        let lower = lower?;
        beside.iter().all(|scale| *scale > 0.0).then(|| Local {
            links: lower.iter().map(directions).collect(),
            lower,
            beside,
        })
    }

    /// Change of the data's prediction by parameters or by their change, weighted.
    fn seen(&self, phi: &[f64]) -> Vec<f64> {
        let row = |i| self.map.row(i).iter().zip(phi).map(|(map, phi)| map * phi).sum::<f64>();
        (0..self.right.len()).map(|i| self.data_share * row(i)).collect()
    }

    fn data_residuals(&self, phi: &[f64]) -> Vec<f64> {
        self.seen(phi).iter().zip(&self.right).map(|(seen, right)| self.data_share * right - seen).collect()
    }

    /// Cost to minimise; infinite if a link or a motor is not physical.
    fn cost(&self, phi: &[f64]) -> f64 {
        let data: f64 = self.data_residuals(phi).iter().map(|residual| residual * residual).sum();
        let divergence = (0..self.links()).map(|link| {
            let j = pseudo_inertia(&self.link(phi, link));
            let ratio = self.inverse[link] * j;
            match j.cholesky() {
                Some(_) => ratio.trace() - ratio.determinant().ln() - 4.0,
                None => f64::INFINITY,
            }
        });
        let beside = (StandardParameters::COUNT * self.links()..phi.len()).map(|k| {
            if !self.is_motor(k) {
                return (phi[k] / FREE_STD).powi(2);
            }
            let ratio = phi[k] / self.nominal[k];
            let own = if ratio > 0.0 { ratio - ratio.ln() - 1.0 } else { f64::INFINITY };
            2.0 * self.firmness.powi(2) * own
        });
        data + 2.0 * self.firmness.powi(2) * divergence.sum::<f64>() + beside.sum::<f64>()
    }

    /// Weight of each coordinate in the prior, `[p]`.
    fn weights(&self) -> Vec<f64> {
        let first = StandardParameters::COUNT * self.links();
        let free = |k: usize| k >= first && !self.is_motor(k);
        (0..self.ids.len()).map(|k| if free(k) { 1.0 / FREE_STD } else { self.firmness }).collect()
    }

    /// Factor of the least-squares problem of Newton's step in local coordinates: the rows of the data, then one row
    /// per coordinate, `w s = -w g` with the prior's slope `g`.
    fn newton(&self, phi: &[f64], local: &Local) -> TriangularFactor {
        let (b, p) = (self.right.len(), phi.len());
        let first = StandardParameters::COUNT * self.links();
        let mut rows = Mat::zeros(b + p, p + 1);
        let (residuals, weights) = (self.data_residuals(phi), self.weights());
        for (i, residual) in residuals.iter().enumerate() {
            for (k, along) in local.links.iter().flatten().enumerate() {
                let link = StandardParameters::COUNT * (k / StandardParameters::COUNT);
                let seen = along.0.iter().enumerate().map(|(m, along)| along * self.map[(i, link + m)]);
                rows[(i, k)] = self.data_share * seen.sum::<f64>();
            }
            for (k, scale) in (first..p).zip(&local.beside) {
                rows[(i, k)] = self.data_share * scale * self.map[(i, k)];
            }
            rows[(i, p)] = *residual;
        }
        for (k, (weight, slope)) in weights.iter().zip(self.slopes(phi, local)).enumerate() {
            rows[(b + k, k)] = *weight;
            rows[(b + k, p)] = -weight * slope;
        }
        let mut factor = TriangularFactor::new(p);
        factor.fold(rows.as_ref());
        factor
    }

    /// Slope of the prior by each coordinate over its curvature, `[p]`: `Lᵀ J0⁻¹ L - 1` of a link,
    /// `k - 1` of a motor.
    fn slopes(&self, phi: &[f64], local: &Local) -> Vec<f64> {
        let of_link = |(l, inverse): (&Matrix4<f64>, &Matrix4<f64>)| {
            coordinates(&(l.transpose() * inverse * l - Matrix4::identity()))
        };
        let mut slopes: Vec<f64> = local.lower.iter().zip(&self.inverse).flat_map(of_link).collect();
        let beside = (slopes.len()..phi.len()).map(|k| match self.is_motor(k) {
            true => phi[k] / self.nominal[k] - 1.0,
            false => phi[k],
        });
        slopes.extend(beside.collect::<Vec<f64>>());
        slopes
    }

    /// Newton's method from `phi` at one weight of the data. Returns the end point, and true if it converged.
    fn descend(
        &self,
        mut phi: Vec<f64>,
        settings: &PhysicalSettings,
        steps: &mut usize,
    ) -> Result<(Vec<f64>, bool), NumericsError> {
        let p = phi.len();
        for _ in 0..settings.max_steps {
            *steps += 1;
            let Some(local) = self.local(&phi) else { return Ok((phi, false)) };
            let factor = self.newton(&phi, &local);
            let right = factor.upper().submatrix(0, p, p, 1);
            let decrement = right.col(0).squared_norm_l2();
            let s = factor.inverse_of_upper()? * right;
            let s: Vec<f64> = (0..p).map(|k| s[(k, 0)]).collect();
            let change = local.change(&s);
            let cost = self.cost(&phi);
            let is_local = decrement <= (LOCAL * self.firmness).powi(2);
            let settled = is_local && decrement <= settings.settled * cost.max(1.0);
            // for the last step, rounding hides the slope
            let part = if settled { 1.0 } else { self.lowest(&phi, &change, &local, &s) };
            let moved: Vec<f64> = phi.iter().zip(&change).map(|(x, dx)| x + part * dx).collect();
            let is_better = self.cost(&moved) <= cost;
            if is_better {
                phi = moved;
            }
            if settled || !is_better {
                return Ok((phi, settled));
            }
        }
        Ok((phi, false))
    }

    /// Part of a step that minimises the cost. The cost is convex along the step, so this is the only root of its
    /// slope.
    fn lowest(&self, phi: &[f64], change: &[f64], local: &Local, s: &[f64]) -> f64 {
        let first = StandardParameters::COUNT * self.links();
        let (links, beside) = s.split_at(first);
        let [fixed, seen] = [self.data_residuals(phi), self.seen(change)];
        let data = [dot(&seen, &seen), dot(&fixed, &seen)];
        let eigenvalues: Vec<f64> = links
            .chunks_exact(StandardParameters::COUNT)
            .flat_map(|s| symmetric(s).symmetric_eigenvalues().as_slice().to_vec())
            .chain((first..phi.len()).zip(beside).filter(|(k, _)| self.is_motor(*k)).map(|(_, s)| *s))
            .collect();
        let of_link = |link: usize| (self.inverse[link] * pseudo_inertia(&self.link(change, link))).trace();
        let of_motor = |k: usize| change[k] / self.nominal[k];
        let trace = (0..self.links()).map(of_link).sum::<f64>()
            + (first..phi.len()).filter(|k| self.is_motor(*k)).map(of_motor).sum::<f64>();
        let free = (first..phi.len()).filter(|k| !self.is_motor(*k));
        let free = free.fold([0.0; 2], |[square, product], k| {
            [square + (change[k] / FREE_STD).powi(2), product + phi[k] * change[k] / FREE_STD.powi(2)]
        });
        let slope = |part: f64| {
            let barrier: f64 = eigenvalues.iter().map(|value| value / (1.0 + part * value)).sum();
            part * data[0] - data[1] + self.firmness.powi(2) * (trace - barrier) + free[0] * part + free[1]
        };
        let (mut low, mut high) = (0.0, (TO_THE_BORDER * local.border(s, |k| self.is_motor(k))).min(1.0));
        if slope(high) <= 0.0 {
            return high;
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            *(if slope(middle) < 0.0 { &mut low } else { &mut high }) = middle;
        }
        low
    }

    fn estimate(
        &self,
        robot: &Robot,
        phi: Vec<f64>,
        steps: usize,
        settled: bool,
    ) -> Result<PhysicalEstimate, NumericsError> {
        let nowhere = NumericsError::NotFinite("the physically consistent parameters");
        if !phi.iter().all(|value| value.is_finite()) {
            return Err(nowhere);
        }
        let local = self.local(&phi).ok_or(nowhere)?;
        let b = self.factor.columns();
        let pairs = self.ids.iter().copied().zip(phi.iter().copied());
        let model = DynamicModel::from_parameters(robot, pairs);
        // the squares of a row's entries add up to the variance of its coordinate
        let root = self.newton(&phi, &local).inverse_of_upper()?;
        let bodies = local.links.iter().enumerate().map(|(link, along)| {
            let first = StandardParameters::COUNT * link;
            let own = root.as_ref().subrows(first, StandardParameters::COUNT);
            body_estimate(&model.inertial[link], along, own, &[self.firmness; 10])
        });
        let motors = (0..phi.len()).filter(|k| self.is_motor(*k)).map(|k| Estimated {
            value: phi[k],
            std: phi[k] * root.row(k).norm_l2(),
            std_without_data: phi[k] / self.firmness,
        });
        Ok(PhysicalEstimate {
            bodies: bodies.collect(),
            motor_inertia: motors.collect(),
            definiteness: model.inertial.iter().map(definiteness).collect(),
            residual_sum_of_squares: self.factor.residual_sum_of_squares(&self.base.group(&phi)),
            unconstrained_sum_of_squares: self.factor.upper()[(b, b)].powi(2),
            model,
            phi,
            steps,
            settled,
        })
    }
}

impl Local {
    /// Change of all parameters `[p]` for the coordinates `s` `[p]`.
    fn change(&self, s: &[f64]) -> Vec<f64> {
        let (of_links, of_others) = s.split_at(StandardParameters::COUNT * self.links.len());
        let link = |(along, s): (&[StandardParameters; 10], &[f64])| -> [f64; 10] {
            std::array::from_fn(|m| along.iter().zip(s).map(|(along, s)| s * along.0[m]).sum())
        };
        let links = self.links.iter().zip(of_links.chunks_exact(StandardParameters::COUNT)).flat_map(link);
        links.chain(self.beside.iter().zip(of_others).map(|(scale, s)| scale * s)).collect()
    }

    /// Largest part of the step `s` `[p]` that keeps all links and motors physical; infinite if there is no limit.
    fn border(&self, s: &[f64], is_motor: impl Fn(usize) -> bool) -> f64 {
        let first = StandardParameters::COUNT * self.links.len();
        let links = s[..first].chunks_exact(StandardParameters::COUNT);
        let smallest = links.map(|s| symmetric(s).symmetric_eigenvalues().min());
        let motors = (first..s.len()).filter(|k| is_motor(*k)).map(|k| s[k]);
        let worst = smallest.chain(motors).fold(0.0, f64::min);
        if worst < 0.0 { -1.0 / worst } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests;
