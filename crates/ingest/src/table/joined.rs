//! Joins the text of a recording in several files: rows one after another, or side by side.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use super::cell;
use super::fields::fields;
use super::preamble::{self, Header};
use super::reader::{ExportReader, ReadOptions};
use crate::bytes::blocks::{BLOCK_BYTES, Blocks, Next};
use crate::bytes::fingerprint::RunningHash;
use crate::bytes::parts::RecordingParts;
use crate::bytes::source::{self, unreadable};
use crate::rejection::Rejection;
use armwatch_config::{Column, Layout, PartMatch, TextEncoding};
use armwatch_model::robot::Robot;
use armwatch_model::text::of_file_name;

/// Rows at the end that one part may lack, as a share of its rows and at least one: writers do not stop at the same
/// time.
const LACKING: f64 = 0.01;

type Bytes = Box<dyn Read + Send>;

impl ExportReader<Bytes> {
    /// Opens `path`, a file or the parts that the path names, with at most `most` bytes after decompression each. Also
    /// returns the running hash of its bytes.
    ///
    /// # Errors
    /// Those of [`ExportReader::new`], and a rejection of a file that cannot be opened and of a missing part.
    pub fn open(
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
        most: u64,
    ) -> Result<(Self, RunningHash), Rejection> {
        let (bytes, hash, layout) = open(path, layout, most)?;
        Ok((Self::new(bytes, path, &layout, robot, options)?, hash))
    }
}

/// The text of `path`, the hash of its bytes, and the layout of the text.
pub(super) fn open<'l>(
    path: &Path,
    layout: &'l Layout,
    most: u64,
) -> Result<(Bytes, RunningHash, Cow<'l, Layout>), Rejection> {
    let Some(parts) = RecordingParts::of(path) else {
        let (bytes, hash) = source::open_hashing_up_to(path, most)?;
        return Ok((bytes, hash, Cow::Borrowed(layout)));
    };
    if let Some(missing) = parts.missing() {
        return Err(missing_part(path, &missing));
    }
    let matching = layout.parts.as_ref().map_or(PartMatch::After, |rule| rule.matching);
    let mut files: VecDeque<(String, PathBuf)> = parts.files().into();
    // the lines before the rows are read here and replaced by blank lines, so that lines keep their numbers
    let mut text = layout.text.clone();
    (text.skip_lines, text.skip_after_header, text.encoding) = (0, 0, TextEncoding::Utf8);
    let of_joined = Cow::Owned(Layout { text, ..layout.clone() });
    let Some((_, first)) = files.pop_front() else {
        return Err(Rejection::of_file(path, "a recording without parts", "export again"));
    };
    let (first, hash) = OpenedPart::open(&first, layout, most)?;
    let bytes: Bytes = match matching {
        PartMatch::After => Box::new(Following::new(first, files, hash.clone(), layout.clone(), most)),
        PartMatch::Row | PartMatch::Time => {
            let mut all = vec![first];
            for (name, file) in files {
                let (mut part, of_part) = OpenedPart::open(&file, layout, most)?;
                hash.follow_with(&of_part);
                part.name = name;
                all.push(part);
            }
            Box::new(SideBySide::new(all, matching, layout, path)?)
        }
    };
    Ok((bytes, hash, of_joined))
}

/// Why a recording cannot be read without one of its parts.
pub fn missing_part(path: &Path, missing: &Path) -> Rejection {
    let name = of_file_name(missing);
    let remedy = "put it next to the others, or correct [parts] of the layout";
    Rejection::of_file(path, format!("a recording without its part {name}"), remedy)
}

/// A part whose header was read.
struct OpenedPart {
    name: String,
    path: PathBuf,
    header: Header,
    blocks: Blocks<Bytes>,
    /// Whole lines; those before `at` are already read.
    block: Vec<u8>,
    at: usize,
    /// The last line has no line end.
    is_open: bool,
    rows: u64,
}

impl OpenedPart {
    fn open(path: &Path, layout: &Layout, most: u64) -> Result<(Self, RunningHash), Rejection> {
        let (bytes, hash) = source::open_hashing_up_to(path, most)?;
        let mut blocks = Blocks::new(bytes, BLOCK_BYTES, layout.text.encoding);
        let header = preamble::read(&mut blocks, layout, path)?;
        let header = header.ok_or_else(|| Rejection::of_file(path, "an empty part", "export again"))?;
        let part = Self {
            name: String::new(),
            path: path.to_owned(),
            header,
            blocks,
            block: Vec::new(),
            at: 0,
            is_open: false,
            rows: 0,
        };
        Ok((part, hash))
    }

    /// Reads more lines; `false` at the end.
    fn fill(&mut self) -> io::Result<bool> {
        let next = self.blocks.next_block(&self.path).map_err(|rejection| {
            let name = of_file_name(&self.path);
            let place = rejection.line.map_or_else(String::new, |line| format!("line {line}: "));
            unreadable(format!("part {name}: {place}{}", rejection.reason), &rejection.remedy)
        })?;
        // a part does not grow
        let Next::Block(block) = next else { return Ok(false) };
        self.is_open = block.unterminated;
        self.blocks.give_back(std::mem::replace(&mut self.block, block.bytes));
        self.at = 0;
        Ok(true)
    }

    /// The next line without its end.
    fn line(&mut self) -> io::Result<Option<&[u8]>> {
        while self.at >= self.block.len() {
            if !self.fill()? {
                return Ok(None);
            }
        }
        let rest = &self.block[self.at..];
        let end = rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
        self.at += end + 1;
        self.rows += 1;
        Ok(Some(rest[..end].strip_suffix(b"\r").unwrap_or(&rest[..end])))
    }
}

/// The header, with blank lines instead of the lines above it and between header and rows.
fn head(header: &str, line: u64, layout: &Layout) -> Vec<u8> {
    let above = usize::try_from(line.saturating_sub(1)).unwrap_or(0).min(100_000);
    let mut text = vec![b'\n'; above];
    if layout.header {
        text.splice(0..0, vec![b'\n'; layout.text.skip_after_header]);
        text.extend(header.as_bytes());
        text.push(b'\n');
    }
    text
}

/// Parts one after another. The header of later parts is omitted; without a header, a part continues exactly at the end
/// of the one before, even within a line.
struct Following {
    header: String,
    current: Option<OpenedPart>,
    files: VecDeque<(String, PathBuf)>,
    hash: RunningHash,
    layout: Layout,
    most: u64,
    output: Vec<u8>,
    given: usize,
}

impl Following {
    fn new(
        first: OpenedPart,
        files: VecDeque<(String, PathBuf)>,
        hash: RunningHash,
        layout: Layout,
        most: u64,
    ) -> Self {
        let output = head(&first.header.text, first.header.line, &layout);
        Self {
            header: first.header.text.clone(),
            current: Some(first),
            files,
            hash,
            layout,
            most,
            output,
            given: 0,
        }
    }

    /// Puts the next bytes into the output; none at the end.
    fn refill(&mut self) -> io::Result<()> {
        self.given = 0;
        self.output.clear();
        while let Some(part) = &mut self.current {
            if part.fill()? {
                self.output.append(&mut part.block);
                if part.is_open {
                    // a block ends with a line end that the file does not have
                    self.output.pop();
                }
                return Ok(());
            }
            let is_open = part.is_open;
            self.current = None;
            let Some((_, file)) = self.files.pop_front() else { return Ok(()) };
            let opened = OpenedPart::open(&file, &self.layout, self.most);
            let (next, hash) = opened.map_err(|rejection| {
                let name = of_file_name(&file);
                unreadable(format!("part {name}: {}", rejection.reason), &rejection.remedy)
            })?;
            self.hash.follow_with(&hash);
            let has_header = !self.layout.header || next.header.text == self.header;
            if has_header && is_open && self.layout.header {
                self.output.push(b'\n');
            }
            if !has_header {
                self.output.extend(next.header.text.as_bytes());
                self.output.push(b'\n');
            }
            self.current = Some(next);
            if !self.output.is_empty() {
                return Ok(());
            }
        }
        Ok(())
    }
}

impl Read for Following {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.given >= self.output.len() {
            self.refill()?;
        }
        Ok(give(&self.output, &mut self.given, buffer))
    }
}

fn give(output: &[u8], given: &mut usize, buffer: &mut [u8]) -> usize {
    let rest = output.get(*given..).unwrap_or_default();
    let count = rest.len().min(buffer.len());
    buffer[..count].copy_from_slice(&rest[..count]);
    *given += count;
    count
}

/// A part in a side-by-side recording.
struct SidePart {
    part: OpenedPart,
    /// Index of its time column, if rows match by time.
    time: Option<usize>,
    /// Cells for a row that it does not have.
    empty: Vec<u8>,
    /// The next row with its time.
    next: Option<(f64, Vec<u8>)>,
}

/// Parts side by side.
struct SideBySide {
    columns: Vec<SidePart>,
    layout: Layout,
    /// Time of the row before and step to it, if rows match by time.
    before: Option<(f64, f64)>,
    /// All parts have started.
    has_begun: bool,
    is_done: bool,
    output: Vec<u8>,
    given: usize,
}

impl SideBySide {
    fn new(
        parts: Vec<OpenedPart>,
        matching: PartMatch,
        layout: &Layout,
        path: &Path,
    ) -> Result<Self, Rejection> {
        let mut names: Vec<String> = Vec::new();
        let mut columns = Vec::new();
        let mut line = 1;
        for part in parts {
            let own: Vec<String> = fields(&part.header.text, layout.delimiter).map(str::to_owned).collect();
            let time = match layout.time.column().filter(|_| matching == PartMatch::Time) {
                Some(Column::Number(number)) => number.checked_sub(1).filter(|at| *at < own.len()),
                Some(Column::Name(name)) if layout.header => own.iter().position(|field| field == name),
                Some(Column::Name(number)) => {
                    number.parse::<usize>().ok().and_then(|number| number.checked_sub(1))
                }
                None => None,
            };
            if matching == PartMatch::Time && time.is_none() {
                let file = of_file_name(&part.path);
                let remedy = "match rows by number: match = \"row\" under [parts]";
                return Err(Rejection::of_file(path, format!("part {file} has no column of time"), remedy));
            }
            if columns.is_empty() {
                line = part.header.line;
            }
            let empty = vec![layout.delimiter; own.len().saturating_sub(1)];
            let unique = own.into_iter().map(|field| match names.contains(&field) && !field.is_empty() {
                true => format!("{}/{field}", part.name),
                false => field,
            });
            let unique: Vec<String> = unique.collect();
            names.extend(unique);
            columns.push(SidePart { part, time, empty, next: None });
        }
        let delimiter = char::from(layout.delimiter).to_string();
        let output = head(
            &names.iter().map(|name| quoted(name, &delimiter)).collect::<Vec<_>>().join(&delimiter),
            line,
            layout,
        );
        let layout = layout.clone();
        Ok(Self { columns, layout, before: None, has_begun: false, is_done: false, output, given: 0 })
    }

    /// The next row of parts whose rows match by number.
    fn row_by_number(&mut self) -> io::Result<()> {
        let delimiter = self.layout.delimiter;
        let (mut ended, mut going) = (None, false);
        for (at, column) in self.columns.iter_mut().enumerate() {
            match column.part.line()? {
                Some(line) => {
                    if at > 0 {
                        self.output.push(delimiter);
                    }
                    self.output.extend_from_slice(line);
                    going = true;
                }
                None => ended = ended.or(Some(at)),
            }
        }
        let Some(ended) = ended else {
            self.output.push(b'\n');
            return Ok(());
        };
        self.output.clear();
        self.is_done = true;
        if going { self.refuse_lack(ended) } else { Ok(()) }
    }

    /// Refuses a part that ends long before another.
    fn refuse_lack(&mut self, ended: usize) -> io::Result<()> {
        let rows = self.columns[ended].part.rows;
        let most = ((rows as f64 * LACKING) as u64).max(1);
        for at in 0..self.columns.len() {
            let mut lacking = self.columns[at].part.rows.saturating_sub(rows);
            while lacking <= most && self.columns[at].part.line()?.is_some() {
                lacking += 1;
            }
            if lacking > most {
                let name = |at: usize| of_file_name(&self.columns[at].part.path);
                return Err(unreadable(
                    format!("part {} ends after {rows} rows, part {} has more", name(ended), name(at)),
                    "export all parts whole, or match rows by time: match = \"time\" under [parts]",
                ));
            }
        }
        Ok(())
    }

    /// The next row of parts whose rows match by time.
    fn row_by_time(&mut self) -> io::Result<()> {
        let (delimiter, layout) = (self.layout.delimiter, &self.layout);
        let Some((first, others)) = self.columns.split_first_mut() else { return Ok(()) };
        let Some((time, row)) = first.take(layout)? else {
            self.is_done = true;
            return Ok(());
        };
        // half a step on either side; the first row has no step yet, and only the same time matches
        let half = self.before.map_or(0.0, |(before, _)| 0.5 * (time - before));
        self.before = Some((time, half));
        let start = self.output.len();
        self.output.extend_from_slice(&row);
        let mut is_whole = true;
        for column in others {
            self.output.push(delimiter);
            let mut found = None;
            while column.peek(layout)?.is_some_and(|of| of <= time + half) {
                let Some((of, row)) = column.take(layout)? else { break };
                if of >= time - half {
                    found = Some(row);
                }
            }
            is_whole &= found.is_some();
            match found {
                Some(row) => self.output.extend_from_slice(&row),
                None => self.output.extend_from_slice(&column.empty),
            }
            self.is_done |= column.peek(layout)?.is_none() && !is_whole;
        }
        self.output.push(b'\n');
        self.has_begun |= is_whole;
        if !self.has_begun || self.is_done {
            self.output.truncate(start);
        }
        Ok(())
    }
}

impl SidePart {
    /// Time of the next row.
    fn peek(&mut self, layout: &Layout) -> io::Result<Option<f64>> {
        if self.next.is_none() {
            self.next = self.read(layout)?;
        }
        Ok(self.next.as_ref().map(|(time, _)| *time))
    }

    fn take(&mut self, layout: &Layout) -> io::Result<Option<(f64, Vec<u8>)>> {
        match self.next.take() {
            None => self.read(layout),
            next => Ok(next),
        }
    }

    fn read(&mut self, layout: &Layout) -> io::Result<Option<(f64, Vec<u8>)>> {
        let place = self.time.unwrap_or(0);
        let path = self.part.path.clone();
        let Some(line) = self.part.line()?.map(<[u8]>::to_vec) else { return Ok(None) };
        let text = String::from_utf8_lossy(&line);
        let time = fields(&text, layout.delimiter).nth(place).unwrap_or_default();
        let number = cell::number(time, layout.text.decimal).map_err(|_| {
            let name = of_file_name(&path);
            unreadable(
                format!("part {name}, row {}: the time \"{time}\" is not a number", self.part.rows),
                "export again or correct the cell",
            )
        })?;
        Ok(Some((number, line)))
    }
}

impl Read for SideBySide {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.given >= self.output.len() && !self.is_done {
            self.given = 0;
            self.output.clear();
            match self.columns.first().is_some_and(|column| column.time.is_some()) {
                true => self.row_by_time()?,
                false => self.row_by_number()?,
            }
        }
        Ok(give(&self.output, &mut self.given, buffer))
    }
}

/// A field in the form of a line.
fn quoted(field: &str, delimiter: &str) -> String {
    let is_plain = !field.contains(delimiter) && !field.contains('"') && !field.contains(char::is_whitespace);
    if is_plain { field.to_owned() } else { format!("\"{}\"", field.replace('"', "\"\"")) }
}

#[cfg(test)]
mod tests;
