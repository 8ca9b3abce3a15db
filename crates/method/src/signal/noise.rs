//! Noise of a recorded channel: differences between rows that no motion causes.

/// Largest number of rows in use: their median is accurate to 2 %.
const MOST_ROWS: usize = 4096;
/// Smallest number of rows for a result.
const FEWEST_ROWS: usize = 50;
/// Median of the magnitude of a standard normal value.
const MEDIAN_MAGNITUDE: f64 = 0.674_489_750_196_081_7;
/// Variance of a second difference of independent values of variance one.
const SECOND_DIFFERENCE: f64 = 6.0;

/// Standard deviation of white noise of a channel, in its unit. It follows from second differences of the part that the
/// low-pass removed, `raw - smooth`, over ascending `rows`. Their median magnitude is not affected by blows and jumps,
/// which are rare, or by oscillations that are slow relative to the row rate. `None` with too few rows.
#[must_use]
pub fn white_noise(raw: &[f64], smooth: &[f64], rows: &[usize]) -> Option<f64> {
    let step = rows.len().div_ceil(MOST_ROWS).max(1);
    let difference = |row: usize| raw[row] - smooth[row];
    let together = rows.windows(3).step_by(step).filter(|of| of[2] == of[0] + 2);
    let second = together.map(|of| difference(of[0]) - 2.0 * difference(of[1]) + difference(of[2]));
    let mut magnitudes: Vec<f64> = second.map(f64::abs).filter(|of| of.is_finite()).collect();
    if magnitudes.len() < FEWEST_ROWS {
        return None;
    }
    let middle = magnitudes.len() / 2;
    let (_, median, _) = magnitudes.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*median / MEDIAN_MAGNITUDE / SECOND_DIFFERENCE.sqrt())
}

/// Part of the standard deviation of white noise that remains after a low-pass with a cut-off, Hz, at a sample rate,
/// Hz.
#[must_use]
pub fn passed(cutoff: f64, sample_rate: f64) -> f64 {
    (2.0 * cutoff / sample_rate).clamp(0.0, 1.0).sqrt()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Slow motion with noise of `sigma`, at `rate` Hz for a minute.
    fn recorded(sigma: f64, rate: f64) -> (Vec<f64>, Vec<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let smooth: Vec<f64> = (0..(60.0 * rate) as usize).map(|row| (row as f64 / rate).sin()).collect();
        let raw = smooth.iter().map(|of| of + sigma * rng.sample::<f64, _>(StandardNormal)).collect();
        (raw, smooth)
    }

    #[test]
    fn noise_is_measured_beside_blows_and_gaps() {
        for rate in [50.0, 250.0] {
            let (mut raw, smooth) = recorded(0.3, rate);
            // one blow per second that rings at 15 Hz for a tenth of a second
            for (row, of) in raw.iter_mut().enumerate() {
                let since = (row as f64 / rate).fract();
                *of += 5.0 * (-since / 0.05).exp() * (std::f64::consts::TAU * 15.0 * since).sin();
            }
            let rows: Vec<usize> = (0..raw.len()).filter(|row| row % 100 > 3).collect();
            let found = white_noise(&raw, &smooth, &rows).expect("rows");
            let tolerance = if rate > 100.0 { 0.05 } else { 0.2 };
            assert!((found / 0.3 - 1.0).abs() < tolerance, "{rate} Hz: {found}");
        }
    }

    #[test]
    fn a_slow_change_is_no_noise_and_few_rows_say_nothing() {
        let (raw, smooth) = recorded(0.0, 250.0);
        let rows: Vec<usize> = (0..raw.len()).collect();
        let lagging: Vec<f64> = raw.iter().map(|of| 0.9 * of).collect();
        assert!(white_noise(&raw, &lagging, &rows).expect("rows") < 1e-5);
        assert_eq!(white_noise(&raw, &smooth, &rows[..20]), None);
        assert_eq!(white_noise(&raw, &smooth, &rows.iter().copied().step_by(2).collect::<Vec<_>>()), None);
    }
}
