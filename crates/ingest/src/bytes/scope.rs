//! TwinCAT Scope exports as the text of a plain CSV file.
//!
//! Such an export has lines about the project, a line of names and further lines about the channels, and a column of
//! times before each group of channels. Rows are those of the fastest group. A slower channel, and one that was
//! recorded at other times, holds its last value.

use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Cursor, Read, Write};

use super::bag::cell;
use super::source::unreadable;

/// Bytes at the start of a file that identify such an export. One of its first lines contains a path.
pub(super) const HEAD_BYTES: u64 = 1024;

/// Name of the column of times, ms.
pub(crate) const TIME: &str = "scope_time_ms";

/// First cell of the line of names, and the name of each column of times.
const NAME: &str = "Name";

/// A line of the project that only such exports have.
const PROJECT: &str = "Starttime of export";

/// Most lines before the first row.
const MOST_LINES: usize = 200;

/// Longest line, bytes.
const LONGEST_LINE: u64 = 1 << 20;

/// Most bytes of values that wait for other channels.
const MOST_WAITING: usize = 128 << 20;

/// Bytes that a waiting row takes in addition to its cells.
const ROW_BYTES: usize = 64;

/// Times that differ by less than this fraction of a step are equal.
const EQUAL: f64 = 1e-6;

/// A channel holds its last value for this many of its steps.
const HELD_STEPS: f64 = 1.5;

const REMEDY: &str = "export again from TwinCAT Scope, with a time column";

/// Returns true if a text begins like such an export.
pub(super) fn is_scope(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
    let Some(sign) = head.get(NAME.len()).filter(|sign| b"\t;,".contains(sign)) else { return false };
    let begins = |line: &[u8], word: &str| {
        line.strip_prefix(word.as_bytes()).is_some_and(|rest| rest.first() == Some(sign))
    };
    let mut lines = head.split(|byte| *byte == b'\n');
    lines.next().is_some_and(|line| begins(line, NAME)) && lines.take(8).any(|line| begins(line, PROJECT))
}

/// A text unchanged, or the rows of a TwinCAT Scope export as CSV.
pub(super) fn plain(mut text: impl Read + Send + 'static) -> io::Result<Box<dyn Read + Send>> {
    let mut head = Vec::new();
    // the rows before the fault of a damaged stream are read first
    let failed = Failed((&mut text).take(HEAD_BYTES).read_to_end(&mut head).err());
    let is_scope = is_scope(&head);
    let whole = Cursor::new(head).chain(failed).chain(text);
    Ok(if is_scope { Box::new(ScopeText::new(whole)) } else { Box::new(whole) })
}

/// Returns an error once.
struct Failed(Option<io::Error>);

impl Read for Failed {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        self.0.take().map_or(Ok(0), Err)
    }
}

/// Channels with a column of times.
struct ChannelGroup {
    /// Column of the times.
    time: usize,
    /// Number of channels after it.
    channels: usize,
    /// Distance between the first two times, ms.
    step: f64,
    waiting: VecDeque<Sample>,
    /// The value that holds.
    held: Option<Sample>,
    /// Latest time that was read, ms.
    latest: f64,
    ended: bool,
}

struct Sample {
    time: f64,
    /// Time as written, and the cells of the channels, each with a comma before it.
    text: String,
    cells: String,
}

struct ScopeText<R> {
    file: BufReader<R>,
    sign: char,
    groups: Vec<ChannelGroup>,
    /// The group whose times the rows have.
    base: usize,
    /// Number of the line that was read last.
    line: usize,
    waiting_bytes: usize,
    is_begun: bool,
    ended: bool,
    text: VecDeque<u8>,
}

impl<R: Read> ScopeText<R> {
    fn new(file: R) -> Self {
        Self {
            file: BufReader::new(file),
            sign: '\t',
            groups: Vec::new(),
            base: 0,
            line: 0,
            waiting_bytes: 0,
            is_begun: false,
            ended: false,
            text: VecDeque::new(),
        }
    }

    /// The next line without its end; `None` after the last.
    fn next_line(&mut self) -> io::Result<Option<String>> {
        let mut bytes = Vec::new();
        (&mut self.file).take(LONGEST_LINE).read_until(b'\n', &mut bytes)?;
        self.line += 1;
        if bytes.len() as u64 == LONGEST_LINE && !bytes.ends_with(b"\n") {
            return Err(self.fault("is longer than 1 MiB"));
        }
        if bytes.is_empty() {
            return Ok(None);
        }
        let text = match String::from_utf8(bytes) {
            Ok(text) => text,
            Err(other) => encoding_rs::WINDOWS_1252.decode(other.as_bytes()).0.into_owned(),
        };
        Ok(Some(text.trim_end_matches(['\r', '\n']).to_owned()))
    }

    fn fault(&self, what: &str) -> io::Error {
        unreadable(format!("a TwinCAT Scope export whose line {} {what}", self.line), REMEDY)
    }

    /// Reads the lines above the rows, and the first two rows, whose times give the steps.
    fn begin(&mut self) -> io::Result<()> {
        self.is_begun = true;
        let first = self.next_line()?.unwrap_or_default();
        self.sign = first.trim_start_matches('\u{FEFF}').chars().nth(NAME.len()).unwrap_or('\t');
        let sign = self.sign;
        let names = loop {
            match self.next_line()? {
                Some(line) if line.split(sign).next() == Some(NAME) => break line,
                Some(_) if self.line < MOST_LINES => {}
                _ => return Err(self.fault("should be before a line of names, which begins with Name")),
            }
        };
        let names: Vec<&str> = names.split(sign).map(str::trim).collect();
        let mut units: Vec<String> = Vec::new();
        let row = loop {
            match self.next_line()? {
                Some(line) if self.is_row(&line) => break Some(line),
                Some(line) if self.line < MOST_LINES => {
                    if line.split(sign).next() == Some("Unit") {
                        units = line.split(sign).map(unit).collect();
                    }
                }
                None => break None,
                Some(_) => return Err(self.fault("should be a row of numbers")),
            }
        };
        self.text.extend(TIME.as_bytes());
        for (at, name) in names.iter().enumerate() {
            if *name == NAME {
                self.groups.push(ChannelGroup {
                    time: at,
                    channels: 0,
                    step: f64::INFINITY,
                    waiting: VecDeque::new(),
                    held: None,
                    latest: f64::NEG_INFINITY,
                    ended: false,
                });
            } else if let Some(group) = self.groups.last_mut().filter(|_| !name.is_empty()) {
                group.channels += 1;
                let unit = units.get(at).map_or("", String::as_str);
                let _ = write!(self.text, ",{}", cell(&format!("{name}{unit}")));
            }
        }
        self.text.push_back(b'\n');
        self.groups.retain(|group| group.channels > 0);
        if self.groups.is_empty() {
            return Err(unreadable("a TwinCAT Scope export without a channel".to_owned(), REMEDY));
        }
        let Some(row) = row else {
            self.ended = true;
            return Ok(());
        };
        self.take(&row)?;
        match self.next_line()? {
            Some(row) => self.take(&row)?,
            None => self.end(),
        }
        for group in &mut self.groups {
            let [first, second] = [0, 1].map(|at| group.waiting.get(at).map(|sample| sample.time));
            group.step = first.zip(second).map_or(f64::INFINITY, |(first, second)| second - first);
        }
        let steps = self.groups.iter().map(|group| group.step).enumerate();
        self.base = steps.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(at, _)| at);
        Ok(())
    }

    /// Returns true if a line begins with a number.
    fn is_row(&self, line: &str) -> bool {
        line.split(self.sign).next().is_some_and(|cell| self.number(cell).is_some())
    }

    fn number(&self, cell: &str) -> Option<f64> {
        self.point(cell.trim()).parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// A cell with a decimal point.
    fn point(&self, cell: &str) -> String {
        if self.sign == ',' { cell.to_owned() } else { cell.replace(',', ".") }
    }

    fn end(&mut self) {
        self.groups.iter_mut().for_each(|group| group.ended = true);
    }

    /// Stores the samples of a row.
    fn take(&mut self, row: &str) -> io::Result<()> {
        let cells: Vec<&str> = row.split(self.sign).collect();
        if cells.iter().all(|cell| cell.trim().is_empty()) {
            return Ok(());
        }
        for at in 0..self.groups.len() {
            let (column, channels) = (self.groups[at].time, self.groups[at].channels);
            let time = cells.get(column).map_or("", |cell| cell.trim());
            if time.is_empty() || time == "EOF" {
                self.groups[at].ended = true;
                continue;
            }
            if self.groups[at].ended {
                return Err(self.fault("has a time after the end of its channel"));
            }
            let Some(number) = self.number(time) else {
                return Err(self.fault(&format!("has \"{}\" instead of a time", time.escape_debug())));
            };
            if number < self.groups[at].latest {
                return Err(self.fault(&format!("has the time {number} ms after a later one")));
            }
            let mut text = String::new();
            for channel in 1..=channels {
                let cell = cells.get(column + channel).map_or("", |cell| cell.trim());
                text.push(',');
                text += &self.point(cell).replace(',', "_");
            }
            self.waiting_bytes += text.len() + ROW_BYTES;
            let sample = Sample { time: number, text: self.point(time), cells: text };
            let group = &mut self.groups[at];
            group.latest = number;
            group.waiting.push_back(sample);
        }
        if self.waiting_bytes > MOST_WAITING {
            let reason =
                "a TwinCAT Scope export whose channels differ so much in time that too many values wait";
            return Err(unreadable(reason.to_owned(), "export with one sample time for all channels"));
        }
        Ok(())
    }

    /// Gives the rows for whose time every channel was read.
    fn give(&mut self) {
        let close = |group: &ChannelGroup| if group.step.is_finite() { EQUAL * group.step } else { 0.0 };
        while let Some(row) = self.groups[self.base].waiting.front() {
            let time = row.time;
            if self.groups.iter().any(|group| !group.ended && group.latest + close(group) < time) {
                return;
            }
            let text = row.text.clone();
            for group in &mut self.groups {
                let until = time + close(group);
                while let Some(sample) = group.waiting.pop_front_if(|sample| sample.time <= until) {
                    self.waiting_bytes -= sample.cells.len() + ROW_BYTES;
                    group.held = Some(sample);
                }
            }
            let holds = |group: &ChannelGroup| {
                group
                    .held
                    .as_ref()
                    .filter(|held| !group.step.is_finite() || time - held.time <= HELD_STEPS * group.step)
                    .is_some()
            };
            // before the first value of a channel, and after its last, there is no whole row
            if self.groups.iter().all(holds) {
                self.text.extend(text.as_bytes());
                let cells = self.groups.iter().filter_map(|group| group.held.as_ref());
                cells.for_each(|held| self.text.extend(held.cells.as_bytes()));
                self.text.push_back(b'\n');
            }
        }
        // after the last row, the others return nothing
        if self.groups[self.base].ended {
            self.groups.iter_mut().for_each(|group| group.waiting.clear());
            self.waiting_bytes = 0;
        }
    }

    fn fill(&mut self) -> io::Result<()> {
        if !self.is_begun {
            self.begin()?;
        }
        while self.text.is_empty() && !self.ended {
            match self.next_line()? {
                Some(row) => self.take(&row)?,
                None => {
                    self.end();
                    self.ended = true;
                }
            }
            self.give();
        }
        Ok(())
    }
}

/// The unit of a channel as a part of its name, without the quantity in brackets.
fn unit(cell: &str) -> String {
    let unit = cell.split('(').next().unwrap_or_default().trim();
    if unit.is_empty() { String::new() } else { format!(" [{unit}]") }
}

impl<R: Read> Read for ScopeText<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.text.is_empty() {
            self.fill()?;
        }
        self.text.read(buffer)
    }
}
