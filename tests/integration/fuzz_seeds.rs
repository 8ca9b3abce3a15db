//! The seeds of the fuzz targets, and some thousand inputs near them, pass the checks of fuzzing.

use std::fs;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[path = "../../fuzz/checks/infer_layout.rs"]
mod infer_layout;
#[path = "../../fuzz/checks/read_binary.rs"]
mod read_binary;
#[path = "../../fuzz/checks/read_csv.rs"]
mod read_csv;
#[path = "../../fuzz/checks/segment.rs"]
mod segment;

/// Changed inputs of each seed; a few seconds for all targets.
const CHANGED: usize = 150;

/// Pieces that are inserted into an input: separators, quotes, ends and beginnings of numbers, lines and characters.
const PIECES: [&[u8]; 24] = [
    b",",
    b";",
    b"\t",
    b"\n",
    b"\r\n",
    b"\r",
    b"\"",
    b"#",
    b".",
    b"-",
    b"1e9",
    b"nan",
    b" ",
    b"\0",
    b"\xFF",
    b"\xC3",
    b"\xEF\xBB\xBF",
    b"\xFF\xFE",
    b"time",
    b"0",
    b"7",
    b"\n\n",
    b"2026-03-01T08:00:00Z",
    b"1.234,5",
];

fn changed(seed: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..random.random_range(1..5) {
        let at = random.random_range(0..=bytes.len());
        match random.random_range(0..4) {
            0 => drop(bytes.splice(at..at, PIECES[random.random_range(0..PIECES.len())].iter().copied())),
            1 => bytes.truncate(at.max(1)),
            2 => {
                let end = (at + random.random_range(0..9)).min(bytes.len());
                bytes.drain(at..end);
            }
            _ => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = random.random();
                }
            }
        }
    }
    bytes
}

fn check(target: &str, run: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(target);
    let mut seeds: Vec<_> =
        fs::read_dir(&folder).expect("seeds").map(|entry| entry.expect("a seed").path()).collect();
    seeds.sort();
    assert!(!seeds.is_empty(), "{target} has no seeds");
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for path in seeds {
        let seed = fs::read(&path).expect("a seed");
        run(&seed);
        for number in 0..CHANGED {
            let input = changed(&seed, &mut random);
            let outcome = std::panic::catch_unwind(|| run(&input));
            assert!(outcome.is_ok(), "{target}: {} changed, number {number}: {input:?}", path.display());
        }
    }
}

#[test]
fn any_bytes_are_rows_or_a_rejection() {
    check("read_csv", read_csv::run);
}

#[test]
fn any_bytes_of_a_parquet_file_or_a_bag_are_text_or_an_error() {
    check("read_binary", read_binary::run);
}

#[test]
fn any_stages_are_cut_into_the_same_cycles() {
    check("segment", segment::run);
}

#[test]
fn any_bytes_are_refused_or_give_a_layout_that_loads() {
    check("infer_layout", infer_layout::run);
}
