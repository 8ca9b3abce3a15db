//! The possible formats of a cell.

use super::names::{meridiem, month_of};
use super::{MomentFormat, is_blank};

/// A piece of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Piece<'c> {
    Digits(&'c str),
    Word(&'c str),
    Sign(char),
}

/// Conversions of the numbers of a date, by their possible numbers of digits.
const DATE_ORDERS: [&[&str]; 5] =
    [&["%d", "%m", "%Y"], &["%m", "%d", "%Y"], &["%Y", "%m", "%d"], &["%d", "%m", "%y"], &["%m", "%d", "%y"]];

/// If the year has two digits and points separate the numbers, the day is first or last.
const SHORT_DATE_ORDERS: [&[&str]; 2] = [&["%d", "%m", "%y"], &["%y", "%m", "%d"]];

/// Orders with the name of a month.
const NAMED_ORDERS: [&[&str]; 3] = [&["%d", "%Y"], &["%d", "%y"], &["%Y", "%d"]];

/// The formats that give a time for a cell with a time of day. If there are several, the cell does not show the
/// position of the day.
pub fn forms_of(cell: &str) -> Vec<MomentFormat> {
    let cell = cell.trim_matches(is_blank);
    let pieces = pieces(cell);
    let Some(clock) = TimeOfDay::find(&pieces) else { return Vec::new() };
    let format = |orders: &[&str]| clock.format(&pieces, orders);
    let has_name = pieces.iter().any(|piece| matches!(piece, Piece::Word(word) if month_of(word).is_some()));
    let dates = clock.numbers_of_date(&pieces);
    let has_points = pieces.windows(2).any(|pair| matches!(pair, [Piece::Digits(_), Piece::Sign('.')]))
        && !pieces.iter().any(|piece| matches!(piece, Piece::Sign('/' | '-')));
    let orders: Vec<&[&str]> = match (has_name, dates) {
        (false, 0) => vec![&[]],
        (false, 1) => vec![&["%Y%m%d"]],
        (true, 2) => NAMED_ORDERS.to_vec(),
        // a point between numbers is used in countries that begin with the day
        (false, 3) if has_points => {
            vec![DATE_ORDERS[0], DATE_ORDERS[2], SHORT_DATE_ORDERS[0], SHORT_DATE_ORDERS[1]]
        }
        (false, 3) => DATE_ORDERS.into_iter().chain([SHORT_DATE_ORDERS[1]]).collect(),
        _ => Vec::new(),
    };
    let mut found: Vec<MomentFormat> = Vec::new();
    for format in orders.into_iter().filter_map(format) {
        let fits = format.moment(cell).is_some() && !found.contains(&format);
        if fits {
            found.push(format);
        }
    }
    // a four-digit year excludes two-digit years
    if found.iter().any(|format| format.text().contains("%Y")) {
        found.retain(|format| !format.text().contains("%y"));
    }
    found
}

/// Formats in a sentence: `"%d/%m/%Y" or "%m/%d/%Y"`.
pub fn joined_forms(forms: &[MomentFormat]) -> String {
    let quoted: Vec<String> = forms.iter().map(|format| format!("{:?}", format.text())).collect();
    quoted.join(" or ")
}

fn pieces(cell: &str) -> Vec<Piece<'_>> {
    let mut pieces = Vec::new();
    let mut rest = cell;
    while let Some(first) = rest.chars().next() {
        let kind = |c: char| (c.is_ascii_digit(), c.is_alphabetic());
        let end = match kind(first) {
            (false, false) => first.len_utf8(),
            of => rest.find(|c| kind(c) != of).unwrap_or(rest.len()),
        };
        let (piece, after) = rest.split_at(end);
        pieces.push(match kind(first) {
            (true, _) => Piece::Digits(piece),
            (_, true) => Piece::Word(piece),
            _ => Piece::Sign(first),
        });
        rest = after;
    }
    pieces
}

/// Position of the time of day among the pieces of a cell.
struct TimeOfDay {
    /// Its first and last piece; every other one is a number.
    first: usize,
    last: usize,
    /// Conversions of the numbers.
    conversions: Vec<&'static str>,
    /// Piece with AM or PM.
    meridiem: Option<usize>,
    /// First piece of the offset from UTC.
    offset: Option<usize>,
}

impl TimeOfDay {
    fn find(pieces: &[Piece<'_>]) -> Option<Self> {
        let is_number = |at: usize| matches!(pieces.get(at), Some(Piece::Digits(_)));
        let sign = |at: usize| match pieces.get(at) {
            Some(Piece::Sign(sign)) => Some(*sign),
            _ => None,
        };
        let first =
            (0..pieces.len()).find(|at| is_number(*at) && sign(at + 1) == Some(':') && is_number(at + 2))?;
        let mut last = first + 2;
        while sign(last + 1) == Some(':') && is_number(last + 2) {
            last += 2;
        }
        let has_fraction = matches!(sign(last + 1), Some('.' | ',')) && is_number(last + 2);
        let mut conversions = match ((last - first) / 2, has_fraction) {
            (1, true) => vec!["%M", "%S"],
            (1, false) => vec!["%H", "%M"],
            (2, _) => vec!["%H", "%M", "%S"],
            (3, false) => vec!["%H", "%M", "%S", "%f"],
            _ => return None,
        };
        if has_fraction {
            conversions.push("%f");
            last += 2;
        }
        let after = || (last + 1)..pieces.len();
        // a.m. is two words, a point between them
        let is_meridiem = |at: &usize| match pieces.get(*at) {
            Some(Piece::Word(word)) => meridiem(word).is_some_and(|(_, rest)| rest.is_empty()),
            _ => false,
        };
        let spelled = |at: &usize| {
            matches!(
                pieces.get(*at..*at + 3),
                Some([Piece::Word("a" | "A" | "p" | "P"), Piece::Sign('.'), Piece::Word("m" | "M")])
            )
        };
        let meridiem = after().find(|at| is_meridiem(at) || spelled(at));
        if meridiem.is_some() && conversions[0] == "%H" {
            conversions[0] = "%I";
        }
        let starts_offset = |at: &usize| {
            matches!(pieces.get(*at), Some(Piece::Word("Z" | "z")))
                || (matches!(sign(*at), Some('+' | '-')) && is_number(at + 1) && first > 0)
        };
        let offset = after().find(starts_offset);
        Some(Self { first, last, conversions, meridiem, offset })
    }

    /// Returns true if a piece belongs to the time of day.
    fn has(&self, at: usize) -> bool {
        (self.first..=self.last).contains(&at) || self.offset.is_some_and(|offset| at >= offset)
    }

    fn numbers_of_date(&self, pieces: &[Piece<'_>]) -> usize {
        let of_date = |(at, piece): &(usize, &Piece<'_>)| matches!(piece, Piece::Digits(_)) && !self.has(*at);
        pieces.iter().enumerate().filter(of_date).count()
    }

    /// The cell as a format; the numbers of the date have these conversions.
    fn format(&self, pieces: &[Piece<'_>], date: &[&str]) -> Option<MomentFormat> {
        let mut text = String::new();
        let mut date = date.iter();
        let mut numbers = self.conversions.iter();
        let mut skipped_until = 0;
        for (at, piece) in pieces.iter().enumerate() {
            if at < skipped_until {
                continue;
            }
            if self.offset == Some(at) {
                text.push_str("%z");
                break;
            }
            match piece {
                Piece::Digits(_) if (self.first..=self.last).contains(&at) => text.push_str(numbers.next()?),
                Piece::Digits(digits) => {
                    let conversion = date.next()?;
                    let width = digits.len();
                    let fits = match *conversion {
                        "%Y" => width == 4,
                        "%Y%m%d" => width == 8,
                        "%y" => width == 2,
                        _ => width <= 2,
                    };
                    text.push_str(fits.then_some(conversion)?);
                }
                Piece::Word(_) if self.meridiem == Some(at) => {
                    text.push_str("%p");
                    // a.m. is two words with two points
                    skipped_until = match pieces.get(at + 1..at + 3) {
                        Some([Piece::Sign('.'), Piece::Word(_)]) => at + 4,
                        _ => at + 1,
                    };
                }
                Piece::Word(word) if month_of(word).is_some() && !text.contains("%b") => {
                    text.push_str("%b");
                    // the point of an abbreviation belongs to the name
                    skipped_until =
                        if pieces.get(at + 1) == Some(&Piece::Sign('.')) { at + 2 } else { at + 1 };
                }
                Piece::Word("T" | "t") => text.push('T'),
                Piece::Word(_) if at == 0 => {
                    text.push_str("%a");
                    skipped_until = if pieces.get(1) == Some(&Piece::Sign('.')) { 2 } else { 1 };
                }
                Piece::Word(_) => return None,
                Piece::Sign('%') => return None,
                Piece::Sign(sign) if is_blank(*sign) => {
                    if !text.ends_with(' ') {
                        text.push(' ');
                    }
                }
                Piece::Sign(sign) => text.push(*sign),
            }
        }
        MomentFormat::new(&text).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_names_its_forms() {
        for (cell, expected) in [
            ("1/5/2026 8:47:00.000 AM", vec!["%d/%m/%Y %I:%M:%S.%f %p", "%m/%d/%Y %I:%M:%S.%f %p"]),
            ("1/15/2026 8:47:00 p.m.", vec!["%m/%d/%Y %I:%M:%S %p"]),
            ("05/01/2026 08:47:00.020", vec!["%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f"]),
            ("05-01-2026 08:47:00,020", vec!["%d-%m-%Y %H:%M:%S,%f", "%m-%d-%Y %H:%M:%S,%f"]),
            ("15-01-2026 08:47:00", vec!["%d-%m-%Y %H:%M:%S"]),
            ("05-Jan-2026 08:47:00.020", vec!["%d-%b-%Y %H:%M:%S.%f"]),
            ("5. M\u{e4}rz 2026 08:47:00", vec!["%d. %b %Y %H:%M:%S"]),
            ("Mon Jan  5 08:47:00 2026", vec!["%a %b %d %H:%M:%S %Y"]),
            ("2026-1-5 08:47:00:000", vec!["%Y-%m-%d %H:%M:%S:%f"]),
            ("2026-1-5T8:47:00+01:00", vec!["%Y-%m-%dT%H:%M:%S%z"]),
            ("8:47:00.020", vec!["%H:%M:%S.%f"]),
            ("08:47:00:000", vec!["%H:%M:%S:%f"]),
            ("47:00.0", vec!["%M:%S.%f"]),
            ("25:00:00", vec!["%H:%M:%S"]),
            ("05.01.26 08:47:00", vec!["%d.%m.%y %H:%M:%S", "%y.%m.%d %H:%M:%S"]),
            ("5.1.2026 08:47:00,02", vec!["%d.%m.%Y %H:%M:%S,%f"]),
            ("20260105 08:47:00", vec!["%Y%m%d %H:%M:%S"]),
            ("hello", vec![]),
            ("1.5", vec![]),
            ("05/01/2026", vec![]),
            ("", vec![]),
            ("1:2:3:4:5", vec![]),
            ("99/99/2026 08:47:00", vec![]),
        ] {
            let found: Vec<String> = forms_of(cell).iter().map(|format| format.text().to_owned()).collect();
            assert_eq!(found, expected, "{cell}");
        }
    }
}
