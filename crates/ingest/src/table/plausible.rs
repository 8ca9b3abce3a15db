//! Decides if a refused file looks like an export. The log, the API and copies of the database show the reason of a
//! refusal to people without access to the file, which may be a list of passwords under another name. The reason
//! therefore quotes the file only if it looks like an export, and describes it otherwise.

use std::path::Path;

use super::cell;
use super::fields::fields;
use crate::rejection::Rejection;
use armwatch_config::{DecimalMark, Layout};

/// Fewest columns of an export: time, a position and a torque.
const FEWEST_COLUMNS: usize = 3;

/// Longest name of a column, characters.
const LONGEST_NAME: usize = 64;

/// Separators of exports.
const DELIMITERS: [u8; 5] = [b',', b';', b'\t', b'|', b' '];

/// Returns true if this number of columns known to the layout shows that a file is an export.
pub(super) fn shows_export(known_columns: usize) -> bool {
    known_columns >= FEWEST_COLUMNS
}

/// Returns true if a header and the lines below it look like an export: names, and a row with as many cells, mostly
/// numbers.
pub(super) fn is_export<'l>(header: &str, below: impl Iterator<Item = &'l str> + Clone) -> bool {
    DELIMITERS.into_iter().any(|delimiter| {
        let count = fields(header, delimiter).count();
        let is_name = |name: &str| {
            name.chars().count() <= LONGEST_NAME && (name.is_empty() || name.chars().any(char::is_alphabetic))
        };
        let is_row = |line: &str| {
            let marks = [DecimalMark::Point, DecimalMark::Comma];
            let is_number = |cell: &&str| marks.into_iter().any(|mark| cell::number(cell, mark).is_ok());
            let numbers = fields(line, delimiter).filter(is_number).count();
            fields(line, delimiter).count() == count && 2 * numbers > count
        };
        count >= FEWEST_COLUMNS && fields(header, delimiter).all(is_name) && below.clone().any(is_row)
    })
}

/// The rejection of a file that is not an export, which quotes nothing from it.
pub(super) fn no_export(path: &Path, line: u64, header: &str, layout: &Layout) -> Rejection {
    let columns = fields(header, layout.delimiter).count();
    let plural = if columns == 1 { "" } else { "s" };
    let reason = format!(
        "not an export: the line has {columns} column{plural} in {} bytes, and no names of columns with \
        rows of numbers below them",
        header.len()
    );
    let remedy = format!(
        "export the recording as text with names of columns as layout \"{}\" gives them; `armwatch \
        quarantine explain` shows the line to users who may read the file",
        layout.name
    );
    Rejection::of_file(path, reason, remedy).at_line(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_with_numbers_below_look_like_an_export() {
        for (header, below) in [
            ("t,q1,tau1", "0.0,1.5,2"),
            ("Zeit;Achse 1 [rad];Moment 1;", "# note\n0,1;1,5;2;"),
            ("t\tq\ttau\tnote", "0\t1\t2\tfine"),
            ("t q tau", "0 1 2"),
        ] {
            assert!(is_export(header, below.lines()), "{header}");
        }
        for (header, below) in [
            ("0ed3d197c2b7a1f00ed3d197c2b7a1f0", ""),
            ("root:$y$j9T$abc$def:19000:0:99999:7:::", "daemon:*:19000:0:99999:7:::"),
            ("user,password,shell", "root,hunter2,/bin/sh"),
            ("user,password,uid", "root,hunter2,0"),
            ("-----BEGIN OPENSSH PRIVATE KEY-----", "b3BlbnNzaC1rZXktdjEAAAAABG5vbmU"),
            ("machine ftp.plant login me password s3cret", "machine b login me password s"),
            ("a,b", "1,2"),
            ("t,q1,tau1", ""),
        ] {
            assert!(!is_export(header, below.lines()), "{header}");
        }
    }
}
