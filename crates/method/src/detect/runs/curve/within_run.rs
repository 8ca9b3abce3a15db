//! The cause of a joint's curve in one run without a comparison, before there is a usual curve: a step, or scatter from
//! cycle to cycle.
//!
//! The curve of the run is a constant, a decay and, from seven cycles on, a second one. A step or scatter is found in
//! the residuals.

use nalgebra::{DMatrix, DVector};

use super::hypothesis::{Cause, Judged};
use super::points::Curve;

/// Fewest cycles: a decay, a step and three for the quality of the fit.
pub(super) const FEWEST_CYCLES: usize = 6;
/// Fewest cycles for a second decay.
const FEWEST_FOR_TWO: usize = 7;
/// Tried time constants of the decays, as parts of the length of the run.
const CONSTANTS: [f64; 4] = [0.15, 0.4, 1.0, 3.0];

/// Tolerance of the smooth curve, as a part of a step.
const PATTERN_ERROR: f64 = 0.03;

/// Residual standard deviation about a smooth curve; `None` with too few cycles.
pub(super) fn scatter(curve: &Curve) -> Option<f64> {
    if curve.len() < FEWEST_CYCLES {
        return None;
    }
    let best = smooth(curve, &|_| 0.0);
    Some((best.1 / freedom(curve)).sqrt())
}

/// Parameters of a smooth course; its time constants count as one.
pub(in crate::detect::runs) const COURSE_PARAMETERS: f64 = 4.0;

/// Residual of each cycle about a smooth course; `None` with too few cycles.
pub(in crate::detect::runs) fn residuals(curve: &Curve) -> Option<Vec<f64>> {
    (curve.len() >= FEWEST_CYCLES).then(|| course(curve, &|_| 0.0).2)
}

/// Causes of one run without a comparison, the likeliest first. `usual` is the scatter of a cycle of a quiet joint.
pub(super) fn judge(curve: &Curve, usual: f64, prior: f64) -> Vec<Judged> {
    let n = curve.len() as f64;
    let price = 0.5 * n.ln();
    let likelihood = |sum: f64, sigma: f64| -0.5 * sum / (sigma * sigma) - n * sigma.ln();
    let (_, sum) = smooth(curve, &|_| 0.0);
    let mut found = vec![Judged { cause: Cause::None, log_posterior: likelihood(sum, usual) }];
    // one cycle alone is no level
    for first in 2..curve.len() - 1 {
        let (size, sum) = smooth(curve, &|i| f64::from(u8::from(i >= first)));
        let sigma = usual.hypot(PATTERN_ERROR * size);
        found.push(Judged {
            cause: Cause::Step { cycle: curve[first].cycle, size },
            log_posterior: likelihood(sum, sigma) + prior - 2.0 * price,
        });
    }
    for (odd, point) in curve.iter().enumerate() {
        let (size, sum) = smooth(curve, &|i| f64::from(u8::from(i == odd)));
        found.push(Judged {
            cause: Cause::OddCycle { cycle: point.cycle, size },
            log_posterior: likelihood(sum, usual) + prior - 2.0 * price,
        });
    }
    let own = (sum / freedom(curve)).sqrt();
    if own > 2.0 * usual {
        let log_posterior = -0.5 * freedom(curve) - n * own.ln() + prior - 2.0 * price;
        found.push(Judged { cause: Cause::Scatter(own), log_posterior });
    }
    found.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
    found
}

/// Size of a pattern, and the residual sum of squares of a smooth curve with it. A pattern that is 0 everywhere has the
/// size 0.
fn smooth(curve: &Curve, pattern: &dyn Fn(usize) -> f64) -> (f64, f64) {
    let (size, sum, _) = course(curve, pattern);
    (size, sum)
}

/// Like [`smooth`], with the residual of each cycle.
fn course(curve: &Curve, pattern: &dyn Fn(usize) -> f64) -> (f64, f64, Vec<f64>) {
    let start = curve.first().map_or(0.0, |point| point.minute);
    let length = curve.last().map_or(1.0, |point| point.minute) - start;
    let y = DVector::from_fn(curve.len(), |i, _| curve[i].ln_torque);
    let decay = |constant: f64, i: usize| (-(curve[i].minute - start) / (constant * length.max(1e-6))).exp();
    let fit = |constants: &[f64]| {
        let x = DMatrix::from_fn(curve.len(), constants.len() + 2, |i, k| match k {
            0 => 1.0,
            1 => pattern(i),
            _ => decay(constants[k - 2], i),
        });
        let solved = x.clone().svd(true, true).solve(&y, 1e-9).ok()?;
        let left = &y - &x * &solved;
        Some((solved[1], left.norm_squared(), left.iter().copied().collect()))
    };
    let tried: Vec<Vec<f64>> = match curve.len() >= FEWEST_FOR_TWO {
        false => CONSTANTS.iter().map(|&of| vec![of]).collect(),
        true => {
            let pairs = CONSTANTS.iter().enumerate();
            pairs
                .flat_map(|(k, &fast)| CONSTANTS[k + 1..].iter().map(move |&slow| vec![fast, slow]))
                .collect()
        }
    };
    tried
        .iter()
        .filter_map(|constants| fit(constants))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or_else(|| (0.0, f64::INFINITY, vec![0.0; curve.len()]))
}

/// Degrees of freedom of the residuals of a smooth curve; its time constants count as one.
fn freedom(curve: &Curve) -> f64 {
    curve.len() as f64 - if curve.len() >= FEWEST_FOR_TWO { COURSE_PARAMETERS } else { 3.0 }
}
