//! Dates and times in the names of files: eight digits and four or six, or a configured form.

use jiff::civil::{Date, DateTime, Time};
use jiff::fmt::strtime;

use super::toml::table::{Table, Value};

/// Plausible years of a recording. Outside, eight digits are a serial number instead of a date.
const YEARS: std::ops::RangeInclusive<i16> = 1980..=2199;

/// Forms of dates and times in file names; conversions of `strptime` (`%Y`, `%y`, `%m`, `%d`, `%b`, `%H`, `%M`, `%S`),
/// all other characters are literal.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct DateFormats {
    /// Form of the group `date`; `None` for YYYYMMDD.
    pub date: Option<String>,
    /// Form of the group `time`; `None` for HHMM or HHMMSS.
    pub time: Option<String>,
}

impl DateFormats {
    /// The local time in `date` and `time`, and true if they give a time of day; midnight without one.
    ///
    /// # Errors
    /// The fault in one of them.
    pub(super) fn moment(&self, date: &str, time: Option<&str>) -> Result<(DateTime, bool), String> {
        let (day, with_it) = match &self.date {
            Some(format) => formatted(format, date, "date_format")?,
            None => (Some(eight_digits(date)?), None),
        };
        let day = day.ok_or("date_format does not give a date")?;
        if !YEARS.contains(&day.year()) {
            return Err(format!(
                "the year {} is not between {} and {}",
                day.year(),
                YEARS.start(),
                YEARS.end()
            ));
        }
        let clock = match (time, &self.time) {
            (Some(time), Some(format)) => formatted(format, time, "time_format")?.1,
            (Some(time), None) => Some(digits_of_clock(time)?),
            (None, _) => with_it,
        };
        Ok((DateTime::from_parts(day, clock.unwrap_or_else(Time::midnight)), clock.is_some()))
    }

    /// The valid contents of the pattern's groups.
    pub fn wanted(&self) -> String {
        let date = self.date.as_deref().unwrap_or("YYYYMMDD");
        let time = self.time.as_deref().unwrap_or("HHMM or HHMMSS");
        format!("date ({date}) and time ({time})")
    }
}

/// Reads `date_format` and `time_format`; `None` if one is wrong. `has` returns true for the groups of the pattern of
/// file names.
pub(super) fn read(table: Option<&Table<'_>>, has: impl Fn(&str) -> bool) -> Option<DateFormats> {
    let one = |key: &str, group: &str, is_right: fn(&str) -> bool, wanted: &str| {
        let Some(value) = table.and_then(|table| table.optional(key)) else { return Some(None) };
        let format = value.text()?;
        if !has(group) {
            let hint = format!("mark its place in the name: (?<{group}>..)");
            value.refuse(format!("needs a group {group} in file_name"), Some(hint));
            return None;
        }
        if !is_right(format) {
            refuse(&value, wanted);
            return None;
        }
        Some(Some(format.to_owned()))
    };
    let date = one(
        "date_format",
        "date",
        gives_date,
        "year, month and day: %y_%m_%d for 26_01_05, %Y-%m-%d for 2026-01-05, %d%b%Y for 05Jan2026",
    );
    let time = one(
        "time_format",
        "time",
        gives_time,
        "the hour, and minutes and seconds if there are any: %H-%M-%S for 08-47-30",
    );
    Some(DateFormats { date: date?, time: time? })
}

fn refuse(value: &Value<'_>, wanted: &str) {
    value.refuse(
        format!("must give {wanted}"),
        Some("conversions are those of strptime, each with its %; everything else is literal text".into()),
    );
}

/// Two times that every other conversion changes.
const PROBES: [(Date, Time); 2] = [
    (Date::constant(2026, 11, 23), Time::constant(21, 48, 37, 0)),
    (Date::constant(1998, 2, 5), Time::constant(4, 9, 0, 0)),
];

/// Returns true if a format reproduces a date that was written with it.
pub(super) fn gives_date(format: &str) -> bool {
    PROBES.iter().all(|(date, time)| {
        let written = strtime::format(format, DateTime::from_parts(*date, *time));
        written.is_ok_and(|text| formatted(format, &text, "").is_ok_and(|(found, _)| found == Some(*date)))
    })
}

/// Returns true if a format reproduces at least the hour of a time that was written with it.
fn gives_time(format: &str) -> bool {
    PROBES.iter().all(|(date, time)| {
        let written = strtime::format(format, DateTime::from_parts(*date, *time));
        let found = written.ok().and_then(|text| formatted(format, &text, "").ok()?.1);
        found.is_some_and(|found| {
            found.hour() == time.hour() && (found.minute() == time.minute() || found.minute() == 0)
        })
    })
}

/// Date and time in a text of this form, as far as it has them.
fn formatted(format: &str, text: &str, key: &str) -> Result<(Option<Date>, Option<Time>), String> {
    let parsed = strtime::parse(format, text)
        .map_err(|error| format!("not in the form {key} = \"{format}\": {error}"))?;
    let date = match (parsed.year(), parsed.month(), parsed.day(), parsed.day_of_year()) {
        (Some(_), Some(_), Some(_), _) | (Some(_), _, _, Some(_)) => {
            Some(parsed.to_date().map_err(|error| error.to_string())?)
        }
        _ => None,
    };
    let clock = match parsed.hour() {
        Some(_) => Some(parsed.to_time().map_err(|error| error.to_string())?),
        None => None,
    };
    Ok((date, clock))
}

fn eight_digits(text: &str) -> Result<Date, String> {
    let [year, month, day] = digits(text, [4, 2, 2])
        .ok_or("the date needs eight digits; for another form set date_format under [recognition], such as \"%y_%m_%d\"")?;
    if !YEARS.contains(&year) {
        return Err(format!("the year {year} is not between {} and {}", YEARS.start(), YEARS.end()));
    }
    let (month, day) = (small(month)?, small(day)?);
    Date::new(year, month, day).map_err(|_| format!("month {month} of {year} has no day {day}"))
}

fn digits_of_clock(text: &str) -> Result<Time, String> {
    let [hour, minute, second] = digits(text, [2, 2, 2])
        .or_else(|| digits(text, [2, 2]).map(|[hour, minute]| [hour, minute, 0]))
        .ok_or("the time needs four or six digits; for another form set time_format under [recognition], such as \"%H-%M-%S\"")?;
    // a leap second, which no clock of this program has; strptime treats it likewise
    let shown = if second == 60 { 59 } else { second };
    Time::new(small(hour)?, small(minute)?, small(shown)?, 0)
        .map_err(|_| format!("the time {hour:02}:{minute:02}:{second:02} does not exist"))
}

fn small(number: i16) -> Result<i8, String> {
    i8::try_from(number).map_err(|error| error.to_string())
}

/// Consecutive decimal numbers of the given widths that form the whole text.
fn digits<const N: usize>(text: &str, widths: [usize; N]) -> Option<[i16; N]> {
    if text.len() != widths.iter().sum::<usize>() || !text.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let mut numbers = [0; N];
    let mut rest = text;
    for (number, width) in numbers.iter_mut().zip(widths) {
        let (head, tail) = rest.split_at_checked(width)?;
        *number = head.parse().ok()?;
        rest = tail;
    }
    Some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formats(date: &str, time: &str) -> DateFormats {
        let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        DateFormats { date: some(date), time: some(time) }
    }

    #[test]
    fn dates_and_times_in_many_forms_are_one_moment() {
        for (date_format, time_format, date, time) in [
            ("", "", "20260105", Some("084730")),
            ("%y_%m_%d", "%H-%M-%S", "26_01_05", Some("08-47-30")),
            ("%Y-%m-%d", "%H:%M:%S", "2026-01-05", Some("08:47:30")),
            ("%d.%m.%Y", "", "05.01.2026", Some("084730")),
            ("%d%b%Y", "%Hh%Mm%Ss", "05Jan2026", Some("08h47m30s")),
            ("%Y%m%dT%H%M%S", "", "20260105T084730", None),
            ("%Y-%j", "%I.%M.%S %p", "2026-005", Some("08.47.30 AM")),
        ] {
            let found =
                formats(date_format, time_format).moment(date, time).map(|(moment, _)| moment.to_string());
            assert_eq!(found.as_deref(), Ok("2026-01-05T08:47:30"), "{date_format} {time_format}");
        }
        let midnight = formats("%y_%m_%d", "").moment("26_01_05", None).map(|(moment, _)| moment.to_string());
        assert_eq!(midnight.as_deref(), Ok("2026-01-05T00:00:00"));
    }

    #[test]
    fn what_does_not_fit_is_said_with_the_key() {
        let refused =
            |date_format: &str, date: &str| formats(date_format, "").moment(date, None).expect_err(date);
        assert!(refused("%y_%m_%d", "26-01-05").contains("not in the form date_format = \"%y_%m_%d\""));
        assert!(refused("%y_%m_%d", "26_13_05").contains("date_format"));
        assert!(refused("%Y_%m_%d", "0012_01_05").contains("the year 12 is not between"));
        assert!(refused("", "26_01_05").contains("set date_format under [recognition]"));
    }

    #[test]
    fn formats_that_lose_the_moment_are_known_before_any_file_comes() {
        for format in ["%y_%m_%d", "%Y-%m-%d", "%d%b%y", "%Y%j", "%Y%m%d_%H%M", "%F"] {
            assert!(gives_date(format), "{format}");
        }
        for format in ["YY_MM_DD", "%m_%d", "%Y", "%H%M", "%", "%Q", "", "%d/%d/%Y"] {
            assert!(!gives_date(format), "{format}");
        }
        for format in ["%H-%M-%S", "%H%M", "%H", "%I%M%p", "%T"] {
            assert!(gives_time(format), "{format}");
        }
        for format in ["HH-MM", "%M%S", "%Y", "%I%M", ""] {
            assert!(!gives_time(format), "{format}");
        }
    }
}
