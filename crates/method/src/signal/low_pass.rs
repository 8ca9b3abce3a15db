//! The zero-phase low-pass, over several channels at once: a lane each.
//!
//! Second-order sections run forwards and backwards over a channel that is continued at either end by its odd
//! reflection (Gustafsson 1996; as SciPy's and sci-rs' `sosfiltfilt`). The order of operations is theirs, so that a
//! channel in a lane is the channel alone to the last bit.

use sci_rs::signal::filter::design::{DigitalFilter, FilterBandType, FilterOutputType, Sos, butter_dyn};
use sci_rs::signal::filter::sosfilt_zi_dyn;

use crate::NumericsError;
use crate::buffers::Buffers;
use crate::lanes::{Kernel, LANES, Lanes, wide};

/// Order of the Butterworth low-pass. Forward and backward passes double the roll-off and cancel
/// the phase.
const FILTER_ORDER: usize = 4;

const SECTIONS: usize = FILTER_ORDER / 2;

/// Most channels that go through the low-pass at once.
pub(super) const MOST_AT_ONCE: usize = 8;

/// Rows by which a channel is continued at either end: three for each coefficient of the whole filter.
const EDGE: usize = 3 * (2 * SECTIONS + 1);

/// A zero-phase low-pass in second-order sections; the transfer-function form loses all digits at
/// low cut-offs.
pub(super) struct LowPass {
    sections: [Sos<f64>; SECTIONS],
}

impl LowPass {
    pub(super) fn new(cutoff: f64, sample_rate: f64) -> Result<Self, NumericsError> {
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
        let DigitalFilter::Sos(sos) = design else { return Err(too_high) };
        let mut sections: [Sos<f64>; SECTIONS] = sos.sos.try_into().map_err(|_| too_high)?;
        sosfilt_zi_dyn::<_, _, Sos<f64>>(sections.iter_mut());
        Ok(Self { sections })
    }

    /// The low-pass over each of several channels of one length, of more than [`EDGE`] rows.
    pub(super) fn over(&self, channels: &[&[f64]], buffers: &Buffers) -> Vec<Vec<f64>> {
        // each number of them is written
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

    /// The first `N` channels, a lane of `GROUPS` each; returns how many they were. Each step waits for the one before, so
    /// that two groups take hardly longer than one.
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

/// `N` channels of one length there and back, in `GROUPS` lanes.
struct ThereAndBack<'a, const N: usize, const GROUPS: usize> {
    sections: &'a [Sos<f64>; SECTIONS],
    channels: &'a [&'a [f64]; N],
    found: [&'a mut [f64]; N],
}

impl<const N: usize, const GROUPS: usize> Kernel for ThereAndBack<'_, N, GROUPS> {
    /// A row goes into lanes, through the sections and back into channels while the sections of the next one wait for it.
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
                // the reflection at a point: twice its value less what lies on the other side
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
        // what comes out before the first row is not asked for
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

/// The states that channels leave which always had their `first` value.
#[inline(always)]
fn start<const GROUPS: usize>(sections: &[Sos<f64>; SECTIONS], first: [Lanes; GROUPS]) -> States<GROUPS> {
    let mut states = [[[Lanes::ZERO; GROUPS]; 2]; SECTIONS];
    for k in 0..SECTIONS {
        for group in 0..GROUPS {
            states[k][0][group] = first[group] * sections[k].zi0;
            states[k][1][group] = first[group] * sections[k].zi1;
        }
    }
    states
}

/// All sections over one row.
#[inline(always)]
fn filter<const GROUPS: usize>(
    sections: &[Sos<f64>; SECTIONS],
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
    use sci_rs::signal::filter::sosfiltfilt_dyn;

    use super::*;

    /// sci-rs, which is held against SciPy, is the form that lanes must equal.
    #[test]
    fn each_channel_is_what_it_is_alone() {
        let buffers = Buffers::going_round();
        // what memory holds that was given back
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
                    let mut sections = low_pass.sections.to_vec();
                    sections.iter_mut().for_each(|section| (section.zi0, section.zi1) = (0.0, 0.0));
                    let expected = sosfiltfilt_dyn(channel.iter(), &sections);
                    let bits = |of: &[f64]| of.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
                    assert_eq!(bits(found), bits(&expected), "{rate} {count} {rows}");
                }
            }
        }
        assert!(LowPass::new(12.0, 250.0).expect("fits").over(&[], &buffers).is_empty());
    }
}
