//! Friction as a function of speed and thermal state, fitted to all runs of a robot.
//!
//! At a speed level, friction is a line over the thermal deficit `x`, 0 for a warm and 1 for a cold joint:
//!
//! `tau(level, x) = warm(level) + cold(level) x`, `x = share x_slow + (1 - share) x_fast`
//!
//! The deficits of the two parts follow from the thermal law ([`super::thermal_state`]), or from a measured
//! temperature. `warm` and `cold` are linear and solved for. The parameters of the law are nonlinear; the fit finds
//! them by a search along one coordinate at a time (variable projection, Golub & Pereyra 1973). If there is an ambient
//! temperature, the cost has long narrow valleys that stop such a search. So its coefficient is solved for at every
//! law, and the search continues in the direction of its last step (Hooke & Jeeves 1961). Each parameter has a weak
//! prior.

use super::law::{
    BOUNDS, Bounds, LawParameter, LawParameters, LawPrior, MOTOR_AHEAD, MOTOR_BOUNDS, MOTOR_PRIOR, PRIOR,
};
use super::record::{JointRecord, RecordPoint, ThermalSensor};
use super::thermal_state::{ThermalDeficit, thermal_deficits};
use crate::friction::golden_section::least_on_grid;

/// First steps of the search.
const STEPS: LawParameters = LawParameters { slow: 0.4, fast: 0.4, share: 0.15, cooling: 0.4, sensor: 0.04 };
/// Step of the slow time constant below which the search ends.
const LAST_STEP: f64 = 0.01;
/// Last step with an ambient temperature.
const LAST_STEP_IN_VALLEYS: f64 = 0.0002;
/// Number of grid intervals over the bounds of an ambient temperature's coefficient: each is 0.0125 1/K, half of the
/// coefficient of a gear that warms by 40 K.
const COEFFICIENT_INTERVALS: usize = 80;
/// Largest number of rounds of the search over all parameters.
const MAX_ROUNDS: usize = 60;

/// Curvature below which the curve is treated as a line.
const MIN_CURVATURE: f64 = 1e-3;

/// Smallest ratio of the slow to the fast time constant; closer ones cannot be distinguished from a single decay.
const MIN_RATIO: f64 = 2.0;

/// Rest, s, after which every gearbox is cold (housings cool within a few hours). Only shorter rests show the rate of
/// cooling.
const COLD_AFTER_S: f64 = 12.0 * 3600.0;

/// A map with the value of its objective.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::friction) struct FittedMap {
    pub law: LawParameters,
    /// Friction of the warm joint by level, Nm; empty if the law is not admissible.
    pub warm: Vec<f64>,
    /// Additional friction of the cold joint by level, Nm, zero or more.
    pub cold: Vec<f64>,
    /// Root-mean-square residual as a fraction of friction.
    pub rms: f64,
    /// Minus twice the logarithm of the posterior, up to a constant.
    cost: f64,
}

impl FittedMap {
    /// Map of a law that is not admissible, worse than any other.
    fn rejected(law: LawParameters) -> Self {
        Self { law, warm: Vec::new(), cold: Vec::new(), rms: f64::INFINITY, cost: f64::INFINITY }
    }

    /// Predicted friction of a point at the law `law` and its thermal deficit `x`, without the run's factor, Nm:
    /// `warm + cold (mixed(x) + offset)`.
    pub(super) fn predicted(&self, law: &LawParameters, p: &RecordPoint, x: ThermalDeficit) -> f64 {
        self.warm[p.level] + self.cold[p.level] * (law.mixed(x) + p.offset)
    }
}

/// Thermal deficit of each point, from the law and the sensor.
pub(super) fn point_deficits(record: &JointRecord, law: &LawParameters) -> Vec<ThermalDeficit> {
    let moments: Vec<(usize, f64)> = record.points.iter().map(|p| (p.run, p.time)).collect();
    moment_deficits(record, law, &moments)
}

/// Thermal deficit at moments in ascending order, each given as a run and a time since the epoch, s.
///
/// A motor's temperature replaces the slow part. An ambient temperature below the usual one is added to both parts.
pub(in crate::friction) fn moment_deficits(
    record: &JointRecord,
    law: &LawParameters,
    moments: &[(usize, f64)],
) -> Vec<ThermalDeficit> {
    let times: Vec<f64> = moments.iter().map(|(_, time)| *time).collect();
    let mut found = thermal_deficits(&law.rates(), &record.spans, &times);
    match &record.sensor {
        ThermalSensor::None => {}
        ThermalSensor::Motor(motor) => {
            for (x, (run, time)) in found.iter_mut().zip(moments) {
                x[0] = curved(law.sensor, motor.thermal_deficit(*run, *time));
            }
        }
        ThermalSensor::Ambient(ambient) => {
            for (x, (run, _)) in found.iter_mut().zip(moments) {
                *x = x.map(|part| part + law.sensor * ambient.below_usual[*run]);
            }
        }
    }
    found
}

/// Thermal deficit at the linear deficit `x` of a temperature, 0 (warm) to 1 (cold): `(exp(k x) - 1) / (exp(k) - 1)`,
/// the dependence of viscosity on temperature; `x` itself at zero curvature `k`.
pub(super) fn curved(k: f64, x: f64) -> f64 {
    if k < MIN_CURVATURE { x } else { (k * x).exp_m1() / k.exp_m1() }
}

/// Prior of the law for a record.
pub(super) fn law_prior(record: &JointRecord) -> LawParameters<LawPrior> {
    match record.sensor {
        ThermalSensor::Motor(_) => MOTOR_PRIOR,
        ThermalSensor::None | ThermalSensor::Ambient(_) => PRIOR,
    }
}

/// Bounds of the law for a record.
fn law_bounds(record: &JointRecord) -> LawParameters<Bounds> {
    match record.sensor {
        ThermalSensor::Motor(_) => MOTOR_BOUNDS,
        ThermalSensor::None | ThermalSensor::Ambient(_) => BOUNDS,
    }
}

/// Parameters of the law that are fitted to a record; the others keep the mean of their prior.
pub(super) fn fitted_parameters(record: &JointRecord) -> Vec<LawParameter> {
    let mut fitted = match record.sensor {
        // the temperature determines the slow part, so neither its time constant nor cooling is needed
        ThermalSensor::Motor(_) => {
            return vec![LawParameter::Fast, LawParameter::Share, LawParameter::Sensor];
        }
        ThermalSensor::None | ThermalSensor::Ambient(_) => {
            vec![LawParameter::Slow, LawParameter::Fast, LawParameter::Share]
        }
    };
    if has_warm_start(record) {
        fitted.push(LawParameter::Cooling);
    }
    if matches!(record.sensor, ThermalSensor::Ambient(_)) {
        fitted.push(LawParameter::Sensor);
    }
    fitted
}

/// Fitted parameters that need a search; the coefficient of an ambient temperature follows from the others.
fn searched_parameters(record: &JointRecord) -> Vec<LawParameter> {
    let mut searched = fitted_parameters(record);
    if matches!(record.sensor, ThermalSensor::Ambient(_)) {
        searched.retain(|parameter| *parameter != LawParameter::Sensor);
    }
    searched
}

/// Returns true if any rest was short enough for the joint to be warm after it.
fn has_warm_start(record: &JointRecord) -> bool {
    record.spans.windows(2).any(|w| (1.0..COLD_AFTER_S).contains(&(w[1].start - w[0].end)))
}

/// Fits law and levels to a record. The search begins at `start`, or at the mean of the prior if there is none.
pub(in crate::friction) fn fit_map(record: &JointRecord, start: Option<LawParameters>) -> FittedMap {
    let mean = law_prior(record).map(|prior| prior.mean);
    let from_mean = search(record, start.unwrap_or(mean));
    // the cost has two minima: the gear warms before the sensor, or the sensor before the gear
    let ahead = match (&record.sensor, start) {
        (ThermalSensor::Motor(_), None) => Some(search(record, MOTOR_AHEAD)),
        _ => None,
    };
    ahead.filter(|ahead| ahead.cost < from_mean.cost).unwrap_or(from_mean)
}

/// Coordinate search: steps up and down along each searched parameter, and halves all steps after a round without a
/// better map. If there is an ambient temperature, a pattern search.
fn search(record: &JointRecord, start: LawParameters) -> FittedMap {
    let in_valleys = matches!(record.sensor, ThermalSensor::Ambient(_));
    let last_step = if in_valleys { LAST_STEP_IN_VALLEYS } else { LAST_STEP };
    let searched = searched_parameters(record);
    let mut best = at_law(record, start);
    let mut steps = STEPS;
    for _ in 0..MAX_ROUNDS {
        let explored = explored(record, best.clone(), &steps, &searched);
        if explored.cost < best.cost {
            best = if in_valleys { on_pattern(record, best, explored, &steps, &searched) } else { explored };
        } else {
            steps = steps.map(|step| 0.5 * step);
            if steps.slow < last_step {
                break;
            }
        }
    }
    best
}

/// Best map after a step up or down along each parameter, starting from `best`.
fn explored(
    record: &JointRecord,
    mut best: FittedMap,
    steps: &LawParameters,
    searched: &[LawParameter],
) -> FittedMap {
    for &parameter in searched {
        for sign in [1.0, -1.0] {
            let value = best.law.get(parameter) + sign * steps.get(parameter);
            let tried = at_law(record, best.law.with(parameter, value));
            if tried.cost < best.cost {
                best = tried;
                break;
            }
        }
    }
    best
}

/// Best map of repeated moves in the direction from `from` to the better `to`, each as far beyond it and followed by a
/// round of steps.
fn on_pattern(
    record: &JointRecord,
    mut from: FittedMap,
    mut to: FittedMap,
    steps: &LawParameters,
    searched: &[LawParameter],
) -> FittedMap {
    for _ in 0..MAX_ROUNDS {
        let tried = explored(record, at_law(record, to.law.beyond(&from.law)), steps, searched);
        if tried.cost >= to.cost {
            break;
        }
        (from, to) = (to, tried);
    }
    to
}

/// Map at one law, with its levels and the coefficient of an ambient temperature solved for.
///
/// `cost = n ln Q + sum ((theta - mean) / deviation)²`: minus twice the logarithm of the posterior, with `n` points,
/// the sum `Q` of squared relative residuals and the law's parameters `theta`.
fn at_law(record: &JointRecord, law: LawParameters) -> FittedMap {
    if !is_admissible(record, &law) {
        return FittedMap::rejected(law);
    }
    let sums = level_sums(record, &law);
    let law = match record.sensor {
        ThermalSensor::Ambient(_) => law.with(LawParameter::Sensor, best_coefficient(record, &sums, &law)),
        ThermalSensor::None | ThermalSensor::Motor(_) => law,
    };
    let lines = lines(&sums, &law);
    let squares = lines.iter().fold(0.0, |sum, line| sum + line.squares);
    let n = record.map_points() as f64;
    // without noise the residuals are zero, which has no logarithm
    let cost = n * squares.max(f64::MIN_POSITIVE).ln() + prior_cost(record, &law);
    if !cost.is_finite() {
        return FittedMap::rejected(law);
    }
    FittedMap {
        law,
        warm: lines.iter().map(|line| line.warm).collect(),
        cold: lines.iter().map(|line| line.cold).collect(),
        rms: (squares / n).sqrt(),
        cost,
    }
}

/// Returns true if a law is within the bounds, with sufficiently different time constants.
fn is_admissible(record: &JointRecord, law: &LawParameters) -> bool {
    let bounds = law_bounds(record);
    let inside = LawParameter::ALL.iter().all(|&k| bounds.get(k).contain(law.get(k)));
    // if the slow part is measured, its time constant plays no role
    let apart = law.slow - law.fast >= MIN_RATIO.ln() || matches!(record.sensor, ThermalSensor::Motor(_));
    inside && apart
}

/// Minus twice the logarithm of the prior, up to a constant: `sum ((theta - mean) / deviation)²`.
fn prior_cost(record: &JointRecord, law: &LawParameters) -> f64 {
    let prior = law_prior(record);
    let square = |k: LawParameter| ((law.get(k) - prior.get(k).mean) / prior.get(k).deviation).powi(2);
    LawParameter::ALL.into_iter().map(square).sum()
}

/// Coefficient of the ambient temperature, 1/K, at the smallest cost, with the other parameters of the law fixed.
fn best_coefficient(record: &JointRecord, sums: &[AmbientSums], law: &LawParameters) -> f64 {
    let n = record.map_points() as f64;
    let cost = |coefficient: f64| {
        let law = law.with(LawParameter::Sensor, coefficient);
        let squares: f64 = lines(sums, &law).iter().map(|line| line.squares).sum();
        n * squares.max(f64::MIN_POSITIVE).ln() + prior_cost(record, &law)
    };
    let Bounds { low, high } = law_bounds(record).sensor;
    least_on_grid(cost, [low, high], COEFFICIENT_INTERVALS)
}

/// Line of each level, with the law's coefficient of the ambient temperature.
fn lines(sums: &[AmbientSums], law: &LawParameters) -> Vec<LevelLine> {
    sums.iter().map(|sums| sums.with_coefficient(law.sensor).line()).collect()
}

/// Sums over the points of a level: of the thermal deficits `x` without the ambient temperature, of the ambient
/// temperature below the usual one, `d`, K, and of friction `y`, Nm.
#[derive(Debug, Clone, Copy, Default)]
struct AmbientSums {
    /// Sums of `x` and `y`.
    without: LevelSums,
    d: f64,
    dd: f64,
    dx: f64,
    dy: f64,
}

/// Sums over the points of a level, of thermal deficits `x` and friction `y`, Nm.
#[derive(Debug, Clone, Copy, Default)]
struct LevelSums {
    n: f64,
    x: f64,
    xx: f64,
    y: f64,
    xy: f64,
    yy: f64,
}

/// Friction at a level as a line over the thermal deficit.
#[derive(Debug, Clone, Copy)]
struct LevelLine {
    /// Friction at zero deficit, Nm.
    warm: f64,
    /// Slope over the deficit, Nm.
    cold: f64,
    /// Sum of squared residuals, as fractions of mean friction.
    squares: f64,
}

/// Sums of each level over the points of the map, for the thermal deficits of a law.
fn level_sums(record: &JointRecord, law: &LawParameters) -> Vec<AmbientSums> {
    let (below_usual, without) = match &record.sensor {
        ThermalSensor::Ambient(ambient) => (&ambient.below_usual[..], law.with(LawParameter::Sensor, 0.0)),
        ThermalSensor::None | ThermalSensor::Motor(_) => (&[][..], *law),
    };
    let deficits = point_deficits(record, &without);
    let mut sums = vec![AmbientSums::default(); record.levels.len()];
    for (p, x) in record.in_map(&deficits) {
        let below_usual = below_usual.get(p.run).copied().unwrap_or(0.0);
        sums[p.level].add(law.mixed(*x) + p.offset, below_usual, p.healthy());
    }
    sums
}

impl AmbientSums {
    fn add(&mut self, x: f64, d: f64, y: f64) {
        self.without.add(x, y);
        self.d += d;
        self.dd += d * d;
        self.dx += d * x;
        self.dy += d * y;
    }

    /// Sums over the deficits `x + c d`.
    fn with_coefficient(&self, c: f64) -> LevelSums {
        let of = self.without;
        LevelSums {
            x: of.x + c * self.d,
            xx: of.xx + c * (2.0 * self.dx + c * self.dd),
            xy: of.xy + c * self.dy,
            ..of
        }
    }
}

impl LevelSums {
    fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.xx += x * x;
        self.y += y;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// Least-squares line `y = warm + cold x` with `cold = max(cov(x, y) / var x, 0)`, since friction does not fall
    /// while a gear cools. The mean square residual is `var y - 2 b cov(x, y) + b² var x` with `b = cold`.
    fn line(&self) -> LevelLine {
        let Self { n, x, xx, y, xy, yy } = *self;
        let (mean_x, mean_y) = (x / n, y / n);
        let (var, cov) = (xx / n - mean_x * mean_x, xy / n - mean_x * mean_y);
        let cold = if var > f64::EPSILON { (cov / var).max(0.0) } else { 0.0 };
        let residual = yy / n - mean_y * mean_y - 2.0 * cold * cov + cold * cold * var;
        LevelLine { warm: mean_y - cold * mean_x, cold, squares: n * residual.max(0.0) / (mean_y * mean_y) }
    }
}
