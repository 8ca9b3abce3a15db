//! Report on a quarantined export, in words and as JSON.

use std::fmt::Write as _;
use std::path::PathBuf;

use jiff::Timestamp;
use serde::Serialize;
use serde_json::{Value, json};

use armwatch_ingest::excerpt::{Excerpt, excerpt};
use armwatch_model::text;
use armwatch_store::{Dismissal, FaultState, QuarantineRow};

/// Present state of a quarantined run's file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::cli) enum ExportState {
    /// The file is unchanged at this path.
    At(PathBuf),
    /// The file has another content now.
    Changed(PathBuf),
    /// The file is still unreadable.
    Unreadable(PathBuf, String),
    /// The file no longer exists at this path.
    Gone(PathBuf),
}

/// Lines shown before and after the faulty one.
const LINES_AROUND: u64 = 2;

/// Characters of a line that are shown: the width next to a line number on a usual terminal.
const SHOWN_CHARACTERS: usize = 88;

/// Characters shown before the cell if the line is cut.
const LEAD_CHARACTERS: usize = 40;

/// All data of a quarantined export.
pub struct FaultReport<'a> {
    latest: &'a QuarantineRow,
    earlier: &'a [QuarantineRow],
    place: &'a ExportState,
    excerpt: Option<Excerpt>,
}

impl<'a> FaultReport<'a> {
    /// The report on the faults of one run, the latest first; `None` if there are none. At most `most` decompressed
    /// bytes of the file are read.
    pub fn new(faults: &'a [QuarantineRow], place: &'a ExportState, most: u64) -> Option<Self> {
        let (latest, earlier) = faults.split_first()?;
        let excerpt = match (place, latest.line) {
            // lines of a changed file would be meaningless
            (ExportState::At(path), Some(line)) => {
                excerpt(path, line, latest.column.as_deref(), LINES_AROUND, most).ok().flatten()
            }
            _ => None,
        };
        Some(Self { latest, earlier, place, excerpt })
    }

    /// For people.
    pub fn as_text(&self) -> String {
        let fault = self.latest;
        let head = format!("run {}, robot {}, {}", fault.run_id, fault.robot, outcome(fault));
        let mut out = format!("{}\n", text::shown(&head));
        let mut line = |name: &str, value: &str| {
            // writing to a string cannot fail
            let _ = writeln!(out, "{name:<10} {}", text::shown(value));
        };
        line("file", &fault.source_path);
        line("since", &minute(fault.first_at));
        if fault.tries > 1 {
            line("tried", &format!("{} times, last {}", fault.tries, minute(fault.last_at)));
        }
        let places = [
            fault.line.map(|n| format!("line {n}")),
            fault.column.as_ref().map(|name| format!("column {name}")),
            fault.byte.map(|n| format!("byte {n}")),
        ];
        let places: Vec<String> = places.into_iter().flatten().collect();
        if !places.is_empty() {
            line("place", &places.join(", "));
        }
        if let Some(value) = &fault.value {
            line("value", &format!("\"{}\"", value.escape_debug()));
        }
        line("problem", &fault.problem);
        if !fault.remedy.is_empty() {
            line("remedy", &fault.remedy);
        }
        if fault.cycles_stored > 0 {
            line("stored", &format!("{} complete cycles before the fault", fault.cycles_stored));
        }
        for earlier in self.earlier {
            line("earlier", &format!("{}: {}", minute(earlier.last_at), one_line(earlier)));
        }
        line("retry", &what_retry_does(fault, self.place));
        if let Some(excerpt) = &self.excerpt {
            let _ = write!(out, "\n{}", drawn(excerpt));
        }
        out.trim_end().to_owned()
    }

    /// For scripts.
    pub fn as_json(&self) -> impl Serialize {
        StoryJson {
            fault: self.latest,
            retry: what_retry_does(self.latest, self.place),
            content: self.place.name(),
            excerpt: self.excerpt.as_ref().map(|excerpt| {
                json!({
                    "first_line": excerpt.first_line, "lines": excerpt.lines,
                    "cell": excerpt.cell.as_ref().map(|cell| json!({"begin": cell.start, "end": cell.end})),
                })
            }),
            earlier: self.earlier,
        }
    }
}

/// A fault and its export, as JSON.
#[derive(Serialize)]
struct StoryJson<'a> {
    #[serde(flatten)]
    fault: &'a QuarantineRow,
    retry: String,
    content: &'static str,
    excerpt: Option<Value>,
    earlier: &'a [QuarantineRow],
}

impl ExportState {
    fn name(&self) -> &'static str {
        match self {
            Self::At(_) => "unchanged",
            Self::Changed(_) => "changed",
            Self::Unreadable(..) => "unreadable",
            Self::Gone(_) => "gone",
        }
    }
}

/// A fault in one line, without file and remedy.
pub fn one_line(fault: &QuarantineRow) -> String {
    let line = fault.line.map(|n| format!("line {n}"));
    let column = fault.column.as_ref().map(|name| format!("column {name}"));
    let place = line.into_iter().chain(column).collect::<Vec<_>>().join(", ");
    let value = fault.value.as_ref().map(|v| format!("\"{}\" is ", v.escape_debug())).unwrap_or_default();
    let separator = if place.is_empty() { "" } else { ": " };
    format!("{place}{separator}{value}{}", fault.problem)
}

/// State of a fault in words.
pub fn outcome(fault: &QuarantineRow) -> String {
    match fault.state {
        FaultState::Open | FaultState::Earlier => "quarantined".to_owned(),
        FaultState::Dismissed => match &fault.dismissal {
            Some(Dismissal { at, by, reason }) => format!("dismissed {} by {by}: {reason}", minute(*at)),
            None => "dismissed".to_owned(),
        },
        FaultState::Reading => "being read again".to_owned(),
        FaultState::Stored => "stored meanwhile".to_owned(),
        FaultState::Superseded => match fault.superseded_by_run_id {
            Some(other) => format!("superseded by run {other}"),
            None => "superseded".to_owned(),
        },
    }
}

/// Expected result of another attempt.
pub fn what_retry_does(fault: &QuarantineRow, place: &ExportState) -> String {
    if !matches!(fault.state, FaultState::Open | FaultState::Dismissed | FaultState::Earlier) {
        return format!("nothing to do: {}", outcome(fault));
    }
    match place {
        ExportState::At(_) if fault.cycles_stored > 0 => format!(
            "reads it from its start as run {}; the {} stored cycles are replaced",
            fault.run_id, fault.cycles_stored
        ),
        ExportState::At(_) => format!("reads it as run {} again", fault.run_id),
        ExportState::Unreadable(at, error) => {
            format!("reads {} if it can be read by then; now: {error}", text::of_path(at))
        }
        ExportState::Changed(at) => format!(
            "impossible: {} now has other content, which is a separate run; the faulty bytes are gone",
            text::of_path(at)
        ),
        ExportState::Gone(at) => {
            format!("impossible: {} no longer exists; export it again", text::of_path(at))
        }
    }
}

/// A time to the minute.
pub fn minute(at: Timestamp) -> String {
    at.strftime("%Y-%m-%d %H:%MZ").to_string()
}

/// The lines with their numbers and a mark under the place.
fn drawn(excerpt: &Excerpt) -> String {
    let last = excerpt.first_line + excerpt.lines.len() as u64;
    let width = last.to_string().len();
    let from = excerpt.cell.as_ref().map_or(0, |cell| window_start(cell.end, cell.start));
    let mut out = String::new();
    for (at, line) in excerpt.lines.iter().enumerate() {
        let number = excerpt.first_line + at as u64;
        let _ = writeln!(out, "{number:>width$} | {}", window(line, from));
        if at == excerpt.place {
            let cell = excerpt.cell.clone().unwrap_or(0..line.chars().count());
            let before = cell.start - from + usize::from(from > 0) * 2;
            let carets = (cell.end - cell.start).clamp(1, SHOWN_CHARACTERS);
            let _ = writeln!(out, "{:>width$} | {}{}", "", " ".repeat(before), "^".repeat(carets));
        }
    }
    out.trim_end_matches('\n').to_owned()
}

/// Index of the first character shown, chosen so that the cell is visible.
fn window_start(cell_end: usize, cell_start: usize) -> usize {
    if cell_end <= SHOWN_CHARACTERS { 0 } else { cell_start.saturating_sub(LEAD_CHARACTERS) }
}

/// Part of a line, with dots at a cut; a control character is shown as a sign, so that the mark stays below its cell
/// and the terminal does not interpret it.
fn window(line: &str, from: usize) -> String {
    let dots = |cut: bool| if cut { ".." } else { "" };
    let shown: String = line
        .chars()
        .skip(from)
        .take(SHOWN_CHARACTERS)
        .map(|c| if text::is_hidden(c) { '\u{fffd}' } else { c })
        .collect();
    let rest = line.chars().count() > from + SHOWN_CHARACTERS;
    format!("{}{shown}{}", dots(from > 0), dots(rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mark_stands_under_its_cell_also_in_a_long_line() {
        let long = format!("{}abc,{}", "0.125,".repeat(40), "7".repeat(200));
        for (line, cell) in [("0,x\u{7}é,2".to_owned(), 2..5), (long, 240..243)] {
            let text: String = line.chars().skip(cell.start).take(cell.len()).collect();
            let excerpt = Excerpt {
                byte: 0,
                first_line: 9,
                lines: vec!["0,1".into(), line],
                place: 1,
                cell: Some(cell),
            };
            let drawn = drawn(&excerpt);
            let lines: Vec<Vec<char>> = drawn.lines().map(|line| line.chars().collect()).collect();
            let carets: Vec<usize> = (0..lines[2].len()).filter(|at| lines[2][*at] == '^').collect();
            let marked: String = carets.iter().map(|at| lines[1][*at]).collect();
            assert_eq!(marked, text.replace('\u{7}', "\u{fffd}"), "{drawn}");
            assert!(lines[1].len() < 100);
        }
    }
}
