//! Forms of times as text, from the cells of a column.

use super::section::{TomlKey, quoted};
use crate::table::cell;
use armwatch_config::{MomentFormat, TextTime, forms_of};

/// Most examined cells of a column.
pub(super) const MOST_CELLS: usize = 4096;

/// Forms that give a time for every cell of a column. If there are several, the cells do not distinguish day and month.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct TimeForms(Vec<TextTime>);

impl TimeForms {
    /// The forms of these cells, and their times in the first form, s from the first cell.
    pub(super) fn of(cells: &[String]) -> (Self, Option<Vec<f64>>) {
        let Some(first) = cells.first() else { return (Self::default(), None) };
        let formats = forms_of(first).into_iter().map(TextTime::Format);
        let times = |form: &TextTime| -> Option<Vec<f64>> {
            let origin = cell::clock_origin(first, form)?;
            let reading = |cell: &String| {
                Some(cell::text_time(cell, form)?.checked_sub(origin.nanoseconds)? as f64 * 1e-9)
            };
            let mut times = cells.iter().map(reading).collect::<Option<Vec<f64>>>()?;
            origin.go_on(&mut times, None);
            Some(times)
        };
        let candidates = [TextTime::Timestamp, TextTime::Duration].into_iter().chain(formats);
        let mut fitting = candidates.filter_map(|form| Some((times(&form)?, form))).peekable();
        // a form without a format string has one meaning
        if let Some((times, form)) = fitting.next_if(|(_, form)| !matches!(form, TextTime::Format(_))) {
            return (Self(vec![form]), Some(times));
        }
        let (times, forms): (Vec<_>, Vec<_>) = fitting.unzip();
        (Self(forms), times.into_iter().next())
    }

    /// Returns true if cells are times as text.
    pub(super) fn is_text(&self) -> bool {
        !self.0.is_empty()
    }

    /// The key of the layout that names the form.
    pub(super) fn key(&self) -> Option<TomlKey> {
        let format = |format: &MomentFormat| TomlKey::decided("format", quoted(format.text()));
        Some(match self.0.as_slice() {
            [] => return None,
            [TextTime::Timestamp, ..] => {
                TomlKey::decided("unit", quoted("timestamp")).because("its cells are dates and times")
            }
            [TextTime::Duration, ..] => {
                TomlKey::decided("unit", quoted("duration")).because("its cells are elapsed times with units")
            }
            [TextTime::Format(only)] => format(only).because("all of its cells have this form"),
            [TextTime::Format(first), others @ ..] => {
                let others = others.iter().filter_map(|form| match form {
                    TextTime::Format(format) => Some(quoted(format.text())),
                    _ => None,
                });
                let others: Vec<String> = others.collect();
                format(first)
                    .asked(&format!("which of its numbers is the day? {} would fit too", others.join(" or ")))
            }
        })
    }
}

/// The question about a column with the name of a time whose times do not rise because digits are lost.
pub(super) fn lost_digits(cells: &[String]) -> Option<String> {
    let first = cells.first()?;
    let is_scientific = first.contains(['E', 'e']) && first.parse::<f64>().is_ok();
    let repeats = || cells.windows(2).any(|pair| pair[0] == pair[1]);
    if !(is_scientific || repeats() && TimeForms::of(cells).0.is_text()) {
        return None;
    }
    Some(format!(
        "the last digits of this time are lost, since it is written as {first}: export it with all digits. If that is not \
         possible, how many rows are there per second?"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cells: &[&str]) -> (Option<TomlKey>, Option<Vec<f64>>) {
        let cells: Vec<String> = cells.iter().map(|cell| (*cell).to_owned()).collect();
        let (forms, times) = TimeForms::of(&cells);
        (forms.key(), times)
    }

    #[test]
    fn cells_name_the_form_or_leave_a_question() {
        for (cells, name, value, asked) in [
            (["2026-01-05 08:47:00.00", "2026-01-05 08:47:00.02"], "unit", "timestamp", false),
            (["T#0ms", "T#20ms"], "unit", "duration", false),
            (["1/5/2026 8:47:00.00 AM", "1/5/2026 8:47:00.02 AM"], "format", "%d/%m/%Y %I:%M:%S.%f %p", true),
            (
                ["1/15/2026 8:47:00.00 AM", "1/15/2026 8:47:00.02 AM"],
                "format",
                "%m/%d/%Y %I:%M:%S.%f %p",
                false,
            ),
            (["05-Jan-2026 08:47:00.00", "05-Jan-2026 08:47:00.02"], "format", "%d-%b-%Y %H:%M:%S.%f", false),
            (["8:47:00.00", "8:47:00.02"], "format", "%H:%M:%S.%f", false),
            (["08:47:00:000", "08:47:00:020"], "format", "%H:%M:%S:%f", false),
            (["59:59.99", "00:00.01"], "format", "%M:%S.%f", false),
        ] {
            let (key, times) = of(&cells);
            let key = key.expect(cells[0]);
            assert_eq!((key.name, key.value, key.question.is_some()), (name, quoted(value), asked));
            let times = times.expect("times");
            assert!((times[0], (times[1] - 0.02).abs() < 1e-9) == (0.0, true), "{times:?}");
        }
        assert_eq!(of(&["31/12/2026 8:47:00", "x"]), (None, None));
        // with several days, one decides
        let (key, _) = of(&["12/01/2026 23:59:59.99", "13/01/2026 00:00:00.01"]);
        assert_eq!(key.expect("a form").value, quoted("%d/%m/%Y %H:%M:%S.%f"));
    }
}
