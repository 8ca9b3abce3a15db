//! Rows as CSV: a header, numbers with every digit and always the same text for the same number, NULL as an empty cell.

use std::fs::File;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::error::ExportError;
use super::target;
use crate::PublicView;

/// Bytes per write.
const BUFFER_BYTES: usize = 1 << 18;

/// A CSV file that is being written.
pub(super) struct CsvFile {
    path: PathBuf,
    writer: csv::Writer<File>,
}

impl CsvFile {
    pub(super) fn new(view: &PublicView, path: &Path, file: File) -> Result<Self, ExportError> {
        let mut writer = csv::WriterBuilder::new().buffer_capacity(BUFFER_BYTES).from_writer(file);
        writer
            .write_record(view.columns.iter().map(|column| &column.name))
            .map_err(|error| ExportError::of_file(path, &cause(error)))?;
        Ok(Self { path: path.to_path_buf(), writer })
    }

    pub(super) fn add<'r>(&mut self, row: impl Iterator<Item = &'r Value>) -> Result<(), ExportError> {
        let path = &self.path;
        let failed = |error| ExportError::of_file(path, &cause(error));
        for value in row {
            match value {
                Value::Null => self.writer.write_field(""),
                Value::String(text) => self.writer.write_field(text),
                number => self.writer.write_field(number.to_string()),
            }
            .map_err(failed)?;
        }
        self.writer.write_record(None::<&[u8]>).map_err(failed)
    }

    pub(super) fn finish(mut self) -> Result<(), ExportError> {
        self.writer.flush().map_err(|error| ExportError::of_file(&self.path, &error))
    }
}

/// True if `path` is free or contains an export of the view: its first line names the columns.
pub(super) fn may_replace(view: &PublicView, path: &Path) -> Result<bool, ExportError> {
    let names: Vec<&str> = view.columns.iter().map(|column| column.name.as_str()).collect();
    target::begins_with(path, format!("{}\n", names.join(",")).as_bytes())
}

/// The error of the system, in a message that does not mention CSV.
fn cause(error: csv::Error) -> Box<dyn std::fmt::Display> {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => Box::new(error),
        other => Box::new(format!("{other:?}")),
    }
}
