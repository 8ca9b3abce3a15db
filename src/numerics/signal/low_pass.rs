//! The zero-phase low-pass, over several channels at once: a lane each.
//!
//! Second-order sections run forwards and backwards over a channel that is continued at either end by its odd
//! reflection (Gustafsson 1996; as SciPy's and sci-rs' `sosfiltfilt`). The order of operations is theirs, so that a
//! channel in a lane is the channel alone to the last bit.

use sci_rs::signal::filter::design::{DigitalFilter, FilterBandType, FilterOutputType, Sos, butter_dyn};
use sci_rs::signal::filter::sosfilt_zi_dyn;

use crate::numerics::NumericsError;
use crate::numerics::lanes::{Kernel, LANES, Lanes, wide};

/// Order of the Butterworth low-pass. Forward and backward passes double the roll-off and cancel
/// the phase.
const FILTER_ORDER: usize = 4;

const SECTIONS: usize = FILTER_ORDER / 2;

/// Rows by which a channel is continued at either end: three for each coefficient of the whole filter.
const EDGE: usize = 3 * (2 * SECTIONS + 1);

/// Groups of lanes that are filtered at once: each step waits for the one before, so one group alone would leave the
/// processor idle.
const GROUPS: usize = 2;

type Rows = [Lanes; GROUPS];

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
    pub(super) fn over(&self, channels: &[&[f64]]) -> Vec<Vec<f64>> {
        let mut found = Vec::with_capacity(channels.len());
        let mut rows: Vec<Rows> = Vec::new();
        for taken in channels.chunks(GROUPS * LANES) {
            // lanes without a channel of their own repeat the first
            let of = |place: usize| taken.get(place).copied().unwrap_or(taken[0]);
            let at: [[&[f64]; LANES]; GROUPS] =
                std::array::from_fn(|group| std::array::from_fn(|lane| of(LANES * group + lane)));
            rows.clear();
            rows.resize(taken[0].len() + 2 * EDGE, [Lanes::ZERO; GROUPS]);
            wide(ThereAndBack { sections: &self.sections, channels: &at, rows: &mut rows });
            let inner = &rows[EDGE..rows.len() - EDGE];
            let lane = |place: usize| inner.iter().map(|row| row[place / LANES].0[place % LANES]).collect();
            found.extend((0..taken.len()).map(lane));
        }
        found
    }
}

struct ThereAndBack<'a> {
    sections: &'a [Sos<f64>; SECTIONS],
    channels: &'a [[&'a [f64]; LANES]; GROUPS],
    rows: &'a mut [Rows],
}

impl Kernel for ThereAndBack<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { sections, channels, rows } = self;
        for (group, channels) in channels.iter().enumerate() {
            let inner = rows.len() - 2 * EDGE;
            let [a, b, c, d] = channels;
            let (a, b, c, d) = (&a[..inner], &b[..inner], &c[..inner], &d[..inner]);
            for (row, out) in rows[EDGE..].iter_mut().take(inner).enumerate() {
                out[group] = Lanes([a[row], b[row], c[row], d[row]]);
            }
        }
        let last = rows.len() - 1;
        let (first, end) = (rows[EDGE], rows[last - EDGE]);
        for k in 0..EDGE {
            for group in 0..GROUPS {
                // the reflection at a point: twice its value less what lies on the other side
                rows[k][group] = first[group] + first[group] - rows[2 * EDGE - k][group];
                rows[last - k][group] = end[group] + end[group] - rows[last - 2 * EDGE + k][group];
            }
        }
        filter(sections, rows[0], rows.iter_mut());
        filter(sections, rows[last], rows.iter_mut().rev());
    }
}

/// One pass of all sections, from the state that a channel which always had its first value leaves.
#[inline(always)]
fn filter<'r>(sections: &[Sos<f64>; SECTIONS], first: Rows, rows: impl Iterator<Item = &'r mut Rows>) {
    let mut states: [[Rows; 2]; SECTIONS] = std::array::from_fn(|k| {
        [sections[k].zi0, sections[k].zi1].map(|state| first.map(|first| first * state))
    });
    for row in rows {
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
}

#[cfg(test)]
mod tests {
    use sci_rs::signal::filter::sosfiltfilt_dyn;

    use super::*;

    /// sci-rs, which is held against SciPy, is the form that lanes must equal.
    #[test]
    fn each_channel_is_what_it_is_alone() {
        for (rate, cutoff) in [(250.0, 12.0), (50.0, 12.0), (1000.0, 2.0)] {
            let low_pass = LowPass::new(cutoff, rate).expect("a cut-off below half the rate");
            for (count, rows) in [(1, 32), (7, 100), (8, 33), (19, 500)] {
                let value = |k: usize, row: usize| {
                    5.0 * (0.01 * ((k + 3) * row) as f64).sin() + (row * 7919 % 101) as f64
                };
                let channels: Vec<Vec<f64>> =
                    (0..count).map(|k| (0..rows).map(|row| value(k, row)).collect()).collect();
                let slices: Vec<&[f64]> = channels.iter().map(Vec::as_slice).collect();
                for (found, channel) in low_pass.over(&slices).iter().zip(&channels) {
                    let mut sections = low_pass.sections.to_vec();
                    sections.iter_mut().for_each(|section| (section.zi0, section.zi1) = (0.0, 0.0));
                    let expected = sosfiltfilt_dyn(channel.iter(), &sections);
                    let bits = |of: &[f64]| of.iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
                    assert_eq!(bits(found), bits(&expected), "{rate} {count} {rows}");
                }
            }
        }
        assert!(LowPass::new(12.0, 250.0).expect("fits").over(&[]).is_empty());
    }
}
