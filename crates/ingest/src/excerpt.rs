//! The lines of an export around a place, to show the text that was not understood.

use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;
use std::path::Path;

use super::bytes::encoding::{Found, TextReader};
use super::bytes::source;
use super::rejection::Rejection;
use armwatch_config::TextEncoding;

/// Longest part of a line that is kept. The reader refuses longer lines, and a file without line ends must not fill the
/// memory.
const MAX_KEPT_BYTES: usize = 1 << 20;

/// Separators that are tried for a header.
const DELIMITERS: [char; 5] = [',', ';', '\t', '|', ' '];

/// A place in an export, with the lines around it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Excerpt {
    /// First byte of the cell, or else of the line, in the decompressed file, from 0.
    pub byte: u64,
    /// Number of the first of `lines`, from 1.
    pub first_line: u64,
    /// The lines, without their ends; invalid UTF-8 is replaced.
    pub lines: Vec<String>,
    /// Index of the place's line in `lines`, from 0.
    pub place: usize,
    /// Characters of the cell in its line, if the column is found.
    pub cell: Option<Range<usize>>,
}

/// The place of a rejection with `around` lines before and after it; `None` if it names no line, or the file does not
/// contain this line within its first `most` decompressed bytes now or is unreadable.
pub fn of_rejection(rejection: &Rejection, around: u64, most: u64) -> Option<Excerpt> {
    excerpt(&rejection.path, rejection.line?, rejection.column.as_deref(), around, most).ok().flatten()
}

/// Line `line` of the export at `path` with `around` lines before and after it, and the cell of the column with the
/// name `column` in its header, or with this number. `None` if the file has fewer lines within its first `most`
/// decompressed bytes. Reads up to the place, in memory that does not grow with the file.
///
/// # Errors
/// A rejection of a file that cannot be opened.
pub fn excerpt(
    path: &Path,
    line: u64,
    column: Option<&str>,
    around: u64,
    most: u64,
) -> Result<Option<Excerpt>, Rejection> {
    let mut reader =
        BufReader::new(TextReader::new(source::open_hashing_up_to(path, most)?.0, TextEncoding::Auto));
    let (mut header, mut kept, mut place_at) = (None, Vec::new(), None);
    let (mut byte, mut number) = (0_u64, 1_u64);
    let mut bytes = Vec::new();
    // a stream that breaks off is shown up to that point
    while let Ok(length @ 1..) = next_line(&mut reader, &mut bytes) {
        if header.is_none() && !bytes.trim_ascii().is_empty() {
            header = Some(String::from_utf8_lossy(&bytes).into_owned());
        }
        if number.saturating_add(around) >= line {
            if number == line {
                place_at = Some((kept.len(), byte));
            }
            kept.push(bytes.clone());
        }
        if number >= line.saturating_add(around) {
            break;
        }
        byte += length;
        number += 1;
    }
    let Some((place, line_byte)) = place_at else { return Ok(None) };
    let (found, mark) = (reader.get_ref().found(), reader.get_ref().mark_bytes());
    let cell = match (&header, column, kept.get(place)) {
        (Some(header), Some(column), Some(line)) => cell(header, column, line),
        _ => None,
    };
    let first_line = line - place as u64;
    Ok(Some(Excerpt {
        byte: mark
            + line_byte
            + cell.as_ref().map_or(0, |cell| bytes_before(kept.get(place), cell.start, found)),
        first_line,
        cell: cell.and_then(|cell| kept.get(place).map(|line| in_characters(line, &cell))),
        lines: kept.iter().map(|line| String::from_utf8_lossy(line).into_owned()).collect(),
        place,
    }))
}

/// Bytes of the text before `end` in the file.
fn bytes_before(line: Option<&Vec<u8>>, end: usize, found: Found) -> u64 {
    line.and_then(|line| line.get(..end)).map_or(0, |text| found.bytes_in_file(text))
}

/// Reads a line into `line`, without its end, and returns the bytes that it takes in the file including its end: 0 at
/// the end of the file.
pub(crate) fn next_line<R: Read>(
    reader: &mut BufReader<TextReader<R>>,
    line: &mut Vec<u8>,
) -> io::Result<u64> {
    line.clear();
    let mut length = 0_u64;
    loop {
        match reader.fill_buf() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            filled => filled?,
        };
        let found = reader.get_ref().found();
        // the same bytes again
        let available = reader.fill_buf()?;
        if available.is_empty() {
            break;
        }
        let end = available.iter().position(|byte| *byte == b'\n');
        let taken = end.map_or(available.len(), |end| end + 1);
        let room = MAX_KEPT_BYTES.saturating_sub(line.len());
        line.extend_from_slice(&available[..taken.min(room)]);
        length += found.bytes_in_file(&available[..taken]);
        reader.consume(taken);
        if end.is_some() {
            break;
        }
    }
    while line.last().is_some_and(|byte| matches!(byte, b'\n' | b'\r')) {
        line.pop();
    }
    Ok(length)
}

/// Bytes of the cell below `column`: a name of the header or, in a file without one, a number.
fn cell(header: &str, column: &str, line: &[u8]) -> Option<Range<usize>> {
    let usual = DELIMITERS.into_iter().max_by_key(|delimiter| header.matches(*delimiter).count())?;
    let numbers = header.split(usual).all(|cell| cell.trim().replace(',', ".").parse::<f64>().is_ok());
    let (index, delimiter) = if numbers {
        (column.parse::<usize>().ok()?.checked_sub(1)?, usual)
    } else {
        DELIMITERS.into_iter().find_map(|delimiter| {
            let mut names = header.split(delimiter).map(|name| name.trim().trim_matches('"'));
            names.position(|name| name == column).map(|index| (index, delimiter))
        })?
    };
    let delimiter = u8::try_from(delimiter).ok()?;
    let mut start = 0;
    for (at, cell) in line.split(|byte| *byte == delimiter).enumerate() {
        if at == index {
            return Some(start..start + cell.len());
        }
        start += cell.len() + 1;
    }
    None
}

fn in_characters(line: &[u8], bytes: &Range<usize>) -> Range<usize> {
    let characters =
        |end: usize| String::from_utf8_lossy(line.get(..end).unwrap_or_default()).chars().count();
    characters(bytes.start)..characters(bytes.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str, line: u64, column: Option<&str>, around: u64) -> Option<Excerpt> {
        of_bytes(text.as_bytes(), line, column, around)
    }

    fn of_bytes(text: &[u8], line: u64, column: Option<&str>, around: u64) -> Option<Excerpt> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        excerpt(&path, line, column, around, 1 << 30).unwrap()
    }

    #[test]
    fn no_more_is_unpacked_than_is_permitted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv.zst");
        let text = "time,pos_1\n".to_owned() + &"0,1\n".repeat(1000);
        std::fs::write(&path, zstd::encode_all(text.as_bytes(), 3).unwrap()).unwrap();
        let at = |most| excerpt(&path, 900, Some("pos_1"), 1, most).unwrap();
        assert_eq!(at(1 << 20).map(|found| found.first_line), Some(899));
        assert_eq!(at(1000), None);
    }

    #[test]
    fn the_byte_is_where_the_cell_begins() {
        let text = "\u{feff}time,\"pos_1\",trq_1\r\n0,1,2\r\n1,µ,abc\r\n2,3,4\r\n";
        for (column, cell) in [("time", "1"), ("pos_1", "µ"), ("trq_1", "abc")] {
            let found = of(text, 3, Some(column), 1).unwrap();
            let byte = usize::try_from(found.byte).unwrap();
            assert_eq!(&text[byte..byte + cell.len()], cell);
            assert_eq!((found.first_line, found.place, found.lines.len()), (2, 1, 3));
            let shown: String =
                found.lines[1].chars().collect::<Vec<_>>()[found.cell.unwrap()].iter().collect();
            assert_eq!(shown, cell);
        }
    }

    #[test]
    fn the_byte_is_that_of_the_file_in_other_encodings() {
        let text = "time;größe\n0;1\n1;abc\n";
        let wide: Vec<u8> = ["\u{feff}", text].concat().encode_utf16().flat_map(u16::to_le_bytes).collect();
        let found = of_bytes(&wide, 3, Some("größe"), 0).unwrap();
        assert_eq!((found.lines, found.cell), (vec!["1;abc".to_owned()], Some(2..5)));
        assert_eq!(&wide[usize::try_from(found.byte).unwrap()..][..4], b"a\0b\0");
        let narrow: Vec<u8> = text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
        let found = of_bytes(&narrow, 3, Some("größe"), 0).unwrap();
        assert_eq!(&narrow[usize::try_from(found.byte).unwrap()..][..3], b"abc");
    }

    #[test]
    fn a_column_goes_by_number_where_there_are_no_names() {
        let found = of("0;1;2\n1;x;3\n", 2, Some("2"), 0).unwrap();
        assert_eq!((found.byte, found.cell, found.lines), (8, Some(2..3), vec!["1;x;3".to_owned()]));
    }

    #[test]
    fn without_the_column_the_line_is_the_place_and_without_the_line_there_is_none() {
        let found = of("time,pos_1\n0,1\n", 2, Some("pos_9"), 5).unwrap();
        assert_eq!((found.byte, found.cell, found.place), (11, None, 1));
        assert_eq!(of("time,pos_1\n0\n", 2, Some("pos_1"), 0).unwrap().cell, None, "the line is short");
        assert_eq!(of("time\n", 2, None, 0), None);
        assert_eq!(of("", 1, None, 3), None);
    }

    #[test]
    fn a_line_without_end_is_kept_in_part() {
        let found = of(&"7".repeat(3 * MAX_KEPT_BYTES), 1, None, 0).unwrap();
        assert_eq!(found.lines[0].len(), MAX_KEPT_BYTES);
    }
}
