//! Checks that any bytes after the first ones of a Parquet file, a bag, a scope export or the header of a trace give
//! text or an error, in bounded time and memory.

use std::io::Read;

use armwatch_ingest::bytes::source::open;

/// Largest number of bytes of text that is read, because a few bytes may encode many equal rows.
const MOST_TEXT_BYTES: u64 = 4 << 20;

/// Checks one input; a failure panics.
pub fn run(data: &[u8]) {
    let Some((choice, rest)) = data.split_first() else { return };
    let magic: &[u8] = match choice % 4 {
        0 => b"PAR1",
        1 => b"\x89MCAP0\r\n",
        2 => b"Name\tScope\nStarttime of export\t1\n\nName\ta\tName\tb\n",
        _ => b"DIAEXTENDED\n",
    };
    let path = std::env::temp_dir().join(format!("armwatch-fuzz-{}.dat", std::process::id()));
    std::fs::write(path.with_extension("r64"), [0; 4096]).expect("a temporary folder");
    std::fs::write(&path, [magic, rest].concat()).expect("a temporary folder");
    if let Ok(reader) = open(&path) {
        let mut text = Vec::new();
        if reader.take(MOST_TEXT_BYTES).read_to_end(&mut text).is_ok() {
            assert!(!text.is_empty(), "no header and no error");
        }
    }
    let _ = std::fs::remove_file(path.with_extension("r64"));
    let _ = std::fs::remove_file(&path);
}
