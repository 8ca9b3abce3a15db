//! Parquet exports as the text of a CSV file, so that the same reader checks the rows of both.
//!
//! Rows are decoded page by page, since a writer may put a whole recording into one row group. polars trusts the sizes
//! that a file states and panics on some damaged pages, so sizes are bounded before it sees them.

use std::cell::Cell;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Cursor, Read, Write};
use std::os::unix::fs::FileExt;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::sync::Once;
use std::time::SystemTime;

use jiff::Timestamp;
use polars_arrow::array::{Array, BooleanArray, PrimitiveArray, StaticArray, Utf8ViewArray};
use polars_arrow::datatypes::{ArrowDataType, Field};
use polars_arrow::types::NativeType;
use polars_buffer::Buffer;
use polars_parquet::parquet::compression::Compression;
use polars_parquet::parquet::metadata::{ColumnChunkMetadata, ColumnDescriptor, FileMetadata};
use polars_parquet::parquet::page::CompressedPage;
use polars_parquet::parquet::read::{BasicDecompressor, PageMetaData, PageReader, deserialize_metadata};
use polars_parquet::parquet::schema::types::{
    IntegerType, PhysicalType, PrimitiveConvertedType, PrimitiveLogicalType, TimeUnit,
};
use polars_parquet::read::column_iter_to_arrays;

use super::access::asking;
use super::fingerprint::{HashingReader, RunningHash, changed_at};
use super::source::unreadable;
use super::thrift;
use crate::rejection::Rejection;

/// First and last bytes of a Parquet file.
pub(super) const MAGIC: [u8; 4] = *b"PAR1";

/// Bytes after the metadata: their length, and [`MAGIC`].
const FOOTER_BYTES: u64 = 8;

/// Most bytes of metadata. A thousand row groups of two hundred columns have some 20 MiB.
const MOST_METADATA_BYTES: u64 = 32 << 20;

/// Most bytes of a page, compressed or not. Writers make pages of 1 MiB.
const MOST_PAGE_BYTES: usize = 64 << 20;

/// Most rows of a page: a repeated value takes no space, so that bytes do not bound the rows.
const MOST_PAGE_ROWS: usize = 4 << 20;

/// Bytes of a page that are read first.
const FIRST_PAGE_BYTES: u64 = 64 << 10;

/// Bytes that are read at once for the hash.
const HASHED_BYTES: usize = 1 << 20;

/// Rows that become text at once.
const ROWS_AT_ONCE: usize = 1024;

/// The cells of a column whose type is not read: a layout that names it fails with this text.
const NOT_READ: &str = "(an unsupported type)";

const REMEDY: &str = "copy the export again, or write it again";

/// The rows of a Parquet file as CSV.
pub(super) struct ParquetText {
    file: File,
    metadata: FileMetadata,
    /// Size and time of the last change when the file was hashed.
    state: (u64, SystemTime),
    columns: Vec<CellForm>,
    /// Number of the next row group, from 0.
    next_group: usize,
    /// Rows that the current group still has.
    rows_left: usize,
    chunks: Vec<ColumnChunk>,
    text: VecDeque<u8>,
}

/// Conversion of a column's values to cells.
#[derive(Debug, Clone, Copy, PartialEq)]
enum CellForm {
    Double,
    Float,
    Int32,
    Int64,
    UInt32,
    UInt64,
    Boolean,
    Text,
    /// Units since 1970 per second, and true if they count from UTC.
    Moment(i128, bool),
    Other,
}

impl ParquetText {
    /// Opens a file and hashes all of it: its metadata is at its end, so that no part of it can be read alone.
    ///
    /// # Errors
    /// A rejection of a file whose metadata cannot be read.
    pub(super) fn open(file: File, path: &Path) -> Result<(Self, RunningHash), Rejection> {
        let failed = |error: io::Error| Rejection::from_io(path, &error);
        let state = state(&file).map_err(failed)?;
        let (mut hashed, hash) = HashingReader::new(&file);
        let mut buffer = vec![0; HASHED_BYTES];
        while hashed.read(&mut buffer).map_err(failed)? > 0 {}
        let metadata = metadata(&file, state.0).map_err(failed)?;
        let columns = metadata.schema_descr.columns();
        let names = columns.iter().map(|column| {
            column.path_in_schema.iter().map(|part| part.as_str()).collect::<Vec<&str>>().join(".")
        });
        let mut text = VecDeque::new();
        for (at, name) in names.enumerate() {
            separate(&mut text, at);
            write_text(&mut text, &name);
        }
        text.push_back(b'\n');
        let columns = columns.iter().map(CellForm::of).collect();
        let text =
            Self { file, metadata, state, columns, next_group: 0, rows_left: 0, chunks: Vec::new(), text };
        Ok((text, hash))
    }

    /// Converts the next rows to text; `false` at the end.
    fn fill(&mut self) -> io::Result<bool> {
        while self.rows_left == 0 {
            let Some(group) = self.metadata.row_groups.get(self.next_group) else {
                return self.refuse_change().map(|()| false);
            };
            self.next_group += 1;
            self.rows_left = group.num_rows();
            let chunks = group.parquet_columns();
            if chunks.len() != self.columns.len() {
                return Err(damaged("has a row group without all columns"));
            }
            let chunk = |(chunk, form): (&ColumnChunkMetadata, &CellForm)| {
                ColumnChunk::new(chunk, *form, self.state.0)
            };
            self.chunks = chunks.iter().zip(&self.columns).map(chunk).collect::<io::Result<_>>()?;
        }
        let mut rows = self.rows_left.min(ROWS_AT_ONCE);
        for chunk in self.chunks.iter_mut().filter(|chunk| chunk.form != CellForm::Other) {
            rows = rows.min(chunk.ready(&self.file, self.rows_left)?);
        }
        for row in 0..rows {
            for (at, chunk) in self.chunks.iter().enumerate() {
                separate(&mut self.text, at);
                chunk.write(row, &mut self.text);
            }
            self.text.push_back(b'\n');
        }
        self.chunks.iter_mut().for_each(|chunk| chunk.pass(rows));
        self.rows_left -= rows;
        Ok(true)
    }

    fn refuse_change(&self) -> io::Result<()> {
        if state(&self.file)? == self.state {
            return Ok(());
        }
        let reason = "a Parquet file that changed while it was read";
        Err(unreadable(reason.to_owned(), "wait until the writer has finished, or export again"))
    }
}

impl Read for ParquetText {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.text.is_empty() && self.fill()? {}
        self.text.read(buffer)
    }
}

impl CellForm {
    fn of(column: &ColumnDescriptor) -> Self {
        let kind = &column.descriptor.primitive_type;
        if column.path_in_schema.len() > 1 || column.descriptor.max_rep_level > 0 {
            return Self::Other;
        }
        let per_second = |unit| match unit {
            TimeUnit::Milliseconds => 1_000,
            TimeUnit::Microseconds => 1_000_000,
            TimeUnit::Nanoseconds => 1_000_000_000,
        };
        match (kind.physical_type, kind.logical_type, kind.converted_type) {
            (PhysicalType::Int64, Some(PrimitiveLogicalType::Timestamp { unit, is_adjusted_to_utc }), _) => {
                Self::Moment(per_second(unit), is_adjusted_to_utc)
            }
            (PhysicalType::Int64, None, Some(PrimitiveConvertedType::TimestampMillis)) => {
                Self::Moment(1_000, true)
            }
            (PhysicalType::Int64, None, Some(PrimitiveConvertedType::TimestampMicros)) => {
                Self::Moment(1_000_000, true)
            }
            (_, Some(PrimitiveLogicalType::Decimal(..) | PrimitiveLogicalType::Date), _)
            | (_, None, Some(PrimitiveConvertedType::Decimal(..) | PrimitiveConvertedType::Date)) => {
                Self::Other
            }
            (PhysicalType::Double, ..) => Self::Double,
            (PhysicalType::Float, ..) => Self::Float,
            (PhysicalType::Boolean, ..) => Self::Boolean,
            (PhysicalType::Int32, Some(PrimitiveLogicalType::Integer(IntegerType::UInt32)), _)
            | (PhysicalType::Int32, None, Some(PrimitiveConvertedType::Uint32)) => Self::UInt32,
            (PhysicalType::Int64, Some(PrimitiveLogicalType::Integer(IntegerType::UInt64)), _)
            | (PhysicalType::Int64, None, Some(PrimitiveConvertedType::Uint64)) => Self::UInt64,
            (PhysicalType::Int32, ..) => Self::Int32,
            (PhysicalType::Int64, ..) => Self::Int64,
            (PhysicalType::ByteArray, Some(PrimitiveLogicalType::String | PrimitiveLogicalType::Enum), _)
            | (
                PhysicalType::ByteArray,
                None,
                Some(PrimitiveConvertedType::Utf8 | PrimitiveConvertedType::Enum),
            ) => Self::Text,
            _ => Self::Other,
        }
    }

    fn arrow(self) -> ArrowDataType {
        match self {
            Self::Double => ArrowDataType::Float64,
            Self::Float => ArrowDataType::Float32,
            Self::Int32 => ArrowDataType::Int32,
            Self::UInt32 => ArrowDataType::UInt32,
            Self::Int64 | Self::Moment(..) => ArrowDataType::Int64,
            Self::UInt64 => ArrowDataType::UInt64,
            Self::Boolean => ArrowDataType::Boolean,
            Self::Text | Self::Other => ArrowDataType::Utf8View,
        }
    }
}

/// The values of a column in a row group.
struct ColumnChunk {
    form: CellForm,
    /// The column in the form that polars needs.
    pages: PageMetaData,
    /// Position of the next page in the file, and the end of the last one.
    at: u64,
    end: u64,
    /// The bytes of the dictionary's page.
    dictionary: Vec<u8>,
    arrays: VecDeque<Box<dyn Array>>,
    /// Values of the first array that were converted to text.
    passed: usize,
}

impl ColumnChunk {
    fn new(chunk: &ColumnChunkMetadata, form: CellForm, file_bytes: u64) -> io::Result<Self> {
        let first = chunk.dictionary_page_offset().unwrap_or_else(|| chunk.data_page_offset());
        let at = u64::try_from(first).ok();
        let end =
            at.zip(u64::try_from(chunk.compressed_size()).ok()).and_then(|(at, size)| at.checked_add(size));
        let (Some(at), Some(end)) = (at, end.filter(|end| *end <= file_bytes)) else {
            return Err(damaged("has a column that lies outside the file"));
        };
        let readable =
            [Compression::Uncompressed, Compression::Snappy, Compression::Zstd, Compression::Lz4Raw];
        if form != CellForm::Other && !readable.contains(&chunk.compression()) {
            let reason =
                format!("a Parquet file with {:?} compression, which is not supported", chunk.compression());
            return Err(unreadable(reason, "write it with zstd, snappy, LZ4_RAW or without compression"));
        }
        let descriptor = chunk.descriptor().descriptor.clone();
        let pages = PageMetaData::new(at, 0, chunk.compression(), descriptor);
        Ok(Self { form, pages, at, end, dictionary: Vec::new(), arrays: VecDeque::new(), passed: 0 })
    }

    /// Decodes the next page if no value is left; returns the number of ready values, at least one.
    fn ready(&mut self, file: &File, rows_left: usize) -> io::Result<usize> {
        loop {
            match self.arrays.front() {
                Some(array) if array.len() > self.passed => return Ok(array.len() - self.passed),
                Some(_) => {
                    self.arrays.pop_front();
                    self.passed = 0;
                }
                None => self.arrays = self.next_page(file, rows_left)?,
            }
        }
    }

    /// The values of the next page.
    fn next_page(&mut self, file: &File, rows_left: usize) -> io::Result<VecDeque<Box<dyn Array>>> {
        loop {
            let (page, bytes) = self.page_bytes(file)?;
            self.at += bytes.len() as u64;
            let CompressedPage::Data(page) = page else {
                self.dictionary = bytes;
                continue;
            };
            let rows = page.num_values();
            if page.uncompressed_size() > MOST_PAGE_BYTES || rows > rows_left.min(MOST_PAGE_ROWS) {
                return Err(damaged(&format!(
                    "has a page of {rows} rows in {} bytes",
                    page.uncompressed_size()
                )));
            }
            drop(page);
            let arrays = self.decoded([self.dictionary.as_slice(), &bytes].concat(), rows)?;
            if arrays.iter().map(|array| array.len()).sum::<usize>() != rows {
                return Err(damaged("has a page with fewer values than rows"));
            }
            if rows > 0 {
                return Ok(arrays);
            }
        }
    }

    /// The next page and its bytes in the file. Its header has no fixed length, so more is read until the page is
    /// whole.
    fn page_bytes(&self, file: &File) -> io::Result<(CompressedPage, Vec<u8>)> {
        let left = self.end - self.at;
        let mut size = FIRST_PAGE_BYTES.min(left);
        loop {
            let mut bytes = vec![0; usize::try_from(size).unwrap_or(MOST_PAGE_BYTES)];
            asking(|| file.read_exact_at(&mut bytes, self.at))?;
            let pages = PageMetaData { num_values: 1, ..self.pages.clone() };
            let found = guarded(|| {
                let cursor = Cursor::new(Buffer::from_vec(bytes.clone()));
                let mut reader = PageReader::new_with_page_meta(cursor, pages, Vec::new(), MOST_PAGE_BYTES);
                let page = reader.next().transpose().map_err(|error| error.to_string())?;
                Ok(page.map(|page| (page, reader.into_inner().0.position())))
            });
            match found {
                Ok(Some((page, length))) => {
                    bytes.truncate(usize::try_from(length).unwrap_or(0));
                    return Ok((page, bytes));
                }
                Err(_) if size < left && size < MOST_PAGE_BYTES as u64 => size = (8 * size).min(left),
                Ok(None) => return Err(damaged("has fewer values than rows")),
                Err(error) => return Err(error),
            }
        }
    }

    /// Decodes the bytes of a page after those of its dictionary.
    fn decoded(&self, bytes: Vec<u8>, rows: usize) -> io::Result<VecDeque<Box<dyn Array>>> {
        let pages = PageMetaData { num_values: rows as i64, ..self.pages.clone() };
        let kind = pages.descriptor.primitive_type.clone();
        let field = Field::new(kind.field_info.name.clone(), self.form.arrow(), true);
        guarded(|| {
            let cursor = Cursor::new(Buffer::from_vec(bytes));
            let reader = PageReader::new_with_page_meta(cursor, pages, Vec::new(), MOST_PAGE_BYTES);
            let decompressor = BasicDecompressor::new(reader, Vec::new());
            let arrays = column_iter_to_arrays(vec![decompressor], vec![&kind], field, None);
            arrays.map(|(arrays, _)| arrays.into()).map_err(|error| error.to_string())
        })
    }

    /// Writes the value `row` rows further on; writes nothing for a missing one.
    fn write(&self, row: usize, text: &mut VecDeque<u8>) {
        let row = self.passed + row;
        let Some(array) = self.arrays.front() else {
            text.extend(NOT_READ.as_bytes());
            return;
        };
        let array = &**array;
        // writing to memory does not fail
        let _ = match self.form {
            // the debug form has an exponent if that is shorter
            CellForm::Double => number::<f64>(array, row).map(|value| write!(text, "{value:?}")),
            CellForm::Float => number::<f32>(array, row).map(|value| write!(text, "{:?}", f64::from(value))),
            CellForm::Int32 => number::<i32>(array, row).map(|value| write!(text, "{value}")),
            CellForm::UInt32 => number::<u32>(array, row).map(|value| write!(text, "{value}")),
            CellForm::Int64 => number::<i64>(array, row).map(|value| write!(text, "{value}")),
            CellForm::UInt64 => number::<u64>(array, row).map(|value| write!(text, "{value}")),
            CellForm::Moment(per_second, is_utc) => {
                number::<i64>(array, row).map(|value| match moment(value, per_second) {
                    Some(moment) if is_utc => write!(text, "{moment}"),
                    Some(moment) => write!(text, "{}", moment.to_string().trim_end_matches('Z')),
                    None => write!(text, "{value}"),
                })
            }
            CellForm::Boolean => {
                value::<BooleanArray>(array, row).map(|value| write!(text, "{}", u8::from(value)))
            }
            CellForm::Text => {
                if let Some(value) = value::<Utf8ViewArray>(array, row) {
                    write_text(text, value);
                }
                None
            }
            CellForm::Other => None,
        };
    }

    fn pass(&mut self, rows: usize) {
        self.passed += rows;
    }
}

fn value<A: StaticArray>(array: &dyn Array, row: usize) -> Option<A::ValueT<'_>> {
    array.as_any().downcast_ref::<A>()?.get(row)
}

fn number<T: NativeType>(array: &dyn Array, row: usize) -> Option<T> {
    let array = array.as_any().downcast_ref::<PrimitiveArray<T>>()?;
    let is_missing = array.validity().is_some_and(|valid| !valid.get(row).unwrap_or(false));
    array.values().get(row).copied().filter(|_| !is_missing)
}

fn moment(value: i64, per_second: i128) -> Option<Timestamp> {
    Timestamp::from_nanosecond(i128::from(value) * (1_000_000_000 / per_second)).ok()
}

fn separate(text: &mut VecDeque<u8>, column: usize) {
    if column > 0 {
        text.push_back(b',');
    }
}

/// A name or word, in quotes if CSV requires them. It stays in its line.
fn write_text(text: &mut VecDeque<u8>, cell: &str) {
    let cell = cell.replace(['\n', '\r', '\0'], " ");
    match cell.contains([',', '"']) {
        true => text.extend(format!("\"{}\"", cell.replace('"', "\"\"")).as_bytes()),
        false => text.extend(cell.as_bytes()),
    }
}

fn state(file: &File) -> io::Result<(u64, SystemTime)> {
    let metadata = asking(|| file.metadata())?;
    Ok((metadata.len(), changed_at(&metadata)))
}

/// The metadata at the end of a file.
fn metadata(file: &File, file_bytes: u64) -> io::Result<FileMetadata> {
    let cut = || damaged("ends too early: its metadata is missing");
    let footer_at = file_bytes.checked_sub(FOOTER_BYTES).ok_or_else(cut)?;
    let mut footer = [0; FOOTER_BYTES as usize];
    asking(|| file.read_exact_at(&mut footer, footer_at))?;
    let [a, b, c, d, magic @ ..] = footer;
    if magic != MAGIC {
        return Err(cut());
    }
    let length = u64::from(u32::from_le_bytes([a, b, c, d]));
    let at = footer_at.checked_sub(length).filter(|_| length <= MOST_METADATA_BYTES);
    let at = at.ok_or_else(|| damaged(&format!("states {length} bytes of metadata")))?;
    let mut bytes = vec![0; usize::try_from(length).unwrap_or(0)];
    asking(|| file.read_exact_at(&mut bytes, at))?;
    if !thrift::is_sound(&bytes) {
        return Err(damaged("has metadata that cannot be read"));
    }
    guarded(|| deserialize_metadata(Buffer::from_vec(bytes)).map_err(|error| error.to_string()))
}

thread_local! {
    /// True while this thread runs code whose panic is expected.
    static IS_GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs code of polars on bytes from outside. Its panic is an error of the file and prints nothing.
fn guarded<T>(work: impl FnOnce() -> Result<T, String>) -> io::Result<T> {
    static HOOKED: Once = Once::new();
    HOOKED.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !IS_GUARDED.get() {
                before(info);
            }
        }));
    });
    IS_GUARDED.set(true);
    let done = panic::catch_unwind(AssertUnwindSafe(work));
    IS_GUARDED.set(false);
    match done {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(error)) => Err(damaged(&format!("cannot be decoded ({error})"))),
        Err(_) => Err(damaged("cannot be decoded")),
    }
}

fn damaged(clause: &str) -> io::Error {
    unreadable(format!("a damaged Parquet file: it {clause}"), REMEDY)
}
