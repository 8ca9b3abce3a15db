//! Rows as Parquet: times as timestamps of UTC, units and meanings of columns in the metadata of fields and of the file.

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::builder::{
    Date32Builder, Float64Builder, Int64Builder, StringBuilder, TimestampMillisecondBuilder,
};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field, Schema, SchemaRef, TimeUnit};
use jiff::civil::Date;
use jiff::{Timestamp, Unit};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use serde_json::{Value, json};

use super::error::ExportError;
use super::target;
use crate::{PublicView, ViewColumn};

/// Rows that are handed on at once.
const BATCH_ROWS: usize = 8_192;

/// Rows of a row group, which is in memory, compressed, until it is whole: some megabytes.
const ROW_GROUP_ROWS: usize = 131_072;

/// Metadata of the file that names its view; no other program writes it.
const VIEW_KEY: &str = "armwatch.view";

/// A Parquet file that is being written.
pub(super) struct ParquetFile<'a> {
    view: &'a PublicView,
    path: PathBuf,
    schema: SchemaRef,
    writer: ArrowWriter<File>,
    columns: Vec<Column>,
    rows: usize,
}

impl<'a> ParquetFile<'a> {
    pub(super) fn new(view: &'a PublicView, path: &Path, file: File) -> Result<Self, ExportError> {
        let schema = Arc::new(Schema::new(view.columns.iter().map(field).collect::<Vec<_>>()));
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_max_row_group_row_count(Some(ROW_GROUP_ROWS))
            .set_key_value_metadata(Some(metadata(view)))
            .build();
        let writer = ArrowWriter::try_new(file, Arc::clone(&schema), Some(properties))
            .map_err(|error| failed(path, error))?;
        let columns = view.columns.iter().map(Column::new).collect();
        Ok(Self { view, path: path.to_path_buf(), schema, writer, columns, rows: 0 })
    }

    pub(super) fn add<'r>(&mut self, row: impl Iterator<Item = &'r Value>) -> Result<(), ExportError> {
        for ((column, value), described) in self.columns.iter_mut().zip(row).zip(&self.view.columns) {
            column.add(value).map_err(|kind| ExportError::Value {
                view: self.view.name.clone(),
                column: described.name.clone(),
                value: value.to_string(),
                kind,
            })?;
        }
        self.rows += 1;
        if self.rows == BATCH_ROWS { self.hand_on() } else { Ok(()) }
    }

    pub(super) fn finish(mut self) -> Result<(), ExportError> {
        self.hand_on()?;
        self.writer.close().map(|_| ()).map_err(|error| failed(&self.path, error))
    }

    fn hand_on(&mut self) -> Result<(), ExportError> {
        if self.rows == 0 {
            return Ok(());
        }
        self.rows = 0;
        let arrays = self.columns.iter_mut().map(Column::take).collect();
        let batch = RecordBatch::try_new(Arc::clone(&self.schema), arrays).map_err(ParquetError::from);
        let written = batch.and_then(|batch| self.writer.write(&batch));
        written.map_err(|error| failed(&self.path, error))
    }
}

/// Whether nothing else lies at `path` than an export of the view: its metadata names it.
pub(super) fn may_replace(view: &PublicView, path: &Path) -> Result<bool, ExportError> {
    let Some(file) = target::existing(path)? else { return Ok(true) };
    let Ok(reader) = SerializedFileReader::new(file) else { return Ok(false) };
    let named = |pair: &KeyValue| pair.key == VIEW_KEY && pair.value.as_deref() == Some(&view.name);
    Ok(reader.metadata().file_metadata().key_value_metadata().is_some_and(|pairs| pairs.iter().any(named)))
}

/// Every column may be NULL, whatever is said of it: readers that join files of several exports want one schema.
fn field(column: &ViewColumn) -> Field {
    let texts = [("unit", &column.unit), ("null_when", &column.null_when)];
    let mut told: HashMap<String, String> =
        texts.iter().filter_map(|(key, text)| Some(((*key).to_owned(), text.as_ref()?.clone()))).collect();
    told.insert("description".into(), column.meaning.clone());
    Field::new(&column.name, kind_of(column), true).with_metadata(told)
}

fn kind_of(column: &ViewColumn) -> DataType {
    match (column.kind.as_str(), column.unit.as_deref()) {
        ("integer", _) => DataType::Int64,
        ("real", _) => DataType::Float64,
        (_, Some("UTC")) => DataType::Timestamp(TimeUnit::Millisecond, Some("UTC".into())),
        (_, Some("UTC day")) => DataType::Date32,
        _ => DataType::Utf8,
    }
}

/// For programs that do not show the metadata of fields.
fn metadata(view: &PublicView) -> Vec<KeyValue> {
    let columns: Vec<Value> = view
        .columns
        .iter()
        .map(|column| {
            json!({"name": column.name, "type": column.kind, "unit": column.unit, "description": column.meaning,
                   "null_when": column.null_when})
        })
        .collect();
    [
        (VIEW_KEY, view.name.clone()),
        ("armwatch.version", env!("CARGO_PKG_VERSION").to_owned()),
        ("armwatch.row_is", view.row_is.clone()),
        ("armwatch.columns", Value::from(columns).to_string()),
    ]
    .map(|(key, value)| KeyValue::new(key.to_owned(), value))
    .into()
}

fn failed(path: &Path, error: ParquetError) -> ExportError {
    match error {
        ParquetError::External(cause) => ExportError::of_file(path, &cause),
        error => ExportError::of_file(path, &error),
    }
}

/// Values of a column that are not handed on yet.
enum Column {
    Integer(Int64Builder),
    Real(Float64Builder),
    Text(StringBuilder),
    Time(TimestampMillisecondBuilder),
    Day(Date32Builder),
}

impl Column {
    fn new(column: &ViewColumn) -> Self {
        match kind_of(column) {
            DataType::Int64 => Self::Integer(Int64Builder::new()),
            DataType::Float64 => Self::Real(Float64Builder::new()),
            DataType::Date32 => Self::Day(Date32Builder::new()),
            DataType::Timestamp(..) => Self::Time(TimestampMillisecondBuilder::new().with_timezone("UTC")),
            _ => Self::Text(StringBuilder::new()),
        }
    }

    /// Fails with what the value should be.
    fn add(&mut self, value: &Value) -> Result<(), &'static str> {
        let text = value.as_str();
        match (self, value) {
            (Self::Integer(of), Value::Null) => of.append_null(),
            (Self::Real(of), Value::Null) => of.append_null(),
            (Self::Text(of), Value::Null) => of.append_null(),
            (Self::Time(of), Value::Null) => of.append_null(),
            (Self::Day(of), Value::Null) => of.append_null(),
            (Self::Integer(of), _) => of.append_value(value.as_i64().ok_or("integer")?),
            (Self::Real(of), _) => of.append_value(value.as_f64().ok_or("number")?),
            (Self::Text(of), _) => of.append_value(text.ok_or("text")?),
            (Self::Time(of), _) => of.append_value(text.and_then(milliseconds).ok_or("time")?),
            (Self::Day(of), _) => of.append_value(text.and_then(days).ok_or("day")?),
        }
        Ok(())
    }

    fn take(&mut self) -> ArrayRef {
        match self {
            Self::Integer(of) => Arc::new(of.finish()),
            Self::Real(of) => Arc::new(of.finish()),
            Self::Text(of) => Arc::new(of.finish()),
            Self::Time(of) => Arc::new(of.finish()),
            Self::Day(of) => Arc::new(of.finish()),
        }
    }
}

fn milliseconds(text: &str) -> Option<i64> {
    text.parse::<Timestamp>().ok().map(Timestamp::as_millisecond)
}

/// Since 1970-01-01.
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
        let column = |kind: &str, unit: Option<&str>| {
            Column::new(&ViewColumn {
                name: "of".into(),
                kind: kind.into(),
                unit: unit.map(str::to_owned),
                null_when: None,
                meaning: String::new(),
            })
        };
        assert_eq!(column("integer", None).add(&json!(1.5)), Err("integer"));
        assert_eq!(column("real", Some("Nm")).add(&json!("1.5")), Err("number"));
        assert_eq!(column("real", Some("Nm")).add(&json!(2)), Ok(()));
        assert_eq!(column("text", None).add(&json!(2)), Err("text"));
        assert_eq!(column("text", Some("UTC")).add(&json!("today")), Err("time"));
        assert_eq!(column("text", Some("UTC day")).add(&json!("2026-13-01")), Err("day"));
        assert_eq!(column("text", Some("UTC day")).add(&Value::Null), Ok(()));
    }
}
