//! Minimum of a function of one variable.

/// Number of steps of the golden section, which reduce the bracket to 7e-5.
const STEPS: usize = 20;

/// Place of the smallest `cost` between `low` and `high`: the best end of `intervals` equal intervals, refined by a
/// golden section between its neighbours, or an end of the range if that is the best.
pub(super) fn least_on_grid(cost: impl Fn(f64) -> f64, [low, high]: [f64; 2], intervals: usize) -> f64 {
    let place = |k: usize| low + (high - low) * k as f64 / intervals as f64;
    let costs = (0..=intervals).map(|k| (k, cost(place(k))));
    let best = costs.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(k, _)| k);
    if best == 0 || best == intervals {
        return place(best);
    }
    least_between(cost, place(best - 1), place(best + 1))
}

/// Place of a minimum of `cost` between `low` and `high`, by the golden section (Kiefer 1953).
pub(super) fn least_between(cost: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let ratio = f64::midpoint(5.0_f64.sqrt(), -1.0);
    for _ in 0..STEPS {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if cost(a) < cost(b) {
            high = b;
        } else {
            low = a;
        }
    }
    f64::midpoint(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lower_of_two_minima_is_found_and_an_end_where_there_is_none() {
        let two = |x: f64| (x * x - 1.0).powi(2) + 0.1 * x;
        let found = least_on_grid(two, [-2.0, 2.0], 16);
        // zero slope: 4 x (x² - 1) + 0.1 = 0
        assert!((4.0 * found * (found * found - 1.0) + 0.1).abs() < 1e-3 && found < 0.0, "{found}");
        assert_eq!(least_on_grid(|x| x, [-2.0, 2.0], 16), -2.0);
        assert_eq!(least_on_grid(|x| -x, [-2.0, 2.0], 16), 2.0);
    }
}
