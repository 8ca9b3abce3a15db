//! Friction as a function of speed from plateau points: Coulomb, viscous, Stribeck, power law, polynomial [3.10].
//!
//! Each form is linear except for at most one parameter (exponent or Stribeck speed). The search for that parameter is
//! one-dimensional and bounded, and solves for the linear ones at each step (variable projection, Golub & Pereyra 1973;
//! a line search because the bounds matter). Friction never drives: coefficients that would be negative become zero,
//! and a polynomial with negative values is refused.

use nalgebra::{DMatrix, DVector};

use super::golden_section::least_between;
use super::separable::{Terms, on_gradient};
use crate::NumericsError;
use crate::statistics::information::corrected_akaike;
use armwatch_model::analysis::friction::{Asymmetry, JointSpeedFits, SpeedCoefficient, SpeedFit, SpeedModel};
use armwatch_model::analysis::{Estimate, FrictionPoint};
use armwatch_model::robot::JointIndex;

/// Smallest number of different speeds of a curve.
const MIN_SPEEDS: usize = 2;

/// Relative difference of speeds below which they are one level.
const SAME_SPEED: f64 = 0.05;

/// Smallest relative error of a point: rows of a torque signal without noise are still rounded.
const MIN_RELATIVE_ERROR: f64 = 1e-4;

/// Number of standard errors that a part beyond Coulomb and viscous friction must exceed to be supported.
const MIN_SIGNIFICANCE: f64 = 2.0;

/// Bounds of the exponent of the power law: measured gears show 0.3 to 2, and a smaller exponent is indistinguishable
/// from a Coulomb part.
const EXPONENT: [f64; 2] = [0.1, 3.0];

/// Bounds of the Stribeck speed: from this fraction of the slowest measured speed to this fraction of the fastest.
/// Points do not show a smaller value (`exp(-4)` remains of it), and a larger one is curvature.
const STRIBECK: [f64; 2] = [0.5, 0.5];

/// Number of grid intervals over the bounds; the minimum is then refined between the neighbours of the best grid point.
const GRID: usize = 24;

/// Number of speeds for checking the sign of a polynomial.
const SIGN_PLACES: usize = 50;

/// Friction over speed of one joint, both directions, in the form that the data support.
///
/// `points` are plateaus of one cycle, or of equally warm cycles; those of other joints are ignored. A point's error is
/// its rows' standard deviation over the root of the number of independent rows. `independent_fraction` (0 to 1) is the
/// part of the rows that is independent after the low-pass. A form needs one speed more than it has parameters, except
/// Coulomb-viscous friction, which two speeds determine without a check.
///
/// The form is chosen for both directions together by the corrected Akaike criterion (Hurvich & Tsai 1989) of the
/// independent rows, with the scatter beyond the points' errors as variance inflation (Burnham & Anderson 2002, QAICc).
/// Standard errors have the same inflation.
///
/// # Errors
/// [`NumericsError::TooFewSpeeds`] with fewer than two different speeds in every direction,
/// [`NumericsError::NotFinite`] for values that are not finite.
pub fn friction_over_speed(
    joint: JointIndex,
    points: &[FrictionPoint],
    independent_fraction: f64,
) -> Result<JointSpeedFits, NumericsError> {
    let mut remarks = Vec::new();
    let sides = sides(joint, points, independent_fraction, &mut remarks)?;
    let speeds = sides.iter().map(|side| side.speeds).min().unwrap_or(0);
    let tried: Vec<(SpeedModel, Vec<Raw>)> = SpeedModel::ALL
        .into_iter()
        .filter(|model| needed_speeds(*model) <= speeds)
        .filter_map(|model| Some((model, sides.iter().map(|side| fit(side, model)).collect::<Option<_>>()?)))
        .collect();
    let inflation = tried
        .iter()
        .filter_map(|(_, raws)| reduced(raws, &sides))
        .fold(f64::INFINITY, f64::min)
        .clamp(1.0, f64::MAX);
    let inflation =
        if tried.iter().any(|(_, raws)| reduced(raws, &sides).is_some()) { inflation } else { 1.0 };
    let criteria: Vec<(SpeedModel, f64)> =
        tried.iter().map(|(model, raws)| (*model, criterion(raws, &sides, inflation))).collect();
    let chosen = tried
        .iter()
        .zip(&criteria)
        .filter(|((model, raws), _)| raws.iter().any(|raw| supported(*model, raw, inflation)))
        .min_by(|a, b| a.1.1.total_cmp(&b.1.1))
        .map(|(tried, _)| tried)
        .ok_or(NumericsError::NotFinite("friction over speed"))?;
    note_levels(joint, speeds, chosen.0, &mut remarks);
    Ok(JointSpeedFits {
        joint,
        directions: sides.iter().zip(&chosen.1).map(|(side, raw)| raw.published(side, inflation)).collect(),
        asymmetry: asymmetry(&sides),
        criteria,
        remarks,
    })
}

/// Fits one form to one direction of a joint's points, even if the data do not support it.
///
/// # Errors
/// Those of [`friction_over_speed`]; [`NumericsError::NotFinite`] also if the form has no fit inside its bounds.
#[cfg(test)]
fn fit_speed_model(
    joint: JointIndex,
    points: &[FrictionPoint],
    independent_fraction: f64,
    model: SpeedModel,
    direction: i8,
) -> Result<SpeedFit, NumericsError> {
    let sides = sides(joint, points, independent_fraction, &mut Vec::new())?;
    let side = sides.iter().find(|side| side.direction == direction);
    let side =
        side.filter(|side| side.speeds >= needed_speeds(model)).ok_or(NumericsError::TooFewSpeeds {
            joint,
            speeds: side.map_or(0, |side| side.speeds),
            needed: needed_speeds(model),
        })?;
    let raw = fit(side, model).ok_or(NumericsError::NotFinite("the friction curve inside its bounds"))?;
    let inflation = reduced(std::slice::from_ref(&raw), std::slice::from_ref(side)).unwrap_or(1.0).max(1.0);
    Ok(raw.published(side, inflation))
}

/// Friction of a fitted curve at `speed` (positive, rad/s), Nm, with its standard error.
#[must_use]
#[cfg(test)]
fn friction_at_speed(fit: &SpeedFit, speed: f64) -> Estimate {
    let x: Vec<f64> = fit.coefficients.iter().map(|c| c.estimate.value).collect();
    let (value, slopes) = match (fit.model, &x[..]) {
        (SpeedModel::Coulomb, [fc]) => (*fc, vec![1.0]),
        (SpeedModel::CoulombViscous, [fc, fv]) => (fc + fv * speed, vec![1.0, speed]),
        (SpeedModel::PowerLaw, [fc, fp, exponent]) => {
            let ratio = speed / fit.speeds[1];
            let power = ratio.powf(*exponent);
            let by_exponent = if ratio > 0.0 { fp * power * ratio.ln() } else { 0.0 };
            (fc + fp * power, vec![1.0, power, by_exponent])
        }
        (SpeedModel::Stribeck, [fc, fv, fs, vs]) => {
            let ratio = speed / vs;
            let bump = (-ratio * ratio).exp();
            let by_vs = fs * bump * 2.0 * ratio * ratio / vs;
            (fc + fv * speed + fs * bump, vec![1.0, speed, bump, by_vs])
        }
        (_, x) => {
            let powers: Vec<f64> = (0..4).map(|k| speed.powi(k)).collect();
            (x.iter().zip(&powers).map(|(x, power)| x * power).sum(), powers)
        }
    };
    let n = slopes.len();
    let variance: f64 = (0..n)
        .flat_map(|i| (0..n).map(move |j| (i, j)))
        .map(|(i, j)| slopes[i] * fit.covariance[i * n + j] * slopes[j])
        .sum();
    Estimate { value, std_error: variance.max(0.0).sqrt() }
}

/// Points of one direction, with speeds as fractions of the largest.
struct Side {
    direction: i8,
    top: f64,
    slowest: f64,
    u: Vec<f64>,
    tau: Vec<f64>,
    weight: Vec<f64>,
    independent_rows: f64,
    speeds: usize,
}

fn sides(
    joint: JointIndex,
    points: &[FrictionPoint],
    independent_fraction: f64,
    remarks: &mut Vec<String>,
) -> Result<Vec<Side>, NumericsError> {
    let mut sides = Vec::new();
    let mut most = 0;
    for direction in [-1_i8, 1] {
        let of_side = points.iter().filter(|p| p.joint == joint && p.direction == direction);
        let side = side(direction, &of_side.copied().collect::<Vec<_>>(), independent_fraction)?;
        most = most.max(side.speeds);
        if side.speeds >= MIN_SPEEDS {
            sides.push(side);
        } else {
            let speeds = side.speeds;
            remarks
                .push(format!("joint {joint}: {speeds} speed(s) in direction {direction:+}, no curve there"));
        }
    }
    if sides.is_empty() {
        return Err(NumericsError::TooFewSpeeds { joint, speeds: most, needed: MIN_SPEEDS });
    }
    Ok(sides)
}

fn side(direction: i8, points: &[FrictionPoint], independent_fraction: f64) -> Result<Side, NumericsError> {
    let finite = |p: &FrictionPoint| p.speed.is_finite() && p.speed > 0.0 && p.torque.is_finite();
    if !points.iter().all(finite) {
        return Err(NumericsError::NotFinite("a friction point's speed or torque"));
    }
    let top = points.iter().map(|p| p.speed).fold(0.0, f64::max);
    let independent = |p: &FrictionPoint| (p.samples as f64 * independent_fraction).max(1.0);
    let along = |p: &FrictionPoint| p.torque * f64::from(p.direction);
    let weight = |p: &FrictionPoint| {
        let floor = MIN_RELATIVE_ERROR * p.torque.abs().max(f64::MIN_POSITIVE);
        let spread = if p.std.is_finite() { p.std / independent(p).sqrt() } else { 0.0 };
        1.0 / spread.hypot(floor).powi(2)
    };
    let mut sorted: Vec<f64> = points.iter().map(|p| p.speed).collect();
    sorted.sort_by(f64::total_cmp);
    let slowest = sorted.first().copied().unwrap_or(0.0);
    let steps = sorted.windows(2).filter(|w| w[1] > w[0] * (1.0 + SAME_SPEED)).count();
    Ok(Side {
        direction,
        top,
        slowest,
        u: points.iter().map(|p| p.speed / top).collect(),
        tau: points.iter().map(along).collect(),
        weight: points.iter().map(weight).collect(),
        independent_rows: points.iter().map(independent).sum(),
        speeds: if points.is_empty() { 0 } else { steps + 1 },
    })
}

fn needed_speeds(model: SpeedModel) -> usize {
    match model {
        SpeedModel::Coulomb | SpeedModel::CoulombViscous => MIN_SPEEDS,
        other => other.coefficient_names().len() + 1,
    }
}

fn note_levels(joint: JointIndex, speeds: usize, chosen: SpeedModel, remarks: &mut Vec<String>) {
    let untried: Vec<&str> = SpeedModel::ALL
        .into_iter()
        .filter(|model| needed_speeds(*model) > speeds)
        .map(SpeedModel::name)
        .collect();
    if !untried.is_empty() {
        remarks.push(format!(
            "joint {joint}: {speeds} speeds do not support the forms {}; {} is taken",
            untried.join(", "),
            chosen.name()
        ));
    }
}

/// Fit with speeds as fractions of the largest.
struct Raw {
    model: SpeedModel,
    /// Linear coefficients, then the logarithm of the nonlinear one, if any.
    x: Vec<f64>,
    free: Vec<bool>,
    covariance: DMatrix<f64>,
    chi_square: f64,
    squares: f64,
}

impl Raw {
    fn parameters(&self) -> usize {
        self.free.iter().filter(|free| **free).count()
    }

    fn significance(&self, k: usize) -> f64 {
        self.x[k].abs() / self.covariance[(k, k)].max(0.0).sqrt()
    }

    /// Coefficients in the units of [`SpeedCoefficient`].
    fn published(&self, side: &Side, inflation: f64) -> SpeedFit {
        let n = self.x.len();
        let nonlinear = |k: usize| k == linear_count(self.model);
        let value = |k: usize| if nonlinear(k) { self.x[k].exp() } else { self.x[k] };
        let scale: Vec<f64> = (0..n)
            .map(|k| match self.model {
                SpeedModel::Polynomial | SpeedModel::CoulombViscous => side.top.powi(-(k as i32)),
                SpeedModel::Stribeck if k == 1 => 1.0 / side.top,
                SpeedModel::Stribeck if nonlinear(k) => side.top,
                _ => 1.0,
            })
            .collect();
        // the error of a logarithm is the relative error
        let slope: Vec<f64> =
            (0..n).map(|k| if nonlinear(k) { scale[k] * value(k) } else { scale[k] }).collect();
        let covariance: Vec<f64> = (0..n * n)
            .map(|at| inflation * slope[at / n] * self.covariance[(at / n, at % n)] * slope[at % n])
            .collect();
        let coefficients =
            self.model.coefficient_names().iter().enumerate().map(|(k, &name)| SpeedCoefficient {
                name,
                estimate: Estimate {
                    value: scale[k] * value(k),
                    std_error: covariance[k * n + k].max(0.0).sqrt(),
                },
                at_bound: !self.free[k],
            });
        let points = side.u.len();
        SpeedFit {
            direction: side.direction,
            model: self.model,
            coefficients: coefficients.collect(),
            covariance,
            speeds: [side.slowest, side.top],
            rmsd: (self.squares / points as f64).sqrt(),
            reduced_chi_square: (points > self.parameters())
                .then(|| self.chi_square / (points - self.parameters()) as f64),
            points,
        }
    }
}

/// Sum of squares per degree of freedom of both directions; `None` with less than two degrees, because it would be
/// chance.
fn reduced(raws: &[Raw], sides: &[Side]) -> Option<f64> {
    let points: usize = sides.iter().map(|side| side.u.len()).sum();
    let freedom = points.checked_sub(raws.iter().map(Raw::parameters).sum())?;
    (freedom >= 2).then(|| raws.iter().map(|raw| raw.chi_square).sum::<f64>() / freedom as f64)
}

fn criterion(raws: &[Raw], sides: &[Side], inflation: f64) -> f64 {
    let k = raws.iter().map(Raw::parameters).sum::<usize>() as f64;
    let rows: f64 = sides.iter().map(|side| side.independent_rows).sum();
    let deviance = raws.iter().map(|raw| raw.chi_square).sum::<f64>() / inflation;
    corrected_akaike(deviance, k, rows)
}

/// Returns true if the terms of a form beyond Coulomb-viscous friction are significant.
fn supported(model: SpeedModel, raw: &Raw, inflation: f64) -> bool {
    let clear = |significance: f64| significance > MIN_SIGNIFICANCE * inflation.sqrt();
    match model {
        SpeedModel::Coulomb | SpeedModel::CoulombViscous => true,
        // the logarithm of an exponent of one is zero
        SpeedModel::PowerLaw => clear(raw.significance(2)) && clear(raw.significance(1)),
        SpeedModel::Stribeck => clear(raw.significance(2)),
        SpeedModel::Polynomial => clear(raw.significance(2)) || clear(raw.significance(3)),
    }
}

fn linear_count(model: SpeedModel) -> usize {
    match model {
        SpeedModel::Coulomb => 1,
        SpeedModel::CoulombViscous | SpeedModel::PowerLaw => 2,
        SpeedModel::Stribeck => 3,
        SpeedModel::Polynomial => 4,
    }
}

/// Linear columns of a form at the speed fraction `u`; `log` is the logarithm of its nonlinear parameter.
fn columns(model: SpeedModel, log: f64, u: f64) -> [f64; 4] {
    match model {
        SpeedModel::Coulomb | SpeedModel::CoulombViscous | SpeedModel::Polynomial => {
            [1.0, u, u * u, u * u * u]
        }
        SpeedModel::PowerLaw => [1.0, u.powf(log.exp()), 0.0, 0.0],
        SpeedModel::Stribeck => [1.0, u, (-(u / log.exp()).powi(2)).exp(), 0.0],
    }
}

fn bounds(side: &Side, model: SpeedModel) -> Option<[f64; 2]> {
    match model {
        SpeedModel::PowerLaw => Some(EXPONENT.map(f64::ln)),
        SpeedModel::Stribeck => Some([(STRIBECK[0] * side.slowest / side.top).ln(), STRIBECK[1].ln()]),
        _ => None,
    }
}

fn fit(side: &Side, model: SpeedModel) -> Option<Raw> {
    let Some([low, high]) = bounds(side, model) else { return finished(side, model, None) };
    if low >= high {
        return None;
    }
    let step = (high - low) / GRID as f64;
    let cost = |log: f64| linear(side, model, log).map_or(f64::INFINITY, |(_, _, chi)| chi);
    let grid: Vec<f64> = (0..=GRID).map(|k| cost(low + step * k as f64)).collect();
    let best = (0..=GRID).min_by(|a, b| grid[*a].total_cmp(&grid[*b]))?;
    if best == 0 || best == GRID {
        // the best value is outside the range that the data can show
        return None;
    }
    let log = least_between(cost, low + step * (best as f64 - 1.0), low + step * (best as f64 + 1.0));
    finished(side, model, Some(finished_log(side, model, log)))
}

/// Nonlinear parameter near `log` with zero slope of the sum of squares, and with the same coefficients held at zero.
fn finished_log(side: &Side, model: SpeedModel, log: f64) -> f64 {
    let bent = linear_count(model) - 1;
    let free = match linear(side, model, log) {
        Some((_, free, _)) if free[bent] => free,
        _ => return log,
    };
    let places: Vec<usize> = (0..=bent).filter(|k| free[*k]).collect();
    let root: Vec<f64> = side.weight.iter().map(|w| w.sqrt()).collect();
    let n = side.u.len();
    let target = DVector::from_fn(n, |i, _| root[i] * side.tau[i]);
    let at_log = |log: &[f64]| {
        let term = |i: usize, k: usize| root[i] * columns(model, log[0], side.u[i])[places[k]];
        let slope = DVector::from_fn(n, |i, _| root[i] * column_slope(model, log[0], side.u[i]));
        let terms = DMatrix::from_fn(n, places.len(), term);
        Some(Terms { terms, slopes: vec![(places.len() - 1, slope)] })
    };
    on_gradient(&[log], &target, at_log)[0]
}

/// Slope of the nonlinear column with respect to the logarithm of its parameter.
fn column_slope(model: SpeedModel, log: f64, u: f64) -> f64 {
    match model {
        SpeedModel::PowerLaw => log.exp() * u.powf(log.exp()) * u.ln(),
        SpeedModel::Stribeck => {
            let square = (u / log.exp()).powi(2);
            2.0 * square * (-square).exp()
        }
        SpeedModel::Coulomb | SpeedModel::CoulombViscous | SpeedModel::Polynomial => 0.0,
    }
}

/// Linear coefficients within their bounds: among all choices of coefficients held at zero, the feasible one with the
/// smallest sum of squares, which is the constrained minimum.
fn linear(side: &Side, model: SpeedModel, log: f64) -> Option<([f64; 4], [bool; 4], f64)> {
    let n = linear_count(model);
    if model == SpeedModel::Polynomial {
        let (x, chi) = solve(side, model, log, &[true; 4])?;
        return Some((x, [true; 4], chi));
    }
    let mut best: Option<([f64; 4], [bool; 4], f64)> = None;
    for held in 0..(1_u32 << n) - 1 {
        let free: [bool; 4] = std::array::from_fn(|k| k < n && held & (1 << k) == 0);
        let Some((x, chi)) = solve(side, model, log, &free) else { continue };
        if x.iter().all(|x| *x >= 0.0) && best.is_none_or(|(_, _, least)| chi < least) {
            best = Some((x, free, chi));
        }
        if held == 0 && best.is_some() {
            break;
        }
    }
    best
}

fn solve(side: &Side, model: SpeedModel, log: f64, free: &[bool; 4]) -> Option<([f64; 4], f64)> {
    let places: Vec<usize> = (0..4).filter(|k| free[*k]).collect();
    let n = side.u.len();
    let root: Vec<f64> = side.weight.iter().map(|w| w.sqrt()).collect();
    let design =
        DMatrix::from_fn(n, places.len(), |i, k| root[i] * columns(model, log, side.u[i])[places[k]]);
    let target = DVector::from_fn(n, |i, _| root[i] * side.tau[i]);
    let inverse = inverse_normal(&design)?;
    let mut found = &inverse * design.transpose() * &target;
    // one refinement step restores the digits that normal equations lose
    found += &inverse * design.transpose() * (&target - &design * &found);
    let chi = (&design * &found - target).norm_squared();
    let mut x = [0.0; 4];
    places.iter().zip(found.iter()).for_each(|(place, value)| x[*place] = *value);
    chi.is_finite().then_some((x, chi))
}

/// `(Jᵀ J)⁻¹` through columns of unit length.
fn inverse_normal(design: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let lengths: Vec<f64> = design.column_iter().map(|c| c.norm()).collect();
    if lengths.iter().any(|l| !(*l > 0.0 && l.is_finite())) {
        return None;
    }
    let scaled = DMatrix::from_fn(design.nrows(), design.ncols(), |i, k| design[(i, k)] / lengths[k]);
    let inverse = (scaled.transpose() * scaled).cholesky()?.inverse();
    Some(DMatrix::from_fn(lengths.len(), lengths.len(), |i, k| inverse[(i, k)] / (lengths[i] * lengths[k])))
}

fn finished(side: &Side, model: SpeedModel, log: Option<f64>) -> Option<Raw> {
    let at = log.unwrap_or(0.0);
    let (x, free, chi_square) = linear(side, model, at)?;
    let n = linear_count(model);
    let last_needed = matches!(model, SpeedModel::PowerLaw | SpeedModel::Stribeck);
    if last_needed && !free[n - 1] || model == SpeedModel::Polynomial && drives(&x) {
        return None;
    }
    let mut places: Vec<usize> = (0..n).filter(|k| free[*k]).collect();
    places.extend(log.map(|_| n));
    let design = DMatrix::from_fn(side.u.len(), places.len(), |i, k| {
        let slope = match places[k] {
            k if k == n => x[n - 1] * column_slope(model, at, side.u[i]),
            k => columns(model, at, side.u[i])[k],
        };
        side.weight[i].sqrt() * slope
    });
    let small = inverse_normal(&design)?;
    let size = n + usize::from(log.is_some());
    let mut covariance = DMatrix::zeros(size, size);
    for (i, &row) in places.iter().enumerate() {
        for (k, &column) in places.iter().enumerate() {
            covariance[(row, column)] = small[(i, k)];
        }
    }
    let value = |u: f64| -> f64 { columns(model, at, u).iter().zip(&x).map(|(c, x)| c * x).sum() };
    let squares = side.u.iter().zip(&side.tau).map(|(u, tau)| (value(*u) - tau).powi(2)).sum();
    Some(Raw {
        model,
        x: x[..n].iter().copied().chain(log).collect(),
        free: free[..n].iter().copied().chain(log.map(|_| true)).collect(),
        covariance,
        chi_square,
        squares,
    })
}

/// Returns true if a polynomial is negative anywhere between rest and the largest measured speed.
fn drives(x: &[f64; 4]) -> bool {
    (0..=SIGN_PLACES).any(|k| {
        let u = k as f64 / SIGN_PLACES as f64;
        columns(SpeedModel::Polynomial, 0.0, u).iter().zip(x).map(|(c, x)| c * x).sum::<f64>() < 0.0
    })
}

/// Difference of the directions over the speeds that both have.
fn asymmetry(sides: &[Side]) -> Option<Asymmetry> {
    let [backward, forward] = sides else { return None };
    let mut pairs = Vec::new();
    for (i, u) in forward.u.iter().enumerate() {
        let speed = u * forward.top;
        let same = |k: &usize| (backward.u[*k] * backward.top / speed - 1.0).abs() < SAME_SPEED;
        let matching: Vec<usize> = (0..backward.u.len()).filter(same).collect();
        for k in matching {
            let variance = 1.0 / forward.weight[i] + 1.0 / backward.weight[k];
            let mean = f64::midpoint(forward.tau[i], backward.tau[k]);
            pairs.push((forward.tau[i] - backward.tau[k], mean, variance));
        }
    }
    let weights: f64 = pairs.iter().map(|(_, _, variance)| 1.0 / variance).sum();
    if pairs.is_empty() || !weights.is_finite() {
        return None;
    }
    let difference = pairs.iter().map(|(d, _, variance)| d / variance).sum::<f64>() / weights;
    let mean = pairs.iter().map(|(_, mean, variance)| mean / variance).sum::<f64>() / weights;
    let chi: f64 = pairs.iter().map(|(d, _, variance)| (d - difference).powi(2) / variance).sum();
    let inflation = if pairs.len() > 2 { (chi / (pairs.len() - 1) as f64).max(1.0) } else { 1.0 };
    let std_error = (inflation / weights).sqrt();
    Some(Asymmetry {
        difference: Estimate { value: difference, std_error },
        relative: Estimate { value: difference / mean, std_error: std_error / mean.abs() },
        levels: pairs.len(),
    })
}

#[cfg(test)]
mod tests;
