//! `[limits]`, and where exports go once they are stored.

use std::path::{Path, PathBuf};

use crate::settings::WorkLimits;
use crate::toml::table::{Table, Value};

/// Most exports of either size at once: each takes the memory of about three cycles, and two analyses at a
/// time are all that two cores do.
const MOST_BACKLOG_FILES: i64 = 64;

/// Largest bound on bytes, 1 PiB, against a mistyped number.
const MOST_BYTES: i64 = 1 << 50;

/// Fewest rows that a cycle may be bounded to: some seconds at a usual rate.
const FEWEST_ROWS: i64 = 1000;

/// Most rows of a cycle that may be allowed: of six axes they take 2 GB.
const MOST_ROWS: i64 = 10_000_000;

/// Most rows of open cycles together: of six axes they take 200 GB.
const MOST_OPEN_ROWS: i64 = 1_000_000_000;

impl Default for WorkLimits {
    /// Two of either size; large from 64 MiB, some twenty minutes at 250 Hz; 64 GiB, which is three times a
    /// ten-hour recording of a nine-axis arm at 1 kHz; a million rows, an hour at 250 Hz, which take 200 MB; four
    /// million of all exports together.
    fn default() -> Self {
        Self {
            backlog_files: 2,
            large_file_bytes: 64 << 20,
            export_bytes: 64 << 30,
            cycle_rows: 1_000_000,
            open_rows: 4_000_000,
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
    let open = number("open_cycles_max_rows", FEWEST_ROWS..=MOST_OPEN_ROWS);
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
        open_rows: count(open, default.open_rows)?,
    })
}

/// The archive, which must not be watched: what is moved there would be found again.
pub(crate) fn archive_of(value: &Value<'_>, folders: &[PathBuf]) -> Option<PathBuf> {
    let archive = PathBuf::from(value.text()?);
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let inside = folders.iter().find(|folder| absolute(&archive).starts_with(absolute(folder)));
    if let Some(folder) = inside {
        let hint = "give a folder beside the watched ones".to_owned();
        value.refuse(format!("lies in the watched folder {}", folder.display()), Some(hint));
        return None;
    }
    Some(archive)
}
