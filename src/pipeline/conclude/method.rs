//! The version of the method: hashes of its sources, computed at build time (`build.rs`).

/// Identifies the sources of the detectors and of everything that they depend on.
pub const METHOD: u64 = number(env!("ARMWATCH_METHOD"));

/// Identifies the sources of friction indices.
pub const INDEX_METHOD: u64 = number(env!("ARMWATCH_INDEX_METHOD"));

const fn number(text: &str) -> u64 {
    match u64::from_str_radix(text, 10) {
        Ok(number) => number,
        // every hash is written as a number
        Err(_) => 0,
    }
}
