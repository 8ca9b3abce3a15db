//! Reading whole exports: any blocks, any growth, any damage.

use std::collections::VecDeque;
use std::io::Read;
use std::path::Path;

use proptest::prelude::*;

use super::{ExportReader, ReadOptions, Step};
use crate::bytes::source::open;
use crate::fixture::{channel, fixture, made_recording, native, read_bytes, recording, with_blocks_of};
use crate::table::channels;
use crate::table::column_map::MAX_COLUMNS;
use armwatch_config::{
    Column, DecimalMark, JointSigns, Layout, RowRule, ScaledColumn, StageSource, TextTime, TimeSource,
    WholeRecording,
};
use armwatch_model::run::{RawSamples, Stage, StageReading};
use armwatch_testing::er3a;

#[test]
fn rows_without_header_time_and_stage_are_counted_and_named_by_the_layout() {
    let layout = Layout {
        header: false,
        time: TimeSource::SampleRate(5000.0),
        position: channel("{joint}"),
        velocity: None,
        torque: channel("{joint+6}"),
        stage: StageSource::Whole(WholeRecording(Stage::Excitation)),
        ..native()
    };
    let text: String = (0..50)
        .map(|row| {
            let cells: Vec<String> =
                (0..12).map(|column| format!("{}", f64::from(row * 100 + column))).collect();
            cells.join(",") + "\n"
        })
        .collect();
    for block_bytes in [100, 1 << 20] {
        let reader = ExportReader::new(
            text.as_bytes(),
            Path::new("a.csv"),
            &layout,
            &er3a(),
            with_blocks_of(block_bytes),
        );
        let mut samples = RawSamples::default();
        reader.unwrap().for_each(|chunk| samples.append(chunk.unwrap().samples));
        assert_eq!((samples.rows(), samples.time[0], samples.time[49]), (50, 0.0, 49.0 / 5000.0));
        assert_eq!((samples.position[2][7], samples.torque[2][7]), (702.0, 708.0));
        assert!(samples.velocity.is_none() && samples.cycle.is_none());
        assert_eq!(samples.stage, StageReading::Known(vec![Stage::Excitation; 50]));
    }
    let broken = text.replacen("1003", "x", 1);
    let reader =
        ExportReader::new(broken.as_bytes(), Path::new("a.csv"), &layout, &er3a(), ReadOptions::default());
    let rejection = reader.unwrap().find_map(Result::err).unwrap();
    assert_eq!((rejection.line, rejection.column.as_deref()), (Some(11), Some("4")));
}

#[test]
fn rows_before_a_fault_come_whole_whatever_the_blocks() {
    let (_, text) = made_recording(200);
    let mut lines: Vec<&str> = text.lines().collect();
    let broken = lines[150].replacen(',', ",x", 1);
    lines[150] = &broken;
    let text = lines.join("\n") + "\n";
    for block_bytes in [600, 5000, 1 << 20] {
        let reader = ExportReader::new(
            text.as_bytes(),
            Path::new("a.csv"),
            &native(),
            &er3a(),
            with_blocks_of(block_bytes),
        );
        let items: Vec<_> = reader.unwrap().collect();
        let rows: usize = items.iter().flatten().map(|chunk| chunk.samples.rows()).sum();
        assert_eq!(rows, 149, "blocks of {block_bytes} bytes");
        assert_eq!(items.last().unwrap().as_ref().unwrap_err().line, Some(151));
    }
}

#[test]
fn lines_and_rows_are_counted_over_chunks() {
    let (_, text) = made_recording(300);
    let path = Path::new("a.csv");
    let mut reader =
        ExportReader::new(text.as_bytes(), path, &native(), &er3a(), with_blocks_of(5000)).unwrap();
    let mut line = 2;
    let mut chunks = 0;
    for chunk in reader.by_ref() {
        let chunk = chunk.unwrap();
        assert_eq!(chunk.first_line, line);
        line += chunk.samples.rows() as u64;
        chunks += 1;
    }
    assert!(chunks > 10);
    assert_eq!((reader.rows(), reader.left_out()), (300, None));
    assert!(reader.next().is_none());
}

#[test]
fn time_is_compared_over_chunks_and_reading_ends_at_the_rejection() {
    let (_, text) = made_recording(200);
    let twice = format!("{text}{}", text.split_once('\n').unwrap().1);
    for block_bytes in [1, 700, 5000, 1 << 20] {
        let options = with_blocks_of(block_bytes);
        let mut reader =
            ExportReader::new(twice.as_bytes(), Path::new("a.csv"), &native(), &er3a(), options).unwrap();
        let rejection = reader.find_map(Result::err).expect("time runs backwards");
        assert_eq!((rejection.line, rejection.value.as_deref()), (Some(202), Some("0")));
        assert_eq!(&*rejection.reason, "earlier than 0.398 in the previous row: time runs backwards");
        assert!(reader.next().is_none());
    }
}

#[test]
fn foreign_units_end_here() {
    let mut layout = native();
    layout.time = TimeSource::Column(ScaledColumn { column: Column::Name("time".into()), to_si: 1e-3 });
    layout.position.to_si = std::f64::consts::PI / 180.0;
    layout.torque.to_si = 50.0;
    layout.torque.sign = JointSigns::Each(vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0]);
    let (samples, text) = made_recording(20);
    let read = read_bytes(text.as_bytes(), &layout, ReadOptions::default()).unwrap();
    for row in 0..20 {
        assert_eq!(read.time[row], samples.time[row] * 1e-3);
        assert_eq!(read.position[2][row], samples.position[2][row] * (std::f64::consts::PI / 180.0));
        assert_eq!(read.torque[4][row], samples.torque[4][row] * 50.0);
        assert_eq!(read.torque[5][row], samples.torque[5][row] * -50.0);
    }
    assert_eq!(read.velocity, samples.velocity);
}

#[test]
fn times_are_counted_from_the_first_row_to_the_last_digit() {
    let (samples, text) = made_recording(50);
    let moved = |origin: f64| {
        let lines = text.lines().enumerate().map(|(number, line)| match (number, line.split_once(',')) {
            (1.., Some((time, rest))) => format!("{},{rest}\n", time.parse::<f64>().unwrap() + origin),
            _ => format!("{line}\n"),
        });
        let moved: String = lines.collect();
        read_bytes(moved.as_bytes(), &native(), with_blocks_of(1000)).unwrap().time
    };
    // Doubles near 1.7e9 lie 2.4e-7 apart.
    for origin in [1.7e9, 36_000.0, 0.5, 0.0, -3600.0] {
        let read = moved(origin);
        let alike = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-15;
        assert!(read.iter().zip(&samples.time).all(alike), "{origin}: {read:?}");
    }
}

/// A clock in whole nanoseconds from 1970, which doubles do not represent exactly.
#[test]
fn a_clock_in_nanoseconds_is_counted_from_the_first_row() {
    let (samples, text) = made_recording(50);
    let mut layout = native();
    layout.time = TimeSource::Column(ScaledColumn { column: Column::Name("time".into()), to_si: 1e-9 });
    let lines = text.lines().enumerate().map(|(number, line)| match line.split_once(',') {
        Some((_, rest)) if number > 0 => {
            format!("{},{rest}\n", 1_700_000_000_000_000_001_u64 + (number as u64 - 1) * 2_000_000)
        }
        _ => format!("{line}\n"),
    });
    let moved: String = lines.collect();
    let read = read_bytes(moved.as_bytes(), &layout, with_blocks_of(1000)).unwrap();
    assert!(read.time.iter().zip(&samples.time).all(|(a, b)| (a - b).abs() < 1e-15), "{:?}", read.time);
}

#[test]
fn a_counter_that_begins_anew_is_counted_from_the_first_row() {
    let (samples, text) = made_recording(50);
    let mut layout = native();
    let column = ScaledColumn { column: Column::Name("time".into()), to_si: 1e-3 };
    layout.time = TimeSource::Counter { column, wraps_at: 65536.0 };
    let lines = text.lines().enumerate().map(|(number, line)| match line.split_once(',') {
        Some((_, rest)) if number > 0 => format!("{},{rest}\n", (65_500 + (number - 1) * 2) % 65_536),
        _ => format!("{line}\n"),
    });
    let moved: String = lines.collect();
    for block_bytes in [1000, 1 << 20] {
        let read = read_bytes(moved.as_bytes(), &layout, with_blocks_of(block_bytes)).unwrap();
        assert!(read.time.iter().zip(&samples.time).all(|(a, b)| (a - b).abs() < 1e-12), "{:?}", read.time);
    }
}

/// The time in a message is the export's, not the one that counts from the first row.
#[test]
fn a_clock_that_runs_backwards_is_named_as_it_stands_in_the_file() {
    let (_, text) = made_recording(3);
    let clocks = ["1700000000.000", "1700000000.002", "1700000000.001"];
    let moved: String = text.lines().enumerate().fold(String::new(), |moved, (number, line)| match number {
        0 => moved + line + "\n",
        _ => moved + clocks[number - 1] + "," + line.split_once(',').unwrap().1 + "\n",
    });
    for block_bytes in [1, 1 << 20] {
        let rejection = read_bytes(moved.as_bytes(), &native(), with_blocks_of(block_bytes)).unwrap_err();
        assert_eq!((rejection.line, rejection.value.as_deref()), (Some(4), Some("1700000000.001")));
        assert_eq!(
            &*rejection.reason,
            "earlier than 1700000000.002 in the previous row: time runs backwards"
        );
    }
}

#[test]
fn a_file_that_ends_inside_a_number_is_noticed_at_any_block_size() {
    let text = std::fs::read_to_string(fixture("no_final_newline_after_torque.csv")).unwrap();
    for block_bytes in 1..text.len() + 2 {
        let path = Path::new("a.csv");
        let options = with_blocks_of(block_bytes);
        let mut reader = ExportReader::new(text.as_bytes(), path, &native(), &er3a(), options).unwrap();
        assert_eq!(reader.by_ref().map(|chunk| chunk.unwrap().samples.rows()).sum::<usize>(), 4);
        assert_eq!(reader.left_out().map(|left_out| left_out.line), Some(6));
    }
}

#[test]
fn wherever_a_file_is_cut_no_wrong_row_comes_out() {
    let text = std::fs::read_to_string(fixture("native.csv")).unwrap();
    let whole = read_bytes(text.as_bytes(), &native(), ReadOptions::default()).unwrap();
    for keep in 0..text.len() {
        if let Ok(read) = read_bytes(&text.as_bytes()[..keep], &native(), ReadOptions::default()) {
            assert_eq!(read, whole.clone().take_front(read.rows()), "cut to {keep} bytes");
        }
    }
}

/// A number of any magnitude that a channel may have; larger ones come as their reciprocals.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        -1e4..1e4,
        any::<f64>().prop_map(|x| if x.abs() <= channels::MAX_POSITION { x } else { x.recip() })
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_block_size_reads_the_same(block_bytes in 1_usize..9000) {
        let (samples, text) = made_recording(60);
        let read = read_bytes(text.as_bytes(), &native(), with_blocks_of(block_bytes));
        prop_assert_eq!(read, Ok(samples));
    }

    #[test]
    fn numbers_come_back_bit_by_bit(numbers in proptest::collection::vec(number(), 18..200)) {
        let mut cycle = numbers.iter().cycle();
        let (samples, text) = recording(numbers.len() / 18, || *cycle.next().expect("endless"));
        let read = read_bytes(text.as_bytes(), &native(), ReadOptions::default());
        prop_assert_eq!(read, Ok(samples));
    }
}

/// A growing file: returns the written bytes up to the next cut, then pauses once.
struct PausingFile<'b> {
    bytes: &'b [u8],
    given: usize,
    cuts: VecDeque<usize>,
}

impl Read for PausingFile<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let written = self.cuts.front().map_or(self.bytes.len(), |cut| (*cut).min(self.bytes.len()));
        if self.given >= written && self.cuts.pop_front().is_some() {
            return Err(std::io::ErrorKind::WouldBlock.into());
        }
        let count = buffer.len().min(written - self.given);
        buffer[..count].copy_from_slice(&self.bytes[self.given..self.given + count]);
        self.given += count;
        Ok(count)
    }
}

/// The rows of a file that is read while it grows by these pieces, opened again until its header is whole.
fn read_growing(bytes: &[u8], layout: &Layout, pieces: &[usize], block_bytes: usize) -> RawSamples {
    let mut cuts: VecDeque<usize> = pieces
        .iter()
        .scan(0, |end, piece| {
            *end += piece;
            Some(*end)
        })
        .collect();
    let mut reader = loop {
        let file = PausingFile { bytes, given: 0, cuts: cuts.clone() };
        let options = with_blocks_of(block_bytes);
        match ExportReader::of_growing(file, Path::new("a.csv"), layout, &er3a(), options).unwrap() {
            Some(reader) => break reader,
            None => cuts.pop_front(),
        };
    };
    let mut samples = RawSamples::default();
    loop {
        match reader.step().unwrap() {
            Step::Rows(chunk) => samples.append(chunk.samples),
            Step::Waiting => {}
            Step::End => return samples,
        }
    }
}

/// The text in another encoding.
fn encoded(text: &str, kind: usize) -> Vec<u8> {
    match kind {
        0 => text.as_bytes().to_vec(),
        1 => ["\u{feff}", text].concat().into_bytes(),
        2 => [0xFEFF].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect(),
        3 => text.encode_utf16().flat_map(u16::to_be_bytes).collect(),
        _ => encoding_rs::WINDOWS_1252.encode(text).0.into_owned(),
    }
}

/// The bytes as a file holds them: plain, gzip or zstd, in one member or cut into two.
fn packed(bytes: &[u8], kind: usize, cut: usize) -> Vec<u8> {
    let gzip = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, bytes).unwrap();
        encoder.finish().unwrap()
    };
    let zstd = |bytes: &[u8]| zstd::encode_all(bytes, 1).unwrap();
    let (front, back) = bytes.split_at(cut.min(bytes.len()));
    match kind {
        0 => bytes.to_vec(),
        1 => [gzip(front), gzip(back)].concat(),
        _ => [zstd(front), zstd(back)].concat(),
    }
}

/// A recording with an additional column that is not ASCII, so that encodings differ.
fn accented(rows: usize, comma: bool) -> (RawSamples, String, Layout) {
    let (samples, text) = made_recording(rows);
    let noted = |(at, line): (usize, &str)| match at {
        0 => format!("{line},größe [°]\n"),
        at => format!("{line},{}\n", if at % 3 == 0 { "ä" } else { "" }),
    };
    let text: String = text.lines().enumerate().map(noted).collect();
    if !comma {
        return (samples, text, native());
    }
    let mut layout = Layout { delimiter: b';', ..native() };
    layout.text.decimal = DecimalMark::Comma;
    (samples, text.replace(',', ";").replace('.', ","), layout)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn however_a_file_is_written_and_grows_it_reads_the_same(
        encoding in 0_usize..5,
        comma: bool,
        pieces in proptest::collection::vec(1_usize..700, 0..40),
        block_bytes in 1_usize..5000,
    ) {
        let (samples, text, layout) = accented(40, comma);
        let read = read_growing(&encoded(&text, encoding), &layout, &pieces, block_bytes);
        prop_assert_eq!(read, samples);
    }

    #[test]
    fn however_a_file_is_packed_it_reads_the_same(
        encoding in 0_usize..5,
        packing in 0_usize..3,
        cut in 0_usize..9000,
        block_bytes in 1_usize..9000,
    ) {
        let (samples, text, layout) = accented(40, false);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, packed(&encoded(&text, encoding), packing, cut)).unwrap();
        let bytes = open(&path).unwrap();
        let reader = ExportReader::new(bytes, &path, &layout, &er3a(), with_blocks_of(block_bytes)).unwrap();
        let mut read = RawSamples::default();
        for chunk in reader {
            read.append(chunk.unwrap().samples);
        }
        prop_assert_eq!(read, samples);
    }
}

/// A recording with bad rows of every kind at these places, and the samples without them.
fn with_bad_rows(rows: usize, places: &[usize]) -> (RawSamples, String) {
    let (samples, text) = made_recording(rows);
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for (kind, row) in places.iter().enumerate() {
        let cells: Vec<&str> = lines[row + 1].split(',').collect();
        let with = |column: usize, cell: &str| {
            let mut cells = cells.clone();
            cells[column] = cell;
            cells.join(",")
        };
        lines[row + 1] = match kind % 7 {
            0 => cells[..9].join(","),
            1 => with(5, ""),
            2 => with(1, "x"),
            3 => with(14, "1e300"),
            4 => format!("{},1,2,3", lines[row + 1]),
            5 => String::new(),
            // an earlier time, and a cell that is not a number
            _ => with(8, "#REF!").replacen(cells[0], "0", 1),
        };
    }
    let mut kept = RawSamples::default();
    let mut rest = samples;
    for row in 0..rows {
        let one = rest.take_front(1);
        if !places.contains(&row) {
            kept.append(one);
        }
    }
    (kept, lines.join("\n") + "\n")
}

fn skipping(most: u64) -> Layout {
    Layout { rows: RowRule { skip_bad: most }, ..native() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn bad_rows_are_passed_over_however_the_file_grows(
        places in proptest::collection::btree_set(1_usize..40, 0..12),
        pieces in proptest::collection::vec(1_usize..700, 0..40),
        block_bytes in 1_usize..5000,
    ) {
        // the last row is whole: a bad one there would be omitted and not counted
        let places: Vec<usize> = places.into_iter().filter(|row| *row < 39).collect();
        let (kept, text) = with_bad_rows(40, &places);
        let layout = skipping(places.len() as u64);
        let mut reader = ExportReader::new(
            text.as_bytes(), Path::new("a.csv"), &layout, &er3a(), with_blocks_of(block_bytes),
        ).unwrap();
        let mut read = RawSamples::default();
        for chunk in reader.by_ref() {
            read.append(chunk.unwrap().samples);
        }
        prop_assert_eq!(&read, &kept);
        prop_assert_eq!((reader.rows(), reader.passed_over().rows), (kept.rows() as u64, places.len() as u64));
        prop_assert_eq!(read_growing(text.as_bytes(), &layout, &pieces, block_bytes), kept);
    }
}

#[test]
fn one_bad_row_more_than_permitted_is_refused_with_the_setting() {
    let (_, text) = with_bad_rows(40, &[3, 8, 20]);
    let refused = |most| {
        let read = |block_bytes| read_bytes(text.as_bytes(), &skipping(most), with_blocks_of(block_bytes));
        let rejection = read(1 << 20).unwrap_err();
        assert_eq!(read(300).unwrap_err(), rejection);
        rejection
    };
    let none = refused(0);
    assert_eq!(none.line, Some(5));
    assert!(none.remedy.contains("skip_bad = 10 under [rows] in the layout"), "{none}");
    let two = refused(2);
    assert_eq!((two.line, two.column.as_deref()), (Some(22), Some("pos_1")));
    assert!(two.remedy.contains("skip_bad = 2 under [rows]"), "{two}");
    assert_eq!(read_bytes(text.as_bytes(), &skipping(3), with_blocks_of(300)).unwrap().rows(), 37);
}

#[test]
fn what_is_wrong_with_the_recording_is_not_passed_over() {
    for name in ["time_backwards.csv", "repeated_header.csv"] {
        let text = std::fs::read(fixture(name)).unwrap();
        let rejection = read_bytes(&text, &skipping(100), with_blocks_of(300)).expect_err(name);
        assert!(!rejection.remedy.contains("skip_bad"), "{rejection}");
    }
}

#[test]
fn a_row_that_is_passed_over_takes_its_time_where_rows_are_counted() {
    let layout = Layout { time: TimeSource::SampleRate(100.0), ..skipping(9) };
    let (_, text) = with_bad_rows(40, &[0, 1, 7, 8, 9, 30]);
    for block_bytes in [1, 300, 1 << 20] {
        let read = read_bytes(text.as_bytes(), &layout, with_blocks_of(block_bytes)).unwrap();
        let expected =
            (0..40).filter(|row| ![0, 1, 7, 8, 9, 30].contains(row)).map(|row| f64::from(row) / 100.0);
        assert_eq!(read.time, expected.collect::<Vec<_>>(), "blocks of {block_bytes} bytes");
    }
}

#[test]
fn dates_count_from_the_first_that_is_understood_whatever_the_blocks() {
    let text = std::fs::read_to_string(fixture("timestamps.csv")).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    let (unreadable, short) =
        (lines[1].replacen('2', "x", 1), lines[2].rsplit_once(',').unwrap().0.to_owned());
    (lines[1], lines[2]) = (&unreadable, &short);
    let text = lines.join("\n") + "\n";
    let layout = Layout {
        time: TimeSource::Text { column: Column::Name("time".into()), form: TextTime::Timestamp },
        ..skipping(2)
    };
    let read = |block_bytes| read_bytes(text.as_bytes(), &layout, with_blocks_of(block_bytes)).unwrap().time;
    assert_eq!(read(1 << 20)[0], 0.002);
    for block_bytes in [1, 200, 400] {
        assert_eq!(read(block_bytes), read(1 << 20), "blocks of {block_bytes} bytes");
    }
}

#[test]
fn a_last_line_with_too_few_fields_is_left_out_with_or_without_line_end() {
    let (samples, text) = made_recording(30);
    let whole = samples.clone().take_front(29);
    let last = text.lines().last().unwrap().len();
    for keep in [1, 9, 30, last / 2] {
        let cut = &text[..text.len() - 1 - last + keep];
        for end in ["", "\n", "\r\n", "\n\n  \n"] {
            let text = format!("{cut}{end}");
            for block_bytes in [1, 400, 1 << 20] {
                let options = with_blocks_of(block_bytes);
                let mut reader =
                    ExportReader::new(text.as_bytes(), Path::new("a.csv"), &native(), &er3a(), options)
                        .unwrap();
                let mut read = RawSamples::default();
                reader.by_ref().for_each(|chunk| read.append(chunk.unwrap().samples));
                assert_eq!(read, whole, "{keep} bytes of the last line, then {end:?}");
                let left_out = reader.left_out().map(|left_out| (left_out.line, left_out.reason));
                assert_eq!(left_out, Some((31, "has too few fields or ends inside a cell")));
                assert_eq!(reader.passed_over().rows, 0);
            }
            assert_eq!(read_growing(text.as_bytes(), &native(), &[900, 7, 3000, 1], 500), whole);
        }
        let alone = format!("{}\n{}\n", text.lines().next().unwrap(), &cut[cut.len() - keep..]);
        let rejection = read_bytes(alone.as_bytes(), &native(), ReadOptions::default()).unwrap_err();
        assert_eq!((&*rejection.reason, rejection.line), ("last line is cut", Some(2)));
    }
}

#[test]
fn lines_above_the_header_are_counted_in_the_remedy() {
    let (_, text) = made_recording(3);
    let text = format!("Exported by cell 4\n\nRobot;R00\n{text}");
    let rejection = read_bytes(text.as_bytes(), &native(), ReadOptions::default()).unwrap_err();
    assert_eq!(
        &*rejection.remedy,
        "the names of the columns are in line 4: set skip_lines = 3 in the layout"
    );
    let mut layout = native();
    layout.text.skip_lines = 3;
    assert_eq!(read_bytes(text.as_bytes(), &layout, ReadOptions::default()).unwrap().rows(), 3);
}

#[test]
fn a_header_of_countless_columns_is_refused_before_anything_is_made_of_it() {
    let (_, text) = made_recording(1);
    let (header, row) = text.split_once('\n').unwrap();
    let wide = |columns: usize| {
        let more = columns - header.split(',').count();
        format!("{header}{}\n{}{}\n", ",x".repeat(more), row.trim_end(), ",0".repeat(more))
    };
    let read = |columns| read_bytes(wide(columns).as_bytes(), &native(), ReadOptions::default());
    let rejection = read(MAX_COLUMNS + 1).unwrap_err();
    assert_eq!((&*rejection.reason, rejection.line), ("a header of more than 10000 columns", Some(1)));
    assert_eq!(read(MAX_COLUMNS).unwrap().rows(), 1);
}
