//! Friction over speed and thermal state, `tau(level, x) = warm + cold x`, from all runs of a robot.
//!
//! Levels enter linearly and are solved for; time constants, share and cooling ratio do not and are sought
//! by coordinates (variable projection, Golub & Pereyra 1973). What the recordings do not tell is held by a
//! weak prior and said: a robot that always rests for a night says nothing of how it cools.

use crate::numerics::friction::record::JointRecord;
use crate::numerics::friction::record::RecordPoint;
use nalgebra::DMatrix;

use super::record::Measured;
use super::thermal_state::{Coldness, Rates, coldness_at};
use crate::analysis::Estimate;
use crate::analysis::friction::{FrictionMap, MapLevel, ThermalLaw, ThermalSource};

/// Parameters of the law: logarithms of the slow and the fast time constant (s), share, logarithm of the
/// cooling ratio; then coldness for a kelvin that the hall is colder (1/K), or the curvature over a motor's
/// temperature.
pub(super) type LawParameters = [f64; 5];

/// Places among them.
const SLOW: usize = 0;
const FAST: usize = 1;
const SHARE: usize = 2;
const COOLING: usize = 3;
const EXTRA: usize = 4;

/// Prior of the law, centre and standard deviation. Six gearboxes of thesis Table 5.6 have slow time
/// constants of 13 to 57 min, geometric mean 27, and fast ones of 0.3 to 7.4 min, geometric mean 1.6. A
/// resting housing loses heat as a moving one does, give or take its own wind and motor losses. Of the hall nothing
/// is known but its scale: gearboxes warm by 10 to 40 K, one coldness.
const PRIOR: [(f64, f64); 5] = [(7.39, 0.9), (4.56, 1.4), (0.5, 0.5), (0.0, 1.0), (0.0, 0.1)];

/// Bounds of the law's parameters: half a minute to ten hours, two seconds to an hour, a share, cooling
/// five times faster to twenty times slower, and a hall that does as much as one coldness in 2 K, either way.
const BOUNDS: [(f64, f64); 5] = [(3.4, 10.5), (0.7, 8.2), (0.0, 1.0), (-1.6, 3.0), (-0.5, 0.5)];

/// Prior and bounds where the motor's temperature is the slow part. The sensor is taken at its word; what it does
/// not show is half of it at most and lasts two minutes to half an hour, as between winding, housing and teeth: less
/// than that, plateaus a minute after the start of a cycle do not tell. Above one, the share leaves a fast part that
/// takes away: motors warm by losses of their own, ahead of the gears. Viscosity falls exponentially, by 1 to 3 % a
/// kelvin over some 25 K.
const PRIOR_OF_MOTOR: [(f64, f64); 5] = [PRIOR[SLOW], (5.3, 0.7), (1.0, 0.3), PRIOR[COOLING], (0.5, 0.3)];
const BOUNDS_OF_MOTOR: [(f64, f64); 5] = [BOUNDS[SLOW], (4.8, 7.5), (0.5, 2.5), BOUNDS[COOLING], (0.0, 2.0)];

/// Second start of the search with a motor's temperature: a motor that warms in a quarter of an hour by half of what
/// its gear does.
const MOTOR_AHEAD: LawParameters = [PRIOR[SLOW].0, 6.8, 1.4, PRIOR[COOLING].0, 0.5];

/// Curvatures below this are a line.
const LEAST_CURVATURE: f64 = 1e-3;

/// Least ratio of the two time constants; closer ones share one decay.
const MIN_RATIO: f64 = 2.0;

/// First and last step of the search, in units of the parameters.
const STEPS: [f64; 5] = [0.4, 0.4, 0.15, 0.4, 0.04];
const LAST_STEP: f64 = 0.01;
/// Most rounds of the search over all coordinates.
const MAX_ROUNDS: usize = 60;

/// A law's parameter is measured if the recordings shrink its prior's standard deviation to this fraction.
const MEASURED: f64 = 0.5;

/// A rest shorter than this, s, may leave a joint warm; after longer ones every gearbox is cold, and how it
/// cools cannot be seen (housings cool within a few hours).
const TELLING_REST_S: f64 = 12.0 * 3600.0;

/// Fewest runs whose scatter tells the errors; with fewer, residuals count as independent.
const MIN_CLUSTERS: usize = 6;

/// Friction that a map has at its speed level `level` (its place in [`FrictionMap::levels`]) and coldness `x`, mean
/// of both directions, Nm, with the standard error of the map; `None` for a level that it does not have.
///
/// The coldness of a coming run is that of [`coldness_at`] at its start, corrected by [`with_temperatures`] and mixed
/// by the law's `slow_share`.
#[must_use]
pub fn map_friction(map: &FrictionMap, level: usize, x: f64) -> Option<Estimate> {
    let of_level = map.levels.get(level)?;
    let (warm, cold) = (level, map.levels.len() + level);
    let size = map.covariance.len().isqrt();
    let entry = |i: usize, k: usize| map.covariance.get(i * size + k).copied();
    let variance = entry(warm, warm)? + 2.0 * x * entry(warm, cold)? + x * x * entry(cold, cold)?;
    let value = of_level.warm.value + of_level.cold.value * x;
    Some(Estimate { value, std_error: variance.max(0.0).sqrt() })
}

/// Coldness by motion, corrected by what was measured: the motor's and the hall's temperature, K. A hall that is not
/// known counts as the usual one; `None` where the map needs the motor's temperature and there is none.
#[must_use]
pub fn with_temperatures(
    source: ThermalSource,
    by_motion: Coldness,
    motor: Option<f64>,
    ambient: Option<f64>,
) -> Option<Coldness> {
    match source {
        ThermalSource::Motion => Some(by_motion),
        ThermalSource::MotorTemperature { warm, cold, curvature } => {
            motor.map(|kelvin| [curved(curvature.value, (warm - kelvin) / (warm - cold)), by_motion[1]])
        }
        ThermalSource::AmbientAndMotion { usual, coldness } => {
            let offset = coldness.value * (usual - ambient.unwrap_or(usual));
            Some(by_motion.map(|part| part + offset))
        }
    }
}

/// A map in the making.
#[derive(Debug, Clone)]
pub(super) struct Fitted {
    pub law: LawParameters,
    pub warm: Vec<f64>,
    pub cold: Vec<f64>,
    /// Root-mean-square of what is left, as a fraction of friction.
    pub rms: f64,
    cost: f64,
}

pub(super) fn rates(law: &LawParameters) -> Rates {
    Rates { heating: [law[0].exp(), law[1].exp()], cooling_ratio: law[3].exp() }
}

/// Slow and fast part mixed by the law's share.
pub(super) fn mixed(law: &LawParameters, x: Coldness) -> f64 {
    law[2] * x[0] + (1.0 - law[2]) * x[1]
}

/// Coldness of each point as law and measurement have it.
pub(super) fn record_coldness(record: &JointRecord, law: &LawParameters) -> Vec<Coldness> {
    let moments: Vec<(usize, f64)> = record.points.iter().map(|p| (p.run, p.time)).collect();
    moment_coldness(record, law, &moments)
}

/// Coldness at moments, each of a run and a time since the epoch, s; times rise.
pub(super) fn moment_coldness(
    record: &JointRecord,
    law: &LawParameters,
    moments: &[(usize, f64)],
) -> Vec<Coldness> {
    let times: Vec<f64> = moments.iter().map(|(_, time)| *time).collect();
    let mut found = coldness_at(&rates(law), &record.spans, &times);
    match &record.measured {
        Measured::Nothing => {}
        Measured::Motor(scale) => {
            for (x, (run, time)) in found.iter_mut().zip(moments) {
                x[0] = curved(law[EXTRA], scale.coldness(*run, *time));
            }
        }
        Measured::Hall(hall) => {
            for (x, (run, _)) in found.iter_mut().zip(moments) {
                *x = x.map(|part| part + law[EXTRA] * hall.colder[*run]);
            }
        }
    }
    found
}

/// Coldness over a temperature that runs from 0 (warm) to 1 (cold), `(exp(k x) - 1) / (exp(k) - 1)`: viscosity over
/// temperature, with the curvature `k`; a line where that is zero.
fn curved(k: f64, x: f64) -> f64 {
    if k < LEAST_CURVATURE { x } else { (k * x).exp_m1() / k.exp_m1() }
}

type Spread = [(f64, f64); 5];

/// Prior (centre and standard deviation) and bounds of the law's parameters.
fn prior_and_bounds(record: &JointRecord) -> (Spread, Spread) {
    match record.measured {
        Measured::Motor(_) => (PRIOR_OF_MOTOR, BOUNDS_OF_MOTOR),
        Measured::Nothing | Measured::Hall(_) => (PRIOR, BOUNDS),
    }
}

/// The parameters of the law that are sought for a record; the others stay at their prior.
fn sought(record: &JointRecord) -> Vec<usize> {
    let mut sought = match record.measured {
        // what a sensor says needs no law
        Measured::Motor(_) => return vec![FAST, SHARE, EXTRA],
        Measured::Nothing | Measured::Hall(_) => vec![SLOW, FAST, SHARE],
    };
    if cooling_shows(record) {
        sought.push(COOLING);
    }
    if matches!(record.measured, Measured::Hall(_)) {
        sought.push(EXTRA);
    }
    sought
}

/// Number of the law's parameters that a map of the record has.
fn law_size(record: &JointRecord) -> usize {
    if record.measured == Measured::Nothing { EXTRA } else { EXTRA + 1 }
}

/// Fits law and levels, from `start` if there is one.
pub(super) fn fit_map(record: &JointRecord, start: Option<LawParameters>) -> Fitted {
    let centre = prior_and_bounds(record).0.map(|(centre, _)| centre);
    let from_centre = sought_from(record, start.unwrap_or(centre));
    // teeth ahead of the sensor and a sensor ahead of the teeth are two valleys
    let ahead = match (&record.measured, start) {
        (Measured::Motor(_), None) => Some(sought_from(record, MOTOR_AHEAD)),
        _ => None,
    };
    ahead.filter(|ahead| ahead.cost < from_centre.cost).unwrap_or(from_centre)
}

/// The best fit that steps from `start` lead to.
fn sought_from(record: &JointRecord, start: LawParameters) -> Fitted {
    let mut best = at_law(record, start);
    let mut steps = STEPS;
    let sought = sought(record);
    for _ in 0..MAX_ROUNDS {
        let mut moved = false;
        for &k in &sought {
            for sign in [1.0, -1.0] {
                let mut law = best.law;
                law[k] += sign * steps[k];
                let tried = at_law(record, law);
                if tried.cost < best.cost {
                    (best, moved) = (tried, true);
                    break;
                }
            }
        }
        if !moved {
            steps = steps.map(|step| 0.5 * step);
            if steps[0] < LAST_STEP {
                break;
            }
        }
    }
    best
}

/// Whether any rest was short enough to tell how the joint cools.
fn cooling_shows(record: &JointRecord) -> bool {
    record.spans.windows(2).any(|w| (1.0..TELLING_REST_S).contains(&(w[1].start - w[0].end)))
}

/// Levels solved for at one law, with minus twice the logarithm of the posterior.
fn at_law(record: &JointRecord, law: LawParameters) -> Fitted {
    let (prior, bounds) = prior_and_bounds(record);
    let inside = law.iter().zip(bounds).all(|(value, (low, high))| (low..=high).contains(value));
    let nothing = Fitted { law, warm: Vec::new(), cold: Vec::new(), rms: f64::INFINITY, cost: f64::INFINITY };
    // a measured slow part is no decay that the fast one could be taken for
    let apart = law[SLOW] - law[FAST] >= MIN_RATIO.ln() || matches!(record.measured, Measured::Motor(_));
    if !inside || !apart {
        return nothing;
    }
    let coldness = record_coldness(record, &law);
    // sums of 1, x, x², y, xy, y² by level
    let mut sums = vec![[0.0; 6]; record.levels.len()];
    for (p, x) in record.in_map(&coldness) {
        let (x, y) = (mixed(&law, *x) + p.offset, p.healthy());
        for (sum, term) in sums[p.level].iter_mut().zip([1.0, x, x * x, y, x * y, y * y]) {
            *sum += term;
        }
    }
    let (mut warm, mut cold, mut squares) = (Vec::new(), Vec::new(), 0.0);
    for [n, x, xx, y, xy, yy] in sums {
        let (mean_x, mean_y) = (x / n, y / n);
        let (var, cov) = (xx / n - mean_x * mean_x, xy / n - mean_x * mean_y);
        // colder gears never run easier; a level that says so has no cold part
        let slope = if var > f64::EPSILON { (cov / var).max(0.0) } else { 0.0 };
        let level = mean_y - slope * mean_x;
        let left = yy / n - mean_y * mean_y - 2.0 * slope * cov + slope * slope * var;
        squares += n * left.max(0.0) / (mean_y * mean_y);
        warm.push(level);
        cold.push(slope);
    }
    let n = record.map_points() as f64;
    let prior: f64 = law.iter().zip(prior).map(|(value, (centre, sd))| ((value - centre) / sd).powi(2)).sum();
    // rounding of noise-free friction has no logarithm
    let cost = n * squares.max(f64::MIN_POSITIVE).ln() + prior;
    if cost.is_finite() { Fitted { law, warm, cold, rms: (squares / n).sqrt(), cost } } else { nothing }
}

/// The coldness for a kelvin of the hall, with its standard error; `None` where the hall is not used.
pub(super) fn hall_coldness(record: &JointRecord, fitted: &Fitted, runs: usize) -> Option<Estimate> {
    matches!(record.measured, Measured::Hall(_)).then_some(())?;
    let at = 2 * record.levels.len() + EXTRA;
    let variance = covariance(record, fitted, runs)?[(at, at)];
    Some(Estimate { value: fitted.law[EXTRA], std_error: variance.max(0.0).sqrt() })
}

/// The map with its covariance and what it explains.
pub(super) fn published(record: &JointRecord, fitted: &Fitted, runs: usize) -> Option<FrictionMap> {
    let levels = record.levels.len();
    let covariance = covariance(record, fitted, runs)?;
    let error = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    let law_at = 2 * levels;
    let source = match &record.measured {
        Measured::Nothing => ThermalSource::Motion,
        Measured::Motor(scale) => ThermalSource::MotorTemperature {
            warm: scale.warm,
            cold: scale.cold,
            curvature: Estimate { value: fitted.law[EXTRA], std_error: error(law_at + EXTRA) },
        },
        Measured::Hall(hall) => ThermalSource::AmbientAndMotion {
            usual: hall.usual,
            coldness: Estimate { value: fitted.law[EXTRA], std_error: error(law_at + EXTRA) },
        },
    };
    let relative = |k: usize| {
        let value = fitted.law[k].exp();
        Estimate { value, std_error: value * error(law_at + k) }
    };
    let law = ThermalLaw {
        slow_s: relative(0),
        fast_s: relative(1),
        slow_share: Estimate { value: fitted.law[2], std_error: error(law_at + 2) },
        cooling_ratio: relative(3),
    };
    let (relative_rmsd, explained) = quality(record, fitted);
    Some(FrictionMap {
        joint: record.joint,
        law,
        source,
        levels: (0..levels)
            .map(|k| MapLevel {
                speed_fraction: record.levels[k],
                warm: Estimate { value: fitted.warm[k], std_error: error(k) },
                cold: Estimate { value: fitted.cold[k], std_error: error(levels + k) },
            })
            .collect(),
        covariance: covariance.transpose().as_slice().to_vec(),
        relative_rmsd,
        explained,
        runs,
        points: record.map_points(),
        remarks: remarks(record, |k| error(law_at + k)),
    })
}

fn remarks(record: &JointRecord, error: impl Fn(usize) -> f64) -> Vec<String> {
    let names = [
        "slow time constant is assumed: the runs are too short for it, or all began warm",
        "fast time constant is assumed: the first cycles do not resolve it",
        "share of the slow part is assumed: the warm-up does not show two parts",
        "cooling is assumed to be as warming: no run began between warm and cold",
    ];
    let used = |k: &usize| match record.measured {
        Measured::Motor(_) => [FAST, SHARE].contains(k),
        Measured::Nothing | Measured::Hall(_) => true,
    };
    let assumed = (0..names.len())
        .filter(used)
        .filter(|&k| error(k) > MEASURED * prior_and_bounds(record).0[k].1)
        .map(|k| format!("joint {}: the {}", record.joint, names[k]));
    record.remarks.iter().cloned().chain(assumed).collect()
}

fn predicted(fitted: &Fitted, p: &RecordPoint, x: Coldness) -> f64 {
    fitted.warm[p.level] + fitted.cold[p.level] * (mixed(&fitted.law, x) + p.offset)
}

/// Relative RMSD, and the part of the variance about each level's mean that coldness explains.
fn quality(record: &JointRecord, fitted: &Fitted) -> (f64, f64) {
    let coldness = record_coldness(record, &fitted.law);
    let n = record.map_points() as f64;
    let mut means = vec![(0.0, 0.0); record.levels.len()];
    for p in record.points.iter().filter(|p| p.in_map) {
        means[p.level].0 += p.torque;
        means[p.level].1 += 1.0;
    }
    let (mut left, mut unexplained, mut raw) = (0.0, 0.0, 0.0);
    for (p, x) in record.in_map(&coldness) {
        let mean = means[p.level].0 / means[p.level].1;
        let found = predicted(fitted, p, *x);
        left += ((p.healthy() - found) / mean).powi(2);
        unexplained += ((p.torque - found) / mean).powi(2);
        raw += ((p.torque - mean) / mean).powi(2);
    }
    let explained = if raw > 0.0 { (1.0 - unexplained / raw).clamp(0.0, 1.0) } else { 0.0 };
    ((left / n).sqrt(), explained)
}

/// Covariance of levels and law with the prior as information, runs as clusters (sandwich, Liang & Zeger
/// 1986).
fn covariance(record: &JointRecord, fitted: &Fitted, runs: usize) -> Option<DMatrix<f64>> {
    const STEP: f64 = 1e-4;
    let levels = record.levels.len();
    let size = 2 * levels + law_size(record);
    let at = |law: &LawParameters| -> Vec<f64> {
        let coldness = record_coldness(record, law);
        let shifted = Fitted { law: *law, ..fitted.clone() };
        record.points.iter().zip(coldness).map(|(p, x)| predicted(&shifted, p, x)).collect()
    };
    let (middle, coldness) = (at(&fitted.law), record_coldness(record, &fitted.law));
    let slopes: Vec<(usize, Vec<f64>)> = sought(record)
        .into_iter()
        .map(|k| {
            let (mut up, mut down) = (fitted.law, fitted.law);
            up[k] += STEP;
            down[k] -= STEP;
            (k, at(&up).iter().zip(at(&down)).map(|(u, d)| (u - d) / (2.0 * STEP)).collect())
        })
        .collect();
    let mut information = DMatrix::zeros(size, size);
    let mut scores = DMatrix::zeros(size, runs);
    let mut squares = 0.0;
    for (i, p) in record.points.iter().enumerate().filter(|(_, p)| p.in_map) {
        let scale = 1.0 / fitted.warm[p.level].abs().max(f64::MIN_POSITIVE);
        let mut row = nalgebra::DVector::zeros(size);
        row[p.level] = scale;
        // a level without a cold part has no error of it
        if fitted.cold[p.level] > 0.0 {
            row[levels + p.level] = scale * (mixed(&fitted.law, coldness[i]) + p.offset);
        }
        slopes.iter().for_each(|(k, slope)| row[2 * levels + k] = scale * slope[i]);
        let residual = scale * (p.healthy() - middle[i]);
        squares += residual * residual;
        information.ger(1.0, &row, &row, 1.0);
        scores.column_mut(p.run).axpy(residual, &row, 1.0);
    }
    let freedom = record.map_points().saturating_sub(size).max(1) as f64;
    let variance = (squares / freedom).max(f64::MIN_POSITIVE);
    for (k, (_, sd)) in prior_and_bounds(record).0.iter().enumerate().take(law_size(record)) {
        information[(2 * levels + k, 2 * levels + k)] += variance / (sd * sd);
    }
    for k in (0..levels).filter(|k| fitted.cold[*k] <= 0.0) {
        information[(levels + k, levels + k)] = 1.0;
    }
    let inverse = information.cholesky()?.inverse();
    if runs < MIN_CLUSTERS {
        return Some(inverse * variance);
    }
    let correction = runs as f64 / (runs as f64 - 1.0);
    let meat = &scores * scores.transpose() * correction;
    // runs that agree by chance must not promise more than independent residuals would
    let clustered = &inverse * meat * &inverse;
    let plain = inverse * variance;
    let error = |k: usize| plain[(k, k)].max(clustered[(k, k)]).max(0.0).sqrt();
    let correlation = |i: usize, k: usize| {
        let lengths = (clustered[(i, i)] * clustered[(k, k)]).max(0.0).sqrt();
        // what only the prior knows has no score in any run
        if lengths > 0.0 {
            (clustered[(i, k)] / lengths).clamp(-1.0, 1.0)
        } else {
            f64::from(u8::from(i == k))
        }
    };
    Some(DMatrix::from_fn(size, size, |i, k| correlation(i, k) * error(i) * error(k)))
}
