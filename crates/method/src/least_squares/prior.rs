//! Ridge regression towards a prior from a drawing or the robot's own past, for parameters that the motion hardly
//! shows.
//!
//! Each prior value with its standard deviation is one more row of the least-squares problem,
//! `theta_k / s_k = p_k / s_k`, so a triangular factor treats it like any other row.

use faer::Mat;

use super::factor::TriangularFactor;
use crate::NumericsError;

/// Prior of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterPrior {
    /// Expected value.
    pub value: f64,
    /// Standard deviation of the expectation, same unit, positive.
    pub std: f64,
}

/// Strength of the prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PriorStrength {
    /// Standard deviations as given: the Bayesian estimate.
    AsGiven,
    /// All standard deviations times one factor, chosen by generalised cross-validation (Golub, Heath
    /// & Wahba 1979) from a hundredth to a thousand.
    CrossValidated,
}

/// Estimate from data and prior.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PriorEstimate {
    /// Parameters, `[b]`.
    pub theta: Vec<f64>,
    /// Standard errors from data and prior together, `[b]`.
    pub sigma: Vec<f64>,
    /// Share of data in each parameter, `[b]`: 1 all data, 0 all prior. The diagonal of the resolution matrix
    /// `(A + P)⁻¹ A`, limited to 0..1.
    pub data_share: Vec<f64>,
    /// Factor on the prior's standard deviations.
    pub spread: f64,
    /// Residual sum of squares of the data, in units of the noise.
    pub residual_sum_of_squares: f64,
}

/// Least squares with priors. `factor` has rows in units of their noise, as from
/// [`joined`](super::weighted::joined); `independent_fraction` of its rows count as
/// independent. `priors` `[b]`; `None` for a parameter without a prior.
///
/// # Errors
/// [`NumericsError::NotFinite`] for a prior without a positive standard deviation, or if neither data nor prior
/// determine a parameter.
pub(crate) fn with_prior(
    factor: &TriangularFactor,
    independent_fraction: f64,
    rows: usize,
    priors: &[Option<ParameterPrior>],
    strength: PriorStrength,
) -> Result<PriorEstimate, NumericsError> {
    let sound = |prior: &ParameterPrior| prior.value.is_finite() && prior.std.is_finite() && prior.std > 0.0;
    if !priors.iter().flatten().all(sound) {
        return Err(NumericsError::NotFinite("a prior's value or standard deviation"));
    }
    if strength == PriorStrength::AsGiven {
        return Ok(solve(factor, independent_fraction, priors, 1.0)?.0);
    }
    /// Number of steps, five per decade: cross-validation is flat near its smallest value.
    const STEPS: i32 = 25;
    let independent = rows as f64 * independent_fraction;
    let mut best: Option<(f64, PriorEstimate)> = None;
    for step in 0..=STEPS {
        let spread = 10_f64.powf(-2.0 + f64::from(step) / 5.0);
        let (estimate, freedom) = solve(factor, independent_fraction, priors, spread)?;
        let rss = independent_fraction * estimate.residual_sum_of_squares;
        let score = rss / (independent - freedom).powi(2);
        if best.as_ref().is_none_or(|(lowest, _)| score < *lowest) {
            best = Some((score, estimate));
        }
    }
    best.map(|(_, estimate)| estimate).ok_or(NumericsError::NotFinite("cross-validation"))
}

/// Estimate, and the trace of its resolution: the number of parameters that data determine.
fn solve(
    factor: &TriangularFactor,
    independent_fraction: f64,
    priors: &[Option<ParameterPrior>],
    spread: f64,
) -> Result<(PriorEstimate, f64), NumericsError> {
    let b = factor.columns();
    let data = factor.upper() * faer::Scale(independent_fraction.sqrt());
    let all = with_prior_rows(factor, independent_fraction, priors, spread);
    let inverse = all.inverse_of_upper()?;
    let theta = &inverse * all.upper().submatrix(0, b, b, 1);
    let covariance = &inverse * inverse.transpose();
    let information = data.submatrix(0, 0, b, b).transpose() * data.submatrix(0, 0, b, b);
    let resolution = &covariance * information;
    let theta: Vec<f64> = (0..b).map(|k| theta[(k, 0)]).collect();
    let estimate = PriorEstimate {
        sigma: (0..b).map(|k| covariance[(k, k)].sqrt()).collect(),
        data_share: (0..b).map(|k| resolution[(k, k)].clamp(0.0, 1.0)).collect(),
        spread,
        residual_sum_of_squares: factor.residual_sum_of_squares(&theta),
        theta,
    };
    Ok((estimate, (0..b).map(|k| resolution[(k, k)]).sum()))
}

/// Factor of data and prior together: `independent_fraction` of the data's weight, and a row for each prior with its
/// standard deviation times `spread`.
pub(crate) fn with_prior_rows(
    factor: &TriangularFactor,
    independent_fraction: f64,
    priors: &[Option<ParameterPrior>],
    spread: f64,
) -> TriangularFactor {
    let b = factor.columns();
    let mut all = factor.scaled(independent_fraction.sqrt());
    let rows: Vec<(usize, ParameterPrior)> =
        priors.iter().enumerate().filter_map(|(k, prior)| prior.map(|p| (k, p))).collect();
    all.fold(
        Mat::from_fn(rows.len(), b + 1, |i, column| {
            let (k, prior) = rows[i];
            let weight = 1.0 / (spread * prior.std);
            if column == k {
                weight
            } else if column == b {
                weight * prior.value
            } else {
                0.0
            }
        })
        .as_ref(),
    );
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a QR of some rows.
    const ROUNDING: f64 = 1e-9;

    /// `tau = 2 x0 + 3 x1` with noise +-1; `x1` hardly varies.
    fn data(weak: f64) -> TriangularFactor {
        let mut factor = TriangularFactor::new(2);
        factor.fold(
            Mat::from_fn(400, 3, |i, j| {
                let (x, y) = ((i as f64).sin(), weak * (i as f64 * 0.7).cos());
                [x, y, 2.0 * x + 3.0 * y + if i % 2 == 0 { 1.0 } else { -1.0 }][j]
            })
            .as_ref(),
        );
        factor
    }

    #[test]
    fn one_parameter_is_the_precision_weighted_mean() {
        let mut factor = TriangularFactor::new(1);
        factor.fold(Mat::from_fn(9, 2, |_, j| if j == 0 { 1.0 } else { 6.0 }).as_ref());
        // nine rows of 6 with noise 1 have precision 9; the prior of 3 with a standard deviation of a third has 9 as
        // well
        let prior = [Some(ParameterPrior { value: 3.0, std: 1.0 / 3.0 })];
        let found = with_prior(&factor, 1.0, 9, &prior, PriorStrength::AsGiven).expect("an estimate");
        assert!((found.theta[0] - 4.5).abs() < ROUNDING);
        assert!((found.data_share[0] - 0.5).abs() < ROUNDING);
        assert!((found.sigma[0] - 18_f64.powf(-0.5)).abs() < ROUNDING);
    }

    #[test]
    fn a_strong_motion_beats_the_prior_and_a_weak_one_yields() {
        let prior = [None, Some(ParameterPrior { value: -1.0, std: 0.5 })];
        let of = |weak: f64| {
            with_prior(&data(weak), 1.0, 400, &prior, PriorStrength::AsGiven).expect("an estimate")
        };
        let (strong, weak) = (of(1.0), of(1e-4));
        assert!((strong.theta[1] - 3.0).abs() < 0.2 && strong.data_share[1] > 0.95, "{strong:?}");
        assert!((weak.theta[1] + 1.0).abs() < 1e-3 && weak.data_share[1] < 1e-3, "{weak:?}");
        assert!((weak.data_share[0] - 1.0).abs() < ROUNDING);
    }

    #[test]
    fn cross_validation_lets_a_wrong_prior_go_and_keeps_a_right_one() {
        let of = |value: f64| {
            let prior = [None, Some(ParameterPrior { value, std: 0.05 })];
            with_prior(&data(0.3), 1.0, 400, &prior, PriorStrength::CrossValidated).expect("an estimate")
        };
        let (wrong, right) = (of(-5.0), of(3.0));
        assert!(wrong.spread > 10.0 && (wrong.theta[1] - 3.0).abs() < 0.6, "{wrong:?}");
        assert!(right.spread <= 1.0, "{right:?}");
    }

    #[test]
    fn nothing_known_and_nothing_seen_is_refused() {
        let none = [None, None];
        assert!(with_prior(&data(0.0), 1.0, 400, &none, PriorStrength::AsGiven).is_err());
        let bad = [None, Some(ParameterPrior { value: 1.0, std: 0.0 })];
        assert!(with_prior(&data(1.0), 1.0, 400, &bad, PriorStrength::AsGiven).is_err());
    }
}
