//! The bytes of an export: which file it is, decompression, Parquet and bags as text, encoding, blocks of whole lines.

pub mod source;
pub mod fingerprint;
pub mod parts;
pub mod encoding;
pub mod access;
pub mod blocks;
mod bag;
mod joint_state;
mod parquet;
mod thrift;

#[cfg(test)]
mod binary_tests;
