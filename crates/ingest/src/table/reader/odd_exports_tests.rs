//! One fixture file for each oddity, and its message.

use super::{ExportReader, ReadOptions};
use crate::bytes::source::open;
use crate::fixture::{fixture, native as layout, read, read_bytes};
use crate::rejection::Rejection;
use armwatch_config::{BLANKS, Column, DecimalMark, Layout, ScaledColumn, TextFormat, TextTime, TimeSource};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::{FrictionSignal, RawSamples, Stage, StageReading};
use armwatch_testing::er3a;

fn rejected(name: &str) -> Rejection {
    match read(&fixture(name)) {
        Err(rejection) => {
            assert_eq!(*rejection.path, *fixture(name));
            assert!(!rejection.remedy.is_empty());
            rejection
        }
        Ok(samples) => panic!("{name} was read as {} rows", samples.rows()),
    }
}

/// The message without the path.
fn message(name: &str) -> String {
    let text = rejected(name).to_string();
    text.strip_prefix(&fixture(name).display().to_string()).expect("path first").to_owned()
}

fn assert_message(name: &str, beginning: &str) {
    let message = message(name);
    assert!(message.starts_with(beginning), "{name}{message}");
}

fn native() -> RawSamples {
    read(&fixture("native.csv")).unwrap()
}

#[test]
fn the_native_layout_is_read_as_it_is_written() {
    let samples = native();
    assert_eq!(samples.time, [0.0, 0.002, 0.004, 0.006, 0.008]);
    assert_eq!(samples.position[1], [0.2, 0.21, 0.22, 0.23, 0.24]);
    assert_eq!(samples.velocity.as_ref().unwrap()[5], [-1.2, -1.15, -1.1, -1.05, -1.0]);
    assert_eq!(samples.torque[0], [3.0, 2.5, 2.0, 1.5, 1.0]);
    let stages = [Stage::Between, Stage::Excitation, Stage::Friction, Stage::Warming, Stage::Between];
    assert_eq!(samples.stage, StageReading::Known(stages.into()));
    assert_eq!(samples.cycle.as_deref(), Some(&[1, 1, 1, 1, 2][..]));
    let tested = Some(FrictionSignal { joint: JointIndex::new(2), level: 5 });
    assert_eq!(samples.friction_signal.as_deref(), Some(&[None, None, tested, None, None][..]));
}

#[test]
fn columns_of_blanks_read_the_same() {
    let commas = std::fs::read_to_string(fixture("native.csv")).unwrap();
    let blanks = Layout { delimiter: BLANKS, ..layout() };
    let read = |text: &str| read_bytes(text.as_bytes(), &blanks, ReadOptions::default());
    for (name, text) in [
        ("numpy", commas.replace(',', " ")),
        ("printf", commas.replace(',', "  \t").replace('\n', " \r\n ").trim_end_matches(' ').to_owned()),
        ("quoted", commas.replacen("time", "\"time\"", 1).replace(',', "   ")),
    ] {
        assert_eq!(read(&text).unwrap(), native(), "{name}");
    }
    // exponents, as `savetxt` writes them
    let exponents = commas.replace(',', " ").replace("0.002", "2.000000000000000042e-03");
    assert_eq!(read(&exponents).unwrap(), native());
    let short = |(number, line): (usize, &str)| match number {
        2 => line.rsplit_once(',').unwrap().0.replace(',', " ") + "\n",
        _ => line.replace(',', " ") + "\n",
    };
    let cut: String = commas.lines().enumerate().map(short).collect();
    let said = read(&cut).unwrap_err().to_string();
    assert!(said.contains("line 3: line too short: 22 fields"), "{said}");
    let comma = read_bytes(commas.replace(',', " ").as_bytes(), &layout(), ReadOptions::default());
    let comma = comma.unwrap_err().to_string();
    assert!(comma.contains("a header separated by \"blank\""), "{comma}");
}

#[test]
fn unusual_but_valid_files_read_the_same() {
    for name in [
        "byte_order_mark.csv",
        "crlf.csv",
        "reordered.csv",
        "extra_columns.csv",
        "quoted.csv",
        "blanks_around_numbers.csv",
        "trailing_delimiters.csv",
        "blank_lines_at_the_end.csv",
        "whole_numbers_as_decimals.csv",
        "no_final_newline.csv",
    ] {
        assert_eq!(read(&fixture(name)).as_ref(), Ok(&native()), "{name}");
    }
}

#[test]
fn velocities_and_signals_may_be_absent() {
    let samples = read(&fixture("no_velocity_no_signals.csv")).unwrap();
    let expected = RawSamples { velocity: None, cycle: None, friction_signal: None, ..native() };
    assert_eq!(samples, expected);
}

#[test]
fn files_without_rows() {
    assert_eq!(message("empty.csv"), ": an empty file; wait until the writer has finished, or export again");
    assert_eq!(
        message("header_only.csv"),
        ": a header but no rows; export again, with the rows of the recording"
    );
}

#[test]
fn missing_columns_are_named_with_the_nearest_spelling() {
    let rejection = rejected("missing_column.csv");
    assert_eq!((rejection.line, rejection.column.as_deref()), (Some(1), Some("trq_3")));
    assert_eq!(&*rejection.reason, "missing column");
    assert!(rejection.remedy.contains("the export has time, pos_1, pos_2,"), "{rejection}");
    assert!(rejection.remedy.contains("trq_2, torque_3, trq_4"), "{rejection}");

    let rejection = rejected("misspelt_velocity.csv");
    assert_eq!(rejection.column.as_deref(), Some("vel_1"));
    assert!(rejection.remedy.starts_with("did you mean Vel_1? "), "{rejection}");
}

#[test]
fn headers_that_are_not_this_robots() {
    assert_message(
        "no_stage.csv",
        ", line 1, column stage: no stage signal: the column is missing; name the column",
    );
    assert_message(
        "seven_joints.csv",
        ", line 1: wrong joint count: the export has positions for 7 joints, the description of er3a has 6; give",
    );
    assert_message(
        "five_joints.csv",
        ", line 1: wrong joint count: the export has positions for 5 joints, the description of er3a has 6; give",
    );
    assert_message("duplicate_column.csv", ", line 1, column pos_1: a column that exists twice;");
    assert_message("no_header.csv", ", line 1: no header line: the first line holds only numbers;");
    assert_message("semicolons.csv", ", line 1: a header separated by semicolon, not by ',';");
}

#[test]
fn bad_cells_are_named_by_line_and_column() {
    for (name, beginning) in [
        (
            "text_in_number.csv",
            ", line 4, column trq_3: \"abc\" is not a number; export again or correct the cell",
        ),
        ("decimal_comma.csv", ", line 5, column vel_2: \"0,25\" is a number with a decimal comma;"),
        ("nan.csv", ", line 3, column pos_4: \"NaN\" is not a finite number;"),
        ("infinity.csv", ", line 6, column trq_6: \"-inf\" is not a finite number;"),
        ("empty_cell.csv", ", line 5, column vel_6: empty cell;"),
        (
            "unknown_stage.csv",
            ", line 4, column stage: \"7\" is not a known stage; add the value to the stage signal",
        ),
        ("stage_in_between.csv", ", line 4, column stage: \"1.5\" is not a known stage;"),
        (
            "absurd_position.csv",
            ", line 4, column pos_2: \"1e200\" is beyond any joint's position (more than 1e4 rad",
        ),
        (
            "absurd_velocity.csv",
            ", line 4, column vel_2: \"-10001\" is beyond any joint's velocity (more than 1e4",
        ),
        (
            "absurd_torque.csv",
            ", line 4, column trq_2: \"2e7\" is beyond any joint's torque (more than 1e7 Nm",
        ),
        ("cycle_negative.csv", ", line 2, column cycle: \"-1\" is not in 0 to 1000000;"),
        ("joint_seven.csv", ", line 4, column joint: \"7\" is not in 0 to 6;"),
        ("level_seven.csv", ", line 4, column level: \"7\" is not in 0 to 6;"),
        ("level_fraction.csv", ", line 4, column level: \"2.5\" is not a whole number;"),
    ] {
        assert_message(name, beginning);
    }
}

#[test]
fn time_that_does_not_rise_says_both_values() {
    assert_message(
        "time_backwards.csv",
        ", line 5, column time: \"0.001\" is earlier than 0.004 in the previous row: time runs backwards;",
    );
    assert_message(
        "time_standing_still.csv",
        ", line 4, column time: \"0.0020\" is not later than 0.002 in the previous row: time does not advance;",
    );
}

#[test]
fn lines_of_the_wrong_shape() {
    for (name, beginning) in [
        ("line_too_long.csv", ", line 3: line too long: 24 fields, the header has 23;"),
        ("line_too_short.csv", ", line 3: line too short: 22 fields, the header has 23;"),
        ("short_and_long.csv", ", line 3: line too short: 22 fields, the header has 23;"),
        ("repeated_header.csv", ", line 5: repeated header: two exports in one file;"),
        ("blank_line.csv", ", line 4: blank line between rows;"),
    ] {
        assert_message(name, beginning);
    }
}

#[test]
fn cut_files() {
    for name in ["cut_last_line.csv", "cut_last_number.csv", "nul_tail.csv"] {
        assert_eq!(read(&fixture(name)), Ok(native().take_front(4)), "{name}");
    }
    assert_message("nul_in_line.csv", ", line 4: NUL bytes: a hole left by a crash or an unfinished copy;");
}

/// The last number of the file is 16.00 and could be the beginning of 16.004.
#[test]
fn a_row_that_may_be_cut_in_its_last_number_is_left_out() {
    let mut whole = native();
    let read = read(&fixture("no_final_newline_after_torque.csv")).unwrap();
    assert_eq!(read, whole.take_front(4));
}

#[test]
fn foreign_encodings_are_read_and_those_that_are_none_are_named() {
    for name in ["utf16.csv", "utf16_no_bom.csv", "latin1.csv", "latin1_in_a_cell.csv"] {
        assert_eq!(read(&fixture(name)).as_ref(), Ok(&native()), "{name}");
    }
    assert_message(
        "utf8_and_latin1.csv",
        ", line 5, column note: text that is not UTF-8; it looks like Latin-1;",
    );
    assert_message(
        "utf32.csv",
        ", line 1: text that is not UTF-8; it looks like UTF-32 (little endian); export as UTF-8",
    );
    assert_message("carriage_returns.csv", ", line 1: lines that end only with carriage returns;");
}

#[test]
fn lines_before_the_rows() {
    for name in ["comments_before_header.csv", "header_behind_comment_sign.csv"] {
        assert_eq!(read(&fixture(name)).as_ref(), Ok(&native()), "{name}");
    }
    assert_message(
        "unit_row.csv",
        ", line 2, column time: \"[s]\" is not a number; if this line gives units or types, set \
         skip_after_header = 1 in the layout (the line begins at byte ",
    );
    let with = |name: &str, text: TextFormat| {
        let bytes = std::fs::read(fixture(name)).unwrap();
        read_bytes(&bytes, &Layout { text, ..layout() }, ReadOptions::default())
    };
    let units = TextFormat { skip_after_header: 1, ..TextFormat::default() };
    assert_eq!(with("unit_row.csv", units), Ok(native()));
    let lines = TextFormat { skip_lines: 3, ..TextFormat::default() };
    assert_eq!(with("lines_before_header.csv", lines), Ok(native()));
    assert!(with("lines_before_header.csv", TextFormat::default()).is_err());
}

#[test]
fn delimiters_at_the_end_of_rows_or_header_only_and_mixed_line_ends() {
    for name in
        ["trailing_delimiters_in_rows.csv", "trailing_delimiter_in_header.csv", "crlf_in_the_middle.csv"]
    {
        assert_eq!(read(&fixture(name)).as_ref(), Ok(&native()), "{name}");
    }
}

#[test]
fn a_decimal_comma_is_read_where_the_layout_says_so_and_explained_where_not() {
    let comma = |delimiter| Layout {
        delimiter,
        text: TextFormat { decimal: DecimalMark::Comma, ..TextFormat::default() },
        ..layout()
    };
    let read = |name: &str, layout: &Layout| {
        read_bytes(&std::fs::read(fixture(name)).unwrap(), layout, ReadOptions::default())
    };
    assert_eq!(read("decimal_commas.csv", &comma(b';')), Ok(native()));
    assert_eq!(read("decimal_commas_quoted.csv", &comma(b',')), Ok(native()));
    let said = |name: &str, layout: &Layout| read(name, layout).unwrap_err().to_string();
    let points = said("semicolons.csv", &comma(b';'));
    assert!(
        points.starts_with(
            "a.csv, line 2, column time: \"0.000\" is a number with a decimal point, but the layout has \
            decimal = \",\"; take decimal"
        ),
        "{points}"
    );
    let commas = said("decimal_commas.csv", &Layout { delimiter: b';', ..layout() });
    assert!(commas.contains("\"0,000\" is a number with a decimal comma; set decimal = \",\""), "{commas}");
    let thousands = said("thousands.csv", &comma(b';'));
    assert!(
        thousands.contains("line 4, column trq_3: \"1.009,00\" is a number with thousands separators;"),
        "{thousands}"
    );
}

#[test]
fn times_in_other_units_and_as_timestamps() {
    let read = |name: &str, time: TimeSource| {
        read_bytes(
            &std::fs::read(fixture(name)).unwrap(),
            &Layout { time, ..layout() },
            ReadOptions::default(),
        )
    };
    let column = || Column::Name("time".into());
    let ticks = || ScaledColumn { column: column(), to_si: 0.002 };
    assert_eq!(
        read("timestamps.csv", TimeSource::Text { column: column(), form: TextTime::Timestamp }),
        Ok(native())
    );
    assert_eq!(read("ticks.csv", TimeSource::Column(ticks())), Ok(native()));
    let wrapping = read("wrapping_ticks.csv", TimeSource::Counter { column: ticks(), wraps_at: 65_536.0 });
    assert_eq!(wrapping, Ok(native()));
    let said = read("wrapping_ticks.csv", TimeSource::Column(ticks())).unwrap_err();
    assert_eq!(&*said.remedy, "if this is a counter that started again, set wraps_at = 65536 under [time]");
    let said =
        read("native.csv", TimeSource::Text { column: column(), form: TextTime::Timestamp }).unwrap_err();
    assert_eq!((said.line, &*said.reason), (Some(2), "not a date and time"));
}

/// Each line of these files has a known length, so the byte of a line is known too.
#[test]
fn the_byte_of_a_bad_line_is_that_of_the_file_whatever_its_encoding() {
    let text = std::fs::read_to_string(fixture("text_in_number.csv")).unwrap();
    let start = text.lines().take(3).map(|line| line.len() + 1).sum::<usize>() as u64;
    let byte = |bytes: &[u8]| read_bytes(bytes, &layout(), ReadOptions::default()).unwrap_err().byte;
    assert_eq!(byte(text.as_bytes()), Some(start));
    assert_eq!(byte(["\u{feff}", &text].concat().as_bytes()), Some(start + 3));
    let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert_eq!(byte(&wide), Some(2 * start));
    let narrow: Vec<u8> = [&b"\xB0\n"[..], text.as_bytes()].concat();
    let skipping = Layout { text: TextFormat { skip_lines: 1, ..TextFormat::default() }, ..layout() };
    let rejection = read_bytes(&narrow, &skipping, ReadOptions::default()).unwrap_err();
    assert_eq!((rejection.line, rejection.byte), (Some(5), Some(start + 2)));
}

/// A cut stream returns all whole lines before the cut, for any blocks.
#[test]
fn rows_before_the_cut_of_a_compressed_stream_are_kept() {
    let text = std::fs::read_to_string(fixture("native.csv")).unwrap();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    std::io::Write::write_all(&mut encoder, text.as_bytes()).unwrap();
    let whole = encoder.finish().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv.gz");
    // Stored without compression, so that half of the file holds about half of the text.
    std::fs::write(&path, &whole[..whole.len() - 100]).unwrap();
    for block_bytes in [64, 1 << 20] {
        let options = ReadOptions { block_bytes };
        let mut reader = ExportReader::new(open(&path).unwrap(), &path, &layout(), &er3a(), options).unwrap();
        let (mut rows, mut fault) = (RawSamples::default(), None);
        for item in &mut reader {
            match item {
                Ok(chunk) => rows.append(chunk.samples),
                Err(rejection) => fault = Some(rejection),
            }
        }
        assert_eq!(rows, native().take_front(4), "{block_bytes}");
        let fault = fault.unwrap();
        assert_eq!(fault.line, Some(6), "{fault}");
        assert!(fault.reason.contains(&format!("at byte {} of the file", whole.len() - 100)), "{fault}");
    }
}
