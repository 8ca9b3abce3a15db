//! Objectives of a trajectory search: a function of the product `G = w' w` of its observation matrix, and its gradient.

use faer::{Mat, MatRef, Scale, Side};

use armwatch_method::NumericsError;

/// Objective that is minimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Objective {
    /// Condition number of the observation matrix, in SI units [2.10].
    Condition,
    /// The same with its columns scaled to unit norm.
    ScaledCondition,
    /// Volume of the parameters' confidence ellipsoid: `det(G)` to the power `-1/(2 b)` (D-optimal).
    LogDeterminant,
    /// A weighted mix of the last two, as logarithms [4.2.3].
    Mixed {
        /// Weight of the scaled condition number, 0 to 1; the rest is that of the volume.
        condition: f64,
    },
    /// Root mean square of the standard deviations of all parameters, each in units of its scale (A-optimal).
    StandardDeviation,
}

/// Value of an objective and its derivative with respect to the product.
#[derive(Debug, Clone)]
pub struct Valued {
    /// The logarithm of the objective.
    pub logarithm: f64,
    /// Its slope `S` `[b x b]`, symmetric: a change `dG` of the product changes the logarithm by `tr(S dG)`.
    pub slope: Mat<f64>,
}

impl Objective {
    /// Logarithm of the objective for the product `gram` `[b x b]`, and its slope.
    ///
    /// Condition numbers are smoothed: `(sum s^2p sum s^-2p)^(1/2p)` of the singular values `s`, which is at least the
    /// condition number and converges to it for large `power`, `p`. Standard deviations are compared with `scale`
    /// `[b]`; a parameter with infinite scale does not count.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if the product has an eigenvalue that is not positive: a column is zero or
    /// dependent.
    pub fn of_product(
        self,
        gram: MatRef<'_, f64>,
        power: f64,
        scale: &[f64],
    ) -> Result<Valued, NumericsError> {
        match self {
            Self::Condition => smooth_condition(gram, power),
            Self::ScaledCondition => scaled(gram, power),
            Self::LogDeterminant => log_determinant(gram),
            Self::Mixed { condition } => {
                let (of_condition, of_volume) = (scaled(gram, power)?, log_determinant(gram)?);
                let rest = 1.0 - condition;
                let slope = Scale(condition) * &of_condition.slope + Scale(rest) * &of_volume.slope;
                let logarithm = condition * of_condition.logarithm + rest * of_volume.logarithm;
                Ok(Valued { logarithm, slope })
            }
            Self::StandardDeviation => standard_deviation(gram, scale),
        }
    }
}

struct Spectrum {
    values: Vec<f64>,
    vectors: Mat<f64>,
}

/// Eigenvalues and eigenvectors of the product, all values positive.
fn spectrum(gram: MatRef<'_, f64>) -> Result<Spectrum, NumericsError> {
    const WHAT: NumericsError = NumericsError::NotFinite("the observation matrix of the trajectory");
    if !gram.is_all_finite() {
        return Err(WHAT);
    }
    let eigen = gram.self_adjoint_eigen(Side::Lower).map_err(|_| WHAT)?;
    let values: Vec<f64> = eigen.S().column_vector().iter().copied().collect();
    let largest = values.iter().copied().fold(0.0, f64::max);
    // eigenvalues below this are rounding
    if values.iter().any(|value| *value <= 1e-15 * largest || !value.is_finite()) {
        return Err(WHAT);
    }
    Ok(Spectrum { values, vectors: eigen.U().to_owned() })
}

impl Spectrum {
    /// The symmetric matrix with the same vectors and other values.
    fn with_values(&self, of: impl Fn(f64) -> f64) -> Mat<f64> {
        let b = self.values.len();
        let stretched = Mat::from_fn(b, b, |i, k| self.vectors[(i, k)] * of(self.values[k]));
        &stretched * self.vectors.transpose()
    }
}

fn smooth_condition(gram: MatRef<'_, f64>, power: f64) -> Result<Valued, NumericsError> {
    let spectrum = spectrum(gram)?;
    let largest = spectrum.values.iter().copied().fold(0.0, f64::max);
    let smallest = spectrum.values.iter().copied().fold(f64::INFINITY, f64::min);
    // relative to the ends, so that no power overflows
    let above: f64 = spectrum.values.iter().map(|value| (value / largest).powf(power)).sum();
    let below: f64 = spectrum.values.iter().map(|value| (smallest / value).powf(power)).sum();
    let logarithm = 0.5 * ((largest / smallest).ln() + (above.ln() + below.ln()) / power);
    let slope = spectrum.with_values(|value| {
        0.5 / value * ((value / largest).powf(power) / above - (smallest / value).powf(power) / below)
    });
    Ok(Valued { logarithm, slope })
}

/// With `D = diag(G)^-1/2` and the slope `S` of the condition number of `D G D`: `D S D - diag(S D G D) / diag(G)`.
fn scaled(gram: MatRef<'_, f64>, power: f64) -> Result<Valued, NumericsError> {
    let b = gram.nrows();
    let lengths: Vec<f64> = (0..b).map(|k| gram[(k, k)].sqrt()).collect();
    let unit = Mat::from_fn(b, b, |i, k| gram[(i, k)] / (lengths[i] * lengths[k]));
    let Valued { logarithm, slope } = smooth_condition(unit.as_ref(), power)?;
    let product = &slope * &unit;
    let own = |i: usize| product[(i, i)] / gram[(i, i)];
    let slope = Mat::from_fn(b, b, |i, k| {
        slope[(i, k)] / (lengths[i] * lengths[k]) - if i == k { own(i) } else { 0.0 }
    });
    Ok(Valued { logarithm, slope })
}

fn log_determinant(gram: MatRef<'_, f64>) -> Result<Valued, NumericsError> {
    let spectrum = spectrum(gram)?;
    let weight = -0.5 / spectrum.values.len() as f64;
    let logarithm = weight * spectrum.values.iter().map(|value| value.ln()).sum::<f64>();
    Ok(Valued { logarithm, slope: spectrum.with_values(|value| weight / value) })
}

/// `1/2 log` of the mean of `inv(G)_kk / scale_k²`, with the slope `-inv(G) E inv(G) / (2 sum)`.
fn standard_deviation(gram: MatRef<'_, f64>, scale: &[f64]) -> Result<Valued, NumericsError> {
    let inverse = spectrum(gram)?.with_values(|value| 1.0 / value);
    let b = inverse.nrows();
    let weights: Vec<f64> = scale.iter().map(|scale| 1.0 / (scale * scale)).collect();
    let sum: f64 = (0..b).map(|k| weights[k] * inverse[(k, k)]).sum();
    let weighted = Mat::from_fn(b, b, |i, k| weights[i] * inverse[(i, k)]);
    let product = &inverse * &weighted;
    let slope = Mat::from_fn(b, b, |i, k| -0.5 / sum * product[(i, k)]);
    Ok(Valued { logarithm: 0.5 * (sum / b as f64).ln(), slope })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Objective; 5] = [
        Objective::Condition,
        Objective::ScaledCondition,
        Objective::LogDeterminant,
        Objective::Mixed { condition: 0.3 },
        Objective::StandardDeviation,
    ];

    fn matrix(step: f64) -> Mat<f64> {
        let number = |k: usize| ((k * 7919 % 1009) as f64 / 504.0 - 1.0).sin();
        let w =
            Mat::from_fn(40, 5, |i, k| (number(5 * i + k) + step * number(900 + 3 * i + k)) * (k + 1) as f64);
        w.transpose() * &w
    }

    #[test]
    fn slopes_are_those_of_differences() {
        let scale = [1.0, 2.0, f64::INFINITY, 3.0, 1.0];
        for objective in ALL {
            let value = |step: f64| {
                objective.of_product(matrix(step).as_ref(), 8.0, &scale).expect("a value").logarithm
            };
            let step = 1e-5;
            let measured = (value(step) - value(-step)) / (2.0 * step);
            let change = (matrix(step) - matrix(-step)) * faer::Scale(0.5 / step);
            let slope = objective.of_product(matrix(0.0).as_ref(), 8.0, &scale).expect("a value").slope;
            let product = &slope * &change;
            let expected: f64 = (0..5).map(|k| product[(k, k)]).sum();
            assert!(
                (measured - expected).abs() < 1e-7 * expected.abs().max(1.0),
                "{objective:?} {measured} {expected}"
            );
        }
    }

    #[test]
    fn a_high_power_is_the_condition_number_by_singular_values() {
        let gram = matrix(0.0);
        let exact = |gram: &Mat<f64>| {
            let values = gram.singular_values().expect("values");
            0.5 * (values[0] / values[4]).ln()
        };
        let found = Objective::Condition.of_product(gram.as_ref(), 2000.0, &[]).expect("a value").logarithm;
        assert!((found - exact(&gram)).abs() < 1e-3 && found >= exact(&gram) - 1e-12);
        let unit = Mat::from_fn(5, 5, |i, k| gram[(i, k)] / (gram[(i, i)] * gram[(k, k)]).sqrt());
        let found =
            Objective::ScaledCondition.of_product(gram.as_ref(), 2000.0, &[]).expect("a value").logarithm;
        assert!((found - exact(&unit)).abs() < 1e-3);
    }

    #[test]
    fn dependent_columns_have_no_value() {
        let mut gram = matrix(0.0);
        for k in 0..5 {
            gram[(4, k)] = gram[(3, k)];
            gram[(k, 4)] = gram[(k, 3)];
        }
        gram[(4, 4)] = gram[(3, 3)];
        for objective in ALL {
            assert!(objective.of_product(gram.as_ref(), 8.0, &[1.0; 5]).is_err(), "{objective:?}");
        }
    }
}
