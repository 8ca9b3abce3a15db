//! See `checks/read_binary.rs`.

#![no_main]

#[path = "../checks/read_binary.rs"]
mod check;

libfuzzer_sys::fuzz_target!(|data: &[u8]| check::run(data));
