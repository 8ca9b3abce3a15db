//! Interprets the text of one cell: a number with a decimal point or comma, or a date and time.

use std::borrow::Cow;

use jiff::civil::Date;
use serde::{Deserialize, Serialize};

use super::clock::ClockOrigin;
use armwatch_config::{DecimalMark, TextTime, duration};

/// Digits of a nanosecond.
const FRACTION_DIGITS: usize = 9;

/// Most digits of a [`Decimal`], as many as 128 bits allow: more than the shortest text of any double after the seconds
/// from 1970.
const MOST_DIGITS: u32 = 37;

/// Why a cell is not a number, and the remedy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoNumber {
    /// Completes "value is ..".
    pub reason: Cow<'static, str>,
    /// The remedy; `None` for the usual remedy of a cell.
    pub remedy: Option<Cow<'static, str>>,
}

/// The number in a cell without blanks around it. An exponent begins with `e` or, as in Fortran, with `d`.
///
/// # Errors
/// [`NoNumber`], which recognises the other decimal mark, separators of thousands and characters that look like those
/// of a number.
pub fn number(cell: &str, decimal: DecimalMark) -> Result<f64, NoNumber> {
    let parsed = match decimal {
        DecimalMark::Point => cell.parse(),
        DecimalMark::Comma if cell.contains('.') => return Err(no_number(cell, decimal)),
        DecimalMark::Comma if cell.contains(',') => cell.replacen(',', ".", 1).parse(),
        DecimalMark::Comma => cell.parse(),
    };
    parsed.or_else(|_| {
        let plain = with_e(cell).or_else(|| with_ascii(cell));
        plain.and_then(|plain| number(&plain, decimal).ok()).ok_or_else(|| no_number(cell, decimal))
    })
}

/// A cell with the typographic minus sign replaced by a hyphen, and without non-breaking blanks around it.
fn with_ascii(cell: &str) -> Option<String> {
    const MINUS: char = '\u{2212}';
    let bare = cell.trim_matches(|c| matches!(c, '\u{a0}' | '\u{202f}' | '\u{2007}' | '\u{2009}' | ' '));
    (bare.len() < cell.len() || bare.contains(MINUS)).then(|| bare.replace(MINUS, "-"))
}

/// A cell with a Fortran exponent, `1.0D+03`, in the form of other languages.
fn with_e(cell: &str) -> Option<String> {
    let (mantissa, exponent) = cell.split_once(['d', 'D'])?;
    let is_exponent = exponent.parse::<i32>().is_ok() && mantissa.bytes().any(|byte| byte.is_ascii_digit());
    is_exponent.then(|| format!("{mantissa}e{exponent}"))
}

/// A number exactly as its digits are written, without the rounding of a double: `digits` times ten to the power of
/// minus `places`. A clock that counts from 1970 in steps of a millisecond needs more digits than a double has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Decimal {
    /// All digits as one whole number.
    pub digits: i128,
    /// Digits after the decimal mark.
    pub places: u32,
}

impl Decimal {
    /// Reads the same numbers as [`number`], except those with so many digits, or such an exponent, that no clock has
    /// them.
    pub fn read(cell: &str, decimal: DecimalMark) -> Option<Self> {
        let mark = match decimal {
            DecimalMark::Point => b'.',
            DecimalMark::Comma => b',',
        };
        let (mantissa, exponent) = match cell.find(['e', 'E', 'd', 'D']) {
            Some(at) => (cell.get(..at)?, cell.get(at + 1..)?.parse::<i32>().ok()?),
            None => (cell, 0),
        };
        let unsigned = mantissa.strip_prefix(['+', '-']).unwrap_or(mantissa);
        let (mut digits, mut count, mut places) = (0_i128, 0_u32, None);
        for byte in unsigned.bytes() {
            match byte {
                b'0'..=b'9' => {
                    digits = digits * 10 + i128::from(byte - b'0');
                    count += 1;
                    places = places.map(|places: i32| places + 1);
                }
                _ if byte == mark && places.is_none() => places = Some(0),
                _ => return None,
            }
            if count > MOST_DIGITS {
                return None;
            }
        }
        let signed = if mantissa.starts_with('-') { -digits } else { digits };
        let places = places.unwrap_or(0).checked_sub(exponent)?;
        let of_whole = |digits: i128| (count > 0 && places.unsigned_abs() <= MOST_DIGITS).then_some(digits);
        match u32::try_from(places) {
            Ok(places) => of_whole(signed).map(|digits| Self { digits, places }),
            Err(_) => {
                let scale = 10_i128.checked_pow(places.unsigned_abs())?;
                of_whole(signed)?.checked_mul(scale).map(|digits| Self { digits, places: 0 })
            }
        }
    }

    /// The nearest double.
    pub fn to_f64(self) -> f64 {
        // both are exact doubles, so that the quotient is rounded once
        const EXACT_PLACES: i32 = 22;
        match i32::try_from(self.places) {
            Ok(places)
                if places <= EXACT_PLACES && self.digits.unsigned_abs() < 1 << f64::MANTISSA_DIGITS =>
            {
                self.digits as f64 / 10_f64.powi(places)
            }
            _ => format!("{}e-{}", self.digits, self.places).parse().unwrap_or(f64::NAN),
        }
    }

    /// The double nearest to the difference; `None` if the numbers are too far apart for an exact difference.
    pub fn minus(self, other: Self) -> Option<f64> {
        let places = self.places.max(other.places);
        let widened = |of: Self| of.digits.checked_mul(10_i128.checked_pow(places - of.places)?);
        let digits = widened(self)?.checked_sub(widened(other)?)?;
        Some(Self { digits, places }.to_f64())
    }
}

/// Difference between the number in a cell and `origin`.
///
/// # Errors
/// Those of [`number`].
pub fn number_since(cell: &str, decimal: DecimalMark, origin: Decimal) -> Result<f64, NoNumber> {
    match Decimal::read(cell, decimal).and_then(|number| number.minus(origin)) {
        Some(difference) => Ok(difference),
        None => Ok(number(cell, decimal)? - origin.to_f64()),
    }
}

fn no_number(cell: &str, decimal: DecimalMark) -> NoNumber {
    let (mark, other) = match decimal {
        DecimalMark::Point => ('.', ','),
        DecimalMark::Comma => (',', '.'),
    };
    let with_point = cell.replacen(other, ".", 1);
    let is_other = !cell.contains(mark) && cell.contains(other) && with_point.parse::<f64>().is_ok();
    match (is_other, decimal) {
        (true, DecimalMark::Point) => NoNumber {
            reason: "a number with a decimal comma".into(),
            remedy: Some(
                "set decimal = \",\" in the layout if all numbers have it, or export with points".into(),
            ),
        },
        (true, DecimalMark::Comma) => NoNumber {
            reason: "a number with a decimal point, but the layout has decimal = \",\"".into(),
            remedy: Some(
                "take decimal = \",\" out of the layout if all numbers have points, or export with commas"
                    .into(),
            ),
        },
        _ if is_grouped(cell, mark) => NoNumber {
            reason: "a number with thousands separators".into(),
            remedy: Some("export without thousands separators".into()),
        },
        _ => match cell.chars().find(|c| !c.is_ascii()) {
            Some(character) => NoNumber {
                reason: format!("not a number: the cell contains {}", unicode_name(character)).into(),
                remedy: Some(
                    "export numbers with ASCII characters only: digits, -, a decimal mark, e".into(),
                ),
            },
            None => NoNumber { reason: "not a number".into(), remedy: None },
        },
    }
}

/// A character by its number, with its name in Unicode if it is invisible or looks like one of a number.
pub(super) fn unicode_name(character: char) -> String {
    let name = match character {
        '\u{a0}' => " NO-BREAK SPACE",
        '\u{ad}' => " SOFT HYPHEN",
        '\u{66b}' => " ARABIC DECIMAL SEPARATOR",
        '\u{660}'..='\u{669}' => " ARABIC-INDIC DIGIT",
        '\u{2007}' => " FIGURE SPACE",
        '\u{2009}' => " THIN SPACE",
        '\u{200b}' => " ZERO WIDTH SPACE",
        '\u{200e}' => " LEFT-TO-RIGHT MARK",
        '\u{200f}' => " RIGHT-TO-LEFT MARK",
        '\u{2010}' => " HYPHEN",
        '\u{2011}' => " NON-BREAKING HYPHEN",
        '\u{2012}' => " FIGURE DASH",
        '\u{2013}' => " EN DASH",
        '\u{2014}' => " EM DASH",
        '\u{202f}' => " NARROW NO-BREAK SPACE",
        '\u{2060}' => " WORD JOINER",
        '\u{2212}' => " MINUS SIGN",
        '\u{3000}' => " IDEOGRAPHIC SPACE",
        '\u{feff}' => " ZERO WIDTH NO-BREAK SPACE",
        '\u{ff0b}' => " FULLWIDTH PLUS SIGN",
        '\u{ff0d}' => " FULLWIDTH HYPHEN-MINUS",
        '\u{ff0e}' => " FULLWIDTH FULL STOP",
        '\u{ff10}'..='\u{ff19}' => " FULLWIDTH DIGIT",
        _ => "",
    };
    format!("U+{:04X}{name}", u32::from(character))
}

/// Returns true if a cell consists of digits in groups of three, as in `1.234.567,8`, `1'234.5` or `1 234`.
fn is_grouped(cell: &str, mark: char) -> bool {
    let unsigned = cell.trim_start_matches(['+', '-']);
    let whole = unsigned.split(mark).next().unwrap_or_default();
    let is_separator = |c: char| matches!(c, ' ' | '\u{a0}' | '\u{202f}' | '\'' | '’' | '.' | ',');
    let groups: Vec<&str> = whole.split(is_separator).collect();
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    groups.len() > 1
        && groups.iter().all(|group| digits(group))
        && groups.first().is_some_and(|group| group.len() <= 3)
        && groups.iter().skip(1).all(|group| group.len() == 3)
}

/// Nanoseconds from 1970 to a date and time; for a time without date, from midnight.
///
/// Reads ISO 8601 with `T` or a blank between date and time, with a fraction of any length after a point or comma,
/// ending in `Z`, an offset such as `+01:00`, or nothing, and dates with the day first, `01.03.2026 08:00:00,004`. A
/// clock without offset is not converted.
pub fn timestamp(cell: &str) -> Option<i64> {
    let (days, clock) = match cell.bytes().position(|byte| matches!(byte, b'T' | b't' | b' ')) {
        Some(at) => (days(cell.get(..at)?)?, cell.get(at + 1..)?),
        None => (0, cell),
    };
    let (clock, offset) = without_offset(clock.trim_start_matches(' '))?;
    let nanoseconds = nanoseconds_of_day(clock)?;
    let seconds = i64::from(days) * 86_400 - offset;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanoseconds)
}

/// Nanoseconds of a time in text form, from the origin of its form.
pub fn text_time(cell: &str, form: &TextTime) -> Option<i64> {
    match form {
        TextTime::Timestamp => timestamp(cell),
        TextTime::Format(format) => format.moment(cell).map(|moment| moment.nanoseconds),
        TextTime::Duration => duration(cell),
    }
}

/// Origin of times whose first one is in this cell.
pub(crate) fn clock_origin(cell: &str, form: &TextTime) -> Option<ClockOrigin> {
    let nanoseconds = text_time(cell, form)?;
    let dated = dated_moment(cell);
    let (period_s, is_local) = match form {
        TextTime::Timestamp => match dated {
            Some((_, has_offset)) => (None, !has_offset),
            None => (form.period_s(), true),
        },
        TextTime::Format(format) => {
            (form.period_s(), format.moment(cell).is_some_and(|moment| !moment.has_offset))
        }
        TextTime::Duration => (None, false),
    };
    Some(ClockOrigin { nanoseconds, period_s, is_local })
}

/// Like [`timestamp`] for a cell with a date; also returns true if it has an offset from UTC.
pub(crate) fn dated_moment(cell: &str) -> Option<(i64, bool)> {
    let (_, clock) = cell.split_once(['T', 't', ' '])?;
    let has_offset = clock.ends_with(['Z', 'z']) || clock.contains(['+', '-']);
    timestamp(cell).map(|nanoseconds| (nanoseconds, has_offset))
}

/// Days from 1970.
fn days(date: &str) -> Option<i32> {
    let bytes = date.as_bytes();
    let (year, month, day) = match (bytes.len(), bytes.get(4), bytes.get(2)) {
        (10, Some(b'-' | b'/'), _) if bytes.get(7) == bytes.get(4) => (0..4, 5..7, 8..10),
        (10, _, Some(b'.')) if bytes.get(5) == Some(&b'.') => (6..10, 3..5, 0..2),
        (8, ..) => (0..4, 4..6, 6..8),
        _ => return None,
    };
    let part = |range| date.get(range).and_then(digits);
    let (year, month, day) = (part(year)?, part(month)?, part(day)?);
    let date =
        Date::new(i16::try_from(year).ok()?, i8::try_from(month).ok()?, i8::try_from(day).ok()?).ok()?;
    let since = date.duration_since(Date::constant(1970, 1, 1));
    i32::try_from(since.as_hours() / 24).ok()
}

/// The clock without its offset, and the seconds that it is ahead of UTC.
fn without_offset(clock: &str) -> Option<(&str, i64)> {
    if let Some(clock) = clock.strip_suffix(['Z', 'z']) {
        return Some((clock.trim_end_matches(' '), 0));
    }
    let Some(at) = clock.find(['+', '-']) else { return Some((clock, 0)) };
    let (clock, offset) = clock.split_at(at);
    let sign = if offset.starts_with('-') { -1 } else { 1 };
    let offset = offset.get(1..)?;
    let hours = offset.get(..2).and_then(digits)?;
    let minutes = match offset.get(2..)?.trim_start_matches(':') {
        "" => 0,
        minutes if minutes.len() == 2 => digits(minutes)?,
        _ => return None,
    };
    (hours <= 18 && minutes < 60).then(|| (clock.trim_end_matches(' '), sign * (hours * 3600 + minutes * 60)))
}

fn nanoseconds_of_day(clock: &str) -> Option<i64> {
    let part = |from: usize| clock.get(from..from + 2).and_then(digits);
    let colon = |at: usize| clock.as_bytes().get(at) == Some(&b':');
    if !colon(2) || !colon(5) {
        return None;
    }
    // Second 60 is a leap second.
    let (hour, minute, second) =
        (part(0).filter(|h| *h < 24)?, part(3).filter(|m| *m < 60)?, part(6).filter(|s| *s <= 60)?);
    let fraction = match clock.get(8..)? {
        "" => 0,
        rest => fraction(rest.strip_prefix(['.', ','])?)?,
    };
    Some((hour * 3600 + minute * 60 + second) * 1_000_000_000 + fraction)
}

/// Nanoseconds of the digits after the mark; digits beyond the ninth are ignored.
fn fraction(text: &str) -> Option<i64> {
    if text.is_empty() || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let kept = text.get(..text.len().min(FRACTION_DIGITS))?;
    let missing = u32::try_from(FRACTION_DIGITS - kept.len()).ok()?;
    Some(digits(kept)? * 10_i64.pow(missing))
}

fn digits(text: &str) -> Option<i64> {
    let valid = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    valid.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers_with_either_mark() {
        for (cell, value) in [("1,5", 1.5), ("-0,25e-3", -0.25e-3), ("7", 7.0), (",5", 0.5), ("+1,", 1.0)] {
            assert_eq!(number(cell, DecimalMark::Comma), Ok(value), "{cell}");
            assert_eq!(number(&cell.replace(',', "."), DecimalMark::Point), Ok(value), "{cell}");
        }
    }

    #[test]
    fn the_other_mark_thousands_and_odd_characters_are_named() {
        const MINUS: &str = "not a number: the cell contains U+2212 MINUS SIGN";
        const NO_BREAK_SPACE: &str = "not a number: the cell contains U+00A0 NO-BREAK SPACE";
        let reason = |cell, decimal| number(cell, decimal).expect_err(cell).reason;
        for (cell, point, comma) in [
            ("0,25", "a number with a decimal comma", ""),
            ("0.25", "", "a number with a decimal point, but the layout has decimal = \",\""),
            ("1.234,5", "not a number", "a number with thousands separators"),
            ("1,234.5", "a number with thousands separators", "not a number"),
            ("1'234.5", "a number with thousands separators", "not a number"),
            ("-1 234 567", "a number with thousands separators", "a number with thousands separators"),
            ("1\u{a0}234", "a number with thousands separators", "a number with thousands separators"),
            ("abc", "not a number", "not a number"),
            ("1,2,3", "not a number", "not a number"),
            ("1\u{2212}0", MINUS, MINUS),
            ("0\u{a0}0", NO_BREAK_SPACE, NO_BREAK_SPACE),
            ("0\u{200b}", "not a number: the cell contains U+200B ZERO WIDTH SPACE", ""),
            ("12°", "not a number: the cell contains U+00B0", ""),
        ] {
            if !point.is_empty() {
                assert_eq!(reason(cell, DecimalMark::Point), point, "{cell}");
            }
            if !comma.is_empty() {
                assert_eq!(reason(cell, DecimalMark::Comma), comma, "{cell}");
            }
        }
    }

    #[test]
    fn the_minus_of_typography_and_blanks_around_a_number_are_read() {
        for (cell, value) in [
            ("\u{2212}0.000015", -0.000_015),
            ("1.5e\u{2212}3", 1.5e-3),
            ("\u{a0}0.5\u{202f}", 0.5),
            ("\u{2212}\u{a0}1", f64::NAN),
        ] {
            let found = number(cell, DecimalMark::Point);
            match value.is_nan() {
                true => assert!(found.is_err(), "{cell}"),
                false => assert_eq!(found, Ok(value), "{cell}"),
            }
        }
    }

    #[test]
    fn exponents_of_fortran_are_read() {
        for (cell, value) in [
            ("1.0D+03", 1e3),
            ("-0.15d-2", -0.15e-2),
            ("2D5", 2e5),
            (".5D0", 0.5),
            ("1.D+00", 1.0),
            ("+12.5D10", 12.5e10),
        ] {
            assert_eq!(number(cell, DecimalMark::Point), Ok(value), "{cell}");
            assert_eq!(number(&cell.replace('.', ","), DecimalMark::Comma), Ok(value), "{cell}");
            assert_eq!(Decimal::read(cell, DecimalMark::Point).map(Decimal::to_f64), Some(value), "{cell}");
        }
        for cell in ["D3", "1D", "1D+", "1D3.5", "1D2D3", "0xD", "d", "1 D3", "nanD1", "1.5+103"] {
            assert!(number(cell, DecimalMark::Point).is_err(), "{cell}");
        }
    }

    #[test]
    fn clocks_lose_no_digit() {
        for (cell, origin, since) in [
            ("1700000000.004", "1700000000", 0.004),
            ("1700000000004000001", "1700000000000000000", 4_000_001.0),
            ("36000.0040", "36000", 0.004),
            ("1.700000000004e9", "17e8", 0.004),
            ("0.3", "0.1", 0.2),
            ("-0.5", "-1.5", 1.0),
            ("+1.", ".5", 0.5),
            ("100000000000.123456789", "100000000000", 0.123_456_789),
        ] {
            let origin = Decimal::read(origin, DecimalMark::Point).expect(origin);
            assert_eq!(number_since(cell, DecimalMark::Point, origin), Ok(since), "{cell}");
            let comma = cell.replace('.', ",");
            assert_eq!(number_since(&comma, DecimalMark::Comma, origin), Ok(since), "{comma}");
        }
    }

    #[test]
    fn what_is_no_decimal_is_left_to_doubles() {
        for cell in
            ["", ".", "-", "e5", "1e", "nan", "inf", "1.2.3", "1 2", "1e-300", "1e300", "0x1", "1,5", "--1"]
        {
            assert_eq!(Decimal::read(cell, DecimalMark::Point), None, "{cell}");
        }
    }

    #[test]
    fn timestamps_of_one_moment_in_many_spellings() {
        // 2026-03-01 is day 20513 from 1970.
        let expected = (20_513 * 86_400 + 8 * 3600) * 1_000_000_000 + 4_000_000;
        for cell in [
            "2026-03-01T08:00:00.004Z",
            "2026-03-01T08:00:00.004",
            "2026-03-01 08:00:00,004",
            "2026/03/01 08:00:00.004000000",
            "20260301T08:00:00.0040000001",
            "2026-03-01T09:00:00.004+01:00",
            "2026-03-01t02:30:00.004-0530",
            "2026-03-01 08:00:00.004 Z",
            "01.03.2026 08:00:00,004",
            "01.03.2026  08:00:00.004",
        ] {
            assert_eq!(timestamp(cell), Some(expected), "{cell}");
        }
        assert_eq!(timestamp("08:00:00.5"), Some(28_800_500_000_000));
    }

    #[test]
    fn what_is_no_moment_is_none() {
        for cell in [
            "",
            "T",
            "2026-03-01",
            "2026-02-30 08:00:00",
            "2026-03-01 24:00:00",
            "2026-03-01 08:60:00",
            "2026-03-01 08:00:00.",
            "2026-03-01 08:00:00.x",
            "2026-03-01T08:00:00+99:00",
            "03/01/2026 08:00:00",
            "1.5",
            "2026-03-01 é8:00:00",
        ] {
            assert_eq!(timestamp(cell), None, "{cell}");
        }
    }

    proptest! {
        #[test]
        fn no_text_makes_either_reader_fall(cell in "\\PC{0,30}") {
            let _ = timestamp(&cell);
            let _ = number(&cell, DecimalMark::Comma);
            let _ = number(&cell, DecimalMark::Point);
            let _ = Decimal::read(&cell, DecimalMark::Point);
        }

        /// The two readers of numbers agree exactly.
        #[test]
        fn a_decimal_is_the_double_that_its_text_is(number in -1e12..1e12_f64, places in 0_usize..12) {
            let cell = format!("{number:.places$}");
            let decimal = Decimal::read(&cell, DecimalMark::Point).expect("a decimal");
            prop_assert_eq!(Ok(decimal.to_f64()), cell.parse());
        }
    }
}
