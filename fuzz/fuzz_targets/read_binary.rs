//! See `checks/read_binary.rs`.

#![no_main]

#[path = "../checks/read_binary.rs"]
mod check;

libfuzzer_sys::fuzz_target!(
    // polars panics on some damaged pages, which is caught; libFuzzer's hook would end the process first
    init: std::panic::set_hook(Box::new(|_| ())),
    |data: &[u8]| check::run(data)
);
