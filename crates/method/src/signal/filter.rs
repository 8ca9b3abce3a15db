//! Zero-phase low-pass and differentiation: from recorded channels to `q`, `qd`, `qdd`, `tau`.

use std::borrow::Cow;
use std::ops::Range;

use super::low_pass::{LowPass, MOST_AT_ONCE};
use super::time_grid::{EvenGrid, is_even, longest_step, median_step, sample_rate};
use crate::NumericsError;
use crate::buffers::Buffers;
use crate::lanes::{Kernel, wide};
use crate::spare_threads::SpareThreads;
use armwatch_model::robot::MAX_JOINTS;
use armwatch_model::run::Samples;

/// Shortest stretch between gaps that is filtered. The odd extension at each end needs 15 rows; shorter stretches have
/// no inner part.
pub const MIN_STRETCH_ROWS: usize = 32;

/// Number of cut-off periods at each end of a stretch whose rows are discarded, because the low-pass uses extrapolated
/// samples there.
const EDGE_PERIODS: f64 = 1.0;

/// Channels of a cycle after the analysis low-pass, with acceleration. Joint channels are `[n][rows]`, in rad, rad/s,
/// rad/s², Nm.
#[derive(Debug, Clone, PartialEq)]
pub struct FilteredSignals {
    /// Positions `q`.
    pub q: Vec<Vec<f64>>,
    /// Velocities `qd`.
    pub qd: Vec<Vec<f64>>,
    /// Accelerations `qdd`, by `differentiated` from `qd`.
    pub qdd: Vec<Vec<f64>>,
    /// Torques `tau`.
    pub tau: Vec<Vec<f64>>,
    /// Usable rows: stretches between gaps, without the ends, because the low-pass and the differences have data on one
    /// side only there.
    pub usable: Vec<Range<usize>>,
    /// Stretches between gaps that were filtered; rows outside hold zeros.
    stretches: Vec<GaplessRows>,
    /// Rows per second ([`sample_rate`]), Hz.
    pub sample_rate: f64,
    /// Cut-off of the low-pass, Hz.
    pub cutoff: f64,
    /// Memory for channels.
    buffers: Buffers,
}

impl FilteredSignals {
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

    /// Writes the state of one row to the given slices: `q`, `qd`, `qdd`, `tau`, each `[n]`.
    pub fn row(&self, row: usize, q: &mut [f64], qd: &mut [f64], qdd: &mut [f64], tau: &mut [f64]) {
        for j in 0..self.q.len() {
            q[j] = self.q[j][row];
            qd[j] = self.qd[j][row];
            qdd[j] = self.qdd[j][row];
            tau[j] = self.tau[j][row];
        }
    }

    /// Usable rows at the rate of the information after the low-pass: every [`row_step`]-th.
    pub fn observed_rows(&self) -> impl Iterator<Item = usize> + '_ {
        let step = row_step(self.cutoff, self.sample_rate);
        self.usable.iter().flat_map(move |stretch| stretch.clone().step_by(step))
    }

    /// Rows that the low-pass was applied to; channels hold zeros in the others.
    pub fn filtered_rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.stretches.iter().flat_map(|stretch| stretch.rows.clone())
    }

    /// Number of stretches between gaps in time that were long enough to be filtered, and number of their rows.
    #[must_use]
    pub fn filtered(&self) -> (usize, usize) {
        (self.stretches.len(), self.stretches.iter().map(|stretch| stretch.rows.len()).sum())
    }

    /// Applies the channels' low-pass to each of `series` `[rows]`; zero in rows outside the stretches.
    #[must_use]
    pub fn low_passed(&self, series: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // this cut-off was already accepted for this sample rate
        let Ok(low_pass) = LowPass::new(self.cutoff, self.sample_rate) else { return series.to_vec() };
        let channels: Vec<&[f64]> = series.iter().map(Vec::as_slice).collect();
        let alone = SpareThreads::default();
        let pieces = low_passed(&channels, &self.stretches, &low_pass, &self.buffers, &alone);
        pieces.into_iter().map(|pieces| joined(pieces, &self.stretches, self.rows())).collect()
    }

    /// Derivative over true times of a low-passed channel, per second; zero in rows that were not filtered.
    #[must_use]
    pub fn derivative(&self, channel: &[f64]) -> Vec<f64> {
        let derivative =
            |stretch: &GaplessRows| differentiated(&stretch.to_grid(channel), stretch.step, &self.buffers);
        joined(self.stretches.iter().map(derivative).collect(), &self.stretches, channel.len())
    }

    /// Same as [`derivative`](Self::derivative), for one `row`, per second; `None` if the row's stretch is not evenly
    /// spaced in time.
    #[must_use]
    pub fn derivative_at(&self, channel: &[f64], row: usize) -> Option<f64> {
        let of_row = |stretch: &&GaplessRows| stretch.rows.contains(&row);
        let Some(stretch) = self.stretches.iter().find(of_row) else { return Some(0.0) };
        let at = row - stretch.rows.start;
        let own = &channel[stretch.rows.clone()];
        stretch.grid.is_none().then(|| difference_at(own, at, stretch.step))
    }

    /// Empty channel with room for all rows of this recording.
    #[must_use]
    pub fn room(&self) -> Vec<f64> {
        self.buffers.room(self.rows())
    }

    /// Returns the memory of channels that are no longer needed.
    pub fn give_back(&self, channels: impl IntoIterator<Item = Vec<f64>>) {
        self.buffers.give_back(channels);
    }

    /// Returns the memory of all channels.
    pub fn end(self) {
        let Self { q, qd, qdd, tau, buffers, .. } = self;
        buffers.give_back([q, qd, qdd, tau].into_iter().flatten());
    }

    /// Returns true if rows are evenly spaced in time, as far as the resolution of the time stamps shows.
    #[must_use]
    pub fn is_even(&self) -> bool {
        self.stretches.iter().all(|stretch| stretch.grid.is_none())
    }

    /// Fraction of the observed rows that are independent: a low-pass at `f_c` leaves `2 f_c` independent values per
    /// second. Standard errors that ignore this are too small by its square root.
    #[must_use]
    pub fn independent_fraction(&self) -> f64 {
        self::independent_fraction(self.cutoff, self.sample_rate)
    }
}

/// Cut-off suitable for rows at `sample_rate` Hz: the given one, or a quarter of the rate if that is less.
///
/// Near half the sample rate, a discrete low-pass is distorted, differences lose signal, and aliases from the logger
/// appear: at 30 Hz a cut-off of 12 Hz doubles the errors of parameters compared with 7 Hz.
#[must_use]
pub fn carried_cutoff(cutoff: f64, sample_rate: f64) -> f64 {
    const RATE_SHARE: f64 = 0.25;
    let most = RATE_SHARE * sample_rate;
    if cutoff <= most { cutoff } else { ((10.0 * most).floor() / 10.0).max(0.1 * most) }
}

/// Filters all channels of `samples` with a zero-phase fourth-order Butterworth low-pass at `cutoff` Hz and
/// differentiates velocity. A missing velocity is the central difference of the filtered position. Rows that are not
/// evenly spaced are interpolated to an even grid and back.
///
/// # Errors
/// [`NumericsError::TooShort`] below 32 rows, [`NumericsError::CutoffTooHigh`] if the sample rate is too low for the
/// cut-off, [`NumericsError::NotFinite`] for a time axis without a median step.
pub fn filter_signals(samples: &Samples, cutoff: f64) -> Result<FilteredSignals, NumericsError> {
    filter_signals_into(samples, cutoff, &Buffers::default(), &SpareThreads::default())
}

/// Same as [`filter_signals`], with channels in memory of `buffers`, and on more threads while some are `spare`.
///
/// # Errors
/// Those of [`filter_signals`].
pub(crate) fn filter_signals_into(
    samples: &Samples,
    cutoff: f64,
    buffers: &Buffers,
    spare: &SpareThreads,
) -> Result<FilteredSignals, NumericsError> {
    let rows = samples.rows();
    if rows < MIN_STRETCH_ROWS {
        return Err(NumericsError::TooShort { what: "the cycle", rows, needed: MIN_STRETCH_ROWS });
    }
    let no_step = NumericsError::NotFinite("the time steps");
    let step = median_step(&samples.time).ok_or(no_step.clone())?;
    let sample_rate = sample_rate(&samples.time).ok_or(no_step)?;
    let low_pass = LowPass::new(cutoff, sample_rate)?;
    let stretches = stretches(&samples.time, longest_step(step, cutoff), sample_rate);

    let derivative = |pieces: &Vec<Vec<f64>>| -> Vec<Vec<f64>> {
        let of_piece =
            |(piece, stretch): (&Vec<f64>, &GaplessRows)| differentiated(piece, stretch.step, buffers);
        pieces.iter().zip(&stretches).map(of_piece).collect()
    };
    let at_rows = |channels: Vec<Vec<Vec<f64>>>| -> Vec<Vec<f64>> {
        channels.into_iter().map(|pieces| joined(pieces, &stretches, rows)).collect()
    };
    let (n, velocity) = (samples.joint_count(), samples.velocity.iter().flatten());
    let recorded = samples.position.iter().chain(&samples.torque).chain(velocity).map(Vec::as_slice);
    let mut q = low_passed(&recorded.collect::<Vec<_>>(), &stretches, &low_pass, buffers, spare);
    let mut tau = q.split_off(n);
    let mut qd = tau.split_off(n);
    if samples.velocity.is_none() {
        qd = q.iter().map(derivative).collect();
    }
    let qdd: Vec<Vec<Vec<f64>>> = qd.iter().map(derivative).collect();
    let [q, qd, qdd, tau] = [q, qd, qdd, tau].map(at_rows);
    let edge = (EDGE_PERIODS * sample_rate / cutoff).ceil() as usize;
    let usable = stretches.iter().map(|s| s.rows.start + edge..s.rows.end.saturating_sub(edge));
    let usable = usable.filter(|s| !s.is_empty()).collect();
    let buffers = buffers.clone();
    Ok(FilteredSignals { q, qd, qdd, tau, usable, stretches, sample_rate, cutoff, buffers })
}

/// Distance in rows between observed rows of a recording at `sample_rate` Hz after a low-pass at `cutoff` Hz. At three
/// times the cut-off the low-pass, applied in both directions, leaves `1 / (1 + 3⁸)`, less than 0.0002; rows at twice
/// that rate hold everything below. More rows take time and add no information.
#[must_use]
pub fn row_step(cutoff: f64, sample_rate: f64) -> usize {
    const ROWS_PER_PERIOD: f64 = 6.0;
    ((sample_rate / (ROWS_PER_PERIOD * cutoff)).floor() as usize).max(1)
}

/// Derivative of `values` over `step` seconds, same length: central differences of sixth order (Fornberg 1988), of
/// second order in the three rows at each end, one-sided in the first and last row.
///
/// Second order loses `(2 pi f step)² / 6` of a signal at the frequency `f`: 1.6 % at 100 Hz and 5 Hz, which the
/// torque has not lost. Sixth order loses 0.001 % there.
fn differentiated(values: &[f64], step: f64, buffers: &Buffers) -> Vec<f64> {
    let n = values.len();
    let mut out = buffers.channel(n);
    for i in (0..n).filter(|i| *i < 3 || i + 3 >= n) {
        out[i] = difference_at(values, i, step);
    }
    if let Some(inner) = out.get_mut(3..) {
        wide(InnerDifferences { values, step, out: inner });
    }
    out
}

/// Difference of `differentiated` at index `i`.
fn difference_at(values: &[f64], i: usize, step: f64) -> f64 {
    let n = values.len();
    if n < 2 {
        return 0.0;
    }
    if i == 0 {
        return (values[1] - values[0]) / step;
    }
    if i == n - 1 {
        return (values[n - 1] - values[n - 2]) / step;
    }
    match i.checked_sub(3).and_then(|first| values[first..].first_chunk()) {
        Some(around) => central_difference(around, step),
        None => (values[i + 1] - values[i - 1]) / (2.0 * step),
    }
}

/// Central difference of sixth order at the middle of seven values.
#[inline(always)]
fn central_difference(at: &[f64; 7], step: f64) -> f64 {
    (45.0 * (at[4] - at[2]) - 9.0 * (at[5] - at[1]) + (at[6] - at[0])) / (60.0 * step)
}

/// Central differences of sixth order for the values with three others on each side; `out` begins after the first
/// three.
struct InnerDifferences<'a> {
    values: &'a [f64],
    step: f64,
    out: &'a mut [f64],
}

impl Kernel for InnerDifferences<'_> {
    /// Has no branch per row, so that the compiler vectorises.
    #[inline(always)]
    fn run(self) {
        let Self { values, step, out } = self;
        for (out, at) in out.iter_mut().zip(values.array_windows::<7>()) {
            *out = central_difference(at, step);
        }
    }
}

/// Rows without a gap in time.
#[derive(Debug, Clone, PartialEq)]
struct GaplessRows {
    rows: Range<usize>,
    /// Even grid for filters and differences, if rows are not evenly spaced.
    grid: Option<EvenGrid>,
    /// Time between grid points, s: the mean step of evenly spaced rows. Time stamps are rounded by the logger, and
    /// that jitter would enter the acceleration.
    step: f64,
}

impl GaplessRows {
    /// Part of a channel on the stretch's grid.
    fn to_grid<'c>(&self, channel: &'c [f64]) -> Cow<'c, [f64]> {
        let own = &channel[self.rows.clone()];
        self.grid.as_ref().map_or(Cow::Borrowed(own), |grid| Cow::Owned(grid.to_grid(own)))
    }

    /// Low-passed parts of channels on the stretch's grid.
    fn low_passed(&self, low_pass: &LowPass, channels: &[&[f64]], buffers: &Buffers) -> Vec<Vec<f64>> {
        let own: Vec<Cow<'_, [f64]>> = channels.iter().map(|channel| self.to_grid(channel)).collect();
        low_pass.over(&own.iter().map(|own| &**own).collect::<Vec<_>>(), buffers)
    }
}

/// Low-passed channels of the whole recording, each as its pieces on the grids of the stretches.
fn low_passed(
    channels: &[&[f64]],
    stretches: &[GaplessRows],
    low_pass: &LowPass,
    buffers: &Buffers,
    spare: &SpareThreads,
) -> Vec<Vec<Vec<f64>>> {
    let groups: Vec<&[&[f64]]> = channels.chunks(MOST_AT_ONCE).collect();
    let of_groups = spare.each(
        groups.len(),
        || (),
        |(), group| {
            let mut of_channels = vec![Vec::with_capacity(stretches.len()); groups[group].len()];
            for stretch in stretches {
                let pieces = stretch.low_passed(low_pass, groups[group], buffers);
                of_channels.iter_mut().zip(pieces).for_each(|(of, piece)| of.push(piece));
            }
            of_channels
        },
    );
    of_groups.into_iter().flatten().collect()
}

/// Joins pieces on the grids of the stretches into one channel of the recording; zero between them.
fn joined(mut pieces: Vec<Vec<f64>>, stretches: &[GaplessRows], rows: usize) -> Vec<f64> {
    if let ([GaplessRows { rows: whole, grid: None, .. }], 1) = (stretches, pieces.len())
        && *whole == (0..rows)
    {
        return pieces.swap_remove(0);
    }
    let mut out = vec![0.0; rows];
    for (piece, stretch) in pieces.iter().zip(stretches) {
        let at_rows = stretch.grid.as_ref().map(|grid| grid.to_rows(piece));
        out[stretch.rows.clone()].copy_from_slice(at_rows.as_ref().unwrap_or(piece));
    }
    out
}

/// Rows between steps longer than `longest_step` s, if there are enough to be filtered. If one stretch is not evenly
/// spaced, all have grids, of one rate.
fn stretches(time: &[f64], longest_step: f64, rate: f64) -> Vec<GaplessRows> {
    let breaks = time.windows(2).enumerate().filter(|(_, w)| w[1] - w[0] > longest_step).map(|(i, _)| i + 1);
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut start = 0;
    for end in breaks.chain([time.len()]) {
        if end - start >= MIN_STRETCH_ROWS {
            found.push(start..end);
        }
        start = end;
    }
    let even = found.iter().all(|rows| is_even(&time[rows.clone()], 1.0 / rate));
    let stretch = |rows: Range<usize>| {
        let grid = (!even).then(|| EvenGrid::new(&time[rows.clone()], rate));
        let mean = (time[rows.end - 1] - time[rows.start]) / (rows.len() - 1) as f64;
        GaplessRows { step: grid.as_ref().map_or(mean, |grid| grid.step), grid, rows }
    };
    found.into_iter().map(stretch).collect()
}

/// Fraction of the observed rows of a recording at `sample_rate` Hz that are independent after a
/// low-pass at `cutoff` Hz.
#[must_use]
pub fn independent_fraction(cutoff: f64, sample_rate: f64) -> f64 {
    (2.0 * cutoff * row_step(cutoff, sample_rate) as f64 / sample_rate).min(1.0)
}

/// Buffers for one sample: `q`, `qd`, `qdd`, `tau`.
pub(crate) fn state() -> ([f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS], [f64; MAX_JOINTS]) {
    ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS])
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
            stage: vec![armwatch_model::run::Stage::Excitation; rows],
            cycle: None,
            friction_signal: None,
            temperatures: None,
            time,
        }
    }

    /// Rows far enough from the ends for the odd extension to have no effect.
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
        let c = filter_signals(&samples, 12.0).expect("conditions");
        assert!(c.tau[0].iter().all(|tau| (tau - 3.5).abs() < 1e-9));
        // a 0.5 Hz sine loses (0.5/12)^8 in two passes of a fourth-order low-pass at 12 Hz
        for (filtered, raw) in inner(&c.q[0]).iter().zip(inner(&samples.position[0])) {
            assert!((filtered - raw).abs() < 1e-6, "{filtered} {raw}");
        }
        for (i, qdd) in c.qdd[0].iter().enumerate().skip(200).take(1600) {
            let exact = -w * w * (w * samples.time[i]).sin();
            assert!((qdd - exact).abs() < 1e-3 * w * w, "{qdd} {exact}");
        }
    }

    fn differentiate(values: &[f64], step: f64) -> Vec<f64> {
        differentiated(values, step, &Buffers::default())
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
        for rows in 0..12 {
            let x: Vec<f64> = (0..rows).map(|i| (0.7 * f64::from(i)).sin()).collect();
            let alone: Vec<f64> = (0..x.len()).map(|i| difference_at(&x, i, step)).collect();
            assert_eq!(differentiate(&x, step), alone);
        }
        assert_eq!(differentiate(&[3.0], 0.1), [0.0]);
        assert_eq!(differentiate(&[1.0, 2.0, 4.0], 1.0), [1.0, 1.5, 2.0]);
    }

    #[test]
    fn a_fast_disturbance_is_removed() {
        let w = 2.0 * std::f64::consts::PI * 60.0;
        let samples = one_joint(250.0, 2000, |t| (w * t).sin(), |_| 0.0);
        let c = filter_signals(&samples, 12.0).expect("conditions");
        assert!(inner(&c.q[0]).iter().all(|q| q.abs() < 1e-5));
    }

    #[test]
    fn a_missing_velocity_is_derived() {
        let mut samples = one_joint(250.0, 2000, |t| t.sin(), |_| 0.0);
        samples.velocity = None;
        let c = filter_signals(&samples, 12.0).expect("conditions");
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
        let c = filter_signals(&samples, 12.0).expect("conditions");
        // 100 Hz and 12 Hz: nine rows at each end
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
        let c = filter_signals(&samples, 12.0).expect("conditions");
        assert!((c.sample_rate - 1.0 / 0.011).abs() < 1e-6, "{}", c.sample_rate);
        assert_eq!(c.filtered(), (1, 1000));
        // remainder of a millisecond of jitter, at a speed of three, after the low-pass
        for row in inner_rows(1000) {
            let exact = w * (w * samples.time[row]).cos();
            assert!((c.qd[0][row] - exact).abs() < 0.01 * w, "{} {exact}", c.qd[0][row]);
        }
    }

    /// Logger of 500 Hz that writes every fifth or sixth row, at random.
    fn uneven(rows: usize) -> Vec<f64> {
        let mut state = 7_u32;
        let mut t = 0.0;
        (0..rows)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                t += if state >> 16 & 3 == 0 { 0.010 } else { 0.012 };
                t
            })
            .collect()
    }

    #[test]
    fn steps_that_change_are_taken_at_their_true_times() {
        let w = 2.0 * std::f64::consts::PI * 0.5;
        let mut samples = one_joint(90.0, 2000, |_| 0.0, |_| 0.0);
        // slower in its second half, one row lost in each half
        samples.time = uneven(2000);
        let late: Vec<f64> =
            samples.time[1000..].iter().map(|t| t * 1.08 - 0.08 * samples.time[1000]).collect();
        samples.time[1000..].copy_from_slice(&late);
        samples.position[0] = samples.time.iter().map(|t| (w * t).sin()).collect();
        for lost in [1500, 500] {
            samples.time.remove(lost);
            samples.position[0].remove(lost);
        }
        samples.velocity = None;
        samples.torque = vec![samples.torque[0][..1998].to_vec()];
        samples.stage.truncate(1998);
        let c = filter_signals(&samples, 12.0).expect("conditions");
        assert_eq!(c.filtered(), (1, 1998));
        let span = samples.time[1997] - samples.time[0];
        assert!((c.sample_rate / (1997.0 / span) - 1.0).abs() < 1e-9, "{}", c.sample_rate);
        for row in 200..1798 {
            let t = samples.time[row];
            assert!((c.qd[0][row] - w * (w * t).cos()).abs() < 2e-4 * w, "{row}: {}", c.qd[0][row]);
            assert!((c.qdd[0][row] + w * w * (w * t).sin()).abs() < 2e-3 * w * w, "{row}: {}", c.qdd[0][row]);
            assert!((c.derivative(&c.q[0])[row] - c.qd[0][row]).abs() < 2e-4 * w || row % 100 > 0);
        }
    }

    #[test]
    fn the_cut_off_is_lowered_where_rows_do_not_carry_it() {
        assert_eq!([50.0, 100.0, 5000.0].map(|rate| carried_cutoff(12.0, rate)), [12.0; 3]);
        assert_eq!([30.0, 20.0, 10.0].map(|rate| carried_cutoff(12.0, rate)), [7.5, 5.0, 2.5]);
        assert!(carried_cutoff(12.0, 0.2) > 0.0);
    }

    #[test]
    fn too_short_and_too_slow_are_refused() {
        let short = one_joint(250.0, 10, |_| 0.0, |_| 0.0);
        assert!(matches!(filter_signals(&short, 12.0), Err(NumericsError::TooShort { rows: 10, .. })));
        let slow = one_joint(20.0, 400, |_| 0.0, |_| 0.0);
        assert!(matches!(filter_signals(&slow, 12.0), Err(NumericsError::CutoffTooHigh { .. })));
    }
}
