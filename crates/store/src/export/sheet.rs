//! A file of rows in one of the formats, and the report on it.

use std::path::{Path, PathBuf};

use serde::{Serialize, Serializer};
use serde_json::Value;

use super::csv_file::{self, CsvFile};
use super::error::ExportError;
use super::parquet_file::{self, ParquetFile};
use super::target::Target;
use crate::PublicView;

/// Format of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SheetFormat {
    /// Text, one line per row.
    Csv,
    /// Columns with types, compressed by zstd.
    Parquet,
}

impl SheetFormat {
    /// Ending of the file names.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
        }
    }

    /// Fails if something else than an export of the view is at `path`, except with `force`.
    pub(super) fn check_is_ours(
        self,
        view: &PublicView,
        path: &Path,
        force: bool,
    ) -> Result<(), ExportError> {
        let may_replace = match self {
            _ if force => true,
            Self::Csv => csv_file::may_replace(view, path)?,
            Self::Parquet => parquet_file::may_replace(view, path)?,
        };
        if may_replace {
            return Ok(());
        }
        Err(ExportError::Foreign { path: path.to_path_buf(), view: view.name.clone() })
    }
}

/// A file that was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Written {
    /// The view.
    pub view: String,
    /// The file.
    #[serde(rename = "file", serialize_with = "shown")]
    pub path: PathBuf,
    /// Its rows.
    pub rows: u64,
    /// Its bytes.
    pub bytes: u64,
    /// For a divided view: its files that were written, removed, or left unchanged.
    pub parts: Option<PartCount>,
}

fn shown<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Counts of the files of a divided view.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct PartCount {
    /// Files that are new or have other rows than before.
    pub written: u64,
    /// Files with the same rows as before; they were not touched.
    pub unchanged: u64,
    /// Files without rows, which were deleted.
    pub removed: u64,
}

/// A file in one of the formats.
pub(super) enum Sheet<'a> {
    Csv(Box<CsvFile>),
    Parquet(Box<ParquetFile<'a>>),
}

impl<'a> Sheet<'a> {
    pub(super) fn new(
        format: SheetFormat,
        view: &'a PublicView,
        target: &Target,
    ) -> Result<Self, ExportError> {
        let (path, file) = (target.path(), target.file()?);
        Ok(match format {
            SheetFormat::Csv => Self::Csv(Box::new(CsvFile::new(view, path, file)?)),
            SheetFormat::Parquet => Self::Parquet(Box::new(ParquetFile::new(view, path, file)?)),
        })
    }

    pub(super) fn add<'r>(&mut self, row: impl Iterator<Item = &'r Value>) -> Result<(), ExportError> {
        match self {
            Self::Csv(file) => file.add(row),
            Self::Parquet(file) => file.add(row),
        }
    }

    pub(super) fn finish(self) -> Result<(), ExportError> {
        match self {
            Self::Csv(file) => file.finish(),
            Self::Parquet(file) => file.finish(),
        }
    }
}
