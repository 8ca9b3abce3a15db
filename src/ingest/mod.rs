//! The world to samples: folders are watched and scanned, settled exports are opened, identified by
//! content and read into [`crate::run::Samples`] in SI, or turned away with a
//! [`rejection::Rejection`].
//!
//! In reading order: [`watch`] finds files, [`settle`] says when a writer has finished,
//! [`fingerprint`] tells one content from another, [`source`] opens plain and compressed exports,
//! [`tail`] those that still grow, [`encoding`] makes UTF-8 of them, [`blocks`] cuts them at line ends,
//! [`preamble`] finds the header, [`layout`] the columns, [`csv`] gives rows that [`parser`] reads with
//! polars and [`exact`] cell by cell where polars would guess; [`start`] finds when a recording started; [`cell`] knows what one of them says, [`channels`] turns columns
//! into SI. [`infer`] proposes a layout for exports that have none. [`excerpt`] shows the place where an export was
//! not understood, [`archive`] moves one that is stored.
//!
//! Three rules hold in here. A file is understood whole or not at all: whatever is not read as it
//! was written becomes a rejection that names line, column, value and remedy. Foreign units, signs
//! and number formats end in here. Nothing but this module names polars, notify, flate2, zstd,
//! encoding_rs or blake3.

pub mod bytes;
pub mod find;
pub mod table;
pub mod excerpt;
pub mod infer;
pub mod plain;
pub mod rejection;

#[cfg(test)]
mod fixture;
