//! Times on the command line.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Reads a time: RFC 3339, or a date with or without a time of day, which are UTC. A date alone is its midnight. A time
/// with a named time zone is refused, since its zone would be ignored.
pub(in crate::cli) fn moment(text: &str) -> Result<Timestamp, String> {
    let utc = |civil: DateTime| civil.to_zoned(TimeZone::UTC).ok().map(|zoned| zoned.timestamp());
    let found = text
        .parse::<Timestamp>()
        .ok()
        .or_else(|| text.parse::<DateTime>().ok().filter(|_| !text.contains('[')).and_then(utc));
    found.ok_or_else(|| "give 2026-03-01, 2026-03-01T14:30 (both UTC) or 2026-03-01T14:30:00+01:00".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_utc_unless_they_say_otherwise() {
        let expected = |text: &str| text.parse::<Timestamp>().expect("a time");
        for (text, time) in [
            ("2026-03-01", "2026-03-01T00:00:00Z"),
            ("2026-03-01T14:30", "2026-03-01T14:30:00Z"),
            ("2026-03-01 14:30:05", "2026-03-01T14:30:05Z"),
            ("2026-03-01T14:30:00Z", "2026-03-01T14:30:00Z"),
            ("2026-03-01T14:30:00+01:00", "2026-03-01T13:30:00Z"),
        ] {
            assert_eq!(moment(text), Ok(expected(time)), "{text}");
        }
        for text in ["yesterday", "01.03.2026", "", "2026-13-01", "2026-03-01T14:30[Europe/Berlin]"] {
            assert!(moment(text).is_err_and(|words| words.contains("2026-03-01")), "{text}");
        }
    }
}
