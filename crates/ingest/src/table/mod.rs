//! Lines to samples in SI: preamble, columns, cells, rows.

pub mod preamble;
pub(super) mod fields;
pub mod cell;
pub mod column_map;
pub mod channels;
pub mod clock;
pub mod mended;
pub mod start;
mod plain_number;
mod block_reader;
mod plausible;
mod sparse;
pub mod parser;
pub mod cell_reader;
pub mod reader;
pub mod joined;
