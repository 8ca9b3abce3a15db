//! Checks that any sequence of stages and counters is cut into the same cycles, independent of the pieces of rows.
//!
//! Each byte of an input is a row: two bits for the stage, two for the counter, one that ends a piece.

use armwatch_method::segment::cycles::{CycleCutter, SegmentError};
use armwatch_model::run::{Cycle, Samples, Stage};

const STAGES: [Stage; 4] = [Stage::Between, Stage::Excitation, Stage::Friction, Stage::Warming];

fn rows(bytes: &[u8], counted: bool) -> Samples {
    let mut counter = 0;
    let counters = bytes.iter().map(|byte| match byte & 0b1100 {
        0b0100 => {
            counter += 1;
            counter
        }
        0b1000 => 0,
        _ => counter,
    });
    Samples {
        time: (0..bytes.len()).map(|row| row as f64 * 0.004).collect(),
        position: vec![vec![0.0; bytes.len()]],
        torque: vec![vec![0.0; bytes.len()]],
        stage: bytes.iter().map(|byte| STAGES[usize::from(byte & 3)]).collect(),
        cycle: counted.then(|| counters.collect()),
        ..Samples::default()
    }
}

fn cut(pieces: impl Iterator<Item = Samples>) -> (Vec<Cycle>, Option<SegmentError>) {
    let mut cutter = CycleCutter::new();
    let mut cycles = Vec::new();
    for piece in pieces {
        cutter.push(piece);
        loop {
            match cutter.next_cycle() {
                Ok(Some(cycle)) => cycles.push(cycle),
                Ok(None) => break,
                Err(error) => return (cycles, Some(error)),
            }
        }
    }
    match cutter.finish() {
        Ok(last) => cycles.extend(last),
        Err(error) => return (cycles, Some(error)),
    }
    (cycles, None)
}

/// Checks one input; a failure panics.
pub fn run(data: &[u8]) {
    let Some((choice, bytes)) = data.split_first() else { return };
    let samples = rows(bytes, choice & 1 == 1);
    let (whole, error) = cut(std::iter::once(samples.clone()));
    assert!(whole.iter().map(|cycle| cycle.samples.rows()).sum::<usize>() <= bytes.len());
    // Counted cycles keep their counter. It may skip numbers but repeats none.
    match choice & 1 {
        1 => assert!(whole.iter().is_sorted_by(|before, after| before.number < after.number)),
        _ => assert!(whole.iter().zip(1..).all(|(cycle, number)| cycle.number == number)),
    }
    let mut rest = samples;
    let mut ends: Vec<usize> =
        bytes.iter().enumerate().filter(|(_, b)| **b & 16 != 0).map(|(at, _)| at).collect();
    ends.push(bytes.len());
    let mut before = 0;
    let pieces: Vec<Samples> = ends
        .into_iter()
        .map(|end| {
            let piece = rest.take_front(end - before);
            before = end;
            piece
        })
        .collect();
    let (pieced, pieced_error) = cut(pieces.into_iter());
    assert_eq!(pieced_error, error);
    assert_eq!(pieced, whole);
}
