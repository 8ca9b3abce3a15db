//! Dates and times as text: the conversions of `[time] format` and `[start] format`, and the possible forms of a cell.

mod forms;
mod names;

use jiff::civil::Date;

pub use self::forms::{forms_of, joined_forms};

/// Seconds of an hour and of a day.
const HOUR: i64 = 3600;
const DAY: i64 = 24 * HOUR;

/// Digits of a nanosecond.
const NANOSECOND_DIGITS: usize = 9;

/// Most digits of elapsed hours, which continue beyond a day.
const ELAPSED_HOUR_DIGITS: usize = 6;

/// The form of a date and time, from conversions of `strptime`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MomentFormat {
    text: String,
    parts: Vec<DatePart>,
}

/// A date, a time of day or both, from a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// Nanoseconds from 1970; for a form without a date, from the start of its largest unit.
    pub nanoseconds: i64,
    /// True if the cell gives its offset from UTC, which is already subtracted.
    pub has_offset: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DatePart {
    Literal(char),
    Blank,
    Number(Field),
    MonthName,
    Weekday,
    Meridiem,
    Offset,
    /// Digits after a point or comma; they may be absent together with the mark.
    Fraction,
    /// Whole milliseconds, microseconds or nanoseconds, by the number of digits.
    Subsecond,
}

/// A number of one or more digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Field {
    Year,
    ShortYear,
    Month,
    Day,
    DayOfYear,
    Hour,
    Hour12,
    Minute,
    Second,
}

impl Field {
    fn digits(self) -> usize {
        match self {
            Self::Year => 4,
            Self::DayOfYear => 3,
            _ => 2,
        }
    }
}

/// Numbers read so far.
#[derive(Debug, Default)]
struct MomentFields {
    year: Option<i64>,
    month: Option<i64>,
    day: Option<i64>,
    day_of_year: Option<i64>,
    hour: i64,
    minute: i64,
    second: i64,
    nanosecond: i64,
    is_afternoon: Option<bool>,
    offset: Option<i64>,
}

impl MomentFormat {
    /// Reads a format. `%d`, `%m`, `%H` and others accept numbers with and without leading zeros, and `%S` accepts
    /// decimals after a point or comma. `%b` and `%B` accept names of months in English, German and Italian.
    ///
    /// # Errors
    /// An unknown conversion, one that depends on the language of a computer, half a date, a month without a name or
    /// number, or twelve hours without AM and PM, as a clause about the format.
    pub fn new(text: &str) -> Result<Self, String> {
        let parts = parts(text)?;
        let format = Self { text: text.to_owned(), parts };
        let has = |field| format.has(DatePart::Number(field));
        let year = has(Field::Year) || has(Field::ShortYear);
        let month = has(Field::Month) || format.has(DatePart::MonthName);
        let whole_date = year && (month && has(Field::Day) || has(Field::DayOfYear));
        if !whole_date && (year || month || has(Field::Day) || has(Field::DayOfYear)) {
            return Err("gives part of a date; it must give year, month and day, or none of them".into());
        }
        if let Some(twice) = format.repeated() {
            return Err(format!("gives {twice} twice"));
        }
        if has(Field::Hour12) != format.has(DatePart::Meridiem) {
            return Err("needs %I and %p together: hours from 1 to 12 are ambiguous".into());
        }
        if !whole_date && !has(Field::Hour) && !has(Field::Hour12) && !has(Field::Second) {
            return Err("gives neither a date nor a time".into());
        }
        Ok(format)
    }

    /// The format's text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns true if it gives year, month and day.
    pub fn gives_date(&self) -> bool {
        self.has(DatePart::Number(Field::Year)) || self.has(DatePart::Number(Field::ShortYear))
    }

    /// Returns true if it gives seconds, or decimals of them.
    pub fn gives_seconds(&self) -> bool {
        self.has(DatePart::Number(Field::Second))
    }

    /// Seconds after which a clock of this form restarts; `None` with a date.
    pub fn period_s(&self) -> Option<f64> {
        let has = |field| self.has(DatePart::Number(field));
        match () {
            () if self.gives_date() => None,
            () if has(Field::Hour) || has(Field::Hour12) => Some(DAY as f64),
            () if has(Field::Minute) => Some(HOUR as f64),
            () => Some(60.0),
        }
    }

    fn has(&self, part: DatePart) -> bool {
        self.parts.contains(&part)
    }

    fn repeated(&self) -> Option<&'static str> {
        let name = |part: &DatePart| match part {
            DatePart::Number(Field::Year | Field::ShortYear) => Some("the year"),
            DatePart::Number(Field::Month) | DatePart::MonthName => Some("the month"),
            DatePart::Number(Field::Day) => Some("the day"),
            DatePart::Number(Field::Hour | Field::Hour12) => Some("the hour"),
            DatePart::Number(Field::Minute) => Some("the minute"),
            DatePart::Number(Field::Second) => Some("the second"),
            _ => None,
        };
        let mut names: Vec<&str> = self.parts.iter().filter_map(name).collect();
        names.sort_unstable();
        names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
    }

    /// The time of a cell in this form.
    pub fn moment(&self, cell: &str) -> Option<Moment> {
        let dated = self.gives_date();
        let mut rest = cell.trim_matches(is_blank);
        let mut found = MomentFields::default();
        for (at, part) in self.parts.iter().enumerate() {
            let next = self.parts.get(at + 1);
            rest = match part {
                DatePart::Literal(wanted) => literal(rest, *wanted)?,
                DatePart::Blank => rest.trim_start_matches(is_blank),
                DatePart::Number(field) => {
                    let counts_on =
                        *field == Field::Hour && !dated && matches!(next, Some(DatePart::Literal(_)));
                    let most = if counts_on { ELAPSED_HOUR_DIGITS } else { field.digits() };
                    let (number, rest) = number(rest, most)?;
                    found.take(*field, number, self)?;
                    rest
                }
                DatePart::MonthName => {
                    let (month, rest) = names::month(rest)?;
                    found.month = Some(month);
                    rest
                }
                DatePart::Weekday => names::skip_word(rest)?,
                DatePart::Meridiem => {
                    let (is_afternoon, rest) = names::meridiem(rest)?;
                    found.is_afternoon = Some(is_afternoon);
                    rest
                }
                DatePart::Offset => {
                    let (offset, rest) = offset(rest.trim_start_matches(is_blank))?;
                    found.offset = Some(offset);
                    rest
                }
                DatePart::Fraction => {
                    let (nanosecond, rest) = fraction(rest)?;
                    found.nanosecond = nanosecond;
                    rest
                }
                DatePart::Subsecond => {
                    let (nanosecond, rest) = subsecond(rest)?;
                    found.nanosecond = nanosecond;
                    rest
                }
            };
        }
        if rest.is_empty() { found.moment() } else { None }
    }
}

impl MomentFields {
    /// Stores a number; `None` if it is invalid for its field.
    fn take(&mut self, field: Field, number: i64, format: &MomentFormat) -> Option<()> {
        let (dated, has_hour) = (format.gives_date(), format.has(DatePart::Number(Field::Hour)));
        let (slot, range) = match field {
            Field::Year => (&mut self.year, 1..=9999),
            // like strptime: from 69 on, the last century
            Field::ShortYear => {
                self.year = Some(if number < 69 { 2000 + number } else { 1900 + number });
                return Some(());
            }
            Field::Month => (&mut self.month, 1..=12),
            Field::Day => (&mut self.day, 1..=31),
            Field::DayOfYear => (&mut self.day_of_year, 1..=366),
            Field::Hour | Field::Hour12 | Field::Minute | Field::Second => {
                let (slot, range) = match field {
                    Field::Hour => (&mut self.hour, 0..=if dated { 23 } else { i64::MAX }),
                    Field::Hour12 => (&mut self.hour, 1..=12),
                    Field::Minute if has_hour || dated => (&mut self.minute, 0..=59),
                    Field::Minute => (&mut self.minute, 0..=i64::MAX),
                    // second 60 is a leap second
                    _ => (&mut self.second, 0..=60),
                };
                *slot = number;
                return range.contains(&number).then_some(());
            }
        };
        *slot = Some(number);
        range.contains(&number).then_some(())
    }

    fn moment(self) -> Option<Moment> {
        let hour = match self.is_afternoon {
            Some(is_afternoon) => self.hour % 12 + if is_afternoon { 12 } else { 0 },
            None => self.hour,
        };
        let seconds =
            self.days()? * DAY + hour * HOUR + self.minute * 60 + self.second - self.offset.unwrap_or(0);
        let nanoseconds = seconds.checked_mul(1_000_000_000)?.checked_add(self.nanosecond)?;
        Some(Moment { nanoseconds, has_offset: self.offset.is_some() })
    }

    /// Days from 1970; zero without a date.
    fn days(&self) -> Option<i64> {
        let Some(year) = self.year else { return Some(0) };
        let year = i16::try_from(year).ok()?;
        let date = match (self.day_of_year, self.month, self.day) {
            (Some(day), ..) => {
                let first = Date::new(year, 1, 1).ok()?;
                let date = first.checked_add(jiff::Span::new().days(day - 1)).ok()?;
                (date.year() == year).then_some(date)?
            }
            (None, Some(month), Some(day)) => {
                Date::new(year, i8::try_from(month).ok()?, i8::try_from(day).ok()?).ok()?
            }
            _ => return None,
        };
        Some(date.duration_since(Date::constant(1970, 1, 1)).as_hours() / 24)
    }
}

/// Nanoseconds of an elapsed time in the notation of IEC 61131-3 and ISO 8601: `T#1h2m3s4ms`, `LTIME#20ms`, `PT1.5S`,
/// `-1d2h`.
pub fn duration(cell: &str) -> Option<i64> {
    const UNITS: [(&str, f64); 9] = [
        ("ms", 1e6),
        ("us", 1e3),
        ("\u{b5}s", 1e3),
        ("\u{3bc}s", 1e3),
        ("ns", 1.0),
        ("d", 86_400e9),
        ("h", 3600e9),
        ("m", 60e9),
        ("s", 1e9),
    ];
    let lower = cell.to_lowercase();
    let signless = lower.trim_start_matches(['-', '+']);
    let bare = match signless.split_once('#') {
        Some(("t" | "time" | "lt" | "ltime", bare)) => bare,
        Some(_) => return None,
        None => signless.strip_prefix('p').unwrap_or(signless),
    };
    let sign = if lower.starts_with('-') || bare.starts_with('-') { -1.0 } else { 1.0 };
    let mut rest = bare.trim_start_matches('-');
    let mut sum = 0.0;
    let mut parts = 0;
    while !rest.is_empty() {
        // the T of ISO 8601 is between days and hours, and underscores may be between any parts
        rest = rest.strip_prefix(['t', '_']).unwrap_or(rest);
        let end = rest.find(|c: char| !c.is_ascii_digit() && !matches!(c, '.' | ',' | '_'))?;
        let number: f64 = rest.get(..end)?.replace(',', ".").replace('_', "").parse().ok()?;
        let (unit, factor) = UNITS.iter().find(|(unit, _)| rest[end..].starts_with(unit))?;
        sum += number * factor;
        parts += 1;
        rest = rest.get(end + unit.len()..)?;
    }
    let sum = (sign * sum).round();
    (parts > 0 && sum.abs() < i64::MAX as f64).then_some(sum as i64)
}

/// Returns true if a character is a blank, including non-breaking ones.
fn is_blank(c: char) -> bool {
    matches!(c, ' ' | '\t' | '\u{a0}' | '\u{202f}' | '\u{2009}')
}

fn literal(text: &str, wanted: char) -> Option<&str> {
    let mut chars = text.chars();
    (chars.next()? == wanted).then_some(chars.as_str())
}

/// The number of at most `most` digits at the start of a text, and the rest.
fn number(text: &str, most: usize) -> Option<(i64, &str)> {
    let text = text.trim_start_matches(is_blank);
    let end = text.bytes().take(most).take_while(u8::is_ascii_digit).count();
    let (digits, rest) = text.split_at_checked(end)?;
    Some((digits.parse().ok()?, rest))
}

/// Nanoseconds of decimals after a point or comma; zero without a mark.
fn fraction(text: &str) -> Option<(i64, &str)> {
    let Some(decimals) = text.strip_prefix(['.', ',']) else { return Some((0, text)) };
    let end = decimals.bytes().take_while(u8::is_ascii_digit).count();
    let (digits, rest) = decimals.split_at_checked(end)?;
    let kept = digits.get(..end.min(NANOSECOND_DIGITS))?;
    let missing = u32::try_from(NANOSECOND_DIGITS - kept.len()).ok()?;
    Some((kept.parse::<i64>().ok()? * 10_i64.pow(missing), rest))
}

/// Nanoseconds of whole milliseconds (up to three digits), microseconds or nanoseconds.
fn subsecond(text: &str) -> Option<(i64, &str)> {
    let end = text.bytes().take_while(u8::is_ascii_digit).count();
    let unit = match end {
        1..=3 => 1_000_000,
        4..=6 => 1_000,
        7..=9 => 1,
        _ => return None,
    };
    let (digits, rest) = text.split_at_checked(end)?;
    Some((digits.parse::<i64>().ok()? * unit, rest))
}

/// Offset of a clock from UTC, s.
fn offset(text: &str) -> Option<(i64, &str)> {
    if let Some(rest) = text.strip_prefix(['Z', 'z']) {
        return Some((0, rest));
    }
    let sign = if text.starts_with('-') { -1 } else { 1 };
    let (hours, rest) = number(text.strip_prefix(['+', '-'])?, 2)?;
    let minutes = rest.strip_prefix(':').unwrap_or(rest);
    let (minutes, rest) = if minutes.is_empty() { (0, minutes) } else { number(minutes, 2)? };
    (hours <= 18 && minutes < 60).then_some((sign * (hours * HOUR + minutes * 60), rest))
}

/// The parts of a format.
fn parts(text: &str) -> Result<Vec<DatePart>, String> {
    let mut parts = Vec::new();
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '%' => {
                // width and padding have no effect, since numbers are read with and without zeros
                while chars.next_if(|c| matches!(c, '-' | '_' | '0'..='9' | ':')).is_some() {}
                let has_mark = chars.next_if_eq(&'.').is_some();
                while chars.next_if(char::is_ascii_digit).is_some() {}
                let conversion = chars.next().ok_or("ends with a %")?;
                add(&mut parts, conversion, has_mark)?;
            }
            c if is_blank(c) => parts.push(DatePart::Blank),
            c => parts.push(DatePart::Literal(c)),
        }
    }
    Ok(with_optional_fraction(parts))
}

fn add(parts: &mut Vec<DatePart>, conversion: char, has_mark: bool) -> Result<(), String> {
    let number = DatePart::Number;
    let colon = DatePart::Literal(':');
    let clock = [number(Field::Hour), colon, number(Field::Minute)];
    match conversion {
        'Y' => parts.push(number(Field::Year)),
        'y' => parts.push(number(Field::ShortYear)),
        'm' => parts.push(number(Field::Month)),
        'd' | 'e' => parts.push(number(Field::Day)),
        'j' => parts.push(number(Field::DayOfYear)),
        'b' | 'B' | 'h' => parts.push(DatePart::MonthName),
        'a' | 'A' => parts.push(DatePart::Weekday),
        'H' | 'k' => parts.push(number(Field::Hour)),
        'I' | 'l' => parts.push(number(Field::Hour12)),
        'M' => parts.push(number(Field::Minute)),
        'S' => parts.push(number(Field::Second)),
        'p' | 'P' => parts.push(DatePart::Meridiem),
        'z' => parts.push(DatePart::Offset),
        'f' | 'N' if has_mark => parts.push(DatePart::Fraction),
        'f' | 'N' => match parts.last() {
            // a point and its decimals are one part, since both may be absent
            Some(DatePart::Literal('.' | ',')) => {
                parts.pop();
                parts.push(DatePart::Fraction);
            }
            _ => parts.push(DatePart::Subsecond),
        },
        'T' => parts.extend(clock.into_iter().chain([colon, number(Field::Second)])),
        'R' => parts.extend(clock),
        'F' => {
            let dash = DatePart::Literal('-');
            parts.extend([number(Field::Year), dash, number(Field::Month), dash, number(Field::Day)]);
        }
        'n' | 't' => parts.push(DatePart::Blank),
        '%' => parts.push(DatePart::Literal('%')),
        'x' | 'X' | 'c' | 'r' | 'D' => {
            return Err(format!(
                "has %{conversion}, whose order of day and month depends on the country; write the order, as in %d/%m/%Y or \
                 %m/%d/%Y"
            ));
        }
        other => {
            return Err(format!(
                "has %{other}, which is not a conversion; the conversions are %Y %y %m %d %j %b %B %a %A %H \
                %I %M %S %f %p %z %F %T %R"
            ));
        }
    }
    Ok(())
}

/// Permits decimals after the seconds unless the format specifies them.
fn with_optional_fraction(parts: Vec<DatePart>) -> Vec<DatePart> {
    let mut with = Vec::with_capacity(parts.len() + 1);
    let mut rest = parts.into_iter().peekable();
    while let Some(part) = rest.next() {
        with.push(part);
        let says_more = matches!(
            rest.peek(),
            Some(DatePart::Fraction | DatePart::Subsecond | DatePart::Literal('.' | ','))
        );
        let is_sub_by_colon = matches!(rest.peek(), Some(DatePart::Literal(':')));
        if part == DatePart::Number(Field::Second) && !says_more && !is_sub_by_colon {
            with.push(DatePart::Fraction);
        }
    }
    with
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-01-05 08:47:00.020 UTC, ns from 1970.
    const MOMENT: i64 = ((20_458 * DAY) + 8 * HOUR + 47 * 60) * 1_000_000_000 + 20_000_000;

    fn read(format: &str, cell: &str) -> Option<i64> {
        MomentFormat::new(format).expect(format).moment(cell).map(|moment| moment.nanoseconds)
    }

    #[test]
    fn one_moment_in_the_spellings_of_spreadsheets_and_controllers() {
        for (format, cell) in [
            ("%m/%d/%Y %I:%M:%S.%f %p", "1/5/2026 8:47:00.020 AM"),
            ("%m/%d/%Y %I:%M:%S %p", "1/5/2026 8:47:00.020\u{202f}a.m."),
            ("%d/%m/%Y %H:%M:%S", "05/01/2026 08:47:00.02"),
            ("%d/%m/%Y %H:%M:%S", "5/1/2026 8:47:00,020"),
            ("%m-%d-%Y %H:%M:%S.%f", "01-05-2026 08:47:00.020"),
            ("%d-%b-%Y %H:%M:%S.%f", "05-Jan-2026 08:47:00.020"),
            ("%d. %B %Y %H:%M:%S", "5. Januar 2026 08:47:00,020"),
            ("%d %b %Y %H:%M:%S", "5 gen 2026 08:47:00,020"),
            ("%a %b %d %H:%M:%S %Y", "Mon Jan  5 08:47:00.020 2026"),
            ("%A, %d. %b %Y %T", "Montag, 05. Jan. 2026 08:47:00.02"),
            ("%Y-%m-%d %H:%M:%S:%f", "2026-1-5 08:47:00:020"),
            ("%Y-%m-%d %H:%M:%S:%f", "2026-01-05 8:47:00:20"),
            ("%d.%m.%y %H:%M:%S,%f", "05.01.26 08:47:00,020"),
            ("%Y%m%d%H%M%S.%f", "20260105084700.020"),
            ("%Y-%j %T", "2026-005 08:47:00.020"),
            ("%FT%T%z", "2026-01-05T09:47:00.02+01:00"),
            ("%FT%T%.f%z", "2026-01-05T06:17:00.02-0230"),
            ("%F %T %z", "2026-01-05 08:47:00.02 Z"),
        ] {
            assert_eq!(read(format, cell), Some(MOMENT), "{format}: {cell}");
        }
        assert_eq!(read("%d.%m.%Y %H:%M", "05.01.2026 08:47"), Some(MOMENT - 20_000_000));
        assert_eq!(read("%d/%m/%y", "05/01/26"), Some(20_458 * DAY * 1_000_000_000));
    }

    #[test]
    fn every_month_is_known_by_its_names() {
        let first = |month: i64| read("%Y-%m-%d", &format!("2026-{month}-1"));
        for (month, names) in names::MONTHS.iter().enumerate() {
            for name in names.iter() {
                let title: String =
                    name.chars().take(1).flat_map(char::to_uppercase).chain(name.chars().skip(1)).collect();
                for spelled in [(*name).to_owned(), name.to_uppercase(), title.clone(), format!("{title}.")] {
                    let cell = format!("01-{spelled}-2026");
                    assert_eq!(read("%d-%b-%Y", &cell), first(month as i64 + 1), "{cell}");
                }
            }
        }
    }

    #[test]
    fn times_alone_count_on_and_say_when_they_begin_anew() {
        let second = 1_000_000_000;
        for (format, cell, seconds, period) in [
            ("%H:%M:%S", "25:00:00.5", 90_000.5, 86_400.0),
            ("%H:%M:%S", "8:47:00", 31_620.0, 86_400.0),
            ("%I:%M:%S %p", "12:00:01 AM", 1.0, 86_400.0),
            ("%I:%M:%S %p", "12:00:01 pm", 43_201.0, 86_400.0),
            ("%M:%S.%f", "47:00.0", 2820.0, 3600.0),
            ("%S.%f", "59.25", 59.25, 60.0),
        ] {
            assert_eq!(read(format, cell), Some((seconds * f64::from(second)) as i64), "{cell}");
            assert_eq!(MomentFormat::new(format).expect(format).period_s(), Some(period), "{format}");
        }
        assert_eq!(MomentFormat::new("%F %T").expect("a format").period_s(), None);
    }

    #[test]
    fn what_does_not_fit_is_no_moment() {
        for (format, cell) in [
            ("%d/%m/%Y %T", "05/13/2026 08:47:00"),
            ("%d/%m/%Y %T", "30/02/2026 08:47:00"),
            ("%d/%m/%Y %T", "05/01/2026 24:00:00"),
            ("%d/%m/%Y %T", "05/01/2026 08:60:00"),
            ("%d/%m/%Y %T", "05/01/2026 08:47:00 x"),
            ("%d/%m/%Y %T", ""),
            ("%d/%b/%Y %T", "05/Foo/2026 08:47:00"),
            ("%I:%M:%S %p", "13:00:00 PM"),
            ("%T.%f", "08:47:00."),
            ("%Y-%j", "2026-366"),
            ("%F %T%z", "2026-01-05 08:47:00+99:00"),
            ("%F", "\u{e4}\u{e4}\u{e4}\u{e4}-01-05"),
        ] {
            assert_eq!(read(format, cell), None, "{format}: {cell}");
        }
    }

    #[test]
    fn formats_that_cannot_be_right_say_why() {
        for (format, said) in [
            ("%d/%m %T", "part of a date"),
            ("%Y %T", "part of a date"),
            ("%I:%M:%S", "are ambiguous"),
            ("%H:%M:%S %p", "are ambiguous"),
            ("%x %T", "depends on the country"),
            ("%D %T", "depends on the country"),
            ("%Q", "not a conversion"),
            ("%", "ends with a %"),
            ("", "neither"),
            ("YYYY", "neither"),
            ("%d/%d/%Y", "part of a date"),
            ("%m/%d/%d/%Y", "the day twice"),
        ] {
            assert!(MomentFormat::new(format).expect_err(format).contains(said), "{format}");
        }
    }

    #[test]
    fn elapsed_times_have_units() {
        let ms = 1_000_000;
        for (cell, expected) in [
            ("T#20ms", 20 * ms),
            ("t#1h2m3s4ms", (3_723_000 + 4) * ms),
            ("TIME#1d_2h", 93_600_000 * ms),
            ("LTIME#1s5us7ns", 1_000 * ms + 5_007),
            ("T#-1.5s", -1500 * ms),
            ("PT1H2M3.004S", 3_723_004 * ms),
            ("P1DT2H", 93_600_000 * ms),
            ("1h2m3s4ms", 3_723_004 * ms),
            ("0,02s", 20 * ms),
        ] {
            assert_eq!(duration(cell), Some(expected), "{cell}");
        }
        for cell in ["", "T#", "T#20", "D#2026-01-05", "20", "ms", "T#1x", "P", "1h2", "..s"] {
            assert_eq!(duration(cell), None, "{cell}");
        }
    }
}
