//! Information in a file name: robot, and start of the recording.

use jiff::Timestamp;
use jiff::tz::{AmbiguousOffset, TimeZone};

use super::like_date::has_date_like;
use crate::date_format::DateFormats;
use crate::settings::Recognition;
use armwatch_model::robot::name::composed;

/// Pattern of the native file names, `{robot}_{YYYYMMDD}_{HHMM}_...`.
pub(crate) const DEFAULT_FILE_NAME: &str = r"^(?<robot>.+?)_(?<date>\d{8})_(?<time>\d{4}(?:\d{2})?)(?:_.*)?$";

/// Robot of exports whose name gives none. No robot may have this name.
pub const UNKNOWN_ROBOT: &str = "unknown";

/// Name that [`DEFAULT_FILE_NAME`] matches, shown in messages about unrecognised files.
const EXAMPLE: &str = "R00_20260105_0847_Col23_20s_cycle5.csv.gz";

/// Endings of exports; they contain no robot or time.
const ENDINGS: [&str; 6] = [".gz", ".zst", ".csv", ".parquet", ".mcap", ".dat"];

/// Information in a file name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecognisedName {
    /// Name of the robot.
    pub robot: String,
    /// Start of the recording, if the name gives it; midnight if it gives only the date.
    pub started_at: Option<Timestamp>,
    /// True if the start is unambiguous: with a time of day, and not in the hour that occurs twice when clocks are set
    /// back. Two recordings of a robot never have the same one.
    pub is_definite: bool,
}

/// Why a file name is not recognised.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecogniseError {
    /// The pattern does not match, or the robot in it is empty.
    #[error("the name {file_name} does not match recognition.file_name '{pattern}'; {}", example(.pattern))]
    NoMatch {
        /// The name without its folder.
        file_name: String,
        /// The pattern.
        pattern: String,
    },
    /// The robot has the reserved name for exports of no robot.
    #[error(
        "the name {file_name} has the robot '{UNKNOWN_ROBOT}', which is reserved for exports of unknown robots"
    )]
    Reserved {
        /// The name without its folder.
        file_name: String,
    },
    /// Date and time are no date and time.
    #[error("the name {file_name} has '{text}' instead of {wanted}: {reason}")]
    NoDate {
        /// The name without its folder.
        file_name: String,
        /// Text of the groups `date` and `time`.
        text: String,
        /// Valid form.
        wanted: String,
        /// The fault.
        reason: String,
    },
    /// The time zone is not in this machine's database.
    #[error("time zone {0} is not known on this computer")]
    NoTimeZone(String),
}

impl Recognition {
    /// The time zone of clocks without an offset; `None` if this machine does not know it.
    pub fn zone(&self) -> Option<jiff::tz::TimeZone> {
        time_zone(&self.time_zone)
    }

    /// Returns true if the pattern matches the file name; [`Recognition::recognise`] may use an unmatched name as that
    /// of a robot.
    pub fn fits(&self, file_name: &str) -> bool {
        forms(&composed(file_name)).into_iter().any(|form| self.file_name.is_match(form))
    }

    /// Robot and start time from the file name `file_name`, given without folder.
    ///
    /// The pattern is tried on the name without the endings `.csv`, `.parquet`, `.mcap`, `.gz` and `.zst`, then without
    /// `.gz` and `.zst` alone, then on the whole name, so that the pattern works without endings. Names are composed
    /// (NFC). A name that does not match and contains nothing like a date is the robot's name as a whole.
    ///
    /// # Errors
    ///
    /// If the pattern does not match, date and time in the name are invalid, or the robot is called [`UNKNOWN_ROBOT`].
    pub fn recognise(&self, file_name: &str) -> Result<RecognisedName, RecogniseError> {
        let recognised = self.recognise_any(file_name)?;
        if recognised.robot == UNKNOWN_ROBOT {
            return Err(RecogniseError::Reserved { file_name: file_name.to_owned() });
        }
        Ok(recognised)
    }

    fn recognise_any(&self, file_name: &str) -> Result<RecognisedName, RecogniseError> {
        let no_match = || RecogniseError::NoMatch {
            file_name: file_name.to_owned(),
            pattern: self.file_name.as_str().to_owned(),
        };
        let name = composed(file_name);
        let forms = forms(&name);
        let Some(captures) = forms.iter().find_map(|form| self.file_name.captures(form)) else {
            let plain = plain_robot(forms[0]).ok_or_else(no_match)?;
            return Ok(RecognisedName { robot: plain.to_owned(), started_at: None, is_definite: false });
        };
        let group = |name| captures.name(name).map(|found| found.as_str());
        let robot =
            group("robot").map(str::trim).filter(|robot| !robot.is_empty()).ok_or_else(no_match)?.to_owned();
        let Some(date) = group("date") else {
            return Ok(RecognisedName { robot, started_at: None, is_definite: false });
        };
        let time = group("time");
        let zone =
            time_zone(&self.time_zone).ok_or_else(|| RecogniseError::NoTimeZone(self.time_zone.clone()))?;
        let (started_at, is_definite) =
            timestamp(&self.formats, date, time, &zone).map_err(|reason| RecogniseError::NoDate {
                file_name: file_name.to_owned(),
                text: [Some(date), time].into_iter().flatten().collect::<Vec<_>>().join(" "),
                wanted: self.formats.wanted(),
                reason,
            })?;
        Ok(RecognisedName { robot, started_at: Some(started_at), is_definite })
    }
}

/// The IANA time zone `name`. UTC is known on every machine, the others if its database is installed.
pub(crate) fn time_zone(name: &str) -> Option<TimeZone> {
    if name == "UTC" { Some(TimeZone::UTC) } else { TimeZone::get(name).ok() }
}

/// The forms of the name for the pattern: without endings, without those of compressed files, and whole.
fn forms(file_name: &str) -> [&str; 3] {
    [strip(file_name, &ENDINGS), strip(file_name, &ENDINGS[..2]), file_name]
}

/// The robot in a name without date and time. A possible date that the pattern does not match must not become part of a
/// robot's name.
fn plain_robot(stem: &str) -> Option<&str> {
    let named = stem.chars().any(char::is_alphanumeric) && !stem.starts_with(['_', '.']);
    (named && !has_date_like(stem)).then_some(stem)
}

fn example(pattern: &str) -> String {
    if pattern == DEFAULT_FILE_NAME {
        format!("a name such as {EXAMPLE} matches")
    } else {
        format!("the shipped pattern '{DEFAULT_FILE_NAME}' matches names such as {EXAMPLE}")
    }
}

fn strip<'n>(name: &'n str, endings: &[&str]) -> &'n str {
    let shorter = endings.iter().find_map(|ending| {
        let (stem, end) = name.split_at_checked(name.len().checked_sub(ending.len())?)?;
        (end.eq_ignore_ascii_case(ending) && !stem.is_empty()).then_some(stem)
    });
    shorter.map_or(name, |stem| strip(stem, endings))
}

/// Date and time of a local clock in `zone`, and true if that is unambiguous: with a time of day that does not occur
/// twice. If clocks are set back, the earlier of the two times is used; if they are set forward, the missing hour
/// continues the old one, as a controller's clock does.
fn timestamp(
    formats: &DateFormats,
    date: &str,
    time: Option<&str>,
    zone: &TimeZone,
) -> Result<(Timestamp, bool), String> {
    let (moment, has_time) = formats.moment(date, time)?;
    let moments = zone.to_ambiguous_timestamp(moment);
    let comes_twice = matches!(moments.offset(), AmbiguousOffset::Fold { .. });
    Ok((moments.compatible().map_err(|error| error.to_string())?, has_time && !comes_twice))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn native() -> Recognition {
        let file_name = regex::Regex::new(DEFAULT_FILE_NAME).expect("a pattern");
        Recognition { file_name, formats: DateFormats::default(), time_zone: "UTC".into() }
    }

    fn recognised(file_name: &str) -> (String, String) {
        let recognised = native().recognise(file_name).expect(file_name);
        (recognised.robot, recognised.started_at.expect("a time").to_string())
    }

    #[test]
    fn native_names_give_robot_and_start() {
        for (name, robot, start) in [
            ("R00_20260105_0847_Col23_20s_cycle5.csv.gz", "R00", "2026-01-05T08:47:00Z"),
            ("Right_20200127_0847_Col25_3min_cycle24.csv", "Right", "2020-01-27T08:47:00Z"),
            ("Right_20200127_0847_Col25_3min_cycle24", "Right", "2020-01-27T08:47:00Z"),
            ("R00_20260105_084759.CSV.ZST", "R00", "2026-01-05T08:47:59Z"),
            // a leap second
            ("R00_20161231_235960.csv", "R00", "2016-12-31T23:59:59Z"),
            ("R00_20260105_0847.parquet", "R00", "2026-01-05T08:47:00Z"),
            ("R00_20260105_0847.MCAP", "R00", "2026-01-05T08:47:00Z"),
            ("cell_4_left_20240229_2359_x.csv.zst", "cell_4_left", "2024-02-29T23:59:00Z"),
        ] {
            assert_eq!(recognised(name), (robot.to_owned(), start.to_owned()), "{name}");
        }
    }

    #[test]
    fn names_without_robot_date_or_time_show_pattern_and_example() {
        for name in [
            "_.csv",
            "_20260105_0847.csv",
            "R00_2026015_0847.csv",
            "R00_20260105_08471.csv",
            "KR7-01.03.2026 08-00.csv",
            ".gz",
            "",
        ] {
            let error = native().recognise(name).expect_err(name);
            assert!(matches!(error, RecogniseError::NoMatch { .. }), "{error}");
            let message = error.to_string();
            assert!(message.contains(DEFAULT_FILE_NAME) && message.contains(EXAMPLE), "{message}");
        }
        assert!(native().recognise(EXAMPLE).is_ok(), "the example must be one");
    }

    #[test]
    fn a_name_with_nothing_like_a_date_is_the_robots() {
        for (name, robot) in [
            ("R00.csv.gz", "R00"),
            ("cell_4_left.csv", "cell_4_left"),
            ("er3a-0815.csv", "er3a-0815"),
            ("Gro\u{308}ße.csv", "Größe"),
        ] {
            let found = native().recognise(name).expect(name);
            assert_eq!(found, RecognisedName { robot: robot.into(), started_at: None, is_definite: false });
        }
    }

    #[test]
    fn impossible_dates_and_times_are_refused_with_what_is_wrong() {
        for (name, reason) in [
            ("R00_20260230_0847.csv", "month 2 of 2026 has no day 30"),
            ("R00_20261301_0847.csv", "month 13 of 2026 has no day 1"),
            ("R00_20260105_2460.csv", "the time 24:60:00 does not exist"),
            ("R00_20260105_084761.csv", "the time 08:47:61 does not exist"),
            ("unknown_20260105_0847.csv", "which is reserved for exports of unknown robots"),
            ("unknown.csv", "which is reserved for exports of unknown robots"),
            ("R00_00012345_0847.csv", "the year 1 is not between 1980 and 2199"),
        ] {
            let message = native().recognise(name).expect_err(name).to_string();
            assert!(message.ends_with(reason), "{message}");
        }
    }

    #[test]
    fn a_pattern_may_leave_out_the_time_and_may_name_the_ending() {
        let by = |pattern| Recognition {
            file_name: regex::Regex::new(pattern).expect(pattern),
            formats: DateFormats::default(),
            time_zone: "UTC".into(),
        };
        let robot_only = by(r"^(?<robot>.+)$").recognise("Left.csv.gz").expect("matches");
        assert_eq!(robot_only, RecognisedName { robot: "Left".into(), started_at: None, is_definite: false });
        let dated =
            by(r"^(?<robot>\w+)-(?<date>\d{8})\.csv$").recognise("Left-20260105.csv.gz").expect("matches");
        assert_eq!(dated.started_at.map(|t| t.to_string()).as_deref(), Some("2026-01-05T00:00:00Z"));
        assert!(!dated.is_definite, "a robot has several recordings a day");
        assert!(native().recognise(EXAMPLE).expect("a name").is_definite);
    }

    #[test]
    fn wall_clocks_are_read_in_their_zone_also_when_clocks_change() {
        // Central European rules written out, so that the machine needs no database of zones.
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").expect("a zone");
        for (date, time, expected, comes_twice) in [
            ("20260105", "0847", "2026-01-05T07:47:00Z", false),
            ("20260705", "0847", "2026-07-05T06:47:00Z", false),
            ("20261025", "0230", "2026-10-25T00:30:00Z", true),
            ("20261025", "0300", "2026-10-25T02:00:00Z", false),
            ("20260329", "0230", "2026-03-29T01:30:00Z", false),
        ] {
            assert_eq!(
                timestamp(&DateFormats::default(), date, Some(time), &zone)
                    .map(|(t, one)| (t.to_string(), !one)),
                Ok((expected.to_owned(), comes_twice)),
                "{date}"
            );
        }
    }

    #[test]
    fn an_unknown_zone_is_said_so() {
        let lost = Recognition { time_zone: "Europe/Atlantis".into(), ..native() };
        assert_eq!(lost.recognise(EXAMPLE), Err(RecogniseError::NoTimeZone("Europe/Atlantis".into())));
    }
}
