//! Trend of a quantity: smoothed value and slope of a short series.

use jiff::Timestamp;

/// Values for the smoothed value: the smallest number that a single outlier cannot determine.
const SMOOTHED_OVER: usize = 3;

/// Fewest runs for a slope.
const FEWEST_RUNS: usize = 4;

const SECONDS_A_DAY: f64 = 86_400.0;

/// Days that a slope refers to: about the interval of maintenance plans.
pub const TREND_DAYS: f64 = 30.0;

/// The trend values of a series.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrendFigures {
    /// The value of the latest run.
    pub latest: Option<f64>,
    /// Median of the latest three runs.
    pub smoothed: Option<f64>,
    /// Median slope, in the unit of the quantity over 30 days.
    pub slope_30_d: Option<f64>,
}

impl TrendFigures {
    /// The trend values of a series, oldest first. The slope is the median of the slopes between all pairs of runs
    /// (Theil 1950, Sen 1968), which is robust against a few outliers.
    pub fn of(series: &[(Timestamp, f64)]) -> Self {
        let values: Vec<f64> = series.iter().map(|(_, value)| *value).collect();
        let latest_values = &values[values.len().saturating_sub(SMOOTHED_OVER)..];
        Self {
            latest: values.last().copied(),
            smoothed: if latest_values.len() == SMOOTHED_OVER { median(latest_values) } else { None },
            slope_30_d: slope(series),
        }
    }
}

fn slope(series: &[(Timestamp, f64)]) -> Option<f64> {
    if series.len() < FEWEST_RUNS {
        return None;
    }
    let days = |time: &Timestamp| time.as_second() as f64 / SECONDS_A_DAY;
    let mut slopes = Vec::new();
    for (place, (earlier, before)) in series.iter().enumerate() {
        for (later, after) in &series[place + 1..] {
            let between = days(later) - days(earlier);
            if between > 0.0 {
                slopes.push(TREND_DAYS * (after - before) / between);
            }
        }
    }
    median(&slopes)
}

fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        length if length % 2 == 1 => Some(sorted[middle]),
        _ => Some(0.5 * (sorted[middle - 1] + sorted[middle])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(values: &[f64]) -> Vec<(Timestamp, f64)> {
        let at = |day: i64| Timestamp::from_second(1_767_600_000 + 86_400 * day).unwrap();
        (0..).zip(values).map(|(day, value)| (at(day), *value)).collect()
    }

    #[test]
    fn one_wild_run_moves_neither_the_smoothed_figure_nor_the_slope() {
        let trend = TrendFigures::of(&series(&[1.0, 1.01, 1.02, 1.03, 1.04, 9.0, 1.06]));
        assert_eq!((trend.latest, trend.smoothed), (Some(1.06), Some(1.06)));
        assert!((trend.slope_30_d.unwrap() - 0.3).abs() < 1e-9, "{trend:?}");
    }

    #[test]
    fn a_few_runs_have_no_trend() {
        assert_eq!(TrendFigures::of(&[]), TrendFigures::default());
        let trend = TrendFigures::of(&series(&[1.0, 2.0]));
        assert_eq!(trend, TrendFigures { latest: Some(2.0), ..TrendFigures::default() });
        assert_eq!(TrendFigures::of(&series(&[1.0, 2.0, 4.0])).slope_30_d, None);
    }
}
