//! Statistics over the cycles of a run.

pub use armwatch_model::analysis::median::median;

use armwatch_model::analysis::{ParameterStatistics, RmsdSwing, StatisticsWindow};
use armwatch_model::robot::ParameterId;

/// Number of warm-up cycles; the thesis gives its statistics with and without them.
const WARM_UP_CYCLES: u32 = 5;

/// Statistics of one parameter over the cycles of a run, given as `(cycle, value)` in the order of the cycles: over all
/// of them and, if there are cycles after the fifth, also over those (Appendix H). Empty without values.
///
/// `D/MM = (max - min) / |max|`, `D/SE = |last - first| / |first|`.
#[must_use]
pub fn parameter_statistics(id: ParameterId, by_cycle: &[(u32, f64)]) -> Vec<ParameterStatistics> {
    let all: Vec<f64> = by_cycle.iter().map(|(_, value)| *value).collect();
    let later: Vec<f64> =
        by_cycle.iter().filter(|(cycle, _)| *cycle > WARM_UP_CYCLES).map(|(_, value)| *value).collect();
    [(StatisticsWindow::All, all), (StatisticsWindow::AfterFive, later)]
        .into_iter()
        .filter_map(|(window, values)| window_statistics(id, window, &values))
        .collect()
}

fn window_statistics(
    id: ParameterId,
    window: StatisticsWindow,
    values: &[f64],
) -> Option<ParameterStatistics> {
    let (first, last) = (*values.first()?, *values.last()?);
    let min = values.iter().copied().fold(f64::INFINITY, f64::min);
    let max = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(ParameterStatistics {
        id,
        window,
        mean: mean(values)?,
        min,
        max,
        d_mm: ratio(max - min, max.abs()),
        d_se: ratio((last - first).abs(), first.abs()),
        sdv: standard_deviation(values),
        cycles: values.len(),
    })
}

fn ratio(numerator: f64, denominator: f64) -> Option<f64> {
    (denominator > 0.0).then(|| numerator / denominator)
}

/// Arithmetic mean; `None` without values.
#[must_use]
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation (divisor `n - 1`); `None` for fewer than two values.
#[must_use]
pub fn standard_deviation(values: &[f64]) -> Option<f64> {
    if values.len() < 2 {
        return None;
    }
    let mean = mean(values)?;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// Median absolute deviation times 1.4826, the factor that makes it the standard deviation of a normal sample
/// (Rousseeuw & Croux 1993); `None` without values.
#[must_use]
pub(crate) fn robust_deviation(values: &[f64]) -> Option<f64> {
    let centre = median(values)?;
    let deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
    median(&deviations).map(|mad| 1.4826 * mad)
}

/// Variation of a series from one value to the next: `sqrt(sum (x[i+1] - x[i])² / (2 (n-1)))`. A slow trend, such as
/// warming up, has little effect (von Neumann 1941). `None` below four values, where chance decides.
///
/// A single outlier has no effect: a value is omitted if the series without it varies by less than half. The first
/// value always counts, since it may be that of a cold arm.
#[must_use]
pub fn swing(series: &[f64]) -> Option<RmsdSwing> {
    const FEWEST: usize = 4;
    const ODD_SHARE: f64 = 0.5;
    let without = |odd: usize| [&series[..odd], &series[odd + 1..]].concat();
    let of = |series: &[f64]| {
        let squares: f64 = series.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        let value = (squares / (2 * (series.len() - 1)) as f64).sqrt();
        RmsdSwing { value, cycles: series.len() }
    };
    let all = (series.len() >= FEWEST).then(|| of(series))?;
    let others = (1..series.len()).filter(|_| series.len() > FEWEST).map(|odd| of(&without(odd)));
    let least = others.min_by(|a, b| a.value.total_cmp(&b.value));
    Some(least.filter(|least| least.value < ODD_SHARE * all.value).unwrap_or(all))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::{JointIndex, ParameterKind};

    const ID: ParameterId = ParameterId { joint: JointIndex::new(0), kind: ParameterKind::Inertial(9) };

    #[test]
    fn the_thesis_figures_come_out_of_a_known_series() {
        let values: Vec<(u32, f64)> =
            [4.0, 2.0, 3.0, 5.0, 6.0, 7.0, 8.0].iter().copied().zip(1..).map(|(v, c)| (c, v)).collect();
        let [all, later] = parameter_statistics(ID, &values)[..] else { panic!("two windows") };
        assert_eq!((all.mean, all.min, all.max, all.cycles), (5.0, 2.0, 8.0, 7));
        assert_eq!((all.d_mm, all.d_se), (Some(0.75), Some(1.0)));
        // sum of squares about the mean is 28 over 6
        assert!((all.sdv.expect("spread") - (28.0_f64 / 6.0).sqrt()).abs() < 1e-15);
        assert_eq!((later.min, later.max, later.cycles), (7.0, 8.0, 2));
    }

    #[test]
    fn negative_maxima_and_zeros_have_no_wrong_ratio() {
        let [all] = parameter_statistics(ID, &[(1, -4.0), (2, -2.0)])[..] else { panic!("one window") };
        assert_eq!(all.d_mm, Some(1.0));
        let [zero] = parameter_statistics(ID, &[(1, 0.0)])[..] else { panic!("one window") };
        assert_eq!((zero.d_mm, zero.d_se, zero.sdv), (None, None, None));
        assert!(parameter_statistics(ID, &[]).is_empty());
    }

    #[test]
    fn a_trend_hardly_swings_and_an_alternation_does() {
        let trend: Vec<f64> = (0..20).map(f64::from).map(|i| 0.01 * i).collect();
        let alternation: Vec<f64> = (0..20).map(|i| if i % 2 == 0 { 0.0 } else { 0.1 }).collect();
        let (trend, alternation) = (swing(&trend).expect("long"), swing(&alternation).expect("long"));
        assert!((trend.value - 0.01 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((alternation.value - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(swing(&[1.0, 2.0, 3.0]), None);
    }

    #[test]
    fn one_odd_value_is_no_swing_and_two_are() {
        let usual = [0.030, 0.032, 0.031, 0.029, 0.031, 0.030, 0.032, 0.030];
        let of = |odd: &[usize]| {
            let with =
                |(place, value): (usize, &f64)| if odd.contains(&place) { 3.0 * value } else { *value };
            swing(&usual.iter().enumerate().map(with).collect::<Vec<f64>>()).expect("long")
        };
        let quiet = of(&[]);
        for odd in 1..8 {
            let found = of(&[odd]);
            assert!(found.cycles == 7 && found.value < 1.5 * quiet.value, "{odd}: {found:?}");
        }
        // a cold first cycle, and several outliers
        assert!(of(&[0]).value > 10.0 * quiet.value && of(&[2, 5]).value > 10.0 * quiet.value);
        assert_eq!(of(&[2, 5]).cycles, 8);
    }

    #[test]
    fn robust_deviation_shrugs_off_an_outlier() {
        assert!((robust_deviation(&[1.0, 2.0, 3.0, 4.0, 1000.0]).expect("some") - 1.4826).abs() < 1e-12);
        assert_eq!(robust_deviation(&[]), None);
        assert_eq!(median(&[3.0, 1.0]), Some(2.0));
    }
}
