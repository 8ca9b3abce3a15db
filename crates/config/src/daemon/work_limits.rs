//! `[limits]`, and the folder of stored exports.

use std::path::{Path, PathBuf};

use crate::settings::WorkLimits;
use crate::toml::table::{Table, Value};

/// Most exports of either size at once: each takes the memory of about three cycles, and two cores run at most two
/// analyses at a time.
const MOST_BACKLOG_FILES: i64 = 64;

/// Largest bound on bytes, 1 PiB, against a mistyped number.
const MOST_BYTES: i64 = 1 << 50;

/// Smallest limit on the rows of a cycle: some seconds at a usual rate.
const FEWEST_ROWS: i64 = 1000;

/// Largest limit on the rows of a cycle: for six axes they take 2 GB.
const MOST_ROWS: i64 = 10_000_000;

/// Least memory of cycles: that of one of some seconds.
const LEAST_CYCLES_BYTES: i64 = 1_000_000;

/// Most rows of open cycles together, under the earlier name of the bound: for six axes they take 200 GB.
const MOST_OPEN_ROWS: i64 = 1_000_000_000;

/// Bytes of memory per row of six axes, for a bound that is given in rows.
const ROW_BYTES: i64 = 200;

impl Default for WorkLimits {
    /// Two of either size; large from 64 MiB, some twenty minutes at 250 Hz; 64 GiB, which is three times a
    /// ten-hour recording of a nine-axis arm at 1 kHz; a million rows, an hour at 250 Hz, which take 200 MB; half of
    /// the gigabyte that the shipped unit may take.
    fn default() -> Self {
        Self {
            backlog_files: 2,
            large_file_bytes: 64 << 20,
            export_bytes: 64 << 30,
            cycle_rows: 1_000_000,
            cycles_bytes: 512 << 20,
        }
    }
}

pub(crate) fn read_work_limits(table: &Table<'_>) -> Option<WorkLimits> {
    let default = WorkLimits::default();
    let number = |key, range| table.optional(key).map(|value| value.integer(range));
    let files = number("backlog_files", 1..=MOST_BACKLOG_FILES);
    let large = number("large_file_bytes", 1..=MOST_BYTES);
    let bytes = number("export_max_bytes", 1..=MOST_BYTES);
    let rows = number("cycle_max_rows", FEWEST_ROWS..=MOST_ROWS);
    let memory =
        table.at_most_one_of(&["cycles_max_bytes", "open_cycles_max_rows"]).map(|(form, value)| match form {
            0 => value.integer(LEAST_CYCLES_BYTES..=MOST_BYTES),
            _ => value
                .integer(FEWEST_ROWS..=MOST_OPEN_ROWS)
                .map(|rows| (rows * ROW_BYTES).max(LEAST_CYCLES_BYTES)),
        });
    let count = |read: Option<Option<i64>>, default: usize| match read {
        Some(given) => usize::try_from(given?).ok(),
        None => Some(default),
    };
    let size = |read: Option<Option<i64>>, default: u64| match read {
        Some(given) => u64::try_from(given?).ok(),
        None => Some(default),
    };
    Some(WorkLimits {
        backlog_files: count(files, default.backlog_files)?,
        large_file_bytes: size(large, default.large_file_bytes)?,
        export_bytes: size(bytes, default.export_bytes)?,
        cycle_rows: count(rows, default.cycle_rows)?,
        cycles_bytes: count(memory, default.cycles_bytes)?,
    })
}

/// The archive, which must not be watched: moved exports would be found again.
pub(crate) fn archive_of(value: &Value<'_>, folders: &[PathBuf]) -> Option<PathBuf> {
    let archive = PathBuf::from(value.text()?);
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let inside = folders.iter().find(|folder| absolute(&archive).starts_with(absolute(folder)));
    if let Some(folder) = inside {
        let hint = "give a folder outside the watched ones".to_owned();
        value.refuse(format!("is inside the watched folder {}", folder.display()), Some(hint));
        return None;
    }
    Some(archive)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toml::table::read_document;

    #[test]
    fn the_earlier_bound_in_rows_is_taken_as_bytes_of_six_axes() {
        let bytes = |text: &str| {
            read_document("a.toml", text, read_work_limits).map(|limits| limits.cycles_bytes).ok()
        };
        assert_eq!(bytes(""), Some(512 << 20));
        assert_eq!(bytes("cycles_max_bytes = 2000000"), Some(2_000_000));
        assert_eq!(bytes("open_cycles_max_rows = 4000000"), Some(800_000_000));
        assert_eq!(bytes("open_cycles_max_rows = 1000"), Some(1_000_000));
        for refused in [
            "cycles_max_bytes = 10",
            "open_cycles_max_rows = 10",
            "cycles_max_bytes = 2000000\nopen_cycles_max_rows = 4000000",
        ] {
            assert_eq!(bytes(refused), None, "{refused}");
        }
    }
}
