//! One recording gives the same results with all kinds of stage signals.

use std::fs;
use std::path::Path;

use crate::support::Workshop;

/// A workshop whose native layout has another section `[stage]`.
fn with_stage(section: &str) -> Workshop {
    let workshop = Workshop::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let native = fs::read_to_string(root.join("config/exports/native.toml")).expect("the native layout");
    let start = native.find("[stage]").expect("a section");
    let end = native.find("# Optional columns").expect("what follows");
    let text = format!("{}[stage]\n{section}\n\n{}", &native[..start], &native[end..]);
    fs::write(workshop.path("layout.toml"), text).expect("a layout");
    workshop.use_file("layout", "layout.toml");
    workshop
}

const COUNTED: [&str; 4] = ["--cycles", "2", "--warming-s", "10"];

/// All values that depend on stages.
const FIGURES: &str = "SELECT cycle, joint, parameter, value, std_error FROM cycle_parameters
     UNION ALL SELECT cycle, joint, stage, rmsd_nm, samples FROM cycle_rmsd
     UNION ALL SELECT cycle, joint, speed_fraction || ' ' || direction, torque_nm, samples FROM friction_points
     ORDER BY 1, 2, 3";

fn figures(section: Option<&str>, signal: &str) -> Vec<String> {
    let workshop = section.map_or_else(Workshop::new, with_stage);
    let export = workshop.simulate("inbox", &[&COUNTED[..], &["--stage-signal", signal]].concat());
    workshop.stdout(&["ingest", &export[0].display().to_string()], 0);
    workshop.query(FIGURES)
}

#[test]
fn words_columns_and_levels_give_what_numbers_give() {
    let numbers = figures(None, "integer");
    assert!(numbers.len() > 2 * 64, "{}", numbers.len());
    let words = "column = \"stage\"\nbetween = [\"IDLE\"]\nexcitation = [\"EXC\"]\nfriction = [\"FRIC\"]\nwarming = [\"WARM\"]";
    assert_eq!(figures(Some(words), "text"), numbers);
    let one_hot = "kind = \"one_hot\"\nexcitation = \"exc\"\nfriction = \"fric\"\nwarming = \"warm\"";
    assert_eq!(figures(Some(one_hot), "one-hot"), numbers);
    // a spike at the boundary may move it by a row
    let levels = "kind = \"levels\"\ncolumn = \"stage\"\nbetween = [-0.5, 0.5]\nexcitation = [2, 3]\n\
                  friction = [4.5, 5.5]\nwarming = [7, 8]\nhysteresis = 0.2\ndebounce_s = 0.1";
    assert_eq!(figures(Some(levels), "analogue"), numbers);
}

#[test]
fn two_stages_at_once_are_refused_with_their_line() {
    let workshop =
        with_stage("kind = \"one_hot\"\nexcitation = \"exc\"\nfriction = \"fric\"\nwarming = \"warm\"");
    let export = workshop
        .simulate("inbox", &["--cycles", "1", "--warming-s", "0", "--stage-signal", "one-hot"])[0]
        .clone();
    let text = fs::read_to_string(&export).expect("the export");
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let names: Vec<&str> = lines[0].split(',').collect();
    let fric = names.iter().position(|name| *name == "fric").expect("a column");
    let row =
        lines.iter().position(|line| line.split(',').nth(fric - 1) == Some("1")).expect("an excitation");
    let mut cells: Vec<&str> = lines[row].split(',').collect();
    cells[fric] = "TRUE";
    let both = cells.join(",");
    lines[row] = both;
    fs::write(&export, lines.join("\n") + "\n").expect("an export");
    let out = workshop.stdout(&["explain", "--json", &export.display().to_string()], 1);
    let said: serde_json::Value = serde_json::from_str(out.trim()).expect("an object");
    assert_eq!(said["rejection"]["line"].as_u64(), Some(row as u64 + 1));
    assert_eq!(said["rejection"]["column"], "fric");
    assert!(
        said["rejection"]["reason"]
            .as_str()
            .is_some_and(|text| text.contains("two stages at the same time: exc"))
    );
}

/// Without any signal the stages also contain the approaches to them: the same arm, from other rows.
#[test]
fn motion_alone_gives_the_same_cycles_friction_and_parameters_within_their_errors() {
    let signals = Workshop::new();
    let arguments = ["--cycles", "2", "--warming-s", "20", "--stage-signal"];
    let take = |workshop: &Workshop, signal: &str| {
        let export = workshop.simulate("inbox", &[&arguments[..], &[signal]].concat());
        workshop.stdout(&["ingest", &export[0].display().to_string()], 0);
    };
    take(&signals, "integer");
    let motion = with_stage("kind = \"motion\"");
    take(&motion, "none");
    let said = "SELECT count(*) FROM cycles WHERE remarks LIKE '%stages come from the motion%' AND status = 'complete'";
    assert_eq!(motion.number(said), 2);

    let friction = "SELECT cycle, joint, speed_fraction, direction, torque_nm FROM friction_points
                    ORDER BY cycle, joint, speed_fraction, direction";
    let points = |workshop: &Workshop| -> Vec<(String, f64)> {
        let split = |row: String| {
            row.rsplit_once('|').map(|(key, torque)| (key.to_owned(), torque.parse().expect("Nm")))
        };
        workshop.query(friction).into_iter().filter_map(split).collect()
    };
    let (expected, found) = (points(&signals), points(&motion));
    assert!(expected.len() > 100, "{}", expected.len());
    // by motion a level may be found that is not constant at the signals' level
    let off = |(key, torque): &(String, f64)| {
        let same = found.iter().find(|(other, _)| other == key).unwrap_or_else(|| panic!("no point {key}"));
        (same.1 - torque).abs() / torque.abs()
    };
    let worst = expected.iter().map(off).fold(0.0, f64::max);
    assert!(worst < FRICTION, "{worst}");

    let values = "SELECT cycle, joint, parameter, value, std_error FROM cycle_parameters ORDER BY 1, 2, 3";
    let values = |workshop: &Workshop| -> Vec<[f64; 2]> {
        let row = |row: String| {
            let cells: Vec<f64> =
                row.split('|').skip(3).map(|cell| cell.parse().expect("a number")).collect();
            [cells[0], cells[1]]
        };
        workshop.query(values).into_iter().map(row).collect()
    };
    let (expected, found) = (values(&signals), values(&motion));
    assert_eq!(found.len(), expected.len());
    let mut off: Vec<f64> =
        expected.iter().zip(&found).map(|(a, b)| (a[0] - b[0]).abs() / a[1].hypot(b[1])).collect();
    off.sort_by(f64::total_cmp);
    let median = off[off.len() / 2];
    // other rows of the same noise: well within the standard errors of both
    assert!(off[off.len() - 1] < 2.0, "{off:?}");
    assert!(median < 0.5, "{off:?}");
}

/// Tolerance of friction: plateaus found by motion may begin and end some rows apart from those of signals.
const FRICTION: f64 = 0.01;
