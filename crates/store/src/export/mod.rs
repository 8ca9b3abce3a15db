//! Export of public views to CSV and Parquet, for programs that do not read SQLite.
//!
//! All files of an export show one moment of the database. They get their names together, once all are complete. Rows
//! are written as they are read, so memory does not depend on their number. `by_month` describes the differences for a
//! view that is divided by robot and month.

mod by_month;
mod error;
mod csv_file;
mod parquet_file;
mod sheet;
mod target;

pub use error::ExportError;
pub use sheet::{PartCount, SheetFormat, Written};

use std::path::PathBuf;

use tokio_util::sync::CancellationToken;

use self::by_month::{ByMonth, has_months};
use self::sheet::Sheet;
use self::target::Target;
use crate::{PublicView, RowFilter, Store};

/// Rows between two checks for a stop.
const ROWS_A_LOOK: u64 = 1024;

/// Most robots listed in a message.
const LISTED_ROBOTS: usize = 20;

/// A view and its file.
#[derive(Debug, Clone)]
pub struct Destination {
    /// The view.
    pub view: &'static PublicView,
    /// The file; for a divided view, the folder has its name without the ending.
    pub path: PathBuf,
}

/// An export of views.
#[derive(Debug, Clone)]
pub struct Export {
    /// Views and their files.
    pub destinations: Vec<Destination>,
    /// Format of rows.
    pub format: SheetFormat,
    /// Selection of rows.
    pub filter: RowFilter,
    /// True if files that are no exports are replaced.
    pub force: bool,
    /// True if views with the rows of runs are divided by robot and month, each into a folder instead of its file.
    pub by_month: bool,
}

/// Progress of an export.
#[derive(Debug, Clone, Copy)]
pub struct ExportProgress<'a> {
    /// The view that is being written.
    pub view: &'a str,
    /// Views before it.
    pub views_done: usize,
    /// Its rows so far.
    pub rows: u64,
}

impl Export {
    /// Reads the views and writes their files.
    ///
    /// # Errors
    /// [`ExportError`]; no file has changed then, unless the last step failed, the renaming of the files.
    pub async fn write(
        &self,
        store: &Store,
        stop: &CancellationToken,
        mut progress: impl FnMut(ExportProgress<'_>),
    ) -> Result<Vec<Written>, ExportError> {
        for Destination { view, path } in self.destinations.iter().filter(|of| !self.is_divided(of.view)) {
            self.format.check_is_ours(view, path, self.force)?;
        }
        let mut reader = store.read_views().await?;
        let known = reader.robots().await?;
        if let Some(name) = self.filter.robots.iter().find(|name| !known.contains(name)) {
            return Err(ExportError::NoRobot { name: name.clone(), known: told(&known) });
        }
        let (mut targets, mut written) = (Vec::new(), Vec::new());
        for (views_done, Destination { view, path }) in self.destinations.iter().enumerate() {
            let mut count = 0;
            let mut look = || {
                if count % ROWS_A_LOOK == 0 {
                    progress(ExportProgress { view: &view.name, views_done, rows: count });
                    if stop.is_cancelled() {
                        return Err(ExportError::Stopped);
                    }
                }
                count += 1;
                Ok(())
            };
            if self.is_divided(view) {
                let folder = path.with_extension("");
                let months =
                    ByMonth { view, folder, format: self.format, filter: &self.filter, force: self.force };
                written.push(months.write(&mut reader, &mut look).await?);
                continue;
            }
            let target = Target::open(path)?;
            let mut sheet = Sheet::new(self.format, view, &target)?;
            let rows = reader.rows(view, &self.filter, |row| {
                look()?;
                sheet.add(row.iter())
            });
            let rows = rows.await?;
            sheet.finish()?;
            let bytes = target.sync()?;
            written.push(Written { view: view.name.clone(), path: path.clone(), rows, bytes, parts: None });
            targets.push(target);
        }
        if stop.is_cancelled() {
            return Err(ExportError::Stopped);
        }
        for target in targets {
            target.place()?;
        }
        Ok(written)
    }

    fn is_divided(&self, view: &PublicView) -> bool {
        self.by_month && has_months(view)
    }
}

fn told(robots: &[String]) -> String {
    let more = robots.len().saturating_sub(LISTED_ROBOTS);
    let listed = robots[..robots.len() - more].join(", ");
    match (robots, more) {
        ([], _) => "none is stored yet".into(),
        (_, 0) => format!("there are {listed}"),
        _ => format!("there are {listed} and {more} more, which `armwatch robots` lists"),
    }
}
