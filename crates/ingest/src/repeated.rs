//! Rows that a sender has sent twice.

use std::io::BufReader;
use std::path::Path;

use super::bytes::encoding::TextReader;
use super::bytes::source;
use super::excerpt::next_line;
use super::rejection::Rejection;
use armwatch_config::TextEncoding;

/// Explains the rejection of a row whose time is earlier than that of the row before. If the same row is further up in
/// the file, a part of the recording was sent again, and the rejection names both parts. Other rejections are
/// unchanged. Reads up to the place, at most `most` decompressed bytes, in memory that does not grow with the file.
pub fn explained(rejection: Rejection, most: u64) -> Rejection {
    let is_backwards = rejection.reason.ends_with("time runs backwards");
    let Some(line) = rejection.line.filter(|_| is_backwards) else { return rejection };
    let Some((first, rows)) = original(&rejection.path, line, most) else { return rejection };
    let lines = |from: u64| match rows {
        1 => format!("line {from}"),
        _ => format!("lines {from} to {}", from + rows - 1),
    };
    let (repeat, were) = if rows == 1 { ("repeats", "was") } else { ("repeat", "were") };
    Rejection {
        reason: format!(
            "{}: {} {repeat} {}, which {were} sent twice",
            rejection.reason,
            lines(line),
            lines(first)
        )
        .into(),
        remedy: format!("delete {}, and make the sender send each part of the recording once", lines(line))
            .into(),
        ..rejection
    }
}

/// The last line before `line` that is equal to it, and the number of lines from there on that are repeated from `line`
/// on.
fn original(path: &Path, line: u64, most: u64) -> Option<(u64, u64)> {
    let row = Lines::from(path, line, most)?.next()?;
    let before = (1..line).zip(Lines::from(path, 1, most)?);
    let first = before.filter(|(_, of)| *of == row).last()?.0;
    let (originals, repeated) = (Lines::from(path, first, most)?, Lines::from(path, line, most)?);
    let rows = (first..line).zip(originals).zip(repeated).take_while(|((_, of), again)| of == again).count();
    Some((first, rows as u64))
}

/// The lines of an export from one of them on, without their ends.
struct Lines(BufReader<TextReader<Box<dyn std::io::Read + Send>>>);

impl Lines {
    /// Returns `None` for an unreadable file, or one with fewer lines.
    fn from(path: &Path, line: u64, most: u64) -> Option<Self> {
        let reader = source::open_hashing_up_to(path, most).ok()?.0;
        let mut lines = Self(BufReader::new(TextReader::new(reader, TextEncoding::Auto)));
        (1..line).all(|_| lines.next().is_some()).then_some(lines)
    }
}

impl Iterator for Lines {
    type Item = Vec<u8>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut line = Vec::new();
        next_line(&mut self.0, &mut line).is_ok_and(|length| length > 0).then_some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BACKWARDS: &str = "earlier than 3 in the previous row: time runs backwards";

    fn explained_in(text: &str, reason: &str, line: u64) -> (String, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, text).unwrap();
        let rejection = explained(Rejection::of_file(&path, reason, "as before").at_line(line), 1 << 20);
        (rejection.reason.into(), rejection.remedy.into())
    }

    #[test]
    fn a_part_that_was_sent_twice_is_named_with_its_lines() {
        let (reason, remedy) = explained_in("time,a\n1,5\n2,6\n3,7\n2,6\n3,7\n4,8\n", BACKWARDS, 5);
        assert_eq!(reason, format!("{BACKWARDS}: lines 5 to 6 repeat lines 3 to 4, which were sent twice"));
        assert_eq!(remedy, "delete lines 5 to 6, and make the sender send each part of the recording once");
        // of a third copy the second is the original, and nothing follows the last row
        let (reason, _) = explained_in("time,a\n1,5\n2,6\n1,5\n2,6\n1,5", BACKWARDS, 6);
        assert_eq!(reason, format!("{BACKWARDS}: line 6 repeats line 4, which was sent twice"));
        // a long copy ends with the original
        let (reason, _) = explained_in("time,a\n1,5\n2,6\n1,5\n2,6\n1,5\n2,6\n", BACKWARDS, 4);
        assert_eq!(reason, format!("{BACKWARDS}: lines 4 to 5 repeat lines 2 to 3, which were sent twice"));
    }

    #[test]
    fn other_rows_and_other_reasons_stay_as_they_are() {
        let stays = |text: &str, reason: &str| {
            assert_eq!(explained_in(text, reason, 4), (reason.to_owned(), "as before".to_owned()), "{text}");
        };
        stays("time,a\n1,5\n3,7\n1,6\n", BACKWARDS);
        stays("time,a\n1,5\n3,7\n1,5\n", "not a number");
        stays("time,a\n1,5\n", BACKWARDS);
    }
}
