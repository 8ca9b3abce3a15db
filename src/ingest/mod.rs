//! The world to samples: folders are watched and scanned, settled exports are opened, identified by
//! content and read into [`crate::run::Samples`] in SI, or turned away with a
//! [`rejection::Rejection`].
//!
//! In reading order: [`watch`] finds files, [`settle`] says when a writer has finished,
//! [`fingerprint`] tells one content from another, [`source`] opens plain and compressed exports,
//! [`tail`] those that still grow, [`blocks`] cuts them at line ends, [`layout`] finds the columns, [`csv`] reads blocks with polars
//! and [`exact`] reads them cell by cell where polars would guess; [`channels`] turns columns into SI;
//! [`excerpt`] shows the place where an export was not
//! understood, and [`archive`] moves one that is stored.
//!
//! Three rules hold in here. A file is understood whole or not at all: whatever is not read as it
//! was written becomes a rejection that names line, column, value and remedy. Foreign units, signs
//! and number formats end in here. Nothing but this module names polars, notify, flate2, zstd or
//! blake3.

pub mod archive;
pub mod blocks;
pub mod channels;
pub mod csv;
mod encoding;
pub mod exact;
pub mod excerpt;
pub mod fingerprint;
pub mod layout;
pub mod plain;
pub mod rejection;
pub mod settle;
pub mod source;
pub mod tail;
pub mod watch;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod oddities;
