//! Information criteria, for the choice among several models of the same points.

/// Corrected Akaike criterion of a model of `points` points with `parameters` parameters; `deviance` is -2 times the
/// logarithm of its likelihood. Infinite with too few points. The smallest is best (Hurvich & Tsai 1989).
#[must_use]
pub fn corrected_akaike(deviance: f64, parameters: f64, points: f64) -> f64 {
    let room = points - parameters - 1.0;
    if room <= 0.0 {
        return f64::INFINITY;
    }
    deviance + 2.0 * parameters + 2.0 * parameters * (parameters + 1.0) / room
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_costs_two_with_many_points_and_more_with_few() {
        let cost = |points: f64| corrected_akaike(7.0, 3.0, points) - corrected_akaike(7.0, 2.0, points);
        assert!((cost(1e9) - 2.0).abs() < 1e-6);
        assert!((cost(10.0) - (2.0 + 24.0 / 6.0 - 12.0 / 7.0)).abs() < 1e-12);
        assert_eq!(corrected_akaike(7.0, 3.0, 4.0), f64::INFINITY);
    }
}
