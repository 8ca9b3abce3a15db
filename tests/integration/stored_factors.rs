//! `identify` and `verify` on stored factors.

use crate::support::{Workshop, text};

/// Two runs of one arm, three cycles each.
fn two_runs() -> Workshop {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--runs", "2", "--cycles", "3", "--warming-s", "5"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

#[test]
fn chosen_cycles_make_a_set_that_verifies_other_runs() {
    let workshop = two_runs();
    let saved =
        workshop.stdout(&["identify", "--run", "1", "--cycles", "2-3", "--save", "warm", "--json"], 0);
    let saved: serde_json::Value = serde_json::from_str(&saved).expect("JSON");
    assert_eq!(saved["parameters"].as_array().map(Vec::len), Some(64));
    assert_eq!(saved["sources"].as_array().map(Vec::len), Some(2));
    assert_eq!(workshop.number("SELECT COUNT(*) FROM parameter_sets WHERE parameter_set = 'warm'"), 64);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM parameter_set_sources"), 2);

    let taken = workshop.run(&["identify", "--run", "2", "--save", "warm"]);
    assert_eq!(taken.status.code(), Some(2));
    assert!(text(&taken.stderr).contains("another name"));

    let by_name = workshop.stdout(&["verify", "--parameters", "warm", "--against", "2", "--json"], 0);
    let by_cycles = workshop.stdout(&["verify", "--parameters", "1:2,3", "--against", "2", "--json"], 0);
    let figure = |out: &str| {
        let value: serde_json::Value = serde_json::from_str(out).expect("JSON");
        value["rmsd"][0]["moving_relative_rmsd"].as_f64().expect("a figure")
    };
    assert!((figure(&by_name) / figure(&by_cycles) - 1.0).abs() < 1e-9, "{by_name} {by_cycles}");
}

#[test]
fn the_cross_matrix_of_a_robot_is_printed_and_stored_on_request() {
    let workshop = two_runs();
    let out = workshop.stdout(&["verify", "--robot", "R01"], 0);
    assert_eq!(out.matches("run 1       ").count(), 6, "{out}");
    assert!(out.contains("joint 6") && out.contains("above 10 %"), "{out}");
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_rmsd WHERE verification = 'cross'"), 0);
    for _twice in 0..2 {
        workshop.stdout(&["verify", "--robot", "R01", "--store"], 0);
        // two parameter sets, six cycles, six joints, four stages
        assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_rmsd WHERE verification = 'cross'"), 288);
    }
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_rmsd WHERE verification = 'self'"), 144);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM warming_contrast"), 36);
}

#[test]
fn what_cannot_be_is_said() {
    let workshop = two_runs();
    for (arguments, said) in [
        (&["identify", "--run", "9"][..], "run 9 has no factors"),
        (&["identify", "--run", "1", "--cycles", "7"], "no cycle 7"),
        (&["identify", "--run", "1", "--cycles", "3-1"], "no range"),
        (&["identify", "--robot", "Left"], "there are runs of: R01"),
        (&["identify", "--run", "1", "--save", "12"], "cannot name a parameter set"),
        (&["verify", "--parameters", "cold", "--against", "1"], "neither a run"),
        (&["verify", "--parameters", "1:2", "--against", "2", "--store"], "whole runs"),
        (&["verify", "--parameters", "1"], "--against"),
    ] {
        let output = workshop.run(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(said), "{arguments:?}: {}", text(&output.stderr));
    }
}
