//! Friction as a function of time while a gearbox warms: `tau(t) = a + b exp(-t/t1) + c exp(-t/t2)` [5.4].
//!
//! Amplitudes are linear parameters, time constants are not: variable projection (Golub & Pereyra 1973) searches only
//! for the latter. The search uses their logarithms, so that a rate is never negative. Among a constant, one and two
//! exponentials, the fit keeps the one that the data support.

mod curve;
mod early;

use nalgebra::{DMatrix, DVector};
use varpro::prelude::*;
use varpro::problem::SeparableProblemBuilder;
use varpro::solvers::levmar::LevMarSolver;
use varpro::statistics::FitStatistics;

use self::curve::{
    CandidateFit, ExponentialFit, Mean, decay, decay_slope, extent, finished_log_times, from_the_best,
    single_starts,
};
use self::early::early_fit;
use crate::NumericsError;
use crate::statistics::distributions::{normal_quantile, student_quantile};
use crate::statistics::information::corrected_akaike;
use armwatch_model::analysis::{Decay, Estimate, FastShown, WarmUpFit, WarmUpModel};
use armwatch_model::robot::JointIndex;

/// Smallest number of points of a fit.
const MIN_POINTS: usize = 4;

/// Largest number of points that a fit uses individually. If there are more, as from all runs of a robot, neighbours in
/// time are averaged: this is enough for a curve of five parameters, and bounds the work.
const MAX_POINTS: usize = 240;

/// Largest distance of neighbours, as a fraction of the time since the start. A decay that is not over by then curves
/// by less than a thousandth over it. Near the start the fraction applies to `NEIGHBOURS_FROM`, min, since the fit does
/// not look for faster parts than the thesis's fastest (0.3 min).
const NEIGHBOURS: f64 = 0.05;
const NEIGHBOURS_FROM: f64 = 0.3;

/// Largest time constant, in lengths of the record. A longer one is in effect a straight line, and its asymptote an
/// extrapolation (thesis Table N.1 has one with a = 0 and a time constant of a day).
const LONGEST_IN_RECORDS: f64 = 1.5;

/// Smallest number of runs whose scatter alone determines the errors.
const MIN_RUNS: usize = 4;

/// Smallest ratio of two time constants; closer ones are a single decay.
const MIN_RATIO: f64 = 2.0;

/// Number of standard errors that a part and its time constant must exceed to be supported.
const MIN_SIGNIFICANCE: f64 = 2.0;

/// A point of a warm-up curve: time since the run's start in minutes, torque magnitude in Nm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct WarmUpPoint {
    /// Run of the point, from 0. Points of one run share its random effect.
    pub run: usize,
    /// Minutes since the run's start.
    pub minute: f64,
    /// Magnitude of the friction torque, Nm.
    pub torque: f64,
}

/// Fits the warm-up curve of one joint at one speed and chooses its shape.
///
/// A shape with more parts wins if it lowers the corrected Akaike criterion (Hurvich & Tsai 1989) and the data support
/// each of its parts: it is positive by several standard errors, and its time constant is not longer than the record
/// allows and has a relative error below a half.
///
/// A fast part that only the first points show cannot meet this condition, since its height at t = 0 is an
/// extrapolation. The condition then uses its value at the first point and an upper bound of its time constant
/// (`early_fit`). It must also lower the Bayesian criterion (Schwarz 1978).
///
/// If there are points of several runs, standard errors are those of leaving out each run in turn, to first order
/// (Efron & Stein 1981), because runs differ by more than points do. They are widened by Student's quantile with one
/// degree of freedom less than there are runs, so that 1.96 of them are the 95 % interval even with few runs.
///
/// # Errors
/// [`NumericsError::TooShort`] below four points, [`NumericsError::NotFinite`] for values that are not finite.
pub(crate) fn fit_warm_up(
    joint: JointIndex,
    speed_fraction: f64,
    points: &[WarmUpPoint],
) -> Result<WarmUpFit, NumericsError> {
    if points.len() < MIN_POINTS {
        return Err(NumericsError::TooShort {
            what: "the warm-up curve",
            rows: points.len(),
            needed: MIN_POINTS,
        });
    }
    if !points.iter().all(|p| p.minute.is_finite() && p.torque.is_finite()) {
        return Err(NumericsError::NotFinite("the points of the warm-up curve"));
    }
    let grouped = grouped(points);
    let mut constant = constant_fit(joint, speed_fraction, &grouped)?;
    if let Some(errors) = errors_by_run(points, constant.a.value, &[]) {
        constant.a.std_error = errors.of(0, constant.a.std_error);
    }
    let by_run = |candidate: Option<CandidateFit>| candidate.map(|of| of.with_errors_by_run(points));
    let single = by_run(best_fit(&grouped, &single_starts(&grouped), 1));
    let double = by_run(best_fit(&grouped, &double_starts(&grouped), 2));
    let double = double.filter(|c| supported(c, &grouped));
    let is_told = double.is_some();
    let mut best = (constant, criterion(grouped.len(), constant.rmsd, 1));
    for (parts, candidate) in [(1, single.filter(|c| supported(c, &grouped))), (2, double)] {
        let Some(candidate) = candidate else { continue };
        let score = criterion(grouped.len(), candidate.rmsd, 1 + 2 * parts);
        if score < best.1 {
            best = (candidate.into_fit(joint, speed_fraction, grouped.len()), score);
        }
    }
    let (simpler, score) = best;
    let parameters = if simpler.slow.is_some() { 3 } else { 1 };
    let is_better = |early: &CandidateFit| {
        criterion(grouped.len(), early.rmsd, 5) < score
            && bayesian(grouped.len(), early.rmsd, 5) < bayesian(grouped.len(), simpler.rmsd, parameters)
    };
    let early = if is_told { None } else { by_run(early_fit(&grouped)) };
    let fit = match early.filter(|early| supported(early, &grouped) && is_better(early)) {
        Some(early) => early.into_fit(joint, speed_fraction, grouped.len()),
        None => simpler,
    };
    let (first, last) = extent(points.iter().map(|p| p.minute));
    Ok(WarmUpFit { rmsd: warm_up_rmsd(&fit, points), samples: points.len(), record: [first, last], ..fit })
}

/// All points up to [`MAX_POINTS`]; beyond that, means of neighbours in time.
fn grouped(points: &[WarmUpPoint]) -> Vec<Mean> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.minute.total_cmp(&b.minute));
    let width = if points.len() > MAX_POINTS { NEIGHBOURS } else { 0.0 };
    let mut means: Vec<Mean> = Vec::new();
    let mut rest = &sorted[..];
    while let Some(first) = rest.first() {
        let end = first.minute + width * first.minute.max(NEIGHBOURS_FROM);
        let size = if width > 0.0 { rest.partition_point(|p| p.minute <= end).max(1) } else { 1 };
        let (group, behind) = rest.split_at(size);
        let n = group.len() as f64;
        means.push(Mean {
            minute: group.iter().map(|p| p.minute).sum::<f64>() / n,
            torque: group.iter().map(|p| p.torque).sum::<f64>() / n,
            weight: n,
        });
        rest = behind;
    }
    let scale = means.len() as f64 / points.len() as f64;
    means.iter_mut().for_each(|mean| mean.weight *= scale);
    means
}

/// Root-mean-square deviation of points from a curve, Nm.
#[must_use]
pub(crate) fn warm_up_rmsd(fit: &WarmUpFit, points: &[WarmUpPoint]) -> f64 {
    let squares: f64 = points.iter().map(|p| (p.torque - warm_up_torque(fit, p.minute)).powi(2)).sum();
    (squares / points.len() as f64).sqrt()
}

/// Value of a fitted curve at `minute`, Nm.
#[must_use]
pub fn warm_up_torque(fit: &WarmUpFit, minute: f64) -> f64 {
    let part = |decay: &Decay| decay.amplitude.value * (-minute / decay.time_constant.value).exp();
    fit.a.value + fit.slow.as_ref().map_or(0.0, part) + fit.fast.as_ref().map_or(0.0, part)
}

/// Corrected Akaike criterion for normal residuals; infinite with too few points. The residual variance counts as one
/// more parameter.
fn criterion(points: usize, rmsd: f64, parameters: usize) -> f64 {
    // a perfect fit of synthetic points has no logarithm
    let deviance = points as f64 * (rmsd * rmsd).max(f64::MIN_POSITIVE).ln();
    corrected_akaike(deviance, parameters as f64 + 1.0, points as f64)
}

/// Bayesian criterion for normal residuals, with the same number of parameters as [`criterion`].
fn bayesian(points: usize, rmsd: f64, parameters: usize) -> f64 {
    let (n, k) = (points as f64, parameters as f64 + 1.0);
    n * (rmsd * rmsd).max(f64::MIN_POSITIVE).ln() + k * n.ln()
}

fn constant_fit(joint: JointIndex, speed_fraction: f64, points: &[Mean]) -> Result<WarmUpFit, NumericsError> {
    let n = points.len() as f64;
    let a = points.iter().map(|p| p.weight * p.torque).sum::<f64>() / n;
    let squares: f64 = points.iter().map(|p| p.weight * (p.torque - a).powi(2)).sum();
    if !squares.is_finite() || points.len() < 2 {
        return Err(NumericsError::NotFinite("the mean of the warm-up curve"));
    }
    let a = Estimate { value: a, std_error: (squares / (n - 1.0) / n).sqrt() };
    Ok(WarmUpFit {
        joint,
        speed_fraction,
        model: WarmUpModel::Constant,
        a,
        slow: None,
        fast: None,
        fast_shown: None,
        rmsd: (squares / n).sqrt(),
        samples: points.len(),
        record: [0.0, 0.0],
    })
}

impl CandidateFit {
    fn with_errors_by_run(mut self, points: &[WarmUpPoint]) -> Self {
        if let Some(errors) = errors_by_run(points, self.a.value, &self.parts) {
            self.a.std_error = errors.of(0, self.a.std_error);
            for (k, part) in self.parts.iter_mut().enumerate() {
                let (amplitude, time) = (&mut part.amplitude, &mut part.time_constant);
                // a value with only an upper bound has no error
                if time.std_error.is_nan() {
                    continue;
                }
                amplitude.std_error = errors.of(1 + 2 * k, amplitude.std_error);
                time.std_error = time.value * errors.of(2 + 2 * k, time.std_error / time.value);
            }
        }
        self
    }

    fn into_fit(self, joint: JointIndex, speed_fraction: f64, samples: usize) -> WarmUpFit {
        let model = if self.parts.len() == 2 { WarmUpModel::Double } else { WarmUpModel::Single };
        let mut parts = self.parts.into_iter();
        WarmUpFit {
            joint,
            speed_fraction,
            model,
            a: self.a,
            slow: parts.next(),
            fast: parts.next(),
            fast_shown: self.fast_shown,
            rmsd: self.rmsd,
            samples,
            record: [0.0, 0.0],
        }
    }
}

/// Standard errors from the scatter between runs.
struct ErrorsByRun {
    runs: usize,
    errors: Vec<f64>,
}

impl ErrorsByRun {
    /// Error of a parameter. Two or three runs may agree by chance, so their error is at least that of independent
    /// points (`plain`).
    fn of(&self, parameter: usize, plain: f64) -> f64 {
        let by_run = self.errors[parameter];
        if self.runs < MIN_RUNS { by_run.max(plain) } else { by_run }
    }
}

/// Standard errors from the scatter between runs: of `a`, then of amplitude and logarithm of the time constant of each
/// part. `None` for a single run, or if only one run shows a parameter.
///
/// Let `A` be the normal equations of all points, and `A_r` and `s_r` the normal equations and the score of run `r`.
/// Leaving the run out changes the parameters by `d_r = (A - A_r)^-1 s_r`; the covariance is
/// `(R - 1) / R sum d_r d_r^T`.
fn errors_by_run(points: &[WarmUpPoint], a: f64, parts: &[Decay]) -> Option<ErrorsByRun> {
    let size = 1 + 2 * parts.len();
    let runs = points.iter().map(|p| p.run).max()? + 1;
    let mut of_runs = vec![(DMatrix::zeros(size, size), DVector::zeros(size)); runs];
    let mut all = DMatrix::zeros(size, size);
    for p in points {
        let (mut value, mut row) = (a, DVector::from_element(size, 1.0));
        for (k, part) in parts.iter().enumerate() {
            let x = p.minute / part.time_constant.value;
            let decayed = (-x).exp();
            value += part.amplitude.value * decayed;
            row[1 + 2 * k] = decayed;
            row[2 + 2 * k] = part.amplitude.value * x * decayed;
        }
        let (normal, score) = &mut of_runs[p.run];
        normal.ger(1.0, &row, &row, 1.0);
        all.ger(1.0, &row, &row, 1.0);
        score.axpy(p.torque - value, &row, 1.0);
    }
    of_runs.retain(|(normal, _)| normal[(0, 0)] > 0.0);
    let (runs, count) = (of_runs.len(), of_runs.len() as f64);
    if runs < 2 {
        return None;
    }
    let mut variances = vec![0.0; size];
    for (normal, score) in of_runs {
        let change = (&all - normal).cholesky()?.solve(&score);
        variances.iter_mut().zip(change.iter()).for_each(|(sum, d)| *sum += d * d);
    }
    let wider = student_quantile(0.975, count - 1.0) / normal_quantile(0.975);
    let error = |sum: f64| wider * ((count - 1.0) / count * sum).sqrt();
    Some(ErrorsByRun { runs, errors: variances.into_iter().map(error).collect() })
}

/// Returns true if every part of a fit is significant and possible for a gearbox that warms up.
fn supported(candidate: &CandidateFit, points: &[Mean]) -> bool {
    let (first, last) = extent(points.iter().map(|p| p.minute));
    let record = last - first;
    let clear = |e: &Estimate| e.std_error.is_finite() && e.value > MIN_SIGNIFICANCE * e.std_error;
    let is_clear = |part: &Decay| match (part.time_constant.std_error.is_nan(), candidate.fast_shown) {
        (true, Some(shown)) => clear(&shown.at_first),
        _ => clear(&part.amplitude) && clear(&part.time_constant),
    };
    let parts_clear = candidate
        .parts
        .iter()
        .all(|part| is_clear(part) && part.time_constant.value < LONGEST_IN_RECORDS * record);
    let apart = match &candidate.parts[..] {
        [slow, fast] => {
            let fast = match (fast.time_constant.std_error.is_nan(), candidate.fast_shown) {
                (true, Some(shown)) => shown.longest,
                _ => fast.time_constant.value,
            };
            slow.time_constant.value > MIN_RATIO * fast
        }
        _ => true,
    };
    parts_clear && apart && clear(&candidate.a)
}

fn double_starts(points: &[Mean]) -> Vec<Vec<f64>> {
    let (first, last) = extent(points.iter().map(|p| p.minute));
    let record = (last - first).max(f64::MIN_POSITIVE);
    [(0.3, 0.02), (0.3, 0.08), (0.6, 0.05), (0.9, 0.2)]
        .iter()
        .map(|(slow, fast)| vec![(slow * record).ln(), (fast * record).ln()])
        .collect()
}

/// Best fit from several starts, because variable projection finds local minima.
fn best_fit(points: &[Mean], starts: &[Vec<f64>], parts: usize) -> Option<CandidateFit> {
    if points.len() <= 1 + 2 * parts {
        return None;
    }
    let sought = starts.iter().filter_map(|start| exponentials(points, start));
    from_the_best(points, sought.collect(), |sought| {
        let finished = finished_log_times(points, &[], sought.nonlinear_parameters().as_slice());
        candidate(points, &exponentials(points, &finished).unwrap_or(sought))
    })
}

/// Fits `a` and one exponential per logarithm of a time constant in `start`.
fn exponentials(points: &[Mean], start: &[f64]) -> Option<ExponentialFit> {
    let names = &["log_t1", "log_t2"][..start.len()];
    let minutes = DVector::from_iterator(points.len(), points.iter().map(|p| p.minute));
    let torques = DVector::from_iterator(points.len(), points.iter().map(|p| p.torque));
    let roots = DVector::from_iterator(points.len(), points.iter().map(|p| p.weight.sqrt()));
    let mut builder = SeparableModelBuilder::<f64>::new(names)
        .invariant_function(|t: &DVector<f64>| DVector::from_element(t.len(), 1.0));
    for name in names {
        builder = builder.function([*name], decay).partial_deriv(*name, decay_slope);
    }
    let model = builder.independent_variable(minutes).initial_parameters(start.to_vec()).build().ok()?;
    let problem = SeparableProblemBuilder::new(model).observations(torques).weights(roots).build().ok()?;
    LevMarSolver::default().solve(problem).ok()
}

fn candidate(points: &[Mean], fit: &ExponentialFit) -> Option<CandidateFit> {
    let parts = fit.nonlinear_parameters().len();
    let torques = DVector::from_iterator(points.len(), points.iter().map(|p| p.torque));
    let roots = DVector::from_iterator(points.len(), points.iter().map(|p| p.weight.sqrt()));
    let statistics = FitStatistics::try_from(fit).ok()?;
    let coefficients = fit.linear_coefficients()?;
    let linear_variance = statistics.linear_coefficients_variance();
    let log_times = fit.nonlinear_parameters();
    let log_variance = statistics.nonlinear_parameters_variance();
    let residual = (fit.best_fit()? - torques).component_mul(&roots);

    let estimate =
        |k: usize| Estimate { value: coefficients[k], std_error: linear_variance[k].max(0.0).sqrt() };
    let mut decays: Vec<Decay> = (0..parts)
        .map(|k| {
            let time = log_times[k].exp();
            // the standard error of a logarithm is the relative error of the time constant
            let time_constant = Estimate { value: time, std_error: time * log_variance[k].max(0.0).sqrt() };
            Decay { amplitude: estimate(k + 1), time_constant }
        })
        .collect();
    decays.sort_by(|x, y| y.time_constant.value.total_cmp(&x.time_constant.value));
    let rmsd = (residual.norm_squared() / points.len() as f64).sqrt();
    let finite = rmsd.is_finite() && decays.iter().all(|d| d.time_constant.value.is_finite());
    let (first, _) = extent(points.iter().map(|p| p.minute));
    let covariance = statistics.covariance_matrix();
    let wide = student_quantile(0.975, (points.len() as f64 - (1 + 2 * parts) as f64).max(1.0));
    let fast_shown =
        (parts == 2).then(|| shown_at(first, &decays[1], covariance, log_times.as_slice(), wide));
    finite.then_some(CandidateFit { a: estimate(0), parts: decays, fast_shown, rmsd })
}

/// Value of the fast part at `first`, and the longest possible time constant: the upper end of its 95 % interval,
/// `wide` standard errors of its logarithm. `covariance` contains `a`, both amplitudes and the logarithms of both time
/// constants, in the order of the fit's `log_times`.
fn shown_at(first: f64, fast: &Decay, covariance: &DMatrix<f64>, log_times: &[f64], wide: f64) -> FastShown {
    let k = usize::from(log_times[1] < log_times[0]);
    let (amplitude, time) = (1 + k, 3 + k);
    let decayed = (-first / fast.time_constant.value).exp();
    let value = fast.amplitude.value * decayed;
    let slope = value * first / fast.time_constant.value;
    let variance = decayed * decayed * covariance[(amplitude, amplitude)]
        + slope * slope * covariance[(time, time)]
        + 2.0 * decayed * slope * covariance[(amplitude, time)];
    let log_error = fast.time_constant.std_error / fast.time_constant.value;
    FastShown {
        at_first: Estimate { value, std_error: variance.max(0.0).sqrt() },
        longest: fast.time_constant.value * (wide * log_error).exp(),
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    const JOINT: JointIndex = JointIndex::new(0);

    /// Normal noise of unit variance, a function of `i`.
    fn noise(i: usize) -> f64 {
        ChaCha8Rng::seed_from_u64(i as u64).sample(StandardNormal)
    }

    fn curve(a: f64, b: f64, t1: f64, c: f64, t2: f64, sigma: f64) -> Vec<WarmUpPoint> {
        (0..48)
            .map(|i| {
                let minute = 1.0 + 2.5 * i as f64;
                let torque = a + b * (-minute / t1).exp() + c * (-minute / t2).exp() + sigma * noise(i);
                WarmUpPoint { run: 0, minute, torque }
            })
            .collect()
    }

    #[test]
    fn table_5_6_comes_back_in_order() {
        // joint 1 of the thesis's Table 5.6
        let fit = fit_warm_up(JOINT, 0.6, &curve(16.609, 4.874, 40.94, 8.562, 2.889, 0.02)).expect("fits");
        assert_eq!(fit.model, WarmUpModel::Double);
        let (slow, fast) = (fit.slow.expect("slow part"), fit.fast.expect("fast part"));
        for (estimate, truth) in [
            (fit.a, 16.609),
            (slow.amplitude, 4.874),
            (slow.time_constant, 40.94),
            (fast.amplitude, 8.562),
            (fast.time_constant, 2.889),
        ] {
            let error = (estimate.value - truth).abs();
            assert!(error < 4.0 * estimate.std_error, "{estimate:?} {truth}");
            assert!(estimate.std_error < 0.2 * truth, "{estimate:?}");
        }
        assert!(slow.time_constant.value > fast.time_constant.value);
        assert!(
            (warm_up_torque(&fit, 0.0) - fit.a.value - slow.amplitude.value - fast.amplitude.value).abs()
                < 1e-12
        );
    }

    #[test]
    fn one_exponential_is_not_called_two() {
        let fit = fit_warm_up(JOINT, 0.6, &curve(10.0, 5.0, 20.0, 0.0, 1.0, 0.1)).expect("fits");
        assert_eq!(fit.model, WarmUpModel::Single);
        let slow = fit.slow.expect("one part");
        assert!((slow.time_constant.value - 20.0).abs() < 4.0 * slow.time_constant.std_error);
        assert!(fit.fast.is_none());
    }

    #[test]
    fn a_steady_joint_is_constant() {
        let fit = fit_warm_up(JOINT, 0.6, &curve(10.0, 0.0, 20.0, 0.0, 1.0, 0.1)).expect("fits");
        assert_eq!(fit.model, WarmUpModel::Constant);
        assert!((fit.a.value - 10.0).abs() < 0.1);
    }

    #[test]
    fn a_straight_fall_is_not_given_a_time_constant_of_a_day() {
        let line: Vec<WarmUpPoint> = (0..48)
            .map(|i| WarmUpPoint { run: 0, minute: f64::from(i), torque: 30.0 - 0.05 * f64::from(i) })
            .collect();
        let fit = fit_warm_up(JOINT, 0.6, &line).expect("fits");
        for part in [fit.slow, fit.fast].into_iter().flatten() {
            assert!(part.time_constant.value < LONGEST_IN_RECORDS * 47.0, "{fit:?}");
        }
    }

    #[test]
    fn the_points_of_many_runs_give_the_curve_of_one_more_narrowly() {
        let (a, b, t1, c, t2) = (16.609, 4.874, 40.94, 8.562, 2.889);
        let one = fit_warm_up(JOINT, 0.6, &curve(a, b, t1, c, t2, 0.2)).expect("fits");
        let all: Vec<WarmUpPoint> = (0..50)
            .flat_map(|run| {
                let clean = curve(a, b, t1, c, t2, 0.0).into_iter().enumerate();
                clean.map(move |(i, p)| WarmUpPoint {
                    torque: p.torque + 0.2 * noise(1000 + 48 * run + i),
                    ..p
                })
            })
            .collect();
        let many = fit_warm_up(JOINT, 0.6, &all).expect("fits");
        assert_eq!((many.model, many.samples), (WarmUpModel::Double, 2400));
        assert!((many.a.value - a).abs() < 4.0 * many.a.std_error);
        assert!(many.a.std_error < 0.5 * one.a.std_error, "{} {}", many.a.std_error, one.a.std_error);
        // the deviation is that of the points, not of their means
        assert!((0.15..0.25).contains(&many.rmsd), "{}", many.rmsd);
    }

    #[test]
    fn three_points_are_too_few() {
        let points = curve(1.0, 0.0, 1.0, 0.0, 1.0, 0.0);
        assert!(matches!(
            fit_warm_up(JOINT, 0.6, &points[..3]),
            Err(NumericsError::TooShort { rows: 3, .. })
        ));
    }
}

#[cfg(test)]
mod history_tests;
