//! A CSV file read by polars alone, without any of the questions that an export is asked: the yardstick of
//! `armwatch-lab benchmark ingest`.

use std::path::Path;

use polars_core::error::PolarsError;
use polars_io::SerReader;
use polars_io::csv::read::CsvReadOptions;

/// Reads a whole comma-separated file with a header into columns, as polars does by default, and drops them.
/// Returns the number of rows.
///
/// # Errors
/// The error of polars.
pub(crate) fn read_with_polars(path: &Path) -> Result<usize, PolarsError> {
    let reader = CsvReadOptions::default()
        .with_has_header(true)
        .try_into_reader_with_file_path(Some(path.to_path_buf()))?;
    Ok(reader.finish()?.height())
}
