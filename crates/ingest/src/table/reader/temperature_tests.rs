//! Temperatures next to the other channels: slow, with gaps, and never a reason to refuse an export.

use std::fmt::Write;
use std::path::Path;

use super::{ExportReader, ReadOptions};
use crate::fixture::{made_recording, native};
use armwatch_config::{DecimalMark, Layout};
use armwatch_model::run::RawSamples;
use armwatch_model::run::temperature::{TemperatureTrack, Temperatures, ZERO_CELSIUS};
use armwatch_testing::er3a;

/// An export of `rows` rows with temperatures in cells from `cell`: motors of joints 2 and 4, ambient.
fn export(rows: usize, cell: impl Fn(usize, usize) -> String) -> (RawSamples, String) {
    let (samples, text) = made_recording(rows);
    let mut lines = text.lines();
    let names = ["motor_temperature_2_degc", "motor_temperature_4_degc", "ambient_temperature_degc"];
    let mut with = format!("{},{}\n", lines.next().expect("a header"), names.join(","));
    for (row, line) in lines.enumerate() {
        writeln!(with, "{line},{},{},{}", cell(row, 0), cell(row, 1), cell(row, 2)).expect("memory");
    }
    (samples, with)
}

fn read(text: &str, layout: &Layout, block_bytes: usize) -> RawSamples {
    let options = ReadOptions { block_bytes };
    let reader =
        ExportReader::new(text.as_bytes(), Path::new("a.csv"), layout, &er3a(), options).expect("a header");
    let mut all = RawSamples::default();
    reader.for_each(|chunk| all.append(chunk.expect("rows").samples));
    all
}

fn track(celsius: impl IntoIterator<Item = Option<f64>>) -> Option<TemperatureTrack> {
    let mut track = TemperatureTrack::default();
    celsius.into_iter().for_each(|value| track.push(value.map(|value| value + ZERO_CELSIUS)));
    Some(track)
}

#[test]
fn temperatures_are_read_where_there_are_any_and_leave_the_rest_alone() {
    let (expected, text) = export(90, |row, of| match of {
        0 => format!("{:.1}", 40.0 + 0.5 * (row / 30) as f64),
        1 if row % 10 == 0 => "33".into(),
        1 => String::new(),
        _ => ["21.5", "NaN", "", "---", " 22.0 "][row % 5].into(),
    });
    for block_bytes in [1 << 20, 700] {
        let mut found = read(&text, &native(), block_bytes);
        let temperatures = found.temperatures.take().expect("recorded");
        assert_eq!(found, expected);
        let second = track((0..90).map(|row| Some(40.0 + 0.5 * f64::from(row / 30))));
        let fourth = track((0..90).map(|row| (row % 10 == 0).then_some(33.0)));
        let hall = track((0..90).map(|row| [Some(21.5), None, None, None, Some(22.0)][row % 5]));
        assert_eq!(
            temperatures,
            Temperatures { motor: vec![None, second, None, fourth, None, None], ambient: hall }
        );
    }
}

#[test]
fn a_file_without_temperatures_is_as_before() {
    let (expected, text) = made_recording(20);
    assert_eq!(read(&text, &native(), 1 << 20), expected);
    assert_eq!(expected.temperatures, None);
}

#[test]
fn other_units_and_decimal_commas_are_the_same_temperatures() {
    let (_, text) = export(12, |row, of| format!("{:.1}", 20.0 + 0.5 * row as f64 + of as f64));
    let expected = read(&text, &native(), 1 << 20);
    let mut commas = native();
    (commas.delimiter, commas.text.decimal) = (b';', DecimalMark::Comma);
    let swapped = text.replace(',', ";").replace('.', ",");
    assert_eq!(read(&swapped, &commas, 1 << 20), expected);
    let (_, fahrenheit) =
        export(12, |row, of| format!("{:.1}", (20.0 + 0.5 * row as f64 + of as f64) * 1.8 + 32.0));
    let toml = include_str!("../../../../../config/exports/native.toml")
        .replace("unit = \"degC\"", "unit = \"degF\"");
    let layout = armwatch_config::parse_layout("f.toml", &toml).expect("a layout");
    assert_eq!(read(&fahrenheit, &layout, 1 << 20), expected);
}

/// Both readers, on cells that hold anything but a delimiter, a quote or a line end.
#[test]
fn whatever_stands_in_a_cell_of_a_temperature_both_readers_take_it_for_the_same() {
    let cells = [
        "", " ", "nan", "inf", "1e999", "abc", "0x1", "1_0", "1.", ".5", "+1", "--1", "1 2", "é", "-0", "°C",
    ];
    let (_, text) = export(cells.len(), |row, of| cells[(row + of) % cells.len()].into());
    let layout = native();
    let fast = read(&text, &layout, 1 << 20);
    // quotes around a number require the exact reader
    let quoted = text.lines().enumerate().map(|(line, row)| match line {
        0 => format!("{row}\n"),
        _ => {
            format!("\"{}\",{}\n", row.split(',').next().expect("time"), row.split_once(',').expect("more").1)
        }
    });
    assert_eq!(read(&quoted.collect::<String>(), &layout, 1 << 20), fast);
    let measured = fast.temperatures.expect("recorded").motor.remove(1).expect("joint 2");
    assert_eq!(measured.measured().map(|(rows, _)| rows).sum::<usize>(), 4, "1., .5, +1 and -0");
}

#[test]
fn a_last_line_cut_in_a_temperature_is_left_out_and_not_refused() {
    let (_, text) = export(5, |_, _| "21.53".into());
    for cut in ["", "21", "21.5"] {
        let end = text.len() - "21.53\n".len();
        assert_eq!(read(&format!("{}{cut}", &text[..end]), &native(), 1 << 20).rows(), 4, "{cut:?}");
    }
}

#[test]
fn a_temperature_that_is_there_twice_is_named() {
    let (_, text) = export(3, |_, _| "20".into());
    let twice = text.replacen("motor_temperature_4_degc", "motor_temperature_2_degc", 1);
    let error =
        ExportReader::new(twice.as_bytes(), Path::new("a.csv"), &native(), &er3a(), ReadOptions::default())
            .expect_err("twice");
    assert_eq!(error.column.as_deref(), Some("motor_temperature_2_degc"));
}
