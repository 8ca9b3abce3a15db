//! The bytes of an export: identity, decompression, Parquet, bags, traces and scope exports as text, encoding, blocks
//! of whole lines.

pub mod source;
pub mod fingerprint;
pub mod parts;
pub mod encoding;
pub mod access;
pub mod blocks;
mod bag;
mod joint_state;
mod parquet;
pub(crate) mod scope;
mod thrift;
pub(crate) mod trace;

#[cfg(test)]
mod binary_tests;
#[cfg(test)]
mod maker_tests;
