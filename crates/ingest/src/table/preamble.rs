//! Reads the lines before the rows of an export: lines to skip, comments, the header, a row of units.

use std::io::Read;
use std::path::Path;

use super::cell;
use super::fields::fields;
use crate::bytes::blocks::{Blocks, Line};
use crate::rejection::Rejection;
use armwatch_config::Layout;

/// Most comment lines before a header; a file with more is not an export.
const MAX_COMMENTS: usize = 10_000;

/// The header of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// The line of column names; if there is none, the first row.
    pub text: String,
    /// Its number in the decompressed file, from 1.
    pub line: u64,
}

/// Takes everything before the rows from `blocks`.
///
/// Blank lines and comments before the header are skipped. A header may be a comment itself, as some programs write it:
/// it is the last comment, if a row of numbers follows it. `None` as long as it is incomplete.
///
/// # Errors
/// Those of [`Blocks::next_line`].
pub fn read<R: Read>(
    blocks: &mut Blocks<R>,
    layout: &Layout,
    path: &Path,
) -> Result<Option<Header>, Rejection> {
    let mut comment: Option<Line> = None;
    let mut comments = 0;
    loop {
        let Some(line) = blocks.next_line(path)? else {
            // Only comments: check the last one as a header.
            let last = comment.filter(|_| blocks.is_at_end());
            return Ok(last.map(|line| Header { text: line.text, line: line.number }));
        };
        if line.text.is_empty() || line.number <= layout.text.skip_lines as u64 {
            continue;
        }
        if is_comment(&line, layout) && comments < MAX_COMMENTS {
            comments += 1;
            comment = Some(line);
            continue;
        }
        let header = Header { text: line.text.clone(), line: line.number };
        if !layout.header {
            blocks.put_back(line);
            return Ok(Some(header));
        }
        if let Some(comment) = comment.filter(|_| is_numbers(&line.text, layout)) {
            blocks.put_back(line);
            let text = comment.text.trim_start().trim_start_matches(&layout.text.comment).to_owned();
            return Ok(Some(Header { text, line: comment.number }));
        }
        for _ in 0..layout.text.skip_after_header {
            if blocks.next_line(path)?.is_none() && !blocks.is_at_end() {
                return Ok(None);
            }
        }
        return Ok(Some(header));
    }
}

fn is_comment(line: &Line, layout: &Layout) -> bool {
    let sign = &layout.text.comment;
    !sign.is_empty() && line.text.trim_start().starts_with(sign.as_str())
}

/// Returns true if a line contains only numbers.
fn is_numbers(text: &str, layout: &Layout) -> bool {
    let mut cells = fields(text, layout.delimiter).filter(|cell| !cell.is_empty()).peekable();
    cells.peek().is_some() && cells.all(|cell| cell::number(cell, layout.text.decimal).is_ok())
}
