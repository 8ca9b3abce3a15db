//! The bytes of an export: which file it is, decompression, encoding, blocks of whole lines.

pub mod source;
pub mod fingerprint;
pub mod encoding;
pub mod access;
pub mod blocks;
