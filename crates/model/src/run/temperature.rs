//! Temperatures next to the rows of a recording. They change once in thousands of rows and are often missing, so they
//! are stored as intervals with one value.

use std::collections::VecDeque;

/// Absolute temperature of 0 degC, K.
pub const ZERO_CELSIUS: f64 = 273.15;

/// Steps per kelvin of stored temperatures: finer than the resolution of any drive's sensor, so a value repeated with
/// rounding stays one interval.
const STEPS: f64 = 100.0;

/// One temperature along the rows of a recording: intervals of rows with one value, stored to 0.01 K.
///
/// A row without a value has none; the value before it is not repeated.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TemperatureTrack {
    /// Neighbours differ, so equal tracks compare as equal, however they were built.
    stretches: VecDeque<Stretch>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stretch {
    rows: u32,
    /// In steps; [`NOTHING`] if there is no value.
    steps: i32,
}

/// Marks a missing value.
const NOTHING: i32 = i32::MIN;

impl TemperatureTrack {
    /// Adds a row with a temperature in K, or with none. A non-finite value counts as none, and values beyond twenty
    /// million kelvin are limited to that.
    pub fn push(&mut self, kelvin: Option<f64>) {
        let finite = kelvin.filter(|kelvin| kelvin.is_finite());
        // a saturating cast; the result stays above the least number, which marks a missing value
        let steps = finite.map_or(NOTHING, |kelvin| ((kelvin * STEPS).round() as i32).max(NOTHING + 1));
        self.add(Stretch { rows: 1, steps });
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.rows as usize).sum()
    }

    /// Intervals of rows with a value: number of rows, and the temperature, K.
    pub fn measured(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let measured = self.stretches.iter().filter(|stretch| stretch.steps != NOTHING);
        measured.map(|stretch| (stretch.rows as usize, f64::from(stretch.steps) / STEPS))
    }

    /// Appends the rows of `other`.
    pub fn append(&mut self, other: Self) {
        other.stretches.into_iter().for_each(|stretch| self.add(stretch));
    }

    /// Removes and returns the first `rows` rows; the rest stays.
    pub fn take_front(&mut self, rows: usize) -> Self {
        let (mut whole, mut left) = (0, rows);
        while let Some(stretch) = self.stretches.get(whole).filter(|stretch| stretch.rows as usize <= left) {
            left -= stretch.rows as usize;
            whole += 1;
        }
        let mut front = Self { stretches: self.stretches.drain(..whole).collect() };
        if left > 0
            && let Some(first) = self.stretches.front_mut()
        {
            // fewer than the rows of this interval
            let taken = left as u32;
            front.add(Stretch { rows: taken, ..*first });
            first.rows -= taken;
        }
        front
    }

    fn add(&mut self, stretch: Stretch) {
        match self.stretches.back_mut() {
            Some(last) if last.steps == stretch.steps && last.rows.checked_add(stretch.rows).is_some() => {
                last.rows += stretch.rows;
            }
            _ => self.stretches.push_back(stretch),
        }
    }
}

/// Temperatures of a recording, if it has any.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Temperatures {
    /// Temperature of each joint's motor `[n]`; `None` for a joint whose temperature is not recorded.
    pub motor: Vec<Option<TemperatureTrack>>,
    /// Ambient temperature.
    pub ambient: Option<TemperatureTrack>,
}

impl Temperatures {
    /// Appends `other`, which has the same tracks.
    pub fn append(&mut self, other: Self) {
        let mine = self.motor.iter_mut().chain([&mut self.ambient]);
        for (mine, theirs) in mine.zip(other.motor.into_iter().chain([other.ambient])) {
            if let (Some(mine), Some(theirs)) = (mine, theirs) {
                mine.append(theirs);
            }
        }
    }

    /// No rows, with the same tracks.
    #[must_use]
    pub fn without_rows(&self) -> Self {
        let empty = |track: &Option<TemperatureTrack>| track.as_ref().map(|_| TemperatureTrack::default());
        Self { motor: self.motor.iter().map(empty).collect(), ambient: empty(&self.ambient) }
    }

    /// Removes and returns the first `rows` rows; the rest stays.
    pub fn take_front(&mut self, rows: usize) -> Self {
        let mut front = |track: &mut Option<TemperatureTrack>| track.as_mut().map(|t| t.take_front(rows));
        Self { motor: self.motor.iter_mut().map(&mut front).collect(), ambient: front(&mut self.ambient) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn track(values: &[Option<f64>]) -> TemperatureTrack {
        let mut track = TemperatureTrack::default();
        values.iter().for_each(|value| track.push(*value));
        track
    }

    fn rows_of(track: &TemperatureTrack) -> Vec<f64> {
        track.measured().flat_map(|(rows, kelvin)| std::iter::repeat_n(kelvin, rows)).collect()
    }

    #[test]
    fn repeated_values_are_one_stretch_and_missing_ones_are_none() {
        let held = track(&[Some(300.004); 5000]);
        assert_eq!(held.measured().collect::<Vec<_>>(), [(5000, 300.0)]);
        let gaps = track(&[None, Some(300.0), Some(f64::NAN), Some(f64::INFINITY), Some(301.5), Some(301.5)]);
        assert_eq!(gaps.rows(), 6);
        assert_eq!(gaps.measured().collect::<Vec<_>>(), [(1, 300.0), (2, 301.5)]);
        // absurd numbers stay absurd
        assert!(track(&[Some(1e300)]).measured().all(|(_, kelvin)| kelvin > 1e7));
        assert!(track(&[Some(-1e300)]).measured().all(|(_, kelvin)| kelvin < -1e7));
    }

    fn value() -> impl Strategy<Value = Option<f64>> {
        proptest::option::of((0..4).prop_map(|steps| 300.0 + 0.5 * f64::from(steps)))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_track_cut_and_joined_anywhere_is_the_same(
            values in prop::collection::vec(value(), 0..60),
            cut in 0_usize..70,
        ) {
            let whole = track(&values);
            let expected: Vec<f64> = values.iter().filter_map(|value| *value).collect();
            prop_assert_eq!(rows_of(&whole), expected);
            let mut back = whole.clone();
            let mut front = back.take_front(cut);
            prop_assert_eq!(&front, &track(&values[..cut.min(values.len())]));
            prop_assert_eq!(front.rows() + back.rows(), values.len());
            front.append(back);
            prop_assert_eq!(front, whole);
        }
    }
}
