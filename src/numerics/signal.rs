//! Zero-phase low-pass and differentiation: from recorded channels to `q`, `qd`, `qdd`, `tau`.

use std::ops::Range;

use sci_rs::signal::filter::design::{DigitalFilter, FilterBandType, FilterOutputType, Sos, butter_dyn};
use sci_rs::signal::filter::sosfiltfilt_dyn;

use super::NumericsError;
use crate::run::Samples;

/// Order of the Butterworth low-pass. Forward and backward passes double the roll-off and cancel
/// the phase.
const FILTER_ORDER: usize = 4;

/// A step longer than this many median steps is a gap: a filter must not run across it.
const GAP_STEPS: f64 = 1.5;

/// Shortest stretch between gaps that is filtered. The odd extension at either end needs 15 rows;
/// shorter stretches have no inner part.
const MIN_STRETCH_ROWS: usize = 32;

/// Periods of the cut-off at either end of a stretch that take no part. A motion that is cut off
/// there goes on in nobody's knowledge, and the extension that the low-pass makes up instead is felt
/// that far in.
const EDGE_PERIODS: f64 = 1.0;

/// A cycle's channels after the analysis low-pass, with acceleration. Joint channels are
/// `[n][rows]`, in rad, rad/s, rad/s², Nm.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditioned {
    /// Positions `q`.
    pub q: Vec<Vec<f64>>,
    /// Velocities `qd`.
    pub qd: Vec<Vec<f64>>,
    /// Accelerations `qdd`, by [`differentiate`] from `qd`.
    pub qdd: Vec<Vec<f64>>,
    /// Torques `tau`.
    pub tau: Vec<Vec<f64>>,
    /// Rows that may be used: stretches between gaps, without the ends over which the low-pass and the
    /// differences knew only one side.
    pub usable: Vec<Range<usize>>,
    /// Stretches between gaps that were filtered; rows outside hold zeros.
    stretches: Vec<Range<usize>>,
    /// Rows per second, from the median time step, Hz.
    pub sample_rate: f64,
    /// Cut-off of the low-pass, Hz.
    pub cutoff: f64,
}

impl Conditioned {
    /// Number of rows, usable or not.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.q.first().map_or(0, Vec::len)
    }

    /// Number of joints `n`.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.q.len()
    }

    /// The state of one row: `q`, `qd`, `qdd`, `tau`, each `[n]`, written to the given slices.
    pub fn row(&self, row: usize, q: &mut [f64], qd: &mut [f64], qdd: &mut [f64], tau: &mut [f64]) {
        for j in 0..self.q.len() {
            q[j] = self.q[j][row];
            qd[j] = self.qd[j][row];
            qdd[j] = self.qdd[j][row];
            tau[j] = self.tau[j][row];
        }
    }

    /// Usable rows at the rate that the low-pass leaves something in: every [`row_step`]-th.
    pub fn observed_rows(&self) -> impl Iterator<Item = usize> + '_ {
        let step = row_step(self.cutoff, self.sample_rate);
        self.usable.iter().flat_map(move |stretch| stretch.clone().step_by(step))
    }

    /// Rows that went through the low-pass; channels hold zeros in the others.
    pub fn filtered_rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.stretches.iter().flat_map(Clone::clone)
    }

    /// Stretches between gaps in time that were long enough to be filtered, and the rows in them.
    #[must_use]
    pub fn filtered(&self) -> (usize, usize) {
        (self.stretches.len(), self.stretches.iter().map(ExactSizeIterator::len).sum())
    }

    /// `series` `[rows]` through the low-pass that the channels went through; zero in unusable rows.
    #[must_use]
    pub fn low_passed(&self, series: &[f64]) -> Vec<f64> {
        // a cut-off that made this recording fits its sample rate
        let low_pass = LowPass::new(self.cutoff, self.sample_rate);
        low_pass.map_or_else(|_| series.to_vec(), |low_pass| low_pass.over(series, &self.stretches))
    }

    /// Fraction of independent rows: a low-pass at `f_c` leaves `2 f_c` independent values a second
    /// out of `f_s`. Standard errors that ignore this are too small by its square root.
    #[must_use]
    pub fn independent_fraction(&self) -> f64 {
        super::cross::independent_fraction(self.cutoff, self.sample_rate)
    }
}

/// Filters all channels of `samples` with a zero-phase fourth-order Butterworth low-pass at
/// `cutoff` Hz and differentiates velocity. A missing velocity is the central difference of the
/// filtered position.
///
/// # Errors
/// [`NumericsError::TooShort`] below 32 rows, [`NumericsError::CutoffTooHigh`] if the sample rate
/// cannot carry the cut-off, [`NumericsError::NotFinite`] for a time axis without a median step.
pub fn condition(samples: &Samples, cutoff: f64) -> Result<Conditioned, NumericsError> {
    let rows = samples.rows();
    if rows < MIN_STRETCH_ROWS {
        return Err(NumericsError::TooShort { what: "the cycle", rows, needed: MIN_STRETCH_ROWS });
    }
    let step = median_step(&samples.time).ok_or(NumericsError::NotFinite("the time steps"))?;
    let sample_rate = 1.0 / step;
    let low_pass = LowPass::new(cutoff, sample_rate)?;
    let stretches = stretches(&samples.time, step);

    let filtered = |channels: &[Vec<f64>]| -> Vec<Vec<f64>> {
        channels.iter().map(|channel| low_pass.over(channel, &stretches)).collect()
    };
    let differentiated = |channels: &[Vec<f64>]| -> Vec<Vec<f64>> {
        channels.iter().map(|channel| differentiate_over(channel, &samples.time, &stretches)).collect()
    };
    let q = filtered(&samples.position);
    let qd = match &samples.velocity {
        Some(velocity) => filtered(velocity),
        None => differentiated(&q),
    };
    let qdd = differentiated(&qd);
    let tau = filtered(&samples.torque);
    let edge = (EDGE_PERIODS * sample_rate / cutoff).ceil() as usize;
    let usable =
        stretches.iter().map(|s| s.start + edge..s.end.saturating_sub(edge)).filter(|s| !s.is_empty());
    Ok(Conditioned { q, qd, qdd, tau, usable: usable.collect(), stretches, sample_rate, cutoff })
}

/// Every how many rows of a recording at `sample_rate` Hz something new is seen after a low-pass at
/// `cutoff` Hz. At three times the cut-off the low-pass, run both ways, leaves `1 / (1 + 3⁸)`, less
/// than 0.0002; rows at twice that rate hold everything below. More of them cost time and say the same
/// again.
#[must_use]
pub fn row_step(cutoff: f64, sample_rate: f64) -> usize {
    const ROWS_PER_PERIOD: f64 = 6.0;
    ((sample_rate / (ROWS_PER_PERIOD * cutoff)).floor() as usize).max(1)
}

/// Median time step, s; `None` for fewer than two rows or a time that does not grow. Taken over pairs
/// of steps, halved: loggers whose clock does not divide their rate alternate, say, 10 and 12 ms.
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

/// Derivative of `values` over `step` seconds, same length: central differences of sixth order
/// (Fornberg 1988), of second order in the three rows at either end, one-sided at the very ends.
///
/// Second order takes `(2 pi f step)² / 6` of what changes at the frequency `f`: at 100 Hz and 5 Hz 1.6 %,
/// which the torque beside it has not lost. Sixth order takes 0.001 % there.
#[must_use]
pub fn differentiate(values: &[f64], step: f64) -> Vec<f64> {
    let n = values.len();
    let mut out = vec![0.0; n];
    if n < 2 {
        return out;
    }
    for i in 1..n - 1 {
        let difference = |rows: usize| values[i + rows] - values[i - rows];
        out[i] = match (3..n.saturating_sub(3)).contains(&i) {
            true => (45.0 * difference(1) - 9.0 * difference(2) + difference(3)) / (60.0 * step),
            false => difference(1) / (2.0 * step),
        };
    }
    out[0] = (values[1] - values[0]) / step;
    out[n - 1] = (values[n - 1] - values[n - 2]) / step;
    out
}

/// A zero-phase low-pass in second-order sections; the transfer-function form loses all digits at
/// low cut-offs.
struct LowPass {
    sections: Vec<Sos<f64>>,
}

impl LowPass {
    fn new(cutoff: f64, sample_rate: f64) -> Result<Self, NumericsError> {
        let too_high = NumericsError::CutoffTooHigh { sample_rate_hz: sample_rate, cutoff_hz: cutoff };
        if !(cutoff > 0.0 && cutoff < 0.5 * sample_rate) {
            return Err(too_high);
        }
        let design = butter_dyn(
            FILTER_ORDER,
            vec![cutoff],
            Some(FilterBandType::Lowpass),
            Some(false),
            Some(FilterOutputType::Sos),
            Some(sample_rate),
        );
        match design {
            DigitalFilter::Sos(sos) => Ok(Self { sections: sos.sos }),
            _ => Err(too_high),
        }
    }

    fn over(&self, channel: &[f64], stretches: &[Range<usize>]) -> Vec<f64> {
        let mut out = vec![0.0; channel.len()];
        for stretch in stretches {
            let filtered = sosfiltfilt_dyn(channel[stretch.clone()].iter(), &self.sections);
            out[stretch.clone()].copy_from_slice(&filtered);
        }
        out
    }
}

/// Rows between gaps in time, as far as they are long enough to be filtered.
fn stretches(time: &[f64], step: f64) -> Vec<Range<usize>> {
    let breaks =
        time.windows(2).enumerate().filter(|(_, w)| w[1] - w[0] > GAP_STEPS * step).map(|(i, _)| i + 1);
    let mut found = Vec::new();
    let mut start = 0;
    for end in breaks.chain([time.len()]) {
        if end - start >= MIN_STRETCH_ROWS {
            found.push(start..end);
        }
        start = end;
    }
    found
}

/// Differentiates stretch by stretch. The step is the stretch's mean: time stamps are rounded to
/// what the logger prints, and the jitter would enter the acceleration.
fn differentiate_over(channel: &[f64], time: &[f64], stretches: &[Range<usize>]) -> Vec<f64> {
    let mut out = vec![0.0; channel.len()];
    for stretch in stretches {
        let steps = (stretch.len() - 1) as f64;
        let step = (time[stretch.end - 1] - time[stretch.start]) / steps;
        out[stretch.clone()].copy_from_slice(&differentiate(&channel[stretch.clone()], step));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_joint(
        rate: f64,
        rows: usize,
        position: impl Fn(f64) -> f64,
        velocity: impl Fn(f64) -> f64,
    ) -> Samples {
        let time: Vec<f64> = (0..rows).map(|i| i as f64 / rate).collect();
        Samples {
            position: vec![time.iter().map(|&t| position(t)).collect()],
            velocity: Some(vec![time.iter().map(|&t| velocity(t)).collect()]),
            torque: vec![vec![3.5; rows]],
            stage: vec![crate::run::Stage::Excitation; rows],
            cycle: None,
            friction_signal: None,
            temperatures: None,
            stage_level: None,
            time,
        }
    }

    /// Away from the ends the odd extension has died out.
    fn inner_rows(rows: usize) -> Range<usize> {
        200..rows - 200
    }

    fn inner(values: &[f64]) -> &[f64] {
        &values[inner_rows(values.len())]
    }

    #[test]
    fn a_constant_stays_and_a_slow_sine_is_not_shifted() {
        let w = 2.0 * std::f64::consts::PI * 0.5;
        let samples = one_joint(250.0, 2000, |t| (w * t).sin(), |t| w * (w * t).cos());
        let c = condition(&samples, 12.0).expect("conditions");
        assert!(c.tau[0].iter().all(|tau| (tau - 3.5).abs() < 1e-9));
        // a 0.5 Hz sine under a twice fourth-order low-pass at 12 Hz loses (0.5/12)^8 of itself
        for (filtered, raw) in inner(&c.q[0]).iter().zip(inner(&samples.position[0])) {
            assert!((filtered - raw).abs() < 1e-6, "{filtered} {raw}");
        }
        for (i, qdd) in c.qdd[0].iter().enumerate().skip(200).take(1600) {
            let exact = -w * w * (w * samples.time[i]).sin();
            assert!((qdd - exact).abs() < 1e-3 * w * w, "{qdd} {exact}");
        }
    }

    #[test]
    fn derivatives_are_exact_for_polynomials_of_their_order() {
        let (step, rows) = (0.1, 20);
        for power in 0..7 {
            let x: Vec<f64> = (0..rows).map(|i| (step * f64::from(i) - 1.0).powi(power)).collect();
            let found = differentiate(&x, step);
            for i in 0..rows {
                let x = step * f64::from(i) - 1.0;
                let exact = if power == 0 { 0.0 } else { f64::from(power) * x.powi(power - 1) };
                let order = if (3..rows - 3).contains(&i) {
                    6
                } else if (1..rows - 1).contains(&i) {
                    2
                } else {
                    1
                };
                if power <= order {
                    // rounding over the step
                    assert!((found[i as usize] - exact).abs() < 1e-12, "x^{power} in row {i}");
                }
            }
        }
        assert_eq!(differentiate(&[3.0], 0.1), [0.0]);
        assert_eq!(differentiate(&[1.0, 2.0, 4.0], 1.0), [1.0, 1.5, 2.0]);
    }

    #[test]
    fn a_fast_disturbance_is_removed() {
        let w = 2.0 * std::f64::consts::PI * 60.0;
        let samples = one_joint(250.0, 2000, |t| (w * t).sin(), |_| 0.0);
        let c = condition(&samples, 12.0).expect("conditions");
        assert!(inner(&c.q[0]).iter().all(|q| q.abs() < 1e-5));
    }

    #[test]
    fn a_missing_velocity_is_derived() {
        let mut samples = one_joint(250.0, 2000, |t| t.sin(), |_| 0.0);
        samples.velocity = None;
        let c = condition(&samples, 12.0).expect("conditions");
        for (i, qd) in c.qd[0].iter().enumerate().skip(200).take(1600) {
            assert!((qd - samples.time[i].cos()).abs() < 1e-4);
        }
    }

    #[test]
    fn a_gap_splits_the_record_and_no_filter_runs_across() {
        let mut samples = one_joint(100.0, 400, |_| 0.0, |_| 0.0);
        for i in 200..400 {
            samples.time[i] += 5.0;
            samples.torque[0][i] = -100.0;
        }
        let c = condition(&samples, 12.0).expect("conditions");
        // 100 Hz and 12 Hz: nine rows at either end
        assert_eq!(c.usable, vec![9..191, 209..391]);
        assert!(c.tau[0][..200].iter().all(|tau| (tau - 3.5).abs() < 1e-9));
        assert!(c.tau[0][200..].iter().all(|tau| (tau + 100.0).abs() < 1e-9));
    }

    #[test]
    fn alternating_steps_are_one_rate_and_no_gaps() {
        let w = 2.0 * std::f64::consts::PI * 0.5;
        let mut samples = one_joint(90.0, 1000, |_| 0.0, |_| 0.0);
        for row in 0..1000 {
            let t = 0.022 * (row / 2) as f64 + if row % 2 == 1 { 0.010 } else { 0.0 };
            samples.time[row] = t;
            samples.position[0][row] = (w * t).sin();
        }
        samples.velocity = None;
        let c = condition(&samples, 12.0).expect("conditions");
        assert!((c.sample_rate - 1.0 / 0.011).abs() < 1e-6, "{}", c.sample_rate);
        assert_eq!(c.filtered(), (1, 1000));
        // a millisecond of jitter on a speed of three: what the low-pass leaves of it
        for row in inner_rows(1000) {
            let exact = w * (w * samples.time[row]).cos();
            assert!((c.qd[0][row] - exact).abs() < 0.01 * w, "{} {exact}", c.qd[0][row]);
        }
    }

    #[test]
    fn too_short_and_too_slow_are_refused() {
        let short = one_joint(250.0, 10, |_| 0.0, |_| 0.0);
        assert!(matches!(condition(&short, 12.0), Err(NumericsError::TooShort { rows: 10, .. })));
        let slow = one_joint(20.0, 400, |_| 0.0, |_| 0.0);
        assert!(matches!(condition(&slow, 12.0), Err(NumericsError::CutoffTooHigh { .. })));
    }
}
