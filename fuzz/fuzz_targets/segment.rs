//! See `checks/segment.rs`.

#![no_main]

#[path = "../checks/segment.rs"]
mod check;

libfuzzer_sys::fuzz_target!(|data: &[u8]| check::run(data));
