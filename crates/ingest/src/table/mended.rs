//! Repairs that make an export readable, with their places.

use std::collections::BTreeMap;

use super::clock::Turn;

/// A kind of deviation that is understood nevertheless.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mend {
    /// A row that repeats the one before in every cell is omitted.
    Repeated,
    /// NUL bytes after the last row are omitted.
    TrailingNuls,
    /// Times continue across a turn of the clock.
    Clock(Turn),
}

/// Places of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Places {
    /// Their number: rows, bytes or turns of the clock.
    pub count: u64,
    /// Line of the first in the decompressed file, from 1.
    pub first_line: u64,
}

/// A repair and its row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MendedRow {
    /// Kind of the repair.
    pub mend: Mend,
    /// Its line in the decompressed file, from 1.
    pub line: u64,
    /// How many in a row.
    pub count: u64,
    /// Time of the row, s.
    pub time: f64,
}

/// All repairs so far.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Mended(BTreeMap<Mend, Places>);

impl Mended {
    /// Notes `count` places from `line` on.
    pub(crate) fn note(&mut self, mend: Mend, count: u64, line: u64) {
        self.0.entry(mend).or_insert(Places { count: 0, first_line: line }).count += count;
    }

    /// Adds later ones.
    pub fn add(&mut self, later: &[MendedRow]) {
        later.iter().for_each(|of| self.note(of.mend, of.count, of.line));
    }

    /// The places of one kind.
    pub fn places(&self, mend: Mend) -> Option<Places> {
        self.0.get(&mend).copied()
    }

    /// Each kind as a sentence with its first line.
    pub fn sentences(&self) -> Vec<String> {
        self.0.iter().map(|(mend, places)| sentence(*mend, *places)).collect()
    }
}

fn sentence(mend: Mend, Places { count, first_line }: Places) -> String {
    let (noun, verb) = if count == 1 { ("row", "is") } else { ("rows", "are") };
    let again = if count == 1 { String::new() } else { format!(" ({count} times)") };
    match mend {
        Mend::Repeated => format!(
            "line {first_line}: the row repeats the previous one in every cell; {count} such {noun} {verb} skipped"
        ),
        Mend::TrailingNuls => {
            format!(
                "line {first_line}: {count} NUL bytes after the last row are skipped, a typical effect of a power cut"
            )
        }
        Mend::Clock(Turn::Anew) => {
            format!(
                "line {first_line}: the clock starts again from zero, as at midnight; times continue{again}"
            )
        }
        Mend::Clock(Turn::Restart) => {
            format!("line {first_line}: the time starts again, so another recording begins{again}")
        }
        Mend::Clock(Turn::Back) => format!(
            "line {first_line}: the clock is set back by one hour from one row to the next, as in autumn; times continue{again}"
        ),
        Mend::Clock(Turn::Forward) => format!(
            "line {first_line}: the clock is set forward by one hour from one row to the next, as in spring; times \
             continue{again}"
        ),
    }
}
