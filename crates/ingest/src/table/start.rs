//! Start of a recording by its own rows: the date and time in the first row of a column.

use std::io::Read;
use std::path::Path;

use jiff::Timestamp;
use jiff::tz::TimeZone;

use super::fields::fields;
use super::{cell, cell_reader, joined, preamble};
use crate::bytes::blocks::{Blocks, Next};
use crate::bytes::source;
use crate::rejection::Rejection;
use armwatch_config::{Column, Layout, StartForm, StartSource};

/// Bytes read at once: only the first row is needed.
const BLOCK_BYTES: usize = 64 << 10;

/// Plausible years of a recording.
const YEARS: std::ops::RangeInclusive<i16> = 1980..=2199;

/// The start of the recording at `path`, from the first row of the column that `layout` names; times without offset are
/// those of clocks in `zone`. Rows that are not understood are skipped, as many as the layout permits.
///
/// # Errors
/// A rejection of a file that is unreadable, has no such column, or whose first row has no time there. It is temporary
/// if the first row is not written yet.
pub fn recorded_start(
    path: &Path,
    layout: &Layout,
    start: &StartSource,
    zone: &TimeZone,
) -> Result<Timestamp, Rejection> {
    let (text, _, layout) = joined::open(path, layout, source::MAX_DECOMPRESSED_BYTES)?;
    first_moment(text, path, &layout, start, zone)
}

fn first_moment(
    reader: impl Read,
    path: &Path,
    layout: &Layout,
    start: &StartSource,
    zone: &TimeZone,
) -> Result<Timestamp, Rejection> {
    let not_yet = || Rejection {
        is_passing: true,
        ..Rejection::of_file(
            path,
            format!("no row with the start in column {} yet", start.column),
            "wait until the writer has begun, or export again",
        )
    };
    let mut blocks = Blocks::new(reader, BLOCK_BYTES, layout.text.encoding);
    let header = preamble::read(&mut blocks, layout, path)?.ok_or_else(not_yet)?;
    let column = match &start.column {
        Column::Number(number) => number.checked_sub(1),
        Column::Name(name) => fields(&header.text, layout.delimiter).position(|field| field == name),
    };
    // a file that still grows may end inside its header
    let column = column.ok_or_else(|| match blocks.is_at_end() {
        true => not_yet(),
        false => missing(path, layout, start, header.line),
    })?;
    let mut first_fault = None;
    let mut faults = 0;
    while let Next::Block(block) = blocks.next_block(path)? {
        if block.unterminated {
            break;
        }
        for (line, number) in cell_reader::lines(&block.bytes).zip(block.first_line..) {
            let text = std::str::from_utf8(line).unwrap_or_default();
            let cell = fields(text, layout.delimiter).nth(column).unwrap_or_default();
            if let Some(moment) = moment(cell, &start.form, zone) {
                return Ok(moment);
            }
            let fault = || {
                let fault = Rejection::of_file(
                    path,
                    format!("no {} for the start", wanted(&start.form)),
                    remedy(&start.form),
                )
                .at_line(number)
                .in_column(&start.column.to_string());
                // a number selects a column in any file, even in one that is not an export
                if matches!(start.column, Column::Name(_)) { fault.with_value(cell) } else { fault }
            };
            let fault = first_fault.get_or_insert_with(fault);
            faults += 1;
            if faults > layout.rows.skip_bad {
                return Err(fault.clone());
            }
        }
    }
    Err(first_fault.unwrap_or_else(not_yet))
}

fn missing(path: &Path, layout: &Layout, start: &StartSource, line: u64) -> Rejection {
    let column = start.column.to_string();
    let remedy = format!("correct column = \"{column}\" under [start] of layout \"{}\"", layout.name);
    Rejection::of_file(path, "missing column of the start", remedy).at_line(line).in_column(&column)
}

fn wanted(form: &StartForm) -> String {
    match form {
        StartForm::Timestamp => "date and time".into(),
        StartForm::Format(format) => format!("date and time in the form {}", format.text()),
        StartForm::Since1970(_) => "time since 1970".into(),
    }
}

fn remedy(form: &StartForm) -> &'static str {
    match form {
        StartForm::Timestamp => {
            "export dates and times as 2026-03-01T08:00:00, or give [start] a format such as \"%d/%m/%y %H:%M:%S\""
        }
        StartForm::Format(_) => "correct format under [start] of the layout",
        StartForm::Since1970(_) => {
            "correct unit under [start] of the layout: s, ms, us or ns since 1970, or timestamp"
        }
    }
}

/// The time in a cell.
fn moment(cell: &str, form: &StartForm, zone: &TimeZone) -> Option<Timestamp> {
    let found = match form {
        StartForm::Timestamp => {
            let (nanoseconds, has_offset) = cell::dated_moment(cell)?;
            at_clock(nanoseconds, has_offset, zone)?
        }
        StartForm::Format(format) => {
            let found = format.moment(cell)?;
            at_clock(found.nanoseconds, found.has_offset, zone)?
        }
        StartForm::Since1970(to_s) => {
            let microseconds = cell::number(cell, armwatch_config::DecimalMark::Point)
                .or_else(|_| cell::number(cell, armwatch_config::DecimalMark::Comma))
                .ok()?
                * to_s
                * 1e6;
            microseconds
                .is_finite()
                .then(|| Timestamp::from_microsecond(microseconds.round() as i64).ok())
                .flatten()?
        }
    };
    // a database stores microseconds
    let found = Timestamp::from_microsecond(found.as_microsecond()).ok()?;
    YEARS.contains(&TimeZone::UTC.to_datetime(found).year()).then_some(found)
}

/// The time that a clock shows, ns from 1970: without an offset from UTC, it is local time in `zone`; see
/// [`armwatch_config::Recognition`] for hours that occur twice or never.
fn at_clock(nanoseconds: i64, has_offset: bool, zone: &TimeZone) -> Option<Timestamp> {
    let clock = Timestamp::from_nanosecond(i128::from(nanoseconds)).ok()?;
    if has_offset {
        return Some(clock);
    }
    zone.to_ambiguous_timestamp(TimeZone::UTC.to_datetime(clock)).compatible().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::native;
    use armwatch_config::{MomentFormat, RowRule, StartForm};

    fn format(text: &str) -> StartForm {
        StartForm::Format(MomentFormat::new(text).expect("a format"))
    }

    fn start(column: &str, form: StartForm) -> StartSource {
        StartSource { column: Column::Name(column.into()), form }
    }

    fn of(text: &str, form: StartForm, zone: &TimeZone) -> Result<String, Rejection> {
        first_moment(text.as_bytes(), Path::new("a.csv"), &native(), &start("when", form), zone)
            .map(|moment| moment.to_string())
    }

    #[test]
    fn the_first_row_says_the_start_in_many_forms() {
        let rome = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").expect("a zone");
        for (cell, form, expected) in [
            ("2026-01-05 08:47:30", StartForm::Timestamp, "2026-01-05T07:47:30Z"),
            ("2026-07-05T08:47:30.25", StartForm::Timestamp, "2026-07-05T06:47:30.25Z"),
            ("2026-01-05T08:47:30Z", StartForm::Timestamp, "2026-01-05T08:47:30Z"),
            ("2026-01-05T08:47:30-02:00", StartForm::Timestamp, "2026-01-05T10:47:30Z"),
            ("05.01.2026 08:47:30", StartForm::Timestamp, "2026-01-05T07:47:30Z"),
            ("26_01_05 08-47", format("%y_%m_%d %H-%M"), "2026-01-05T07:47:00Z"),
            ("Jan 5 2026", format("%b %d %Y"), "2026-01-04T23:00:00Z"),
            ("5. M\u{e4}rz 2026 8:47", format("%d. %B %Y %H:%M"), "2026-03-05T07:47:00Z"),
            ("1/5/2026 8:47:30 AM", format("%m/%d/%Y %I:%M:%S %p"), "2026-01-05T07:47:30Z"),
            ("1767602850.5", StartForm::Since1970(1.0), "2026-01-05T08:47:30.5Z"),
            ("1767602850500", StartForm::Since1970(1e-3), "2026-01-05T08:47:30.5Z"),
        ] {
            let text = format!("time,when,x\n0.0,{cell},1\n0.1,later,2\n");
            assert_eq!(of(&text, form, &rome).as_deref(), Ok(expected), "{cell}");
        }
    }

    #[test]
    fn what_says_no_start_is_named() {
        let utc = TimeZone::UTC;
        let refused = |text: &str, form| of(text, form, &utc).expect_err(text);
        let missing = refused("time,x\n0,1\n", StartForm::Timestamp);
        assert_eq!((missing.line, missing.is_passing), (Some(1), false), "{missing}");
        for cell in ["08:47:30", "soon", "", "0"] {
            let none = refused(&format!("time,when\n0,{cell}\n"), StartForm::Timestamp);
            assert_eq!((none.line, none.column.as_deref()), (Some(2), Some("when")), "{cell}");
        }
        let uptime = refused("time,when\n0,812.5\n", StartForm::Since1970(1.0));
        assert!(uptime.to_string().contains("is no time since 1970"), "{uptime}");
        for begun in ["", "time,wh", "time,when\n", "time,when\n0,2026-01-05 08:4"] {
            assert!(refused(begun, StartForm::Timestamp).is_passing, "{begun}");
        }
    }

    #[test]
    fn bad_rows_at_the_beginning_are_passed_over_where_the_layout_permits() {
        let text = "time,when\n#\n0,\n1,2026-01-05 08:00:00\n";
        let read = |skip_bad| {
            let layout = Layout { rows: RowRule { skip_bad }, ..native() };
            let layout = Layout {
                text: armwatch_config::TextFormat { comment: String::new(), ..layout.text.clone() },
                ..layout
            };
            let start = start("when", StartForm::Timestamp);
            first_moment(text.as_bytes(), Path::new("a.csv"), &layout, &start, &TimeZone::UTC)
        };
        assert_eq!(read(1).expect_err("two are bad").line, Some(2));
        assert_eq!(read(2).map(|moment| moment.to_string()).as_deref(), Ok("2026-01-05T08:00:00Z"));
    }
}
