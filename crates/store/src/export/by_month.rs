//! Views divided by robot and month, for histories of years: `cycles/robot=R01/month=2026-11/cycles.parquet`. Engines
//! for many files read these names as columns (Hive's partitions). Files have all columns except `robot`, which the
//! name of their folder contains.
//!
//! A row belongs to the month (UTC) of the start of its run, or of its own time in a view of events, and thus to one
//! file. Rows without a run have the month `__HIVE_DEFAULT_PARTITION__`, Hive's name for NULL. Equal rows give equal
//! bytes, so a file with unchanged rows is not written again, and a copy by modification time transfers it only once. A
//! file gets its name as soon as it is complete, since there may be more files than a program may have open. The next
//! export completes one that was stopped.

use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use serde_json::Value;

use super::error::ExportError;
use super::sheet::{PartCount, Sheet, SheetFormat, Written};
use super::target::{Target, existing};
use crate::{PublicView, RowFilter, ViewReader};

/// Name of a folder that engines interpret as NULL.
const NULL: &str = "__HIVE_DEFAULT_PARTITION__";

/// True if the rows of a view belong to robots and months.
pub(super) fn has_months(view: &PublicView) -> bool {
    let has = |name: &str| view.columns.iter().any(|column| column.name == name);
    has("robot") && (has("run_id") || has("at"))
}

/// Robot and month, as in the names of the folders.
#[derive(Debug, Clone, PartialEq, Eq)]
struct RobotMonth {
    robot: String,
    month: String,
}

impl RobotMonth {
    fn of(robot: &Value, month: &Value) -> Self {
        Self {
            robot: robot.as_str().map_or_else(|| NULL.to_owned(), escaped),
            month: month.as_str().unwrap_or(NULL).to_owned(),
        }
    }

    fn file(&self, folder: &Path, name: &str) -> PathBuf {
        folder.join(format!("robot={}", self.robot)).join(format!("month={}", self.month)).join(name)
    }
}

/// A name as part of a path, escaped as Hive does.
fn escaped(name: &str) -> String {
    let is_plain = |of: char| !of.is_ascii() || of.is_ascii_alphanumeric() || "_-. ".contains(of);
    name.chars()
        .map(|of| if is_plain(of) { of.to_string() } else { format!("%{:02X}", u32::from(of)) })
        .collect()
}

/// The file of a month that is being written.
struct OpenMonth<'a> {
    part: RobotMonth,
    target: Target,
    sheet: Sheet<'a>,
}

/// A view to be divided.
pub(super) struct ByMonth<'a> {
    pub(super) view: &'a PublicView,
    /// Parent of the folders of robots.
    pub(super) folder: PathBuf,
    pub(super) format: SheetFormat,
    pub(super) filter: &'a RowFilter,
    /// True if files that are no exports are replaced.
    pub(super) force: bool,
}

impl ByMonth<'_> {
    /// Writes the files. `look` is called before each row.
    pub(super) async fn write(
        &self,
        reader: &mut ViewReader,
        look: &mut impl FnMut() -> Result<(), ExportError>,
    ) -> Result<Written, ExportError> {
        let Self { view, folder, format, filter, force } = self;
        let of_part = without_robot(view);
        let robot = view.columns.iter().position(|column| column.name == "robot").unwrap_or(0);
        let name = format!("{}.{}", view.name, format.suffix());
        let mut count = PartCount::default();
        let (mut bytes, mut kept) = (0, BTreeSet::new());
        let mut open: Option<OpenMonth<'_>> = None;
        let mut close = |open: Option<OpenMonth<'_>>, kept: &mut BTreeSet<PathBuf>| {
            let Some(OpenMonth { target, sheet, .. }) = open else { return Ok(()) };
            sheet.finish()?;
            bytes += target.sync()?;
            kept.insert(target.path().to_path_buf());
            if target.is_as_before()? {
                count.unchanged += 1;
                return Ok(());
            }
            count.written += 1;
            target.place()
        };
        let rows = reader.rows_by_month(view, filter, |row| {
            look()?;
            let (month, row) = row.split_last().unwrap_or((&Value::Null, row));
            let part = RobotMonth::of(&row[robot], month);
            if open.as_ref().is_none_or(|open| open.part != part) {
                close(open.take(), &mut kept)?;
                let path = part.file(folder, &name);
                format.check_is_ours(&of_part, &path, *force)?;
                let target = Target::open(&path)?;
                let sheet = Sheet::new(*format, &of_part, &target)?;
                open = Some(OpenMonth { part, target, sheet });
            }
            let columns = row[..robot].iter().chain(&row[robot + 1..]);
            open.as_mut().map_or(Ok(()), |open| open.sheet.add(columns))
        });
        let rows = rows.await?;
        close(open.take(), &mut kept)?;
        for path in self.earlier(&name)? {
            if !kept.contains(&path) {
                format.check_is_ours(&of_part, &path, *force)?;
                fs::remove_file(&path).map_err(|error| ExportError::of_file(&path, &error))?;
                count.removed += 1;
            }
        }
        Ok(Written { view: view.name.clone(), path: folder.clone(), rows, bytes, parts: Some(count) })
    }

    /// Files of earlier exports of a view, for the exported robots and months.
    fn earlier(&self, name: &str) -> Result<Vec<PathBuf>, ExportError> {
        let month = |time: Option<Timestamp>| time.map(|time| format!("{time:.3}")[..7].to_owned());
        let (since, until) = (month(self.filter.since), month(self.filter.until));
        let is_asked_robot = |name: &str| {
            self.filter.robots.is_empty() || self.filter.robots.iter().any(|of| escaped(of) == name)
        };
        let is_asked_month = |name: &str| {
            name == NULL
                || (since.as_deref().is_none_or(|since| name >= since)
                    && until.as_deref().is_none_or(|until| name < until))
        };
        let mut found = Vec::new();
        for (robot, path) in folders(&self.folder, "robot=")? {
            if !is_asked_robot(&robot) {
                continue;
            }
            for (month, path) in folders(&path, "month=")? {
                let path = path.join(name);
                if is_asked_month(&month) && existing(&path)?.is_some() {
                    found.push(path);
                }
            }
        }
        Ok(found)
    }
}

/// Folders in `folder` whose names begin with `begin`, each with the rest of its name; empty if `folder` does not
/// exist.
fn folders(folder: &Path, begin: &str) -> Result<Vec<(String, PathBuf)>, ExportError> {
    let failed = |error: std::io::Error| ExportError::of_file(folder, &error);
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(failed)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix(begin));
        found.extend(name.map(|name| (name.to_owned(), path.clone())));
    }
    Ok(found)
}

/// The view without the column that the folders contain.
fn without_robot(view: &PublicView) -> PublicView {
    let columns = view.columns.iter().filter(|column| column.name != "robot").cloned().collect();
    PublicView { columns, ..view.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_robots_are_escaped_as_in_hive() {
        assert_eq!(escaped("R01-b_2.x"), "R01-b_2.x");
        assert_eq!(escaped("Halle 3/Süd=%"), "Halle 3%2FSüd%3D%25");
        let part = RobotMonth::of(&Value::Null, &Value::Null);
        assert_eq!((part.robot.as_str(), part.month.as_str()), (NULL, NULL));
    }
}
