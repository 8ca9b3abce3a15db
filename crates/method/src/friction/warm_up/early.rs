//! Fast part of warming that only the first points of a run show.
//!
//! If cycles take five minutes and the time constant is one minute, only the first cycle shows the fast part. Its
//! height at t = 0 and its time constant are then not distinguishable: any faster part of larger height gives the same
//! points. The points do show its value at the first of them, and an upper bound of its time constant. So the fit tries
//! a series of time constants and fits the other parameters for each (profile likelihood, Venzon & Moolgavkar 1988).

use nalgebra::DVector;
use varpro::prelude::*;
use varpro::problem::SeparableProblemBuilder;
use varpro::solvers::levmar::LevMarSolver;
use varpro::statistics::FitStatistics;

use super::curve::{
    CandidateFit, ExponentialFit, Mean, decay, decay_slope, extent, finished_log_times, from_the_best,
    single_starts,
};
use crate::statistics::distributions::{f_quantile, student_quantile};
use armwatch_model::analysis::{Decay, Estimate, FastShown};

/// Number of time constants to try.
const STEPS: usize = 16;

/// Fastest time constant relative to the time of the first point: the height at t = 0 is then twenty times the value
/// there. A faster one gives the same points and a meaningless height.
const FASTEST_IN_FIRST: f64 = 1.0 / 3.0;

/// Fastest time constant in any case, min: the thesis's fastest is 0.3.
const FASTEST: f64 = 0.05;

/// Slowest time constant relative to the record; slower ones are not fast.
const SLOWEST_IN_RECORD: f64 = 0.25;

/// Smallest number of points that show the part, each by `SHOWN_BY` times the deviation of all. If each cycle has one
/// point, there may be only one; it must then exceed the level that chance reaches in `CHANCE_OF_ONE_POINT` of all
/// curves.
const FEWEST_POINTS: f64 = 2.0;
const SHOWN_BY: f64 = 2.0;
const CHANCE_OF_ONE_POINT: f64 = 1e-4;

/// Fit of two exponentials. The result describes the faster one by its value at the first point and an upper bound of
/// its time constant. `None` if the points do not bound it, or too few show it.
pub(super) fn early_fit(points: &[Mean]) -> Option<CandidateFit> {
    // as many parameters as two exponentials, and at least one degree of freedom for the residual
    let freedom = points.len().checked_sub(5).filter(|freedom| *freedom > 0)? as f64;
    let (first, last) = extent(points.iter().map(|p| p.minute));
    let (fastest, slowest) = ((FASTEST_IN_FIRST * first).max(FASTEST), SLOWEST_IN_RECORD * (last - first));
    if slowest <= fastest {
        return None;
    }
    let times = (0..STEPS).map(|step| fastest * (slowest / fastest).powf(step as f64 / (STEPS - 1) as f64));
    let fits: Vec<(f64, Option<Fixed>)> = times.map(|time| (time, fixed(points, first, time))).collect();
    let (time, best) = fits
        .iter()
        .filter_map(|(time, fit)| Some((*time, fit.as_ref()?)))
        .min_by(|a, b| a.1.squares.total_cmp(&b.1.squares))?;
    // ends of the 95 % interval, as for all other estimates
    let limit = best.squares * (1.0 + f_quantile(0.95, 1.0, freedom) / freedom);
    let fits_as_well = |fit: &Option<Fixed>| fit.as_ref().is_some_and(|fit| fit.squares <= limit);
    let last_that_fits = fits.iter().rposition(|(_, fit)| fits_as_well(fit))?;
    // the next step is beyond the bound; without a next step there is no bound
    let longest = fits.get(last_that_fits + 1)?.0;
    let rmsd = (best.squares / points.len() as f64).sqrt();
    let value = |minute: f64| best.at_first.value * (-(minute - first) / time).exp();
    let showing = points.iter().filter(|p| value(p.minute) > SHOWN_BY * rmsd).map(|p| p.weight).sum::<f64>();
    let stands_out = student_quantile(1.0 - CHANCE_OF_ONE_POINT, freedom) * best.at_first.std_error;
    let shown = showing >= FEWEST_POINTS || best.at_first.value > stands_out;
    (shown && best.at_first.value > 0.0).then(|| CandidateFit {
        a: best.a,
        parts: vec![best.slow, unbounded(best.at_first.value * (first / time).exp(), time)],
        fast_shown: Some(FastShown { at_first: best.at_first, longest }),
        rmsd,
    })
}

/// Part whose height and time constant have only a one-sided bound.
fn unbounded(height: f64, time: f64) -> Decay {
    let estimate = |value| Estimate { value, std_error: f64::NAN };
    Decay { amplitude: estimate(height), time_constant: estimate(time) }
}

/// Fit for one time constant of the fast part.
struct Fixed {
    a: Estimate,
    slow: Decay,
    at_first: Estimate,
    squares: f64,
}

/// Best of the searches from several starts, refined; if that fails, the next best.
fn fixed(points: &[Mean], first: f64, time: f64) -> Option<Fixed> {
    let starts = single_starts(points);
    let sought = starts.iter().filter_map(|start| sought_from(points, first, time, start));
    from_the_best(points, sought.collect(), |sought| finished(points, first, time, sought))
}

fn finished(points: &[Mean], first: f64, time: f64, sought: ExponentialFit) -> Option<Fixed> {
    let log_times = sought.nonlinear_parameters();
    let fast = |minute: f64| (-(minute - first) / time).exp();
    let finished = finished_log_times(points, &[&fast], log_times.as_slice());
    let fit = sought_from(points, first, time, &finished).unwrap_or(sought);
    let column = |of: &dyn Fn(&Mean) -> f64| DVector::from_iterator(points.len(), points.iter().map(of));
    let (torques, roots) = (column(&|p| p.torque), column(&|p| p.weight.sqrt()));
    let statistics = FitStatistics::try_from(&fit).ok()?;
    let (values, variances) = (fit.linear_coefficients()?, statistics.linear_coefficients_variance());
    let log_variance = statistics.nonlinear_parameters_variance();
    let slow = fit.nonlinear_parameters()[0].exp();
    let squares = (fit.best_fit()? - torques).component_mul(&roots).norm_squared();
    let estimate = |k: usize| Estimate { value: values[k], std_error: variances[k].max(0.0).sqrt() };
    let time_constant = Estimate { value: slow, std_error: slow * log_variance[0].max(0.0).sqrt() };
    (squares.is_finite() && slow.is_finite()).then(|| Fixed {
        a: estimate(0),
        at_first: estimate(1),
        slow: Decay { amplitude: estimate(2), time_constant },
        squares,
    })
}

/// Fits `a`, a decay of the given time constant, and a decay whose time constant has the logarithm `start` at the start
/// of the search.
fn sought_from(points: &[Mean], first: f64, time: f64, start: &[f64]) -> Option<ExponentialFit> {
    let column = |of: &dyn Fn(&Mean) -> f64| DVector::from_iterator(points.len(), points.iter().map(of));
    let (torques, roots) = (column(&|p| p.torque), column(&|p| p.weight.sqrt()));
    let model = SeparableModelBuilder::<f64>::new(["log_t1"])
        .invariant_function(|t: &DVector<f64>| DVector::from_element(t.len(), 1.0))
        .invariant_function(move |t: &DVector<f64>| t.map(|t| (-(t - first) / time).exp()))
        .function(["log_t1"], decay)
        .partial_deriv("log_t1", decay_slope)
        .independent_variable(column(&|p| p.minute))
        .initial_parameters(start.to_vec())
        .build()
        .ok()?;
    let problem = SeparableProblemBuilder::new(model).observations(torques).weights(roots).build().ok()?;
    LevMarSolver::default().solve(problem).ok()
}
