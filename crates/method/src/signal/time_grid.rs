//! Recordings with uneven times: their detection, their rate, and interpolation of channels to an even grid and back,
//! so that a digital filter and central differences use true times.

/// Largest step, in median steps, that a filter may cross; a longer one is a gap. One row that a logger dropped makes a
/// step of two, which interpolation bridges.
const GAP_STEPS: f64 = 2.5;
/// Longest gap that is bridged, in periods of the cut-off: signals that the low-pass keeps need two rows per period,
/// with a margin.
const BRIDGED_PERIODS: f64 = 0.35;
/// Largest step, in median steps, that needs no bridge.
const UNBRIDGED_STEPS: f64 = 1.5;
/// Deviation from evenly spaced rows that has no effect, relative to a step: a speed of full range in 50 rows changes
/// the position by less than its noise.
const EVEN: f64 = 0.01;
/// Largest deviation of rounded time stamps from evenly spaced rows, in units of their last digit, with rounding.
const ROUNDED: f64 = 1.05;
/// Smallest relative difference between the mean and the median step that requires the mean.
const MEDIAN_HOLDS: f64 = 1e-3;
/// Number of points of a Lagrange polynomial.
pub(crate) const POINTS: usize = 6;
/// Spacing of neighbouring points, relative to the mean step, within which a polynomial through six of them does not
/// amplify their noise.
const SPACING: [f64; 2] = [0.4, 2.6];

/// Median time step, s; `None` for fewer than two rows or a time that does not grow. It uses half the time of pairs of
/// steps, because loggers whose clock does not divide their rate alternate, for example between 10 and 12 ms.
#[must_use]
pub fn median_step(time: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = match time.len() {
        0..3 => time.windows(2).map(|w| w[1] - w[0]).collect(),
        _ => time.windows(3).map(|w| 0.5 * (w[2] - w[0])).collect(),
    };
    if steps.is_empty() {
        return None;
    }
    let middle = steps.len() / 2;
    let (_, median, _) = steps.select_nth_unstable_by(middle, f64::total_cmp);
    (median.is_finite() && *median > 0.0).then_some(*median)
}

/// Rows per second, Hz: for evenly spaced rows the inverse of the median step, otherwise the number of steps over their
/// time, without gaps. `None` like [`median_step`].
#[must_use]
pub fn sample_rate(time: &[f64]) -> Option<f64> {
    let median = median_step(time)?;
    let inside = time.windows(2).map(|w| w[1] - w[0]).filter(|step| *step <= GAP_STEPS * median);
    let (steps, span) = inside.fold((0_usize, 0.0), |(steps, span), step| (steps + 1, span + step));
    let mean = span / steps as f64;
    let even = steps == 0 || mean <= 0.0 || (mean / median - 1.0).abs() < MEDIAN_HOLDS;
    Some(if even { 1.0 / median } else { 1.0 / mean })
}

/// Longest step that is no gap for a low-pass at `cutoff` Hz, s; `median` is the median step.
pub(super) fn longest_step(median: f64, cutoff: f64) -> f64 {
    (GAP_STEPS * median).min((UNBRIDGED_STEPS * median).max(BRIDGED_PERIODS / cutoff))
}

/// Returns true if rows at `time` are evenly spaced by `step` s, as far as the resolution of the time stamps shows.
pub(super) fn is_even(time: &[f64], step: f64) -> bool {
    let rows = time.len() as f64;
    let middle = 0.5 * (rows - 1.0);
    let (first, sum) = (time.first().copied().unwrap_or(0.0), time.iter().sum::<f64>());
    let (mean, mut along, mut square) = (sum / rows, 0.0, 0.0);
    for (row, t) in time.iter().enumerate() {
        let at = row as f64 - middle;
        along += at * (t - mean);
        square += at * at;
    }
    let slope = if square > 0.0 { along / square } else { step };
    let deviation = |(row, t): (usize, &f64)| (t - first) - slope * row as f64;
    let bounds = |[low, high]: [f64; 2], x: f64| [low.min(x), high.max(x)];
    let [low, high] = time.iter().enumerate().map(deviation).fold([f64::INFINITY, f64::NEG_INFINITY], bounds);
    let span = slope * rows;
    let drift = (slope - step).abs() * rows.min(1.0 / MEDIAN_HOLDS);
    let least = EVEN * step;
    let spread = high - low;
    let stamped = spread <= least || spread <= ROUNDED * last_digit(time, span);
    stamped && (drift <= step || (slope / step - 1.0).abs() < MEDIAN_HOLDS)
}

/// Decimal place such that all times since the first are multiples of it, s; zero if there is none.
fn last_digit(time: &[f64], span: f64) -> f64 {
    let first = time.first().copied().unwrap_or(0.0);
    let rounding = 8.0 * f64::EPSILON * (first.abs() + span.abs());
    let whole = |unit: f64| {
        let tolerance = 1e-3 + rounding / unit;
        tolerance < 0.1
            && time.iter().all(|t| {
                let units = (t - first) / unit;
                (units - units.round()).abs() < tolerance
            })
    };
    (1..=7).map(|digits| 10.0_f64.powi(-digits)).find(|unit| whole(*unit)).unwrap_or(0.0)
}

/// Weights of neighbouring values for each interpolated point.
#[derive(Debug, Clone, PartialEq)]
struct Interpolation {
    /// Index of the first value, and weights.
    points: Vec<(usize, [f64; POINTS])>,
}

impl Interpolation {
    /// Interpolates from values at `nodes`, ascending, to the points `wanted`, ascending.
    fn new(nodes: &[f64], wanted: impl Iterator<Item = f64>, step: f64) -> Self {
        let last = nodes.len() - POINTS;
        let mut behind = 0;
        let point = |x: f64| {
            while behind + 1 < nodes.len() && nodes[behind + 1] <= x {
                behind += 1;
            }
            let start = behind.saturating_sub(POINTS / 2 - 1).min(last);
            let near = &nodes[start..start + POINTS];
            let regular = near.windows(2).all(|w| {
                let spacing = (w[1] - w[0]) / step;
                (SPACING[0]..=SPACING[1]).contains(&spacing)
            });
            let weights = if regular { lagrange(near, x) } else { hermite(near, behind - start, x) };
            (start, weights)
        };
        Self { points: wanted.map(point).collect() }
    }

    fn apply(&self, values: &[f64]) -> Vec<f64> {
        let of_point = |(start, weights): &(usize, [f64; POINTS])| {
            weights.iter().zip(&values[*start..]).map(|(weight, value)| weight * value).sum()
        };
        self.points.iter().map(of_point).collect()
    }
}

/// Weights of evenly spaced values at the places -2 to 3 for the value at the fraction `part` between places 0 and 1.
pub(crate) fn between(part: f64) -> [f64; POINTS] {
    lagrange(&[-2.0, -1.0, 0.0, 1.0, 2.0, 3.0], part)
}

fn lagrange(nodes: &[f64], x: f64) -> [f64; POINTS] {
    std::array::from_fn(|i| {
        let others = (0..POINTS).filter(|&k| k != i);
        others.map(|k| (x - nodes[k]) / (nodes[i] - nodes[k])).product()
    })
}

/// Weights of a cubic between two neighbours, with slopes of parabolas through three points. Points that are close
/// together do not make it oscillate.
fn hermite(nodes: &[f64], behind: usize, x: f64) -> [f64; POINTS] {
    let i = behind.min(POINTS - 2);
    let mut weights = [0.0; POINTS];
    let h = nodes[i + 1] - nodes[i];
    if h <= 0.0 {
        weights[i] = 1.0;
        return weights;
    }
    let u = ((x - nodes[i]) / h).clamp(0.0, 1.0);
    weights[i] += (1.0 + 2.0 * u) * (1.0 - u) * (1.0 - u);
    weights[i + 1] += u * u * (3.0 - 2.0 * u);
    for (at, factor) in [(i, h * u * (1.0 - u) * (1.0 - u)), (i + 1, -h * u * u * (1.0 - u))] {
        let (before, after) = (at.saturating_sub(1), (at + 1).min(POINTS - 1));
        let [h0, h1] = [nodes[at] - nodes[before], nodes[after] - nodes[at]];
        // a slope over a very short time is noise
        let mut slope = |from: usize, to: usize, part: f64| {
            let over = factor * part / (nodes[to] - nodes[from]);
            weights[to] += over;
            weights[from] -= over;
        };
        if h0 < 0.1 * h || h1 < 0.1 * h || before == at || after == at {
            slope(i, i + 1, 1.0);
        } else {
            slope(before, at, h1 / (h0 + h1));
            slope(at, after, h0 / (h0 + h1));
        }
    }
    weights
}

/// Even grid over rows that are not evenly spaced.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EvenGrid {
    /// Time between grid points, s.
    pub step: f64,
    to_grid: Interpolation,
    to_rows: Interpolation,
}

impl EvenGrid {
    /// Creates a grid over the rows at `time`, six or more, with about `rate` points per second.
    pub fn new(time: &[f64], rate: f64) -> Self {
        let (first, last) = (time[0], time[time.len() - 1]);
        let steps = ((last - first) * rate).round().max(POINTS as f64);
        let step = (last - first) / steps;
        let grid: Vec<f64> = (0..=steps as usize).map(|k| first + step * k as f64).collect();
        Self {
            step,
            to_grid: Interpolation::new(time, grid.iter().copied(), step),
            to_rows: Interpolation::new(&grid, time.iter().copied(), step),
        }
    }

    /// Interpolates values from the rows to the grid.
    pub fn to_grid(&self, values: &[f64]) -> Vec<f64> {
        self.to_grid.apply(values)
    }

    /// Interpolates values from the grid to the rows.
    pub fn to_rows(&self, values: &[f64]) -> Vec<f64> {
        self.to_rows.apply(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(rows: usize, step: f64, unit: f64) -> Vec<f64> {
        (0..rows).map(|row| (row as f64 * step / unit).round() * unit).collect()
    }

    /// Repeated steps of 10, 10 and 12 ms.
    fn mixed(rows: usize) -> Vec<f64> {
        (0..rows).map(|row| 0.032 * (row / 3) as f64 + 0.010 * (row % 3) as f64).collect()
    }

    #[test]
    fn rounded_stamps_are_even_and_mixed_steps_are_not() {
        for (step, unit) in [(0.004, 1e-4), (1.0 / 300.0, 1e-4), (1.0 / 94.0, 1e-3), (0.0002, 1e-4)] {
            let time = rounded(4000, step, unit);
            let rate = sample_rate(&time).expect("a rate");
            assert!((rate * step - 1.0).abs() < 1e-3, "{step} {unit}: {rate}");
            assert!(is_even(&time, 1.0 / rate), "{step} {unit}");
        }
        let time = mixed(3000);
        let rate = sample_rate(&time).expect("a rate");
        assert!((rate - 3.0 / 0.032).abs() < 0.02, "{rate}");
        assert!(!is_even(&time, 1.0 / rate));
    }

    #[test]
    fn the_rate_of_an_even_recording_is_one_over_its_step_to_the_last_bit() {
        let time: Vec<f64> = (0..500).map(|row| f64::from(row) * 0.004).collect();
        assert_eq!(sample_rate(&time), median_step(&time).map(|step| 1.0 / step));
    }

    #[test]
    fn a_smooth_signal_survives_the_way_to_the_grid_and_back() {
        let w = std::f64::consts::TAU * 4.0;
        let jittered: Vec<f64> =
            (0..2000).map(|row| 0.01 * f64::from(row) + 0.004 * (f64::from(row) * 1.7).sin()).collect();
        for time in [mixed(2000), jittered] {
            let rate = sample_rate(&time).expect("a rate");
            let grid = EvenGrid::new(&time, rate);
            let values: Vec<f64> = time.iter().map(|t| (w * t).sin()).collect();
            let on_grid = grid.to_grid(&values);
            for (k, value) in on_grid.iter().enumerate() {
                let exact = (w * (time[0] + grid.step * k as f64)).sin();
                // cubics where points are dense: the third power of a quarter radian per step
                assert!((value - exact).abs() < 6e-3, "{value} {exact}");
            }
            for (value, back) in values.iter().zip(grid.to_rows(&on_grid)) {
                assert!((value - back).abs() < 8e-3, "{value} {back}");
            }
        }
    }

    #[test]
    fn one_dropped_row_is_bridged_where_the_cut_off_allows_it() {
        assert!(longest_step(0.01, 12.0) > 0.02, "100 Hz, 12 Hz: seen every 20 ms is enough");
        assert!(longest_step(1.0 / 30.0, 7.0) < 2.0 / 30.0, "30 Hz, 7 Hz: every 67 ms is not");
        assert!(longest_step(0.0002, 12.0) < 0.0006, "two rows of 5 kHz are a gap like any other");
    }
}
