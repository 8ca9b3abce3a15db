//! Exports that the daemon reads in half a second: the arm with the fewest joints, three short cycles.

use std::collections::HashMap;
use std::fs;
use std::io::Write;
use std::sync::{LazyLock, Mutex};

use crate::support::Workshop;

/// Cycles of each export.
pub const CYCLES: &str = "3";

/// An export as on disk.
#[derive(Debug, Clone)]
pub struct Export {
    pub name: String,
    pub bytes: Vec<u8>,
}

impl Export {
    /// The same with another name.
    pub fn named(&self, name: &str) -> Self {
        Self { name: name.to_owned(), bytes: self.bytes.clone() }
    }

    pub fn gzip(&self) -> Self {
        Self { name: format!("{}.gz", self.name), bytes: gzip(&self.bytes) }
    }

    pub fn zstd(&self) -> Self {
        let bytes = zstd::encode_all(&self.bytes[..], 1).expect("compressed");
        Self { name: format!("{}.zst", self.name), bytes }
    }

    /// The same with a letter in place of a number, near the end.
    pub fn spoiled(mut self) -> Self {
        let near_the_end = self.bytes.len() - self.bytes.len() / 20;
        let comma = self.bytes[near_the_end..].iter().position(|byte| *byte == b',').expect("a comma");
        self.bytes[near_the_end + comma + 1] = b'x';
        self
    }

    /// Lines from the header on, including their ends.
    pub fn lines(&self) -> Vec<&[u8]> {
        self.bytes.split_inclusive(|byte| *byte == b'\n').collect()
    }

    /// The same with its text changed.
    pub fn with(&self, change: impl FnOnce(&str) -> String) -> Self {
        let text = std::str::from_utf8(&self.bytes).expect("text");
        Self { name: self.name.clone(), bytes: change(text).into_bytes() }
    }
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).expect("compressed");
    encoder.finish().expect("compressed")
}

/// The export of a robot that begins on a day of January; only the seed determines its content. Created once for all
/// tests.
pub fn export(robot: &str, seed: u32, day: u32) -> Export {
    made(robot, seed, &format!("2026-01-{day:02}T08:47:00Z"), &[])
}

/// The same as a production log from the afternoon of that day, see [`watching_work`].
pub fn work(robot: &str, seed: u32, day: u32) -> Export {
    made(robot, seed, &format!("2026-01-{day:02}T14:00:00Z"), &["--stage-signal", "none"])
}

fn made(robot: &str, seed: u32, start: &str, more: &[&str]) -> Export {
    static MADE: LazyLock<Mutex<HashMap<String, Export>>> = LazyLock::new(Mutex::default);
    let mut made = MADE.lock().expect("no test fails while it makes an export");
    let make = || {
        let seed = seed.to_string();
        let scara = format!("{}/config/robots/scara.toml", env!("CARGO_MANIFEST_DIR"));
        let shape = ["--cycles", CYCLES, "--warming-s", "2", "--rate-hz", "30", "--robot", &scara];
        let which = ["--name", robot, "--seed", &seed, "--start", start];
        let workshop = workshop();
        let path = workshop.simulate("made", &[&shape[..], &which[..], more].concat()).remove(0);
        let name = path.file_name().expect("a name").to_str().expect("text").to_owned();
        Export { name, bytes: fs::read(path).expect("an export") }
    };
    made.entry(format!("{robot} {seed} {start} {more:?}")).or_insert_with(make).clone()
}

impl Workshop {
    /// Writes an export into the inbox.
    pub fn add(&self, export: &Export) {
        fs::write(self.inbox(&export.name), &export.bytes).expect("written");
    }
}

/// A folder for such exports.
pub fn workshop() -> Workshop {
    let workshop = Workshop::new();
    workshop.describe("scara");
    workshop
}

/// Like [`workshop`], with exports without signals as production logs.
pub fn watching_work() -> Workshop {
    let workshop = workshop();
    workshop.watch_work("scara", 1 + 3 * 4);
    workshop
}
