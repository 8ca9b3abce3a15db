//! See `checks/read_csv.rs`.

#![no_main]

#[path = "../checks/read_csv.rs"]
mod check;

libfuzzer_sys::fuzz_target!(|data: &[u8]| check::run(data));
