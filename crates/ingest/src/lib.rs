//! Reads recordings as samples: folders are watched and scanned, settled exports are opened, identified by content and
//! read into [`armwatch_model::run::Samples`] in SI units, or refused with a [`rejection::Rejection`].
//!
//! [`find`] finds files and decides when a writer has finished. [`bytes`] identifies an export by its content, opens
//! plain, compressed and growing ones, converts Parquet files and MCAP bags to text, and cuts UTF-8 at line ends.
//! [`table`] finds header and columns, reads valid blocks of rows in one pass and others cell by cell, and converts
//! columns to SI units. [`infer`] proposes a layout for exports that have none. [`excerpt`] shows the place of a fault
//! in an export.
//!
//! Three rules hold in this crate. A file is understood as a whole or not at all: any deviation becomes a rejection
//! with line, column, value and remedy. Foreign units, signs and number formats are converted here. Only this crate
//! uses notify, flate2, zstd, mcap, encoding_rs or blake3.

pub mod bytes;
pub mod find;
pub mod table;
pub mod excerpt;
pub mod infer;
pub mod rejection;
pub mod repeated;

#[cfg(test)]
mod fixture;
