//! Files of motions and recordings have the positions of the controller, without the offsets of the description.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::Path;

use crate::support::Workshop;

/// Rounding of sums of positions.
const EQUAL: f64 = 1e-12;
/// Rounding of positions in the native layout, rad (m).
const NATIVE_STEP: f64 = 1e-6;

/// Offsets of the joints of [`scara_with_offsets`], rad (m).
const OFFSETS: [f64; 4] = [FRAC_PI_2, 0.0, -0.25, 0.0];

fn shipped(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robots").join(name);
    fs::read_to_string(path).expect("a description")
}

/// The SCARA with an offset of its first joint and of its slide.
fn scara_with_offsets(workshop: &Workshop) {
    let text = shipped("scara.toml")
        .replacen("position_min_deg", "position_offset_deg = 90\nposition_min_deg", 1)
        .replacen("position_min_m", "position_offset_m = -0.25\nposition_min_m", 1);
    fs::write(workshop.path("offset.toml"), text).expect("written");
    fs::write(workshop.path("plain.toml"), shipped("scara.toml")).expect("written");
}

/// Columns of a CSV file that are numbers.
fn table(path: &Path) -> BTreeMap<String, Vec<f64>> {
    let mut reader = csv::Reader::from_path(path).expect("a file");
    let names: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for record in reader.records() {
        for (name, cell) in names.iter().zip(&record.expect("a row")) {
            columns.entry(name.clone()).or_default().push(cell.parse().expect("a number"));
        }
    }
    columns
}

/// Checks that both files have the same rows, except positions, which are less by the offsets.
fn assert_less_by_offsets(with: &Path, without: &Path, tolerance: f64) {
    let (with, without) = (table(with), table(without));
    assert_eq!(with.keys().collect::<Vec<_>>(), without.keys().collect::<Vec<_>>());
    for (name, values) in &with {
        let joint = name.strip_prefix("pos_").map(|rest| rest.split('_').next().expect("a number"));
        let offset = joint.map_or(0.0, |joint| OFFSETS[joint.parse::<usize>().expect("a number") - 1]);
        assert!(values.len() > 100 && values.len() == without[name].len(), "{name}");
        for (value, plain) in values.iter().zip(&without[name]) {
            assert!((value + offset - plain).abs() <= tolerance, "{name}: {value} {plain}");
        }
    }
}

/// A motion of the SCARA within a few degrees of the middle of the ranges.
fn programme() -> String {
    let joint = |kind: &str, unit: &str, centre: f64| {
        format!(
            "{{\"type\": \"{kind}\", \"centre_{unit}\": {centre}, \"a_{unit}_s\": [0.04, -0.04], \"b_{unit}_s\": [0.02, -0.01]}}"
        )
    };
    let joints = [("revolute", "rad", 0.2), ("revolute", "rad", -0.1), ("prismatic", "m", 0.1)]
        .into_iter()
        .chain([("revolute", "rad", 0.0)])
        .map(|(kind, unit, centre)| joint(kind, unit, centre));
    format!(
        "{{\"format\": \"armwatch-trajectory\", \"version\": 1, \"robot\": \"scara-example\", \"base_frequency_hz\": 0.25, \
         \"joints\": [{}]}}",
        joints.collect::<Vec<_>>().join(", ")
    )
}

#[test]
fn motions_for_a_controller_have_its_positions_and_are_read_back() {
    let workshop = Workshop::new();
    scara_with_offsets(&workshop);
    fs::write(workshop.path("motion.json"), programme()).expect("written");
    for (command, file) in [
        (&["trajectory", "export", "motion.json", "--rate-hz", "100"][..], "export"),
        (&["trajectory", "test", "--warming-s", "0", "--levels", "2", "--rate-hz", "100"], "test"),
    ] {
        let [with, without] = ["offset", "plain"].map(|arm| {
            let (description, output) = (format!("{arm}.toml"), format!("{file}-{arm}.csv"));
            let told = workshop.stderr(&[command, &["--robot", &description, "-o", &output]].concat(), 0);
            let offsets = "description: joint 1 +1.570796 rad, joint 3 -0.250000 m";
            assert_eq!(told.contains(offsets), arm == "offset", "{told}");
            output
        });
        assert_less_by_offsets(&workshop.path(&with), &workshop.path(&without), EQUAL);
        // the range of the slide is 0 to 0.2 m: read without its offset, it is left
        workshop.stdout(&["trajectory", "check", &with, "--robot", "offset.toml"], 0);
        let broken = workshop.stdout(&["trajectory", "check", &with, "--robot", "plain.toml"], 1);
        assert!(broken.contains("BROKEN joint 3: highest position"), "{broken}");
    }
}

#[test]
fn points_of_a_test_are_positions_of_the_controller() {
    let workshop = Workshop::new();
    scara_with_offsets(&workshop);
    let command = ["trajectory", "test", "--parts", "points", "--robot", "offset.toml", "--points"];
    // the slide from 0.05 to 0.15 m, joint 1 from 0 to 10 degrees
    fs::write(workshop.path("points.csv"), "pos_1_deg,pos_2,pos_3_mm,pos_4\n-90,0,300,0\n-80,0,400,0\n")
        .expect("written");
    workshop.stdout(&[&command[..], &["points.csv", "-o", "points-test.csv"]].concat(), 0);
    let rows = table(&workshop.path("points-test.csv"));
    let last = |name: &str, value: f64| rows[name].iter().any(|of| (of - value).abs() < EQUAL);
    assert!(last("pos_1_rad", (-80.0_f64).to_radians()) && last("pos_3_m", 0.4), "no such row");
    fs::write(workshop.path("points.csv"), "pos_1,pos_2,pos_3,pos_4\n0,0,0.3,0\n0,0,0.1,0\n")
        .expect("written");
    let refused = workshop.stderr(&[&command[..], &["points.csv"]].concat(), 2);
    assert!(refused.contains("joint 3 at -0.15 m (0.1 m of the controller)"), "{refused}");
}

#[test]
fn simulated_exports_have_positions_of_the_controller_in_every_layout() {
    let workshop = Workshop::new();
    scara_with_offsets(&workshop);
    let short = ["--cycles", "1", "--warming-s", "0", "--levels", "2,3", "--rate-hz", "100", "--robot"];
    let of = |folder: &str, more: &[&str]| workshop.simulate(folder, &[&short[..], more].concat()).remove(0);
    let with = of("inbox", &["offset.toml"]);
    assert_less_by_offsets(&with, &of("plain", &["plain.toml"]), NATIVE_STEP);
    workshop.use_file("description", "offset.toml");
    let told = workshop.stdout(&["explain", with.to_str().expect("a path")], 0);
    assert!(told.contains(" parameters") && told.contains("problems    none"), "{told}");
}
