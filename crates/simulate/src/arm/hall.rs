//! The ambient temperature over the year and the day, and the working hours of an arm.

use std::f64::consts::TAU;

use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Days of a year, and its warmest day on the northern hemisphere: mid July.
const YEAR_DAYS: f64 = 365.25;
const WARMEST_DAY: f64 = 196.0;
/// The warmest hour of a day, UTC.
const WARMEST_HOUR: f64 = 15.0;

/// Variation of the ambient temperature with season and hour.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HallSettings {
    /// Amplitude over the year, K.
    pub season_k: f64,
    /// Amplitude over the day, K.
    pub day_k: f64,
}

impl HallSettings {
    /// Difference from the yearly mean temperature at `time`, K.
    pub fn offset(&self, time: Timestamp) -> f64 {
        let at = time.to_zoned(TimeZone::UTC);
        let hour = f64::from(at.hour()) + f64::from(at.minute()) / 60.0;
        let wave = |phase: f64| (TAU * phase).cos();
        self.season_k * wave((f64::from(at.day_of_year()) - WARMEST_DAY) / YEAR_DAYS)
            + self.day_k * wave((hour - WARMEST_HOUR) / 24.0)
    }
}

/// Working hours of an arm in addition to its tests: it is warm after work, and cold after rest.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkingHours {
    /// Shifts: start and end, hours of the day in UTC, 0 to 24.
    pub shifts: Vec<[f64; 2]>,
    /// Days of the week from Monday on, 1 to 7.
    pub days: i8,
}

impl WorkingHours {
    /// Time since the start of the shift that contains `time`, s; 0 outside shifts and on days off.
    pub fn worked_s(&self, time: Timestamp) -> f64 {
        let at = time.to_zoned(TimeZone::UTC);
        let hour = f64::from(at.hour()) + f64::from(at.minute()) / 60.0 + f64::from(at.second()) / 3600.0;
        if at.weekday().to_monday_one_offset() > self.days {
            return 0.0;
        }
        let shift = self.shifts.iter().find(|[from, to]| (*from..*to).contains(&hour));
        shift.map_or(0.0, |[from, _]| 3600.0 * (hour - from))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    #[test]
    fn the_hall_is_warmest_on_a_july_afternoon() {
        let hall = HallSettings { season_k: 6.0, day_k: 2.0 };
        assert!((hall.offset(at("2026-07-15T15:00:00Z")) - 8.0).abs() < 0.01);
        assert!((hall.offset(at("2026-07-15T03:00:00Z")) - 4.0).abs() < 0.01);
        assert!((hall.offset(at("2026-01-14T03:00:00Z")) + 8.0).abs() < 0.01);
        assert_eq!(HallSettings::default().offset(at("2026-07-15T15:00:00Z")), 0.0);
    }

    #[test]
    fn an_arm_is_warm_within_its_shift_and_cold_at_weekends() {
        let hours = WorkingHours { shifts: vec![[6.0, 14.0], [14.0, 22.0]], days: 5 };
        // a Monday, and the Saturday of that week
        for (time, worked) in [
            ("2026-01-05T08:30:00Z", 9000.0),
            ("2026-01-05T14:10:00Z", 600.0),
            ("2026-01-05T23:00:00Z", 0.0),
            ("2026-01-10T08:30:00Z", 0.0),
        ] {
            assert!((hours.worked_s(at(time)) - worked).abs() < 1e-6, "{time}");
        }
    }
}
