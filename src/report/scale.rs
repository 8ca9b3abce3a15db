//! Maps values to positions on a page, and chooses the ticks of an axis.

use jiff::civil::Date;
use jiff::{Timestamp, Unit};

/// An axis: values `from..to` at positions `start..end`, spaced evenly or by their logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) start: f64,
    pub(super) end: f64,
    logarithmic: bool,
}

/// A tick: its value and its label.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub(super) label: String,
}

impl Scale {
    /// An axis over `extent`, widened by `margin` of its length at either end; an axis with one value or none is made
    /// wide enough to draw.
    pub(super) fn over(extent: Option<(f64, f64)>, margin: f64, start: f64, end: f64) -> Self {
        let (low, high) = extent.unwrap_or((0.0, 1.0));
        let (low, high) = (low.max(-LARGEST), high.min(LARGEST));
        let length = high - low;
        // a constant is in the middle of its axis
        let widened = if length > f64::EPSILON * high.abs().max(low.abs()) {
            margin * length
        } else {
            0.5 * high.abs().max(1.0)
        };
        Self { from: low - widened, to: high + widened, start, end, logarithmic: false }
    }

    /// A logarithmic axis over an extent of positive values.
    pub(super) fn logarithmic(extent: Option<(f64, f64)>, margin: f64, start: f64, end: f64) -> Self {
        let (low, high) = extent.map_or((1.0, 10.0), |(low, high)| (low.max(SMALLEST), high.max(SMALLEST)));
        let length = (high / low).ln().max(LEAST_LENGTH);
        let widened = (margin * length).exp();
        // the same factor below and above a single value
        let open = (0.5 * (length - (high / low).ln())).exp();
        Self { from: low / widened / open, to: high * widened * open, start, end, logarithmic: true }
    }

    /// An axis of days over an extent; a single day is in the middle of three.
    pub(super) fn days(extent: Option<(f64, f64)>, margin: f64, start: f64, end: f64) -> Self {
        let (low, high) = extent.unwrap_or((0.0, 1.0));
        let short = 0.5 * (1.0 - (high - low)).max(0.0);
        Self::over(Some((low - short, high + short)), margin, start, end)
    }

    /// Position of a value.
    pub(super) fn at(&self, value: f64) -> f64 {
        let share = if self.logarithmic {
            (value / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        };
        self.start + share * (self.end - self.start)
    }

    /// Returns true if a value has a position on the axis.
    pub(super) fn holds(&self, value: f64) -> bool {
        self.from <= value && value <= self.to
    }

    /// About `wanted` ticks at multiples of 1, 2 or 5 times a power of ten.
    pub(super) fn ticks(&self, wanted: usize) -> Vec<Tick> {
        if self.logarithmic {
            return self.logarithmic_ticks(wanted);
        }
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

    /// Ticks at 1, 2 and 5 times powers of ten, or at powers of ten alone if those are too many.
    fn logarithmic_ticks(&self, wanted: usize) -> Vec<Tick> {
        let decades = self.from.log10().floor() as i32..=self.to.log10().floor() as i32;
        let ticks = |steps: &[f64]| -> Vec<Tick> {
            let values =
                decades.clone().flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)));
            values
                .filter(|value| self.holds(*value))
                .map(|value| {
                    let digits = (-value.log10().floor()).max(0.0) as usize;
                    let large = value >= LARGE;
                    let label = if large { format!("{value:.0e}") } else { format!("{value:.digits$}") };
                    Tick { value, label }
                })
                .collect()
        };
        let fine = ticks(&[1.0, 2.0, 5.0]);
        if fine.len() <= 2 * wanted { fine } else { ticks(&[1.0]) }
    }

    /// At most `wanted` ticks of an axis of days at the start of days, months or years, with the date.
    pub(super) fn date_ticks(&self, wanted: usize) -> Vec<Tick> {
        let Some((first, last)) = date(self.from).zip(date(self.to)) else { return Vec::new() };
        let wanted = wanted.max(2) as f64;
        let days = self.to - self.from;
        if let Some(step) = DAY_STEPS.into_iter().find(|step| days / f64::from(*step) <= wanted) {
            // from a day that all pictures with this step share
            let start = (self.from / f64::from(step)).ceil() as i64;
            let end = (self.to / f64::from(step)).floor() as i64;
            let ticks = (start..=end).map(|i| (i * i64::from(step)) as f64);
            return ticks
                .filter_map(|value| Some(Tick { value, label: date(value)?.strftime("%-d %b").to_string() }))
                .collect();
        }
        let months = MONTH_STEPS.into_iter().find(|step| days / (30.4 * f64::from(*step)) <= wanted);
        let months = months.unwrap_or_else(|| 12 * (days / 365.2 / wanted).ceil() as u16);
        let month = |of: Date| i32::from(of.year()) * 12 + i32::from(of.month()) - 1;
        let form = if months >= 12 { "%Y" } else { "%b %Y" };
        (month(first)..=month(last))
            .filter(|month| month.rem_euclid(i32::from(months)) == 0)
            .filter_map(|month| {
                let day = Date::new(
                    i16::try_from(month.div_euclid(12)).ok()?,
                    i8::try_from(month.rem_euclid(12) + 1).ok()?,
                    1,
                );
                let day = day.ok()?;
                let value = f64::from(Date::constant(1970, 1, 1).until((Unit::Day, day)).ok()?.get_days());
                self.holds(value).then(|| Tick { value, label: day.strftime(form).to_string() })
            })
            .collect()
    }

    /// Years of an axis of days, such as `2026` or `2025 to 2026`.
    pub(super) fn years(&self) -> String {
        match date(self.from).zip(date(self.to)) {
            Some((first, last)) if first.year() != last.year() => {
                format!("{} to {}", first.year(), last.year())
            }
            Some((first, _)) => first.year().to_string(),
            None => String::new(),
        }
    }
}

/// The day of a value of an axis of days, UTC.
fn date(days: f64) -> Option<Date> {
    moment(days).map(|time| time.to_zoned(jiff::tz::TimeZone::UTC).date())
}

/// The time of a value of an axis of days.
pub(super) fn moment(days: f64) -> Option<Timestamp> {
    Timestamp::from_second((days * 86_400.0).floor() as i64).ok()
}

/// Steps of days between ticks.
const DAY_STEPS: [i32; 5] = [1, 2, 4, 7, 14];

/// Steps of months between ticks.
const MONTH_STEPS: [u16; 5] = [1, 2, 3, 6, 12];

/// Smallest value on a logarithmic axis.
const SMALLEST: f64 = 1e-12;

/// Shortest logarithmic axis: a factor of 2.
const LEAST_LENGTH: f64 = std::f64::consts::LN_2;

/// Largest magnitude on an axis; larger values are outside the page, because the length of their axis would not be
/// finite.
const LARGEST: f64 = 1e300;

/// Ticks from this value on use a power of ten.
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
    fn a_logarithmic_axis_has_even_room_for_equal_factors() {
        let scale = Scale::logarithmic(Some((1.0, 100.0)), 0.0, 0.0, 100.0);
        assert!((scale.at(10.0) - 50.0).abs() < 1e-9);
        let labels = |scale: Scale| scale.ticks(5).into_iter().map(|tick| tick.label).collect::<Vec<_>>();
        assert_eq!(labels(scale), ["1", "2", "5", "10", "20", "50", "100"]);
        assert_eq!(labels(Scale::logarithmic(Some((1e-4, 1e4)), 0.0, 0.0, 1.0)).len(), 9);
        let one = Scale::logarithmic(Some((3.0, 3.0)), 0.0, 0.0, 100.0);
        assert!((one.at(3.0) - 50.0).abs() < 1e-9 && one.to > one.from);
        assert!(!Scale::logarithmic(None, 0.1, 0.0, 1.0).ticks(5).is_empty());
    }

    #[test]
    fn days_have_dates_at_their_start_and_months_and_years_theirs() {
        // 2026-01-05 is 20,458 days after the start of 1970
        let labels = |days: f64| {
            let scale = Scale::days(Some((20_458.4, 20_458.4 + days)), 0.0, 0.0, 100.0);
            scale.date_ticks(6).into_iter().map(|tick| tick.label).collect::<Vec<_>>()
        };
        assert_eq!(labels(5.0), ["6 Jan", "7 Jan", "8 Jan", "9 Jan", "10 Jan"]);
        assert_eq!(labels(100.0), ["Feb 2026", "Mar 2026", "Apr 2026"]);
        assert_eq!(labels(900.0), ["Jul 2026", "Jan 2027", "Jul 2027", "Jan 2028"]);
        assert_eq!(labels(3000.0), ["2028", "2030", "2032", "2034"]);
        assert_eq!(labels(0.0), ["5 Jan"]);
        assert_eq!(Scale::days(Some((20_400.0, 20_500.0)), 0.0, 0.0, 1.0).years(), "2025 to 2026");
        assert!(Scale::days(Some((-1e300, 1e300)), 0.0, 0.0, 1.0).date_ticks(5).is_empty());
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
