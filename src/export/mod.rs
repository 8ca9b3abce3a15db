//! Public views to files: CSV and Parquet, for programs that do not read SQLite.
//!
//! All files of an export are of one moment of the database. They get their names together, once all are whole. Rows are
//! written as they come, so memory does not depend on how many there are.

mod error;
mod csv_file;
mod parquet_file;
mod target;

pub use error::ExportError;

use std::path::PathBuf;

use serde_json::Value;
use tokio_util::sync::CancellationToken;

use self::csv_file::CsvFile;
use self::parquet_file::ParquetFile;
use self::target::Target;
use crate::store::{PublicView, RowFilter, Store};

/// Rows between two looks at whether to stop.
const ROWS_A_LOOK: u64 = 1024;

/// Robots that a message lists at most.
const LISTED_ROBOTS: usize = 20;

/// How rows are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Text, a line a row.
    Csv,
    /// Columns with types, compressed by zstd.
    Parquet,
}

impl Format {
    /// How names of such files end.
    #[must_use]
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
        }
    }
}

/// A view and the file that it goes to.
#[derive(Debug, Clone)]
pub struct Destination {
    /// The view.
    pub view: &'static PublicView,
    /// The file.
    pub path: PathBuf,
}

/// What is exported.
#[derive(Debug, Clone)]
pub struct Export {
    /// Views and their files.
    pub destinations: Vec<Destination>,
    /// How rows are written.
    pub format: Format,
    /// Which rows.
    pub filter: RowFilter,
    /// Whether files that are no exports are replaced.
    pub force: bool,
}

/// A file that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// The view.
    pub view: String,
    /// The file.
    pub path: PathBuf,
    /// Its rows.
    pub rows: u64,
    /// Its bytes.
    pub bytes: u64,
}

/// How far an export is.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
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
    /// [`ExportError`]; no file then has changed, unless the last step failed: giving the files their names.
    pub async fn write(
        &self,
        store: &Store,
        stop: &CancellationToken,
        mut progress: impl FnMut(Progress<'_>),
    ) -> Result<Vec<Written>, ExportError> {
        for Destination { view, path } in self.destinations.iter().filter(|_| !self.force) {
            let may_replace = match self.format {
                Format::Csv => csv_file::may_replace(view, path)?,
                Format::Parquet => parquet_file::may_replace(view, path)?,
            };
            if !may_replace {
                return Err(ExportError::Foreign { path: path.clone(), view: view.name.clone() });
            }
        }
        let mut reader = store.read_views().await?;
        let known = reader.robots().await?;
        if let Some(name) = self.filter.robots.iter().find(|name| !known.contains(name)) {
            return Err(ExportError::NoRobot { name: name.clone(), known: told(&known) });
        }
        let (mut targets, mut written) = (Vec::new(), Vec::new());
        for (views_done, Destination { view, path }) in self.destinations.iter().enumerate() {
            let target = Target::open(path)?;
            let mut sheet = Sheet::new(self.format, view, &target)?;
            let mut count = 0;
            let rows = reader.rows(view, &self.filter, |row| {
                if count % ROWS_A_LOOK == 0 {
                    progress(Progress { view: &view.name, views_done, rows: count });
                    if stop.is_cancelled() {
                        return Err(ExportError::Stopped);
                    }
                }
                count += 1;
                sheet.add(row)
            });
            let rows = rows.await?;
            sheet.finish()?;
            let bytes = target.sync()?;
            written.push(Written { view: view.name.clone(), path: path.clone(), rows, bytes });
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
}

/// A file in one of the formats.
enum Sheet<'a> {
    Csv(Box<CsvFile<'a>>),
    Parquet(Box<ParquetFile<'a>>),
}

impl<'a> Sheet<'a> {
    fn new(format: Format, view: &'a PublicView, target: &'a Target) -> Result<Self, ExportError> {
        let (path, file) = (target.path(), target.file()?);
        Ok(match format {
            Format::Csv => Self::Csv(Box::new(CsvFile::new(view, path, file)?)),
            Format::Parquet => Self::Parquet(Box::new(ParquetFile::new(view, path, file)?)),
        })
    }

    fn add(&mut self, row: &[Value]) -> Result<(), ExportError> {
        match self {
            Self::Csv(file) => file.add(row),
            Self::Parquet(file) => file.add(row),
        }
    }

    fn finish(self) -> Result<(), ExportError> {
        match self {
            Self::Csv(file) => file.finish(),
            Self::Parquet(file) => file.finish(),
        }
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
