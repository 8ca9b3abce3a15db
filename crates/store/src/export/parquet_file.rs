//! Rows as Parquet: times as timestamps of UTC, units and meanings of columns in the metadata of fields and of the
//! file.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use jiff::civil::Date;
use jiff::{Timestamp, Unit};
use polars_core::prelude::{
    ArrowDataType, ArrowField, ArrowSchema, ArrowTimeUnit, ChunkedBuilder, Column, CompatLevel, DataFrame,
    Float64Type, Int32Type, Int64Type, IntoColumn, PlSmallStr, PolarsError, PolarsResult,
    PrimitiveChunkedBuilder, StringChunkedBuilder,
};
use polars_parquet::read::read_metadata;
use polars_parquet::write::{
    CompressionOptions, Encoding, FileWriter, KeyValue, StatisticsOptions, Version, WriteOptions,
    row_group_iter, schema_to_metadata_key,
};
use serde_json::{Value, json};

use super::error::ExportError;
use super::target;
use crate::{PublicView, ViewColumn};

/// Rows of a row group, which is in memory until it is complete: some tens of megabytes in the widest view.
const ROW_GROUP_ROWS: usize = 65_536;

/// Metadata of the file that names its view; only armwatch writes it.
const VIEW_KEY: &str = "armwatch.view";

/// A Parquet file that is being written.
pub(super) struct ParquetFile<'a> {
    view: &'a PublicView,
    path: PathBuf,
    writer: FileWriter<BufWriter<ParquetOutput>>,
    failure: Failure,
    columns: Vec<Cells>,
    rows: usize,
}

impl<'a> ParquetFile<'a> {
    pub(super) fn new(view: &'a PublicView, path: &Path, file: File) -> Result<Self, ExportError> {
        let failure = Failure::default();
        let output = BufWriter::new(ParquetOutput { file, failure: Arc::clone(&failure) });
        let schema: ArrowSchema =
            view.columns.iter().map(|column| (name_of(column), field(column))).collect();
        let options = WriteOptions {
            statistics: StatisticsOptions::default(),
            version: Version::V1,
            compression: CompressionOptions::Zstd(None),
            data_page_size: None,
        };
        let writer = FileWriter::try_new(output, schema, options)
            .map_err(|error| ExportError::of_file(path, &error))?;
        let columns = view.columns.iter().map(Cells::new).collect();
        Ok(Self { view, path: path.to_path_buf(), writer, failure, columns, rows: 0 })
    }

    pub(super) fn add<'r>(&mut self, row: impl Iterator<Item = &'r Value>) -> Result<(), ExportError> {
        for ((cells, value), described) in self.columns.iter_mut().zip(row).zip(&self.view.columns) {
            cells.add(value).map_err(|kind| ExportError::Value {
                view: self.view.name.clone(),
                column: described.name.clone(),
                value: value.to_string(),
                kind,
            })?;
        }
        self.rows += 1;
        if self.rows == ROW_GROUP_ROWS { self.hand_on() } else { Ok(()) }
    }

    pub(super) fn finish(mut self) -> Result<(), ExportError> {
        self.hand_on()?;
        let metadata = metadata(self.view, self.writer.schema());
        self.writer.end(Some(metadata)).map(|_| ()).map_err(|error| self.failed(&error))
    }

    fn hand_on(&mut self) -> Result<(), ExportError> {
        if self.rows == 0 {
            return Ok(());
        }
        let empty = self.view.columns.iter().map(Cells::new).collect();
        let full = std::mem::replace(&mut self.columns, empty);
        self.write_group(full).map_err(|error| self.failed(&error))
    }

    fn write_group(&mut self, columns: Vec<Cells>) -> PolarsResult<()> {
        let encodings = vec![vec![Encoding::RleDictionary]; columns.len()];
        let rows = DataFrame::new(self.rows, columns.into_iter().map(Cells::finish).collect())?;
        // one, since columns are not chunked
        for chunk in rows.iter_chunks(CompatLevel::newest(), false) {
            let types = self.writer.parquet_schema().fields().to_vec();
            let group = row_group_iter(chunk, encodings.clone().into(), types, self.writer.options());
            self.writer.write(self.rows as u64, group)?;
        }
        self.rows = 0;
        Ok(())
    }

    fn failed(&self, error: &PolarsError) -> ExportError {
        match self.failure.get() {
            Some(cause) => ExportError::of_file(&self.path, cause),
            None => ExportError::of_file(&self.path, error),
        }
    }
}

/// The first error of the system. The errors of polars only have its text, within a longer one.
type Failure = Arc<OnceLock<io::Error>>;

/// The file, with the reason if it could not be written.
struct ParquetOutput {
    file: File,
    failure: Failure,
}

impl Write for ParquetOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.file.write_all(bytes).map(|()| bytes.len());
        written.map_err(|error| {
            let kind = error.kind();
            self.failure.get_or_init(|| error);
            kind.into()
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// True if `path` is free or contains an export of the view, whose metadata names it.
pub(super) fn may_replace(view: &PublicView, path: &Path) -> Result<bool, ExportError> {
    let Some(mut file) = target::existing(path)? else { return Ok(true) };
    let Ok(metadata) = read_metadata(&mut file) else { return Ok(false) };
    let named = |pair: &KeyValue| pair.key == VIEW_KEY && pair.value.as_deref() == Some(&view.name);
    Ok(metadata.key_value_metadata().as_ref().is_some_and(|pairs| pairs.iter().any(named)))
}

fn name_of(column: &ViewColumn) -> PlSmallStr {
    column.name.as_str().into()
}

fn kind_of(column: &ViewColumn) -> ArrowDataType {
    match (column.kind.as_str(), column.unit.as_deref()) {
        ("integer", _) => ArrowDataType::Int64,
        ("real", _) => ArrowDataType::Float64,
        (_, Some("UTC")) => ArrowDataType::Timestamp(ArrowTimeUnit::Millisecond, Some("UTC".into())),
        (_, Some("UTC day")) => ArrowDataType::Date32,
        _ => ArrowDataType::Utf8,
    }
}

/// Every column may be NULL, since readers that join files of several exports need one schema.
fn field(column: &ViewColumn) -> ArrowField {
    let texts = [
        ("description", Some(&column.meaning)),
        ("null_when", column.null_when.as_ref()),
        ("unit", column.unit.as_ref()),
    ];
    let told = texts.into_iter().filter_map(|(key, text)| Some((key.into(), text?.as_str().into())));
    ArrowField::new(name_of(column), kind_of(column), true).with_metadata(told.collect())
}

/// The schema, also as JSON for programs that do not show the metadata of fields.
fn metadata(view: &PublicView, schema: &ArrowSchema) -> Vec<KeyValue> {
    let columns: Vec<Value> = view
        .columns
        .iter()
        .map(|column| {
            json!({"name": column.name, "type": column.kind, "unit": column.unit, "description": column.meaning,
                   "null_when": column.null_when})
        })
        .collect();
    let told = [
        (VIEW_KEY, view.name.clone()),
        ("armwatch.version", env!("CARGO_PKG_VERSION").to_owned()),
        ("armwatch.row_is", view.row_is.clone()),
        ("armwatch.columns", Value::from(columns).to_string()),
    ]
    .map(|(key, value)| KeyValue { key: key.to_owned(), value: Some(value) });
    [schema_to_metadata_key(schema)].into_iter().chain(told).collect()
}

/// Values of a column that are not written yet.
enum Cells {
    Integer(PrimitiveChunkedBuilder<Int64Type>),
    Real(PrimitiveChunkedBuilder<Float64Type>),
    Text(StringChunkedBuilder),
    Time(PrimitiveChunkedBuilder<Int64Type>),
    Day(PrimitiveChunkedBuilder<Int32Type>),
}

impl Cells {
    fn new(column: &ViewColumn) -> Self {
        let name = name_of(column);
        match kind_of(column) {
            ArrowDataType::Int64 => Self::Integer(PrimitiveChunkedBuilder::new(name, 0)),
            ArrowDataType::Float64 => Self::Real(PrimitiveChunkedBuilder::new(name, 0)),
            ArrowDataType::Date32 => Self::Day(PrimitiveChunkedBuilder::new(name, 0)),
            ArrowDataType::Timestamp(..) => Self::Time(PrimitiveChunkedBuilder::new(name, 0)),
            _ => Self::Text(StringChunkedBuilder::new(name, 0)),
        }
    }

    /// Fails with the expected kind of the value.
    fn add(&mut self, value: &Value) -> Result<(), &'static str> {
        let text = value.as_str();
        match (self, value) {
            (Self::Integer(of) | Self::Time(of), Value::Null) => of.append_null(),
            (Self::Real(of), Value::Null) => of.append_null(),
            (Self::Text(of), Value::Null) => of.append_null(),
            (Self::Day(of), Value::Null) => of.append_null(),
            (Self::Integer(of), _) => of.append_value(value.as_i64().ok_or("integer")?),
            (Self::Real(of), _) => of.append_value(value.as_f64().ok_or("number")?),
            (Self::Text(of), _) => of.append_value(text.ok_or("text")?),
            (Self::Time(of), _) => of.append_value(text.and_then(milliseconds).ok_or("time")?),
            (Self::Day(of), _) => of.append_value(text.and_then(days).ok_or("day")?),
        }
        Ok(())
    }

    /// The column; times and days are numbers, whose types are in the schema.
    fn finish(self) -> Column {
        match self {
            Self::Integer(of) | Self::Time(of) => of.finish().into_column(),
            Self::Real(of) => of.finish().into_column(),
            Self::Text(of) => of.finish().into_column(),
            Self::Day(of) => of.finish().into_column(),
        }
    }
}

fn milliseconds(text: &str) -> Option<i64> {
    text.parse::<Timestamp>().ok().map(Timestamp::as_millisecond)
}

/// Days since 1970-01-01.
fn days(text: &str) -> Option<i32> {
    let date: Date = text.parse().ok()?;
    Date::constant(1970, 1, 1).until((Unit::Day, date)).ok().map(|span| span.get_days())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_days_count_from_1970() {
        assert_eq!(milliseconds("1970-01-02T00:00:00.001Z"), Some(86_400_001));
        assert_eq!(milliseconds("2026-01-05T08:47:00.000Z"), Some(1_767_602_820_000));
        assert_eq!(days("1970-01-01"), Some(0));
        assert_eq!(days("2026-01-05"), Some(20_458));
        assert_eq!((milliseconds("yesterday"), days("")), (None, None));
    }

    #[test]
    fn a_value_of_another_type_is_no_value() {
        let cells = |kind: &str, unit: Option<&str>| {
            Cells::new(&ViewColumn {
                name: "of".into(),
                kind: kind.into(),
                unit: unit.map(str::to_owned),
                null_when: None,
                meaning: String::new(),
            })
        };
        assert_eq!(cells("integer", None).add(&json!(1.5)), Err("integer"));
        assert_eq!(cells("real", Some("Nm")).add(&json!("1.5")), Err("number"));
        assert_eq!(cells("real", Some("Nm")).add(&json!(2)), Ok(()));
        assert_eq!(cells("text", None).add(&json!(2)), Err("text"));
        assert_eq!(cells("text", Some("UTC")).add(&json!("today")), Err("time"));
        assert_eq!(cells("text", Some("UTC day")).add(&json!("2026-13-01")), Err("day"));
        assert_eq!(cells("text", Some("UTC day")).add(&Value::Null), Ok(()));
    }
}
