//! The world to samples: folders are watched and scanned, settled exports are opened, identified by
//! content and read into [`armwatch_model::run::Samples`] in SI, or turned away with a
//! [`rejection::Rejection`].
//!
//! [`find`] says which files there are and when a writer has finished. [`bytes`] identifies an export by its content,
//! opens plain, compressed and growing ones, makes text of Parquet files and MCAP bags, and cuts UTF-8 at line ends.
//! [`table`] finds header and columns, reads sound blocks of rows in one pass and others cell by cell, and turns columns
//! into SI. [`infer`] proposes a layout for
//! exports that have none. [`excerpt`] shows the place where an export was not understood.
//!
//! Three rules hold in here. A file is understood whole or not at all: whatever is not read as it
//! was written becomes a rejection that names line, column, value and remedy. Foreign units, signs
//! and number formats end in here. Nothing but this module names notify, flate2, zstd, mcap,
//! encoding_rs or blake3.

pub mod bytes;
pub mod find;
pub mod table;
pub mod excerpt;
pub mod infer;
pub mod rejection;
pub mod repeated;

#[cfg(test)]
mod fixture;
