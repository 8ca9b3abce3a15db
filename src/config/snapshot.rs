//! `[snapshot]`: a copy of the database that any user and machine can read.

use std::path::PathBuf;
use std::time::Duration;

use super::toml::range::Limits;
use super::toml::table::Table;

const DEFAULT_INTERVAL_MIN: f64 = 15.0;

/// When the daemon writes a copy of what is stored, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SnapshotSettings {
    /// The file, which is replaced each time.
    pub file: PathBuf,
    /// Least time between two copies.
    pub interval: Duration,
}

/// Reads `[snapshot]`; outer `None` after a problem, inner without the section.
pub(super) fn read_snapshot(table: Option<&Table<'_>>) -> Option<Option<SnapshotSettings>> {
    let Some(table) = table else { return Some(None) };
    let file = table.required("file").and_then(|value| value.text().map(PathBuf::from));
    let interval = Limits::between(0.1, 10_080.0, "min");
    let interval = table.number_or("interval_min", &interval, DEFAULT_INTERVAL_MIN);
    Some(Some(SnapshotSettings {
        file: file?,
        interval: Duration::try_from_secs_f64(60.0 * interval?).ok()?,
    }))
}
