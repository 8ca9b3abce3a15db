//! From values to places on a page, and where the ticks of an axis stand.

/// A linear axis: values `from..to` on places `start..end`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) start: f64,
    pub(super) end: f64,
}

/// A tick: its value and what stands beside it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub(super) label: String,
}

impl Scale {
    /// An axis over `extent`, widened by `margin` of its length at either end; an axis of one value or of
    /// none is made wide enough to draw.
    pub(super) fn over(extent: Option<(f64, f64)>, margin: f64, start: f64, end: f64) -> Self {
        let (low, high) = extent.unwrap_or((0.0, 1.0));
        let (low, high) = (low.max(-LARGEST), high.min(LARGEST));
        let length = high - low;
        // a constant has a place in the middle of its axis
        let widened = if length > f64::EPSILON * high.abs().max(low.abs()) {
            margin * length
        } else {
            0.5 * high.abs().max(1.0)
        };
        Self { from: low - widened, to: high + widened, start, end }
    }

    /// Place of a value.
    pub(super) fn at(&self, value: f64) -> f64 {
        self.start + (value - self.from) / (self.to - self.from) * (self.end - self.start)
    }

    /// About `wanted` ticks at multiples of 1, 2 or 5 times a power of ten.
    pub(super) fn ticks(&self, wanted: usize) -> Vec<Tick> {
        let step = nice_step((self.to - self.from) / wanted.max(1) as f64);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        let large = self.from.abs().max(self.to.abs()) >= LARGE;
        let first = (self.from / step).ceil();
        let count = ((self.to / step).floor() - first).max(-1.0) as usize + 1;
        (0..count)
            .map(|i| {
                // adding 0.0 makes zero of minus zero
                let value = (first + i as f64) * step + 0.0;
                let label = if large { format!("{value:.1e}") } else { format!("{value:.digits$}") };
                Tick { value, label }
            })
            .collect()
    }
}

/// Values beyond are drawn off the page: the length of their axis would not be finite.
const LARGEST: f64 = 1e300;

/// From here on ticks are written with a power of ten.
const LARGE: f64 = 1e6;

/// Smallest of 1, 2, 5 times a power of ten that is not below `step`.
fn nice_step(step: f64) -> f64 {
    let power = 10.0_f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|nice| nice * power).find(|nice| *nice >= step).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(from: f64, to: f64, wanted: usize) -> Vec<String> {
        let scale = Scale::over(Some((from, to)), 0.0, 0.0, 100.0);
        scale.ticks(wanted).into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn ticks_stand_at_round_values_inside_the_axis() {
        assert_eq!(labels(0.0, 10.0, 5), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(-0.03, 0.11, 4), ["0.00", "0.05", "0.10"]);
        assert_eq!(labels(297.0, 1204.0, 4), ["500", "1000"]);
        assert_eq!(labels(0.0, 3e9, 3), ["0.0e0", "1.0e9", "2.0e9", "3.0e9"]);
    }

    #[test]
    fn values_go_to_their_places_also_downwards() {
        let scale = Scale::over(Some((2.0, 4.0)), 0.0, 50.0, 10.0);
        assert!((scale.at(2.0) - 50.0).abs() < 1e-9 && (scale.at(4.0) - 10.0).abs() < 1e-9);
        assert!((scale.at(3.0) - 30.0).abs() < 1e-9);
    }

    #[test]
    fn an_axis_of_one_value_or_none_can_be_drawn() {
        for extent in [None, Some((7.0, 7.0)), Some((0.0, 0.0)), Some((f64::MIN, f64::MAX))] {
            let scale = Scale::over(extent, 0.05, 0.0, 100.0);
            assert!(scale.to > scale.from && !scale.ticks(4).is_empty(), "{extent:?}");
        }
    }
}
