//! Friction map with its errors, as it is stored and evaluated.
//!
//! The unknowns of a fitted map are its levels and the parameters of its law. Their covariance follows from the
//! gradients and the residuals of all points, with the runs as clusters. A remark names each parameter whose error is
//! mainly that of its prior, such as the cooling ratio of a robot that always rests overnight.

use nalgebra::{DMatrix, DVector};

use super::law::{LawParameter, LawParameters};
use super::map::{FittedMap, curved, fitted_parameters, law_prior, point_deficits};
use super::record::{JointRecord, ThermalSensor};
use super::thermal_state::ThermalDeficit;
use armwatch_model::analysis::Estimate;
use armwatch_model::analysis::friction::{FrictionMap, MapLevel, ThermalLaw, ThermalSource};

/// Largest standard error of a measured parameter, as a fraction of its prior's deviation.
const MEASURED: f64 = 0.5;

/// Smallest number of runs for a covariance that is clustered by run; with fewer, residuals count as independent.
const MIN_CLUSTERS: usize = 6;

/// Friction of a map at the index `level` into [`FrictionMap::levels`] and the thermal deficit `x`, mean of both
/// directions, Nm, with its standard error; `None` for a level that the map does not have.
///
/// `tau = warm + cold x`, `var tau = var warm + 2 x cov(warm, cold) + x² var cold`
///
/// For a future run, `x` follows from [`thermal_deficits`](super::thermal_state::thermal_deficits) at its start,
/// corrected by [`with_temperatures`] and mixed by the law's `slow_share`.
#[must_use]
pub fn map_friction(map: &FrictionMap, level: usize, x: f64) -> Option<Estimate> {
    let of_level = map.levels.get(level)?;
    let layout = MapLayout { levels: map.levels.len() };
    let (warm, cold) = (layout.warm(level), layout.cold(level));
    let size = map.covariance.len().isqrt();
    let entry = |i: usize, k: usize| map.covariance.get(i * size + k).copied();
    let variance = entry(warm, warm)? + 2.0 * x * entry(warm, cold)? + x * x * entry(cold, cold)?;
    let value = of_level.warm.value + of_level.cold.value * x;
    Some(Estimate { value, std_error: variance.max(0.0).sqrt() })
}

/// Thermal deficit from motion, corrected by the measured temperature of the motor or of the air, K.
///
/// An unknown ambient temperature counts as the usual one. `None` if the map needs the motor's temperature and `motor`
/// is `None`.
#[must_use]
pub fn with_temperatures(
    source: ThermalSource,
    by_motion: ThermalDeficit,
    motor: Option<f64>,
    ambient: Option<f64>,
) -> Option<ThermalDeficit> {
    match source {
        ThermalSource::Motion => Some(by_motion),
        ThermalSource::MotorTemperature { warm, cold, curvature } => {
            motor.map(|kelvin| [curved(curvature.value, (warm - kelvin) / (warm - cold)), by_motion[1]])
        }
        ThermalSource::AmbientAndMotion { usual, coldness: per_kelvin } => {
            let offset = per_kelvin.value * (usual - ambient.unwrap_or(usual));
            Some(by_motion.map(|part| part + offset))
        }
    }
}

/// Order of a map's unknowns in its covariance: `warm` of each level, `cold` of each level, then the parameters of
/// the law as in [`LawParameter::ALL`].
#[derive(Debug, Clone, Copy)]
struct MapLayout {
    levels: usize,
}

impl MapLayout {
    fn of(record: &JointRecord) -> Self {
        Self { levels: record.levels.len() }
    }

    fn warm(self, level: usize) -> usize {
        level
    }

    fn cold(self, level: usize) -> usize {
        self.levels + level
    }

    fn law(self, parameter: LawParameter) -> usize {
        2 * self.levels + parameter as usize
    }

    /// Number of unknowns with these parameters of the law, the first ones of [`LawParameter::ALL`].
    fn size(self, parameters: &[LawParameter]) -> usize {
        2 * self.levels + parameters.len()
    }
}

/// Parameters of the law in the covariance of a record's map.
fn covariance_parameters(record: &JointRecord) -> &'static [LawParameter] {
    match &record.sensor {
        ThermalSensor::None => &LawParameter::ALL[..LawParameter::Sensor as usize],
        ThermalSensor::Motor(_) | ThermalSensor::Ambient(_) => &LawParameter::ALL,
    }
}

/// Increase of friction per kelvin below the usual ambient temperature, at the level with the largest cold part, Nm/K,
/// with its standard error; `None` if the record has no ambient temperature.
///
/// It is the product of `cold` and the coefficient `c`, with the variance
/// `c² var cold + 2 c cold cov(cold, c) + cold² var c`. If the first cycles hardly resolve the fast part, both
/// factors are uncertain, but their product is not.
pub(super) fn ambient_effect(record: &JointRecord, fitted: &FittedMap, runs: usize) -> Option<Estimate> {
    if !matches!(record.sensor, ThermalSensor::Ambient(_)) {
        return None;
    }
    let layout = MapLayout::of(record);
    let level = (0..layout.levels).max_by(|a, b| fitted.cold[*a].total_cmp(&fitted.cold[*b]))?;
    let (cold, c) = (fitted.cold[level], fitted.law.sensor);
    let (at_cold, at_c) = (layout.cold(level), layout.law(LawParameter::Sensor));
    let covariance = covariance(record, fitted, runs)?;
    let variance = c * c * covariance[(at_cold, at_cold)]
        + 2.0 * c * cold * covariance[(at_cold, at_c)]
        + cold * cold * covariance[(at_c, at_c)];
    Some(Estimate { value: cold * c, std_error: variance.max(0.0).sqrt() })
}

/// Map with its covariance and the share of friction's variance that it explains; `None` if the covariance is singular.
pub(in crate::friction) fn published(
    record: &JointRecord,
    fitted: &FittedMap,
    runs: usize,
) -> Option<FrictionMap> {
    let covariance = covariance(record, fitted, runs)?;
    let layout = MapLayout::of(record);
    let error = |at: usize| covariance[(at, at)].max(0.0).sqrt();
    let law_error = |k: LawParameter| error(layout.law(k));
    let level = |k: usize| MapLevel {
        speed_fraction: record.levels[k],
        warm: Estimate { value: fitted.warm[k], std_error: error(layout.warm(k)) },
        cold: Estimate { value: fitted.cold[k], std_error: error(layout.cold(k)) },
    };
    let (relative_rmsd, explained) = quality(record, fitted);
    Some(FrictionMap {
        joint: record.joint,
        law: published_law(&fitted.law, law_error),
        source: published_source(record, &fitted.law, law_error),
        levels: (0..layout.levels).map(level).collect(),
        covariance: covariance.transpose().as_slice().to_vec(),
        relative_rmsd,
        explained,
        runs,
        points: record.map_points(),
        remarks: remarks(record, law_error),
    })
}

/// Law in physical units, with errors to first order: `d exp(theta) = exp(theta) d theta` for a logarithm `theta`.
fn published_law(law: &LawParameters, error: impl Fn(LawParameter) -> f64) -> ThermalLaw {
    let exponential = |k: LawParameter| {
        let value = law.get(k).exp();
        Estimate { value, std_error: value * error(k) }
    };
    ThermalLaw {
        slow_s: exponential(LawParameter::Slow),
        fast_s: exponential(LawParameter::Fast),
        slow_share: Estimate { value: law.share, std_error: error(LawParameter::Share) },
        cooling_ratio: exponential(LawParameter::Cooling),
    }
}

/// Source of the map's thermal state.
fn published_source(
    record: &JointRecord,
    law: &LawParameters,
    error: impl Fn(LawParameter) -> f64,
) -> ThermalSource {
    let parameter = || Estimate { value: law.sensor, std_error: error(LawParameter::Sensor) };
    match &record.sensor {
        ThermalSensor::None => ThermalSource::Motion,
        ThermalSensor::Motor(motor) => {
            ThermalSource::MotorTemperature { warm: motor.warm, cold: motor.cold, curvature: parameter() }
        }
        ThermalSensor::Ambient(ambient) => {
            ThermalSource::AmbientAndMotion { usual: ambient.usual, coldness: parameter() }
        }
    }
}

/// Remarks of the record, and one for each parameter of the law that is assumed rather than measured.
fn remarks(record: &JointRecord, error: impl Fn(LawParameter) -> f64) -> Vec<String> {
    let prior = law_prior(record);
    let used = |k: &LawParameter| match record.sensor {
        ThermalSensor::Motor(_) => matches!(k, LawParameter::Fast | LawParameter::Share),
        ThermalSensor::None | ThermalSensor::Ambient(_) => true,
    };
    let remark = |k: LawParameter| k.assumed().filter(|_| error(k) > MEASURED * prior.get(k).deviation);
    let assumed = LawParameter::ALL
        .into_iter()
        .filter(used)
        .filter_map(remark)
        .map(|assumed| format!("joint {}: the {assumed}", record.joint));
    record.remarks.iter().cloned().chain(assumed).collect()
}

/// Root-mean-square residual after each run's offset and factor, as a fraction of each level's mean friction; and the
/// share of the variance about these means that the thermal deficit explains, 0 to 1.
fn quality(record: &JointRecord, fitted: &FittedMap) -> (f64, f64) {
    let deficits = point_deficits(record, &fitted.law);
    let n = record.map_points() as f64;
    let mut means = vec![(0.0, 0.0); record.levels.len()];
    for p in record.points.iter().filter(|p| p.in_map) {
        means[p.level].0 += p.torque;
        means[p.level].1 += 1.0;
    }
    let (mut residual, mut unexplained, mut raw) = (0.0, 0.0, 0.0);
    for (p, x) in record.in_map(&deficits) {
        let mean = means[p.level].0 / means[p.level].1;
        let predicted = fitted.predicted(&fitted.law, p, *x);
        residual += ((p.healthy() - predicted) / mean).powi(2);
        unexplained += ((p.torque - predicted) / mean).powi(2);
        raw += ((p.torque - mean) / mean).powi(2);
    }
    let explained = if raw > 0.0 { (1.0 - unexplained / raw).clamp(0.0, 1.0) } else { 0.0 };
    ((residual / n).sqrt(), explained)
}

/// Covariance of a map's unknowns in the order of [`MapLayout`]; `None` if it is singular.
///
/// Let `g` be the gradient and `r` the relative residual of each point, `s²` the residual variance and `sigma` the
/// prior deviations. The information is `A = sum g gᵀ + s² diag(1 / sigma²)`. A few runs have the covariance
/// `s² A⁻¹`. From [`MIN_CLUSTERS`] runs on, the runs are clusters of residuals that depend on each other
/// ([`clustered`]).
fn covariance(record: &JointRecord, fitted: &FittedMap, runs: usize) -> Option<DMatrix<f64>> {
    let equations = normal_equations(record, fitted, runs);
    let freedom = record.map_points().saturating_sub(equations.information.nrows()).max(1) as f64;
    let variance = (equations.squares / freedom).max(f64::MIN_POSITIVE);
    let information = with_prior(record, fitted, equations.information, variance);
    let inverse = information.cholesky()?.inverse();
    if runs < MIN_CLUSTERS {
        return Some(inverse * variance);
    }
    let clustered = clustered(&inverse, &equations.scores);
    Some(with_larger_errors(&(inverse * variance), &clustered))
}

/// Sums over the points of a map for its covariance.
struct CovarianceSums {
    /// `sum g gᵀ`.
    information: DMatrix<f64>,
    /// `sum r g` over the points of each run, one column per run.
    scores: DMatrix<f64>,
    /// `sum r²`.
    squares: f64,
}

/// Sums of the gradients `g` of relative friction over the map's unknowns and of the relative residuals `r`. Both
/// are fractions of the warm friction of the point's level.
fn normal_equations(record: &JointRecord, fitted: &FittedMap, runs: usize) -> CovarianceSums {
    let layout = MapLayout::of(record);
    let size = layout.size(covariance_parameters(record));
    let deficits = point_deficits(record, &fitted.law);
    let slopes = law_slopes(record, fitted);
    let mut information = DMatrix::zeros(size, size);
    let mut scores = DMatrix::zeros(size, runs);
    let mut squares = 0.0;
    for (i, p) in record.points.iter().enumerate().filter(|(_, p)| p.in_map) {
        let scale = 1.0 / fitted.warm[p.level].abs().max(f64::MIN_POSITIVE);
        let mut gradient = DVector::zeros(size);
        gradient[layout.warm(p.level)] = scale;
        // a cold part at its bound of zero has no error
        if fitted.cold[p.level] > 0.0 {
            gradient[layout.cold(p.level)] = scale * (fitted.law.mixed(deficits[i]) + p.offset);
        }
        for (k, slope) in &slopes {
            gradient[layout.law(*k)] = scale * slope[i];
        }
        let residual = scale * (p.healthy() - fitted.predicted(&fitted.law, p, deficits[i]));
        squares += residual * residual;
        information.ger(1.0, &gradient, &gradient, 1.0);
        scores.column_mut(p.run).axpy(residual, &gradient, 1.0);
    }
    CovarianceSums { information, scores, squares }
}

/// Derivative of the predicted friction of each point with respect to each fitted parameter of the law, at fixed
/// levels, by central differences: `(tau(theta + h) - tau(theta - h)) / 2 h`.
fn law_slopes(record: &JointRecord, fitted: &FittedMap) -> Vec<(LawParameter, Vec<f64>)> {
    const STEP: f64 = 1e-4;
    let predicted = |law: LawParameters| -> Vec<f64> {
        let deficits = point_deficits(record, &law);
        record.points.iter().zip(deficits).map(|(p, x)| fitted.predicted(&law, p, x)).collect()
    };
    let slope = |k: LawParameter| -> Vec<f64> {
        let value = fitted.law.get(k);
        let up = predicted(fitted.law.with(k, value + STEP));
        let down = predicted(fitted.law.with(k, value - STEP));
        up.iter().zip(down).map(|(up, down)| (up - down) / (2.0 * STEP)).collect()
    };
    fitted_parameters(record).into_iter().map(|k| (k, slope(k))).collect()
}

/// Adds the information of the prior, `variance / sigma²` for each parameter of the law. A cold part at its bound of
/// zero gets an information of one, which keeps the matrix regular.
fn with_prior(
    record: &JointRecord,
    fitted: &FittedMap,
    mut information: DMatrix<f64>,
    variance: f64,
) -> DMatrix<f64> {
    let (layout, prior) = (MapLayout::of(record), law_prior(record));
    for &k in covariance_parameters(record) {
        let (at, deviation) = (layout.law(k), prior.get(k).deviation);
        information[(at, at)] += variance / (deviation * deviation);
    }
    for level in (0..layout.levels).filter(|level| fitted.cold[*level] <= 0.0) {
        information[(layout.cold(level), layout.cold(level))] = 1.0;
    }
    information
}

/// Sandwich covariance with runs as clusters (Liang & Zeger 1986): `c A⁻¹ (sum s sᵀ) A⁻¹` over the scores `s`
/// of the runs, with `c = R / (R - 1)` for `R` runs.
fn clustered(inverse: &DMatrix<f64>, scores: &DMatrix<f64>) -> DMatrix<f64> {
    let runs = scores.ncols() as f64;
    let correction = runs / (runs - 1.0);
    let meat = scores * scores.transpose() * correction;
    inverse * meat * inverse
}

/// Covariance with the correlations of `clustered` and the larger standard error of the two for each unknown.
///
/// Scores of a few runs can be small by chance, so errors never fall below those of independent residuals. An unknown
/// that has no score in any run, and is known only from its prior, is uncorrelated with the others.
fn with_larger_errors(independent: &DMatrix<f64>, clustered: &DMatrix<f64>) -> DMatrix<f64> {
    let error = |k: usize| independent[(k, k)].max(clustered[(k, k)]).max(0.0).sqrt();
    let correlation = |i: usize, k: usize| {
        let product = (clustered[(i, i)] * clustered[(k, k)]).max(0.0).sqrt();
        if product > 0.0 {
            (clustered[(i, k)] / product).clamp(-1.0, 1.0)
        } else {
            f64::from(u8::from(i == k))
        }
    };
    let size = clustered.nrows();
    DMatrix::from_fn(size, size, |i, k| correlation(i, k) * error(i) * error(k))
}
