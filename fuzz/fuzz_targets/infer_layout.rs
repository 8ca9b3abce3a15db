//! See `checks/infer_layout.rs`.

#![no_main]

#[path = "../checks/infer_layout.rs"]
mod check;

libfuzzer_sys::fuzz_target!(|data: &[u8]| check::run(data));
