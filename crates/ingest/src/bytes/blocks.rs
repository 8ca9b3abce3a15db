//! Cuts an export into blocks of whole lines, with the line numbers for messages.

use std::io::{self, ErrorKind, Read};
use std::path::Path;

use super::encoding::{Found, TextReader, Wide, narrow_encoding, wide_encoding, without_bom};
use crate::rejection::Rejection;
use armwatch_config::TextEncoding;

/// Bytes read before a block is cut: few enough to keep text and columns in a core's cache and to let allocators reuse
/// the memory. A quarter to twice as many take the same time.
pub const BLOCK_BYTES: usize = 1 << 19;

/// Largest block: a larger setting would only reserve memory that no export needs.
const MAX_BLOCK_BYTES: usize = 256 << 20;

/// Most NUL bytes at the end of a file that are skipped: loggers do not preallocate more.
const MOST_TRAILING_NULS: u64 = 64 << 20;

/// Longest line. A row of a nine-axis arm with two hundred further columns has some five kilobytes; a file without line
/// ends must not let the buffer grow without bound.
const MAX_LINE_BYTES: usize = 1 << 20;

/// Consecutive whole lines, without the header. The last one is not blank.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// The lines; each ends with a line feed, even if the file's last one does not.
    pub bytes: Vec<u8>,
    /// Number of the first line in the decompressed file, from 1.
    pub first_line: u64,
    /// Offset of the first line in the decompressed file, bytes from 0.
    pub first_byte: u64,
    /// Encoding of these characters in the file.
    pub encoding: Found,
    /// True if the file ends without a line end after the last line, so that line may be cut.
    pub unterminated: bool,
}

/// A line before the rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Its text without byte order mark and line end; empty if it is blank.
    pub text: String,
    /// Its number in the decompressed file, from 1.
    pub number: u64,
    raw: Vec<u8>,
}

/// Next item of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Next {
    /// Whole lines.
    Block(Block),
    /// No whole line yet; the file may still grow.
    Later,
    /// The end.
    End,
}

/// Progress of skipping lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passed {
    /// There is more to skip.
    Going,
    /// The position is reached.
    There,
    /// The stream does not have this position.
    Elsewhere,
}

/// Cuts a stream into blocks. If the reader returns [`std::io::ErrorKind::WouldBlock`], it is at the end of a file that
/// may still grow: whole lines are passed on at once, and the rest waits for its line end.
#[derive(Debug)]
pub struct Blocks<R> {
    reader: TextReader<R>,
    block_bytes: usize,
    /// Bytes read and not yet passed on.
    pending: Vec<u8>,
    /// Memory of a block that was returned for reuse.
    spare: Vec<u8>,
    /// Line number of the first byte in `pending`.
    line: u64,
    /// Offset of that byte in the decompressed file, without a byte order mark.
    byte: u64,
    /// Why reading ended; reported after the whole lines.
    fault: Option<Rejection>,
    at_end: bool,
    /// True if the reader had no more bytes at the last read, but was not at its end.
    paused: bool,
    /// Number of NUL bytes after `pending`; other bytes may follow.
    nuls: u64,
}

impl<R: Read> Blocks<R> {
    /// Creates blocks of about `block_bytes`, at least one line each and 256 MiB at most.
    pub fn new(reader: R, block_bytes: usize, encoding: TextEncoding) -> Self {
        Self {
            reader: TextReader::new(reader, encoding),
            block_bytes: block_bytes.clamp(1, MAX_BLOCK_BYTES),
            pending: Vec::new(),
            spare: Vec::new(),
            line: 1,
            byte: 0,
            fault: None,
            at_end: false,
            paused: false,
            nuls: 0,
        }
    }

    /// At the end: number of NUL bytes after the last line, and the line with the first of them; `None` if there are
    /// none.
    pub fn trailing_nuls(&self) -> Option<(u64, u64)> {
        (self.nuls > 0).then_some((self.nuls, self.line))
    }

    /// Takes the next line; `None` as long as it has no end and the file may still grow, and at the end of the file.
    /// Must be called before [`Blocks::next_block`].
    ///
    /// # Errors
    /// A rejection for an unsupported encoding, NUL bytes, lines that end with carriage returns alone, a line that does
    /// not end, or a failed read.
    pub fn next_line(&mut self, path: &Path) -> Result<Option<Line>, Rejection> {
        let Some(end) = self.line_end(path)? else { return Ok(None) };
        let raw: Vec<u8> = self.pending.drain(..end).collect();
        let number = self.line;
        self.pass(&raw);
        let text = line_text(&raw, path).map_err(|rejection| rejection.at_line(number))?;
        Ok(Some(Line { text, number, raw }))
    }

    /// Puts back the line that was taken last, if it is a row.
    pub fn put_back(&mut self, line: Line) {
        self.line = line.number;
        self.byte -= self.reader.found().bytes_in_file(&line.raw);
        self.pending.splice(0..0, line.raw);
    }

    /// Skips lines, a block at most, on the way to line `line`, which begins at byte `byte` of the decompressed file.
    /// Does not check their cells.
    ///
    /// # Errors
    /// Those of [`Blocks::next_block`].
    pub fn pass_to(&mut self, line: u64, byte: u64, path: &Path) -> Result<Passed, Rejection> {
        if self.line >= line {
            let here = self.byte + self.reader.mark_bytes();
            return Ok(if (self.line, here) == (line, byte) { Passed::There } else { Passed::Elsewhere });
        }
        self.fill(self.block_bytes, path);
        let end = loop {
            match self.pending.iter().rposition(|byte| *byte == b'\n') {
                Some(last) if self.line + line_count(&self.pending) <= line => break last + 1,
                Some(_) => break self.start_of(line),
                None if self.fault.is_some() => return self.fault.take().map_or(Ok(Passed::Elsewhere), Err),
                None if self.at_end || self.paused => return Ok(Passed::Elsewhere),
                None => {
                    self.refuse_endless_line(path)?;
                    self.fill(self.longer(), path);
                }
            }
        };
        let passed = &self.pending[..end];
        (self.line, self.byte) =
            (self.line + line_count(passed), self.byte + self.reader.found().bytes_in_file(passed));
        self.pending.drain(..end);
        Ok(Passed::Going)
    }

    /// Start of a line after the first that begins in `pending`.
    fn start_of(&self, line: u64) -> usize {
        let ends = self.pending.iter().enumerate().filter(|(_, byte)| **byte == b'\n');
        ends.map(|(at, _)| at + 1)
            .zip(self.line + 1..)
            .find(|(_, next)| *next == line)
            .map_or(0, |(at, _)| at)
    }

    /// Returns true if nothing is left.
    pub fn is_at_end(&self) -> bool {
        self.at_end && self.pending.is_empty()
    }

    /// The detected encoding of the text.
    pub fn encoding(&self) -> Found {
        self.reader.found()
    }

    /// Counts the lines of `bytes`, which are passed on.
    fn pass(&mut self, bytes: &[u8]) {
        self.line += line_count(bytes);
        self.byte += self.reader.found().bytes_in_file(bytes);
    }

    /// The next block. Blank lines at the end of the file are omitted.
    ///
    /// # Errors
    /// A rejection for a line that does not end, or a failed read.
    pub fn next_block(&mut self, path: &Path) -> Result<Next, Rejection> {
        let mut wanted = self.block_bytes;
        loop {
            let known = self.pending.len();
            self.fill(wanted, path);
            self.set_nuls_aside(known, path)?;
            let rest = match last_line_end(&self.pending) {
                Some(end) => {
                    let mut rest = std::mem::take(&mut self.spare);
                    rest.extend_from_slice(&self.pending[end..]);
                    self.pending.truncate(end);
                    rest
                }
                None if self.fault.is_some() => return self.fault.take().map_or(Ok(Next::End), Err),
                None if self.at_end => return Ok(self.unterminated_line().map_or(Next::End, Next::Block)),
                None => {
                    self.refuse_endless_line(path)?;
                    if self.paused {
                        return Ok(Next::Later);
                    }
                    wanted = self.longer();
                    continue;
                }
            };
            let bytes = std::mem::replace(&mut self.pending, rest);
            let block = self.block_here(bytes, false);
            self.pass(&block.bytes);
            return Ok(Next::Block(block));
        }
    }

    /// Takes the memory of an unneeded block for one of the next.
    pub fn give_back(&mut self, mut bytes: Vec<u8>) {
        bytes.clear();
        self.spare = bytes;
    }

    /// Removes NUL bytes from the end of the bytes read so far: at the end of a file, they are a part of the disk that
    /// was never written. `known` bytes were read before the last call; if other bytes follow, the removed ones are
    /// restored.
    ///
    /// # Errors
    /// A rejection of more than a line of NUL bytes before other bytes.
    fn set_nuls_aside(&mut self, known: usize, path: &Path) -> Result<(), Rejection> {
        let kept = self.pending.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
        if self.nuls > 0 && kept > known {
            let nuls = usize::try_from(self.nuls).ok().filter(|nuls| *nuls <= MAX_LINE_BYTES);
            let nuls =
                nuls.ok_or_else(|| nul(path).at_line(self.line + line_count(&self.pending[..known])))?;
            self.pending.splice(known..known, std::iter::repeat_n(0, nuls));
            self.nuls = 0;
            return self.set_nuls_aside(known, path);
        }
        self.nuls += (self.pending.len() - kept) as u64;
        if self.nuls > MOST_TRAILING_NULS {
            return Err(nul(path).at_line(self.line + line_count(&self.pending[..kept])));
        }
        self.pending.truncate(kept);
        Ok(())
    }

    fn unterminated_line(&mut self) -> Option<Block> {
        let mut bytes = std::mem::take(&mut self.pending);
        if bytes.iter().all(|byte| is_blank(*byte) || *byte == b'\n') {
            return None;
        }
        // A carriage return is half of a line end, and shows that the line is whole.
        let unterminated = bytes.last() != Some(&b'\r');
        bytes.push(b'\n');
        Some(self.block_here(bytes, unterminated))
    }

    fn block_here(&self, bytes: Vec<u8>, unterminated: bool) -> Block {
        let first_byte = self.byte + self.reader.mark_bytes();
        Block { bytes, first_line: self.line, first_byte, encoding: self.reader.found(), unterminated }
    }

    /// Length of the first line with its end; `None` at the end of the file and if it may still grow.
    fn line_end(&mut self, path: &Path) -> Result<Option<usize>, Rejection> {
        loop {
            if let Some(at) = self.pending.iter().position(|byte| *byte == b'\n') {
                return Ok(Some(at + 1));
            }
            if let Some(fault) = self.fault.take() {
                return Err(fault);
            }
            if self.at_end {
                return Ok(Some(self.pending.len()).filter(|length| *length > 0));
            }
            self.refuse_endless_line(path)?;
            self.fill(self.longer(), path);
            if self.paused && !self.pending.contains(&b'\n') {
                return Ok(None);
            }
        }
    }

    /// Bytes to examine next if no line ended: at least twice as many, so that a long line is not searched repeatedly.
    fn longer(&self) -> usize {
        self.pending.len() + self.block_bytes.max(self.pending.len())
    }

    fn fill(&mut self, wanted: usize, path: &Path) {
        let missing = wanted.saturating_sub(self.pending.len());
        self.paused = false;
        if missing == 0 || self.at_end {
            return;
        }
        let read = read_up_to(&mut self.reader, missing, &mut self.pending);
        self.paused = matches!(&read, Err(error) if error.kind() == ErrorKind::WouldBlock);
        match read {
            Ok(count) => self.at_end = count < missing,
            // bytes read before the pause are in `pending` nevertheless
            Err(_) if self.paused => {}
            // whole lines before it come first, so that the result does not depend on blocks
            Err(error) => {
                let lines = line_count(&self.pending);
                self.fault = Some(Rejection::from_io(path, &error).at_line(self.line + lines));
                self.at_end = true;
            }
        }
    }

    fn refuse_endless_line(&self, path: &Path) -> Result<(), Rejection> {
        if self.pending.len() <= MAX_LINE_BYTES {
            return Ok(());
        }
        let rejection = if let Some(encoding) = wide_encoding(&self.pending) {
            wide(path, encoding)
        } else if self.pending.contains(&0) {
            nul(path)
        } else if self.pending.contains(&b'\r') {
            bare_returns(path)
        } else {
            Rejection::of_file(
                path,
                format!("a line longer than {} KiB", MAX_LINE_BYTES >> 10),
                "check that this is a CSV export",
            )
        };
        Err(rejection.at_line(self.line))
    }
}

/// Returns true if a byte is white space inside a line.
pub(crate) fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\r')
}

/// Number of line feeds.
pub(crate) fn line_count(bytes: &[u8]) -> u64 {
    count(bytes, b'\n')
}

/// Number of occurrences of a byte.
pub(crate) fn count(bytes: &[u8], wanted: u8) -> u64 {
    /// Few enough for a byte to contain their count: the compiler then counts in as many lanes as a register has bytes.
    const FEW: usize = 192;
    let of_few = |few: &[u8]| few.iter().fold(0_u8, |sum, byte| sum + u8::from(*byte == wanted));
    bytes.chunks(FEW).map(|few| u64::from(of_few(few))).sum()
}

/// A rejection for zero bytes.
pub(crate) fn nul(path: &Path) -> Rejection {
    Rejection::of_file(
        path,
        "NUL bytes: a hole left by a crash or an unfinished copy",
        "copy the export again from the controller",
    )
}

/// A rejection for text in another eight-bit encoding.
pub(crate) fn narrow(path: &Path, text: &[u8]) -> Rejection {
    Rejection::of_file(
        path,
        format!("text that is not UTF-8; it looks like {}", narrow_encoding(text)),
        "export as UTF-8, or give the encoding in the layout",
    )
}

/// End of the last line that is not blank. Blank lines wait until it is clear that the file continues.
fn last_line_end(bytes: &[u8]) -> Option<usize> {
    let last = bytes.iter().rposition(|byte| *byte == b'\n')?;
    let content = bytes[..last].iter().rposition(|byte| !is_blank(*byte) && *byte != b'\n')?;
    bytes[content..].iter().position(|byte| *byte == b'\n').map(|at| content + at + 1)
}

/// Appends bytes until there are `wanted` more or none is left, in pieces of a block: a hash is far faster on many
/// bytes at once. Returns how many; bytes read before an error stay.
fn read_up_to(reader: &mut impl Read, wanted: usize, bytes: &mut Vec<u8>) -> io::Result<usize> {
    let before = bytes.len();
    loop {
        let read = bytes.len() - before;
        let piece = (wanted - read).min(BLOCK_BYTES);
        if piece == 0 {
            return Ok(read);
        }
        let here = bytes.len();
        bytes.resize(here + piece, 0);
        let count = reader.read(&mut bytes[here..]);
        bytes.truncate(here + count.as_ref().map_or(0, |count| *count));
        match count {
            Ok(0) => return Ok(read),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

fn line_text(line: &[u8], path: &Path) -> Result<String, Rejection> {
    if let Some(encoding) = wide_encoding(line) {
        return Err(wide(path, encoding));
    }
    if line.contains(&0) {
        return Err(nul(path));
    }
    let line = without_bom(line);
    let text = std::str::from_utf8(line).map_err(|_| narrow(path, line))?;
    // Removes only the line end: with tabs as separators, a tab at the end is an empty column.
    let text = text.trim_end_matches(['\r', '\n']);
    if text.contains('\r') {
        return Err(bare_returns(path));
    }
    Ok(if text.trim().is_empty() { String::new() } else { text.to_owned() })
}

fn wide(path: &Path, encoding: Wide) -> Rejection {
    let reason = format!("text that is not UTF-8; it looks like {}", encoding.name());
    let remedy = match encoding {
        Wide::Utf16Le | Wide::Utf16Be => "export as UTF-8, or remove encoding from the layout",
        Wide::Utf32Le | Wide::Utf32Be => "export as UTF-8",
    };
    Rejection::of_file(path, reason, remedy)
}

fn bare_returns(path: &Path) -> Rejection {
    Rejection::of_file(path, "lines that end only with carriage returns", "export with LF or CRLF line ends")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first line that is not blank.
    fn first_text(cutter: &mut Blocks<impl Read>) -> String {
        let mut next = || cutter.next_line(Path::new("a.csv")).unwrap().unwrap().text;
        std::iter::from_fn(|| Some(next())).find(|text| !text.is_empty()).unwrap()
    }

    fn blocks(text: &str, block_bytes: usize) -> (String, Vec<Block>) {
        let path = Path::new("a.csv");
        let mut cutter = Blocks::new(text.as_bytes(), block_bytes, TextEncoding::Auto);
        let header = first_text(&mut cutter);
        let mut blocks = Vec::new();
        while let Next::Block(block) = cutter.next_block(path).unwrap() {
            blocks.push(block);
        }
        (header, blocks)
    }

    #[test]
    fn bytes_are_read_as_far_as_wanted_and_those_before_an_error_stay() {
        struct Interrupted<'t>(&'t [u8], u32);
        impl Read for Interrupted<'_> {
            fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
                self.1 += 1;
                match self.1 % 3 {
                    1 => Err(ErrorKind::Interrupted.into()),
                    _ if self.0.is_empty() => Err(ErrorKind::TimedOut.into()),
                    _ => {
                        let most = buffer.len().min(7);
                        self.0.read(&mut buffer[..most])
                    }
                }
            }
        }
        let text = b"some bytes that come in small pieces";
        let mut found = b"before ".to_vec();
        assert_eq!(read_up_to(&mut Interrupted(text, 0), 20, &mut found).ok(), Some(20));
        assert_eq!(found, b"before some bytes that come");
        let mut reader = Interrupted(text, 0);
        let error = read_up_to(&mut reader, 100, &mut found).expect_err("no end");
        assert_eq!((error.kind(), &found[27..]), (ErrorKind::TimedOut, &text[..]));
        assert_eq!(read_up_to(&mut &text[..], 100, &mut found).ok(), Some(text.len()));
    }

    /// Returns its parts one by one, with a pause before each and at the end of the last.
    struct Slow(Vec<Vec<u8>>, bool);

    impl Read for Slow {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            self.1 = !self.1;
            if self.1 || self.0.is_empty() {
                return Err(ErrorKind::WouldBlock.into());
            }
            let mut part = self.0.remove(0);
            let rest = part.split_off(part.len().min(buffer.len()));
            buffer[..part.len()].copy_from_slice(&part);
            if !rest.is_empty() {
                self.0.insert(0, rest);
            }
            Ok(part.len())
        }
    }

    #[test]
    fn a_growing_file_gives_whole_lines_only() {
        let path = Path::new("a.csv");
        let parts = ["ti", "me\n", "1\n2", "2\n\n", "3\r", "\n4"].map(|part| part.as_bytes().to_vec());
        let mut cutter = Blocks::new(Slow(parts.to_vec(), false), 1 << 10, TextEncoding::Auto);
        let header = (0..9).find_map(|_| cutter.next_line(path).unwrap());
        assert_eq!(header.map(|line| line.text).as_deref(), Some("time"));
        let mut lines = Vec::new();
        for _ in 0..20 {
            if let Next::Block(block) = cutter.next_block(path).unwrap() {
                assert!(block.bytes.ends_with(b"\n") && !block.unterminated);
                lines.push((block.first_line, String::from_utf8(block.bytes).unwrap()));
            }
        }
        let expected = [(2, "1\n"), (3, "22\n"), (4, "\n3\r\n")];
        assert_eq!(lines, expected.map(|(line, text)| (line, text.to_owned())));
        assert_eq!(cutter.next_block(path).unwrap(), Next::Later, "the last line has no end");
    }

    #[test]
    fn bytes_are_counted_in_pieces_of_any_length() {
        for length in [0, 1, 191, 192, 193, 1000, 4096] {
            let bytes: Vec<u8> = (0..length).map(|k| if k * 7919 % 11 < 4 { b'\n' } else { b'7' }).collect();
            let expected = bytes.iter().filter(|byte| **byte == b'\n').count() as u64;
            assert_eq!(line_count(&bytes), expected);
            assert_eq!(count(&vec![b'\n'; length], b'\n'), length as u64);
        }
    }

    #[test]
    fn blocks_put_together_are_the_lines() {
        let text = "time,x\r\n1,2\r\n3,4\r\n\r\n5,6\r\n\r\n \t\r\n";
        for block_bytes in 1..=text.len() + 1 {
            let (header, blocks) = blocks(text, block_bytes);
            assert_eq!(header, "time,x");
            let bytes: Vec<u8> = blocks.iter().flat_map(|b| b.bytes.clone()).collect();
            assert_eq!(String::from_utf8(bytes).unwrap(), "1,2\r\n3,4\r\n\r\n5,6\r\n", "{block_bytes}");
            let (mut line, mut byte) = (2, 8);
            for block in &blocks {
                assert_eq!((block.first_line, block.first_byte), (line, byte));
                line += line_count(&block.bytes);
                byte += block.bytes.len() as u64;
            }
        }
    }

    #[test]
    fn a_last_line_without_end_is_marked() {
        for block_bytes in 1..20 {
            let (_, blocks) = blocks("time\n1\n2", block_bytes);
            let last = blocks.last().unwrap();
            assert_eq!((last.bytes.as_slice(), last.first_line, last.unterminated), (&b"2\n"[..], 3, true));
        }
        assert!(!blocks("time\n1\n2\r", 4).1.last().unwrap().unterminated);
        assert!(!blocks("time\n1\n2\n", 4).1.last().unwrap().unterminated);
        assert!(blocks("time", 4).1.is_empty());
    }

    #[test]
    fn blank_lines_before_the_header_count_as_lines() {
        let (header, blocks) = blocks("\n \n\u{feff}time\n1\n", 3);
        assert_eq!((header.as_str(), blocks[0].first_line), ("time", 4));
    }

    #[test]
    fn a_file_without_line_ends_does_not_fill_the_memory() {
        let path = Path::new("a.csv");
        let reason = |bytes: Vec<u8>| {
            let endless =
                std::io::repeat(0).take(0).chain(std::io::Cursor::new(bytes)).chain(std::io::repeat(b'7'));
            Blocks::new(endless, BLOCK_BYTES, TextEncoding::Auto).next_line(path).unwrap_err().reason
        };
        assert_eq!(&*reason(b"7".to_vec()), "a line longer than 1024 KiB");
        assert!(reason(b"77\r77".to_vec()).starts_with("lines that end only with carriage"));
        assert!(reason(b"777\0".to_vec()).starts_with("NUL bytes"));
        let mut cutter = Blocks::new((&b"time\n1\n"[..]).chain(std::io::repeat(0)), 10, TextEncoding::Auto);
        first_text(&mut cutter);
        assert!(matches!(cutter.next_block(path).unwrap(), Next::Block(_)));
        let rejection = cutter.next_block(path).unwrap_err();
        assert!(rejection.reason.starts_with("NUL bytes"), "{rejection}");
        assert_eq!(rejection.line, Some(3));
    }
}
