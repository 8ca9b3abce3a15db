//! Proposed layouts, loaded and used: the samples must be those of the native export.

use std::fmt::Write;
use std::path::Path;

use super::super::fixture::native;
use super::*;
use crate::infer::proposal::{Hints, Proposed};
use crate::table::reader::{ExportReader, ReadOptions};
use armwatch_config::{Layout, parse_layout};
use armwatch_model::run::RawSamples;
use armwatch_testing::er3a;

/// Rows of each made export: three stages of two seconds.
const ROWS: usize = 1500;

/// Largest difference of a sample, in SI: exports are written with nine decimals, and degrees and turns a
/// minute lose one or two of them.
const ROUNDING: f64 = 1e-6;

/// Form of a recording.
struct Style {
    names: fn(usize) -> [String; 3],
    singles: [&'static str; 5],
    units_row: Option<[&'static str; 4]>,
    /// Factors from SI to the file: time, position, velocity.
    per_si: [f64; 3],
    delimiter: char,
    comma: bool,
    stages: [i64; 4],
}

fn native_style() -> Style {
    Style {
        names: |j| [format!("pos_{j}"), format!("vel_{j}"), format!("trq_{j}")],
        singles: ["time", "stage", "cycle", "joint", "level"],
        units_row: None,
        per_si: [1.0; 3],
        delimiter: ',',
        comma: false,
        stages: [0, 1, 2, 3],
    }
}

/// Positions and velocities of a row: all joints, one by one, all again.
fn motion(row: usize, joint: usize) -> (f64, f64) {
    let time = row as f64 * 0.004;
    let rate = 1.0 + joint as f64 * 0.37;
    let moves = match row / 500 {
        1 => row % 500 / 84 == joint,
        _ => true,
    };
    if !moves {
        return (0.1, 0.0);
    }
    let phase = rate * time;
    (0.8 * phase.sin(), 0.8 * rate * phase.cos())
}

fn export(style: &Style) -> String {
    let separator = style.delimiter.to_string();
    let mut header = vec![style.singles[0].to_owned()];
    for quantity in 0..3 {
        header.extend((1..=6).map(|joint| (style.names)(joint)[quantity].clone()));
    }
    header.extend(style.singles[1..].iter().map(|name| (*name).to_owned()));
    let mut text = header.join(&separator) + "\n";
    if let Some([time, position, velocity, torque]) = style.units_row {
        let units = [(time, 1), (position, 6), (velocity, 6), (torque, 6), ("", 4)];
        let cells: Vec<&str> = units.iter().flat_map(|(unit, n)| vec![*unit; *n]).collect();
        text += &(cells.join(&separator) + "\n");
    }
    let [time, position, velocity] = style.per_si;
    for row in 0..ROWS {
        let joints: Vec<(f64, f64)> = (0..6).map(|joint| motion(row, joint)).collect();
        let mut line = format!("{}", (row as f64 * 0.004 * time * 1e9).round() / 1e9);
        joints.iter().for_each(|(q, _)| write!(line, "|{:.9}", q * position).unwrap());
        joints.iter().for_each(|(_, v)| write!(line, "|{:.9}", v * velocity).unwrap());
        (1..=6).for_each(|j| write!(line, "|{:.3}", joints[j - 1].1 * j as f64).unwrap());
        let stage = row / 500 + 1;
        write!(line, "|{}|1|0|0", style.stages[stage]).unwrap();
        let line = if style.comma { line.replace('.', ",") } else { line };
        text += &(line.replace('|', &separator) + "\n");
    }
    text
}

/// The native export of these tests.
pub(super) fn native_text() -> String {
    export(&native_style())
}

fn proposed(bytes: &[u8], hints: Hints<'_>) -> Proposed {
    infer(bytes, Path::new("a.csv"), "proposed", hints).unwrap()
}

fn loaded(proposed: &Proposed) -> Layout {
    assert_eq!(proposed.questions, 0, "{}", proposed.toml);
    parse_layout("proposed.toml", &proposed.toml).unwrap_or_else(|e| panic!("{e}\n{}", proposed.toml))
}

fn samples(bytes: &[u8], layout: &Layout) -> RawSamples {
    let reader =
        ExportReader::new(bytes, Path::new("a.csv"), layout, &er3a(), ReadOptions::default()).unwrap();
    let mut samples = RawSamples::default();
    reader.for_each(|chunk| samples.append(chunk.unwrap().samples));
    samples
}

fn assert_same(found: &RawSamples, expected: &RawSamples, toml: &str) {
    let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= ROUNDING);
    let channels =
        |s: &RawSamples| [s.position.clone(), s.velocity.clone().unwrap(), s.torque.clone()].concat();
    assert!(close(&found.time, &expected.time), "time\n{toml}");
    for (channel, (a, b)) in channels(found).iter().zip(&channels(expected)).enumerate() {
        assert!(close(a, b), "channel {channel}\n{toml}");
    }
    assert_eq!((&found.stage, &found.cycle), (&expected.stage, &expected.cycle), "{toml}");
}

#[test]
fn proposals_read_exports_of_many_houses_as_the_native_one() {
    let truth = samples(export(&native_style()).as_bytes(), &native());
    let deg = 180.0 / std::f64::consts::PI;
    let rpm = 60.0 / std::f64::consts::TAU;
    let styles = [
        native_style(),
        // German, degrees, decimal comma
        Style {
            names: |j| {
                [
                    format!("Achse {j} Istwert [°]"),
                    format!("Achse {j} Geschwindigkeit"),
                    format!("A{j}_Drehmoment"),
                ]
            },
            singles: ["Zeit [ms]", "Phase", "Zyklus", "Achse", "Stufe"],
            per_si: [1e3, deg, deg],
            delimiter: ';',
            comma: true,
            ..native_style()
        },
        // No units anywhere: only the numbers give them.
        Style {
            names: |j| [format!("q{j}"), format!("qd{j}"), format!("tau{j}")],
            per_si: [1e6, deg, rpm],
            delimiter: '\t',
            ..native_style()
        },
        // French, units in a separate row, foreign stage values
        Style {
            names: |j| [format!("Position axe {j}"), format!("Vitesse axe {j}"), format!("Couple axe {j}")],
            singles: ["Temps", "Etape", "Cycle", "axe", "niveau"],
            units_row: Some(["s", "rad", "tr/min", "N.m"]),
            per_si: [1.0, 1.0, rpm],
            delimiter: ';',
            stages: [5, 10, 20, 30],
            ..native_style()
        },
        // Chinese; counts of a clock of 4 ms
        Style {
            names: |j| [format!("关节{j}位置"), format!("关节{j}速度"), format!("关节{j}力矩[Nm]")],
            singles: ["时间", "阶段", "循环", "关节", "等级"],
            per_si: [250.0, 1.0, 1.0],
            ..native_style()
        },
    ];
    for style in styles {
        let text = export(&style);
        let proposed = proposed(text.as_bytes(), Hints::default());
        assert_same(&samples(text.as_bytes(), &loaded(&proposed)), &truth, &proposed.toml);
    }
}

#[test]
fn the_encoding_does_not_matter() {
    let style = Style {
        names: |j| [format!("q{j} [°]"), format!("qd{j}"), format!("M{j} Moment")],
        ..native_style()
    };
    let text = export(&style);
    let plain = proposed(text.as_bytes(), Hints::default());
    let wide: Vec<u8> = [0xFEFF].into_iter().chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
    let (narrow, ..) = encoding_rs::WINDOWS_1252.encode(&text);
    for bytes in [wide, narrow.into_owned()] {
        let other = proposed(&bytes, Hints::default());
        let keys = |toml: &str| -> Vec<String> {
            toml.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
        };
        assert_eq!(keys(&other.toml), keys(&plain.toml));
    }
}

#[test]
fn without_names_the_arm_tells_how_many_columns_belong_together() {
    let native_text = export(&native_style());
    let rows: String = native_text.lines().skip(1).map(|line| line.to_owned() + "\n").collect();
    let robot = er3a();
    let asked = proposed(rows.as_bytes(), Hints::default());
    assert!(asked.questions > 0 && asked.toml.contains("# ? "), "{}", asked.toml);
    let told = proposed(
        rows.as_bytes(),
        Hints {
            robot: Some(&robot),
            gravity_torques: Some(|_, _| Some(vec![0.1, 0.5, 0.2, 0.0, 0.0, 2.0])),
            ..Hints::default()
        },
    );
    let layout = loaded(&told);
    assert!(!layout.header);
    let truth = samples(native_text.as_bytes(), &native());
    let found = samples(rows.as_bytes(), &layout);
    assert_eq!((found.position, found.torque), (truth.position, truth.torque), "{}", told.toml);
}

#[test]
fn recordings_at_the_motors_without_time_need_only_the_rate() {
    let text: String =
        std::iter::once((1..=6).map(|j| format!("mpos_{j},mtrq_{j}")).collect::<Vec<_>>().join(","))
            .chain((0..200).map(|row| {
                let cells = (0..6).map(|joint| format!("{},{joint}.5", 300.0 * motion(row, joint).0));
                cells.collect::<Vec<_>>().join(",")
            }))
            .map(|line| line + "\n")
            .collect();
    let asked = proposed(text.as_bytes(), Hints::default());
    assert!(asked.toml.contains("how many rows are there per second?"), "{}", asked.toml);
    let told = proposed(text.as_bytes(), Hints { sample_rate: Some(5000.0), ..Hints::default() });
    assert!(
        told.toml.contains("column = \"mpos_{joint}\"") && told.toml.contains("side = \"motor\""),
        "{}",
        told.toml
    );
}

#[test]
fn reasons_and_ratios_stand_above_the_keys() {
    let style = Style {
        names: |j| [format!("q{j}"), format!("qd{j}"), format!("tau{j}")],
        per_si: [1.0, 180.0 / std::f64::consts::PI, 1.0],
        ..native_style()
    };
    let toml = proposed(export(&style).as_bytes(), Hints::default()).toml;
    assert!(toml.contains("velocity is 0.0175 times the change of position"), "{toml}");
    assert!(toml.contains("unit = \"deg\"") && toml.contains("unit = \"rad/s\""), "{toml}");
}

#[test]
fn velocities_that_count_against_positions_get_a_sign() {
    let style = Style { per_si: [1.0, 1.0, -1.0], ..native_style() };
    let toml = proposed(export(&style).as_bytes(), Hints::default()).toml;
    assert!(toml.contains("sign = [-1, -1, -1, -1, -1, -1]"), "{toml}");
}

/// The native export with temperatures of its joints and of the ambient air under other names.
fn with_temperatures(motor: fn(usize) -> String, hall: &str, cells: [fn(usize) -> String; 2]) -> String {
    let text = export(&native_style());
    let mut lines = text.lines();
    let names: Vec<String> = (1..=6).map(motor).chain([hall.to_owned()]).collect();
    let mut found = format!("{},{}\n", lines.next().unwrap(), names.join(","));
    for (row, line) in lines.enumerate() {
        let motors = (0..6).map(|_| cells[0](row)).collect::<Vec<_>>().join(",");
        writeln!(found, "{line},{motors},{}", cells[1](row)).unwrap();
    }
    found
}

#[test]
fn temperatures_are_proposed_with_their_units_and_disturb_nothing() {
    let sparse =
        |row: usize| if row.is_multiple_of(50) { format!("{}", 30 + row / 300) } else { String::new() };
    let kelvin = |row: usize| format!("{:.1}", 303.15 + (row / 300) as f64);
    let text = with_temperatures(
        |j| format!("Motortemperatur A{j} [°C]"),
        "Raumtemperatur",
        [sparse, |_| "21.5".into()],
    );
    let proposal = proposed(text.as_bytes(), Hints::default());
    let found = samples(text.as_bytes(), &loaded(&proposal));
    let temperatures = found.temperatures.clone().expect("named");
    let motor = temperatures.motor[5].as_ref().expect("all of them");
    assert_eq!(motor.measured().map(|(rows, _)| rows).sum::<usize>(), ROWS / 50);
    assert!(motor.measured().all(|(_, kelvin)| (303.0..309.0).contains(&kelvin)));
    assert!(
        temperatures.ambient.expect("named").measured().all(|(_, kelvin)| (kelvin - 294.65).abs() < 0.01)
    );
    let plain = samples(export(&native_style()).as_bytes(), &native());
    assert_eq!(RawSamples { temperatures: None, ..found }, plain, "{}", proposal.toml);

    let text =
        with_temperatures(|j| format!("motor_temp_{j}"), "room temperature", [kelvin, |_| "71.2".into()]);
    let toml = proposed(text.as_bytes(), Hints::default()).toml;
    assert!(
        toml.contains("unit = \"K\"") && toml.contains("unit = \"degF\"") && !toml.contains("Not read"),
        "{toml}"
    );

    let text =
        with_temperatures(|j| format!("inverter temperature {j}"), "cabinet temperature", [sparse, sparse]);
    let toml = proposed(text.as_bytes(), Hints::default()).toml.replace("\n#", "");
    assert!(
        !toml.contains("_temperature]") && toml.contains("cabinet temperature (a temperature, but not known"),
        "{toml}"
    );
}

/// The native export without names, its torques divided by `gain`.
fn nameless(gain: f64) -> String {
    let text = export(&native_style());
    let rows = text.lines().skip(1).map(|line| {
        let cells = line.split(',').enumerate().map(|(column, cell)| match column {
            13..=18 => format!("{:.6}", cell.parse::<f64>().unwrap() / gain),
            _ => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",") + "\n"
    });
    rows.collect()
}

/// Gravity torques equal to those of the made exports, in Nm.
fn gravity(_: &armwatch_model::robot::Robot, _: &[f64]) -> Option<Vec<f64>> {
    Some(vec![0.1, 1.0, 1.0, 0.2, 0.1, 6.0])
}

#[test]
fn columns_without_names_are_never_guessed_to_be_torques_where_they_may_be_currents() {
    let plain = er3a();
    let mut with_gains = er3a();
    with_gains.joints.iter_mut().for_each(|joint| joint.drive_gain = Some(10.0));
    let toml = |robot, gravity_torques, gain| {
        let hints = Hints { robot: Some(robot), gravity_torques, sample_rate: None };
        proposed(nameless(gain).as_bytes(), hints)
    };
    let fits = toml(&plain, Some(gravity), 1.0);
    assert_eq!(fits.questions, 0, "{}", fits.toml);
    for (asked, said) in [
        (toml(&plain, Some(gravity), 20.0), "not as large as torques in Nm"),
        (toml(&plain, None, 1.0), "torques in Nm, currents in A and % of rated"),
        (toml(&with_gains, Some(gravity), 1.0), "the description has drive gains"),
        (toml(&with_gains, None, 20.0), "the description has drive gains"),
    ] {
        assert_eq!(asked.questions, 1, "{}", asked.toml);
        let words = asked.toml.replace("\n#", "");
        assert!(words.contains(said) && asked.toml.contains("# ? "), "{}", asked.toml);
        assert!(!asked.toml.contains("\nunit = \"Nm\""), "{}", asked.toml);
    }
}

#[test]
fn torques_by_name_that_are_as_small_as_currents_are_asked_about() {
    let robot = er3a();
    let hints = Hints { robot: Some(&robot), gravity_torques: Some(gravity), sample_rate: None };
    let native = proposed(export(&native_style()).as_bytes(), hints);
    assert_eq!(native.questions, 0, "{}", native.toml);
    let header = export(&native_style()).lines().next().unwrap().to_owned();
    let small = proposed(format!("{header}\n{}", nameless(50.0)).as_bytes(), hints);
    assert!(small.questions == 1 && small.toml.contains("# ? the name contains torque"), "{}", small.toml);
}

#[test]
fn a_log_without_positions_names_its_currents_and_asks_for_positions() {
    let text: String = std::iter::once("time,current_1,current_2,temp_motor_1,temp_motor_2\n".to_owned())
        .chain((0..50).map(|row| format!("{row}.5,{}.25,-1.5,31.5,30\n", row % 5)))
        .collect();
    let found = proposed(text.as_bytes(), Hints::default()).toml;
    assert!(
        found.contains("column = \"current_{joint}\"") && found.contains("the largest is 4.2500"),
        "{found}"
    );
    assert!(!found.contains("columns = []") && found.contains("# ? "), "{found}");
    assert!(found.contains("column = \"temp_motor_{joint}\""), "{found}");
}
