//! Files in an unusual form: the proposal reads its own file, or reports the problem.

use std::path::Path;

use super::proposal::{Hints, Proposed};
use super::{infer, tests};
use crate::table::reader::{ExportReader, ReadOptions};
use armwatch_config::parse_layout;
use armwatch_testing::er3a;

const SCOPE: &str = include_str!("../../../../tests/fixtures/infer/scope_block.csv");
const LINE_ENDS: &str = include_str!("../../../../tests/fixtures/infer/line_end_in_name.csv");
const MINUTES: &str = include_str!("../../../../tests/fixtures/infer/time_in_minutes.csv");

fn proposed(text: &str) -> Proposed {
    let robot = er3a();
    let hints = Hints { robot: Some(&robot), ..Hints::default() };
    infer(text.as_bytes(), Path::new("a.csv"), "a", hints).expect("a table")
}

/// Rows that the export has with the likely answers.
fn rows(text: &str, proposed: &Proposed) -> u64 {
    let toml = proposed.answered.as_ref().unwrap_or_else(|| panic!("no answers\n{}", proposed.toml));
    let layout = parse_layout("a.toml", toml).unwrap_or_else(|errors| panic!("{errors}\n{toml}"));
    let reader =
        ExportReader::new(text.as_bytes(), Path::new("a.csv"), &layout, &er3a(), ReadOptions::default());
    let mut reader = reader.unwrap_or_else(|rejection| panic!("{}\n{toml}", rejection.sentence()));
    for chunk in reader.by_ref() {
        chunk.unwrap_or_else(|rejection| panic!("{}\n{toml}", rejection.sentence()));
    }
    reader.rows()
}

fn words_of(toml: &str) -> String {
    toml.lines().map(|line| line.trim_start_matches('#').trim()).collect::<Vec<_>>().join(" ")
}

/// The made export of the other tests, its lines changed.
fn changed(change: impl Fn(usize, &str) -> String) -> String {
    tests::native_text().lines().enumerate().map(|(at, line)| change(at, line) + "\n").collect()
}

#[test]
fn lines_of_metadata_above_the_rows_are_no_rows() {
    let found = proposed(SCOPE);
    let keys: Vec<&str> = found.toml.lines().filter(|line| !line.starts_with('#')).collect();
    for key in ["skip_lines = 3", "skip_after_header = 5", "excitation = [1]", "column = \"pos_{joint}\""] {
        assert!(keys.contains(&key), "{key}\n{}", found.toml);
    }
    assert_eq!(rows(SCOPE, &found), 81, "{}", found.toml);
}

#[test]
fn names_with_line_ends_in_them_are_understood_and_columns_go_by_number() {
    let found = proposed(LINE_ENDS);
    assert_eq!(found.questions, 0, "{}", found.toml);
    for key in [
        "header = false",
        "skip_lines = 7",
        "columns = [14, 15, 16, 17, 18, 19]",
        "unit = \"Nm\"",
        "column = 20",
    ] {
        assert!(found.toml.lines().any(|line| line == key), "{key}\n{}", found.toml);
    }
    assert_eq!(rows(LINE_ENDS, &found), LINE_ENDS.lines().count() as u64 - 7);
}

#[test]
fn a_column_without_a_name_and_names_that_are_there_twice_do_not_disturb() {
    for text in [
        changed(|at, line| if at == 0 { line.to_owned() } else { format!("{line},ok") }),
        changed(|at, line| if at == 0 { format!("{line},") } else { format!("{line},ok") }),
        changed(|at, line| if at == 0 { format!("{line},trq_1") } else { format!("{line},7") }),
        changed(|at, line| if at == 0 { format!("{line},note,note") } else { format!("{line},7,8") }),
        changed(|_, line| format!("{line},")),
    ] {
        let found = proposed(&text);
        assert_eq!(rows(&text, &found) as usize, text.lines().count() - 1, "{}", found.toml);
    }
    // a number before the first name: the names cannot be assigned to columns
    let text = changed(|at, line| if at == 0 { line.to_owned() } else { format!("{at},{line}") });
    let found = proposed(&text);
    assert!(found.questions > 0 && found.toml.contains("header = false"), "{}", found.toml);
}

#[test]
fn a_bad_cell_does_not_hide_its_column() {
    let plain = proposed(&tests::native_text());
    let text = changed(|at, line| if at == 700 { line.replacen('.', "x", 3) } else { line.to_owned() });
    assert_eq!(proposed(&text).toml, plain.toml);
}

#[test]
fn lines_that_end_with_returns_alone_are_refused_with_the_remedy() {
    let text = tests::native_text().replace('\n', "\r");
    let refused = infer(text.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect_err("one line");
    assert!(refused.sentence().contains("the lines end only with CR"), "{}", refused.sentence());
}

#[test]
fn a_column_called_time_is_never_dropped_without_a_question() {
    let with_time = |time: fn(f64) -> String| {
        changed(|at, line| match line.split_once(',') {
            Some((first, rest)) if at > 0 => format!("{},{rest}", time(first.parse().expect("a time"))),
            _ => line.to_owned(),
        })
    };
    for text in [
        with_time(|s| format!("T#{}ms", (s * 1e3).round())),
        with_time(|s| format!("8:47:{s:06.3}")),
        with_time(|s| format!("05-Jan-2026 08:47:{s:06.3}")),
        with_time(|_| "1.7676E+12".to_owned()),
        with_time(|s| format!("{:.3}", (s + 3.0) % 4.0)),
        with_time(|s| format!("{:.1}", s)),
    ] {
        let found = proposed(&text);
        assert!(
            found.toml.contains("column = \"time\"") && !found.toml.contains("sample_rate_hz"),
            "{}",
            found.toml
        );
        let said = words_of(&found.toml);
        let asks = said.contains("called a time") && said.contains("missing rows cannot be seen");
        assert!(asks == (found.questions > 0), "{}", found.toml);
    }
}

#[test]
fn minutes_are_not_taken_for_the_ticks_of_a_clock() {
    let found = proposed(MINUTES);
    assert!(!found.toml.contains("tick_s") || found.toml.contains("# tick_s"), "{}", found.toml);
    assert!(!found.toml.contains("\nunit = \"deg\""), "{}", found.toml);
    assert!(found.questions > 0 || found.toml.contains("\nunit = \"min\""), "{}", found.toml);
}

#[test]
fn times_of_their_own_are_named_with_their_distance() {
    let own = |late: f64| {
        changed(|at, line| {
            let cells: Vec<&str> = line.split(',').collect();
            let pairs = cells[1..].iter().enumerate().map(|(column, cell)| match at {
                0 => format!("Time,{cell}"),
                _ => {
                    let shift = if (12..18).contains(&column) { late } else { 0.0 };
                    format!("{:.4},{cell}", cells[0].parse::<f64>().expect("a time") + shift)
                }
            });
            pairs.collect::<Vec<_>>().join(",")
        })
    };
    let text = own(0.008);
    let found = proposed(&text);
    let said = words_of(&found.toml);
    assert!(found.questions == 1 && said.contains("25 (0.008 later)"), "{}", found.toml);
    assert_eq!(rows(&text, &found) as usize, text.lines().count() - 1, "{}", found.toml);
    let found = proposed(&own(0.0));
    assert!(
        found.questions == 0 && words_of(&found.toml).contains("The same time is also in 3, 5"),
        "{}",
        found.toml
    );
}

#[test]
fn a_row_that_is_there_twice_is_no_counter_that_began_anew() {
    let text = changed(|at, line| if at == 400 { format!("{line}\n{line}") } else { line.to_owned() });
    assert!(!proposed(&text).toml.contains("wraps_at"));
}

#[test]
fn without_names_several_columns_of_few_values_are_a_question() {
    // stages, cycles, joints and levels, like in a whole test
    let text = changed(|at, line| {
        let cells: Vec<&str> = line.rsplitn(4, ',').collect();
        format!("{},{},{},{}", cells[3], at / 700 + 1, if at % 500 < 250 { 0 } else { 2 }, at / 100 % 3)
    });
    let rows: String = text.lines().skip(1).map(|line| line.to_owned() + "\n").collect();
    let found = proposed(&rows);
    let said = words_of(&found.toml);
    assert!(
        found.toml.contains("# column = 20") && said.contains("column 20 (1, 2, 3) or column"),
        "{}",
        found.toml
    );
    assert!(!found.toml.contains("\nwhole_recording"), "{}", found.toml);
}

#[test]
fn blanks_between_columns_are_proposed_as_numpy_matlab_and_c_write_them() {
    let cell =
        |cell: &str| cell.parse::<f64>().map_or_else(|_| cell.to_owned(), |number| format!("{number:.18e}"));
    let numpy = changed(|at, line| {
        let cells: Vec<String> = line.split(',').map(cell).collect();
        (if at == 0 { "# " } else { "" }).to_owned() + &cells.join(" ")
    });
    let aligned = changed(|_, line| line.split(',').map(|cell| format!("  {cell:>10}")).collect::<String>());
    let fortran =
        changed(|_, line| line.split(',').map(cell).collect::<Vec<_>>().join("   ").replace("e-", "D-0"));
    let expected = tests::native_text().lines().count() as u64 - 1;
    for (writer, text) in [("numpy", numpy), ("C", aligned), ("Fortran", fortran)] {
        let found = proposed(&text);
        assert_eq!(found.questions, 0, "{writer}: {}", found.toml);
        assert!(found.toml.contains("delimiter = \"blank\""), "{writer}: {}", found.toml);
        assert_eq!(rows(&text, &found), expected, "{writer}: {}", found.toml);
    }
}
