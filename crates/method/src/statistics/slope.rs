//! Trend of a noisy series, as a slope that is robust to a few outliers.

use super::distributions::normal_quantile;

/// Smallest number of points for an interval of the slope.
const FEWEST_POINTS: usize = 8;

/// Median slope of a series, with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MedianSlope {
    /// Median of the slopes between all pairs of points.
    pub value: f64,
    /// Ends of the interval that contains the true slope with the requested probability.
    pub interval: [f64; 2],
}

/// Median of the slopes between all pairs of points `(x, y)` (Theil 1950), with the interval from the variance of
/// Kendall's statistic (Sen 1968): `C = z sqrt(n (n - 1) (2 n + 5) / 18)` pairs around the middle. `level` is the
/// probability of the interval, such as 0.95. `None` with fewer than eight points, or if all `x` are equal. The
/// interval is valid for points with independent scatter.
#[must_use]
pub fn median_slope(points: &[(f64, f64)], level: f64) -> Option<MedianSlope> {
    if points.len() < FEWEST_POINTS {
        return None;
    }
    let mut slopes = Vec::with_capacity(points.len() * (points.len() - 1) / 2);
    for (place, (x, y)) in points.iter().enumerate() {
        let later = points[place + 1..].iter().filter(|(later, _)| later != x);
        slopes.extend(later.map(|(later, value)| (value - y) / (later - x)));
    }
    slopes.sort_unstable_by(f64::total_cmp);
    let last = slopes.len().checked_sub(1)?;
    let n = points.len() as f64;
    let width = normal_quantile(0.5 + 0.5 * level) * (n * (n - 1.0) * (2.0 * n + 5.0) / 18.0).sqrt();
    let pairs = slopes.len() as f64;
    let at = |place: f64| slopes[(place.max(0.0) as usize).min(last)];
    let value = 0.5 * (slopes[last / 2] + slopes[slopes.len() / 2]);
    Some(MedianSlope {
        value,
        interval: [at((0.5 * (pairs - width)).floor()), at((0.5 * (pairs + width)).ceil())],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random numbers between -0.5 and 0.5 (van der Corput's sequence).
    fn scatter(place: usize) -> f64 {
        let bits = |place: usize| {
            (0..16).map(|bit| ((place >> bit) & 1) as f64 / f64::from(2u32 << bit)).sum::<f64>()
        };
        bits(place) - 0.5
    }

    #[test]
    fn a_line_has_its_slope_and_a_wild_value_moves_it_not() {
        let mut line: Vec<(f64, f64)> = (0..20).map(|x| (f64::from(x), 3.0 + 0.5 * f64::from(x))).collect();
        line[7].1 = 1e6;
        let found = median_slope(&line, 0.95).expect("a slope");
        assert!((found.value - 0.5).abs() < 1e-12, "{found:?}");
        assert!((found.interval[0] - 0.5).abs() < 1e-9 && found.interval[1] < 1.0, "{found:?}");
    }

    #[test]
    fn the_interval_holds_zero_for_scatter_alone_and_not_for_a_rise() {
        let series = |rise: f64| -> Vec<(f64, f64)> {
            (1..41).map(|x| (x as f64, scatter(x) + rise * x as f64)).collect()
        };
        let still = median_slope(&series(0.0), 0.95).expect("a slope");
        assert!(still.interval[0] < 0.0 && still.interval[1] > 0.0, "{still:?}");
        let rising = median_slope(&series(0.03), 0.95).expect("a slope");
        assert!(
            rising.interval[0] > 0.0 && rising.interval[0] < 0.03 && rising.interval[1] > 0.03,
            "{rising:?}"
        );
    }

    #[test]
    fn too_few_points_have_none() {
        let points: Vec<(f64, f64)> = (0..7).map(|x| (f64::from(x), 0.0)).collect();
        assert_eq!(median_slope(&points, 0.95), None);
        assert_eq!(median_slope(&[(1.0, 2.0); 9], 0.95), None);
    }
}
