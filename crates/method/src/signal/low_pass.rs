//! Zero-phase low-pass over several channels at once, one per lane.
//!
//! Second-order sections run forwards and backwards over a channel that is extended at each end by its odd reflection
//! (Gustafsson 1996; as SciPy's `sosfiltfilt`). The order of operations is SciPy's, so that a channel in a lane gives
//! the same bits as a single channel.

use std::f64::consts::PI;

use nalgebra::Complex;

use crate::NumericsError;
use crate::buffers::Buffers;
use crate::lanes::{Kernel, LANES, Lanes, wide};

/// Order of the Butterworth low-pass. Forward and backward passes double the roll-off and cancel
/// the phase.
const FILTER_ORDER: usize = 4;

const SECTIONS: usize = FILTER_ORDER / 2;

/// Largest number of channels that are filtered at once.
pub(super) const MOST_AT_ONCE: usize = 8;

/// Number of rows of the extension at each end: three for each coefficient of the whole filter.
const EDGE: usize = 3 * (2 * SECTIONS + 1);

/// Zero-phase low-pass in second-order sections; the transfer-function form loses all digits at low cut-offs.
pub(super) struct LowPass {
    sections: [FilterSection; SECTIONS],
}

/// Section `(b0 + b1/z + b2/z²) / (a0 + a1/z + a2/z²)` with `a0 = 1`.
#[derive(Debug, Clone, Copy)]
struct FilterSection {
    b: [f64; 3],
    a: [f64; 3],
    /// States of the section for a constant input of 1 to the whole filter.
    settled: [f64; 2],
}

impl LowPass {
    /// Designs the filter. Poles of the analog low-pass are on the left half of a circle, at
    /// `s_i = W exp(jπ(2i + N + 1)/2N)`; the bilinear transform `z = (4 + s)/(4 - s)` of a rate of 2 moves them into
    /// the unit circle and all zeros to -1. The warped radius `W = 4 tan(π cutoff/rate)` keeps the gain of 1/√2 at
    /// the cut-off (Oppenheim and Schafer, Discrete-Time Signal Processing, 7.2 and 7.3). The poles nearest to the
    /// unit circle come last, the gain `Re W^N / Π(4 - s_i)` first. This is
    /// `butter(4, cutoff, fs=rate, output="sos")` of SciPy.
    pub(super) fn new(cutoff: f64, sample_rate: f64) -> Result<Self, NumericsError> {
        if !(cutoff > 0.0 && cutoff < 0.5 * sample_rate) {
            return Err(NumericsError::CutoffTooHigh { sample_rate_hz: sample_rate, cutoff_hz: cutoff });
        }
        let radius = 4.0 * (PI * (2.0 * cutoff / sample_rate) / 2.0).tan();
        let analog =
            [-3.0, -1.0, 1.0, 3.0].map(|i| -Complex::cis(PI * i / (2 * FILTER_ORDER) as f64) * radius);
        let from_four = analog.iter().map(|s| 4.0 - s).product::<Complex<f64>>();
        let gain = radius.powi(4) * from_four.inv().re;
        // the upper pole of each pair
        let [near, far, ..] = analog.map(|s| (4.0 + s) / (4.0 - s));
        let mut level = 1.0;
        let sections = [(far, gain), (near, 1.0)].map(|(pole, gain)| {
            let b = [gain, 2.0 * gain, gain];
            let a = [1.0, -2.0 * pole.re, pole.re * pole.re + pole.im * pole.im];
            // states of the transposed direct form II for a constant input, as SciPy's `sosfilt_zi`
            let rest = [b[1] - a[1] * b[0], b[2] - a[2] * b[0]];
            let first = (rest[0] + rest[1]) / (a[0] + a[1] + a[2]);
            let second = (a[0] + a[1]) * first - rest[0];
            let settled = [level * first, level * second];
            level *= (b[0] + b[1] + b[2]) / (a[0] + a[1] + a[2]);
            FilterSection { b, a, settled }
        });
        Ok(Self { sections })
    }

    /// Applies the low-pass to each of several channels of equal length, longer than [`EDGE`] rows.
    pub(super) fn over(&self, channels: &[&[f64]], buffers: &Buffers) -> Vec<Vec<f64>> {
        // every number is overwritten
        let mut found: Vec<Vec<f64>> =
            channels.iter().map(|channel| buffers.channel(channel.len())).collect();
        let mut passed = 0;
        while passed < channels.len() {
            let (channels, found) = (&channels[passed..], &mut found[passed..]);
            passed += match channels.len() {
                1 => self.pass::<1, 1>(channels, found),
                2 | 3 => self.pass::<2, 1>(channels, found),
                4 | 5 => self.pass::<4, 1>(channels, found),
                6 | 7 => self.pass::<6, 2>(channels, found),
                _ => self.pass::<MOST_AT_ONCE, 2>(channels, found),
            };
        }
        found
    }

    /// Filters the first `N` channels in `GROUPS` groups of lanes and returns their number. Each step waits for the
    /// previous one, so two groups take hardly longer than a single group.
    fn pass<const N: usize, const GROUPS: usize>(
        &self,
        channels: &[&[f64]],
        found: &mut [Vec<f64>],
    ) -> usize {
        let Some(channels) = channels.first_chunk::<N>() else { return channels.len() };
        let Some(found) = found.first_chunk_mut::<N>() else { return channels.len() };
        let found = found.each_mut().map(Vec::as_mut_slice);
        wide(ThereAndBack::<N, GROUPS> { sections: &self.sections, channels, found });
        N
    }
}

/// Forward and backward pass over `N` channels of equal length, in `GROUPS` groups of lanes.
struct ThereAndBack<'a, const N: usize, const GROUPS: usize> {
    sections: &'a [FilterSection; SECTIONS],
    channels: &'a [&'a [f64]; N],
    found: [&'a mut [f64]; N],
}

impl<const N: usize, const GROUPS: usize> Kernel for ThereAndBack<'_, N, GROUPS> {
    /// Each row passes from the channels into lanes, through the sections and back, because the next row needs the
    /// states.
    #[inline(always)]
    fn run(self) {
        let Self { sections, channels, found } = self;
        let length = channels[0].len();
        let channels: [&[f64]; N] = std::array::from_fn(|k| &channels[k][..length]);
        let found = found.map(|of| &mut of[..length]);
        let mut row = [Lanes::ZERO; GROUPS];
        let (mut front, mut behind) = ([row; EDGE], [row; EDGE]);
        for n in 0..N {
            let (channel, first, last) = (channels[n], channels[n][0], channels[n][length - 1]);
            for k in 0..EDGE {
                // odd reflection at a point: twice its value minus the value on the other side
                front[k][n / LANES].0[n % LANES] = first + first - channel[EDGE - k];
                behind[k][n / LANES].0[n % LANES] = last + last - channel[length - 2 - k];
            }
        }
        let mut states = start(sections, front[0]);
        for row in &mut front {
            filter(sections, &mut states, row);
        }
        for at in 0..length {
            for n in 0..N {
                row[n / LANES].0[n % LANES] = channels[n][at];
            }
            filter(sections, &mut states, &mut row);
            for n in 0..N {
                found[n][at] = row[n / LANES].0[n % LANES];
            }
        }
        for row in &mut behind {
            filter(sections, &mut states, row);
        }
        let mut states = start(sections, behind[EDGE - 1]);
        for row in behind.iter_mut().rev() {
            filter(sections, &mut states, row);
        }
        // the output before the first row is not needed
        for at in (0..length).rev() {
            for n in 0..N {
                row[n / LANES].0[n % LANES] = found[n][at];
            }
            filter(sections, &mut states, &mut row);
            for n in 0..N {
                found[n][at] = row[n / LANES].0[n % LANES];
            }
        }
    }
}

/// Both states of each section.
type States<const GROUPS: usize> = [[[Lanes; GROUPS]; 2]; SECTIONS];

/// States after channels that have always had their `first` value.
#[inline(always)]
fn start<const GROUPS: usize>(
    sections: &[FilterSection; SECTIONS],
    first: [Lanes; GROUPS],
) -> States<GROUPS> {
    let mut states = [[[Lanes::ZERO; GROUPS]; 2]; SECTIONS];
    for k in 0..SECTIONS {
        for group in 0..GROUPS {
            states[k][0][group] = first[group] * sections[k].settled[0];
            states[k][1][group] = first[group] * sections[k].settled[1];
        }
    }
    states
}

/// Applies all sections to one row.
#[inline(always)]
fn filter<const GROUPS: usize>(
    sections: &[FilterSection; SECTIONS],
    states: &mut States<GROUPS>,
    row: &mut [Lanes; GROUPS],
) {
    for group in 0..GROUPS {
        let mut x = row[group];
        for k in 0..SECTIONS {
            let (b, a) = (&sections[k].b, &sections[k].a);
            let [near, far] = &mut states[k];
            let y = x * b[0] + near[group];
            near[group] = x * b[1] - y * a[1] + far[group];
            far[group] = x * b[2] - y * a[2];
            x = y;
        }
        row[group] = x;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One channel forwards and backwards, row by row.
    fn alone(low_pass: &LowPass, channel: &[f64]) -> Vec<f64> {
        let last = channel.len() - 1;
        let front = (0..EDGE).map(|k| channel[0] + channel[0] - channel[EDGE - k]);
        let behind = (0..EDGE).map(|k| channel[last] + channel[last] - channel[last - 1 - k]);
        let mut rows: Vec<f64> = front.chain(channel.iter().copied()).chain(behind).collect();
        for _ in 0..2 {
            let first = rows[0];
            for section in &low_pass.sections {
                let (b, a) = (&section.b, &section.a);
                let mut state = section.settled.map(|settled| settled * first);
                for row in &mut rows {
                    let x = *row;
                    *row = b[0] * x + state[0];
                    state = [b[1] * x - a[1] * *row + state[1], b[2] * x - a[2] * *row];
                }
            }
            rows.reverse();
        }
        rows[EDGE..=EDGE + last].to_vec()
    }

    #[test]
    fn each_channel_is_what_it_is_alone() {
        let buffers = Buffers::going_round();
        // stale contents of returned memory
        buffers.give_back((0..30).map(|_| vec![f64::NAN; 50]));
        for (rate, cutoff) in [(250.0, 12.0), (50.0, 12.0), (1000.0, 2.0)] {
            let low_pass = LowPass::new(cutoff, rate).expect("a cut-off below half the rate");
            for (count, rows) in [(1, 32), (3, 40), (5, 64), (7, 100), (8, 33), (19, 500)] {
                let value = |k: usize, row: usize| {
                    5.0 * (0.01 * ((k + 3) * row) as f64).sin() + (row * 7919 % 101) as f64
                };
                let channels: Vec<Vec<f64>> =
                    (0..count).map(|k| (0..rows).map(|row| value(k, row)).collect()).collect();
                let slices: Vec<&[f64]> = channels.iter().map(Vec::as_slice).collect();
                for (found, channel) in low_pass.over(&slices, &buffers).iter().zip(&channels) {
                    let bits = |of: &[f64]| of.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
                    assert_eq!(bits(found), bits(&alone(&low_pass, channel)), "{rate} {count} {rows}");
                }
            }
        }
        assert!(LowPass::new(12.0, 250.0).expect("fits").over(&[], &buffers).is_empty());
    }

    /// Values of SciPy 1.17.1: `b[0]` of the first section and both `a[1:]` of
    /// `butter(4, cutoff, fs=rate, output="sos")`, and `sosfilt_zi`.
    #[test]
    fn sections_are_those_of_scipy() {
        let expected = [
            (
                (12.0, 250.0),
                0.0003588407958559482,
                [[-1.4984959033971867, 0.5693282483273973], [-1.7148025270468699, 0.7958594614085954]],
                [[0.019905392794575424, -0.011178159817881549], [0.9797357664095669, -0.7755952278181627]],
            ),
            (
                (12.0, 50.0),
                0.08267262046299348,
                [[-0.06533681044003006, 0.04055215548149342], [-0.09087377369825422, 0.4472530945667702]],
                [[0.25642220975413554, 0.06892159418505785], [0.6609051697828711, -0.10815826434964121]],
            ),
            (
                (2.0, 1000.0),
                1.5332455206019598e-9,
                [[-1.9768913542871203, 0.977047453642916], [-1.990271241661728, 0.9904283975206014]],
                [[3.9287431472772094e-5, -3.838564968875365e-5], [0.9999607110335417, -0.9903891085541597]],
            ),
        ];
        for ((cutoff, rate), gain, poles, settled) in expected {
            let low_pass = LowPass::new(cutoff, rate).expect("a cut-off below half the rate");
            for (section, (gain, (pole, settled))) in
                low_pass.sections.iter().zip([gain, 1.0].into_iter().zip(poles.iter().zip(&settled)))
            {
                let found = [section.b, section.a].concat();
                let expected = [gain, 2.0 * gain, gain, 1.0, pole[0], pole[1]];
                for (found, expected) in found.iter().zip(&expected) {
                    assert!((found / expected - 1.0).abs() < 1e-14, "{cutoff} {rate}: {found} {expected}");
                }
                // differences of sums near 1; the gain of the earlier sections amplifies their rounding
                for (found, expected) in section.settled.iter().zip(settled) {
                    assert!((found / expected - 1.0).abs() < 1e-8, "{cutoff} {rate}: {found} {expected}");
                }
            }
        }
    }

    /// Values of SciPy 1.17.1: `sosfiltfilt(butter(4, 12, fs=50, output="sos"), arange(40) ** 2 % 17)`, every eighth.
    #[test]
    fn a_channel_passes_as_in_scipy() {
        let channel: Vec<f64> = (0..40).map(|k| f64::from(k * k % 17)).collect();
        let low_pass = LowPass::new(12.0, 50.0).expect("a cut-off below half the rate");
        let found = low_pass.over(&[&channel], &Buffers::going_round());
        let expected = [
            -0.0001456783263071859,
            14.988383905877551,
            0.5965226226341325,
            9.897840972613473,
            5.200460043685033,
        ];
        for (found, expected) in found[0].iter().step_by(8).zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    /// Gain of the sections at a frequency, Hz.
    fn response(low_pass: &LowPass, frequency: f64, rate: f64) -> f64 {
        let back = Complex::cis(-2.0 * PI * frequency / rate);
        let at = |of: &[f64; 3]| back * back * of[2] + back * of[1] + of[0];
        low_pass.sections.iter().map(|section| (at(&section.b) / at(&section.a)).norm()).product()
    }

    #[test]
    fn a_constant_passes_the_cut_off_loses_half_its_power_and_poles_lie_inside() {
        for (cutoff, rate) in [(12.0, 250.0), (12.0, 50.0), (0.5, 1000.0), (24.9, 50.0), (1000.0, 8000.0)] {
            let low_pass = LowPass::new(cutoff, rate).expect("a cut-off below half the rate");
            let gain = |frequency| response(&low_pass, frequency, rate);
            assert!((gain(0.0) - 1.0).abs() < 1e-7, "{cutoff} {rate}: {}", gain(0.0));
            assert!((gain(cutoff) - 0.5f64.sqrt()).abs() < 1e-7, "{cutoff} {rate}: {}", gain(cutoff));
            assert!(gain(0.5 * rate) < 1e-12);
            for section in &low_pass.sections {
                // stability triangle of Jury
                assert!(section.a[2] < 1.0 && section.a[1].abs() < 1.0 + section.a[2], "{section:?}");
            }
        }
        for (cutoff, rate) in [(0.0, 250.0), (125.0, 250.0), (f64::NAN, 250.0), (12.0, f64::NAN)] {
            assert!(LowPass::new(cutoff, rate).is_err());
        }
    }
}
