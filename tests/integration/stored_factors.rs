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

    let taken = workshop.stderr(&["identify", "--run", "2", "--save", "warm"], 2);
    assert!(taken.contains("another name"));

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
        (&["identify", "--run", "9"][..], "there is no run 9; runs with cycles: 1"),
        (&["identify", "--run", "1", "--cycles", "7"], "no cycle 7"),
        (&["identify", "--run", "1", "--cycles", "3-1"], "not a range"),
        (&["identify", "--robot", "Left"], "there are runs of: R01"),
        (&["identify", "--run", "1", "--save", "12"], "not a valid name for a parameter set"),
        (&["verify", "--parameters", "cold", "--against", "1"], "neither a run"),
        (&["verify", "--parameters", "1:2", "--against", "2", "--store"], "whole runs"),
        (&["verify", "--parameters", "1"], "--against"),
        (&["identify", "--run", "1", "--estimator", "prior"], "--prior"),
        (&["identify", "--run", "1", "--prior", "2"], "requires --estimator prior"),
        (&["identify", "--run", "1", "--estimator", "prior", "--prior", "1:2"], "would count twice"),
        (&["identify", "--run", "1", "--estimator", "prior", "--prior", "cold"], "neither a run"),
        (&["identify", "--run", "1", "--estimator", "huber"], "at least 5"),
        (&["identify", "--run", "1", "--estimator", "huber", "--each-cycle"], "cannot weight a single one"),
        (&["identify", "--run", "1", "--estimator", "per-joint", "--save", "a"], "not one parameter set"),
        (&["identify", "--run", "1", "--estimator", "per-joint", "--essential"], "--essential requires"),
        (&["identify", "--run", "1", "--save", "description"], "not a valid name"),
        (&["parameters", "show", "cold"], "parameters list"),
        (&["parameters", "delete", "cold"], "parameters list"),
    ] {
        let output = workshop.stderr(arguments, 2);
        assert!(output.contains(said), "{arguments:?}: {output}");
    }
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

fn count(value: &serde_json::Value) -> usize {
    value.as_array().map_or(0, Vec::len)
}

/// Nine cycles: enough for a scatter of their own, and for a robust estimate.
fn nine_cycles() -> Workshop {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--runs", "1", "--cycles", "9", "--warming-s", "5"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

#[test]
fn every_estimator_answers_with_intervals_and_says_what_they_stand_on() {
    let workshop = nine_cycles();
    for estimator in ["ordinary", "weighted", "huber"] {
        let found =
            json(&workshop.stdout(&["identify", "--run", "1", "--estimator", estimator, "--json"], 0));
        assert_eq!((count(&found["parameters"]), count(&found["rmsd"])), (64, 24), "{estimator}");
        assert_eq!(found["error_basis"]["cycles"], 9, "{found}");
        for parameter in found["parameters"].as_array().expect("a list") {
            let figure = |key: &str| parameter[key].as_f64().expect("a figure");
            assert!(figure("interval_low") < figure("value") && figure("value") < figure("interval_high"));
            assert!(parameter["grouping"].is_string() && parameter["unit"].is_string());
        }
        assert_eq!(count(&found["motion"]["unseen"]) + count(&found["motion"]["indistinct"]), 0);
    }
    let few = workshop.stdout(&["identify", "--run", "1", "--cycles", "1-7", "--groupings"], 0);
    assert!(few.contains("standard errors from the residual") && few.contains("J2_Izz + "), "{few}");

    let views = json(&workshop.stdout(&["identify", "--run", "1", "--estimator", "per-joint", "--json"], 0));
    assert_eq!((count(&views["joint_views"]), count(&views["rmsd"])), (6, 24));
    let sixth = &views["joint_views"][5];
    assert_eq!(count(&sixth["parameters"]) + count(&sixth["within_others"]) + count(&sixth["unseen"]), 64);
    assert!(count(&sixth["unseen"]) >= 52, "{sixth}");

    let essential = json(&workshop.stdout(&["identify", "--run", "1", "--essential", "--json"], 0));
    let removed = count(&essential["essential"]["removed"]);
    let zeros = essential["parameters"].as_array().expect("a list");
    assert!(removed > 0 && zeros.iter().filter(|p| p["std_error"].is_null()).count() == removed);
    assert_eq!(count(&essential["essential"]["rmsd_with_all"]), 24);
    workshop.stdout(&["identify", "--run", "1", "--essential"], 0);
}

#[test]
fn a_prior_helps_one_cycle_and_says_how_much() {
    let workshop = two_runs();
    workshop.stdout(&["identify", "--run", "1", "--estimator", "weighted", "--save", "first"], 0);
    for prior in [&["--prior", "description"][..], &["--prior", "first", "--prior-std-fraction", "0.05"]] {
        let one = ["identify", "--run", "2", "--cycles", "1", "--estimator", "prior", "--json"];
        let found = json(&workshop.stdout(&[&one[..], prior].concat(), 0));
        let shares = found["parameters"].as_array().expect("a list").iter();
        let shares: Vec<f64> = shares.map(|p| p["data_share"].as_f64().expect("a share")).collect();
        assert!(shares.len() == 64 && shares.iter().all(|share| (0.0..=1.0).contains(share)), "{shares:?}");
        assert!(found["prior_spread"].as_f64().is_some_and(|spread| spread > 0.0));
    }
    let firm = workshop.stdout(
        &[
            "identify",
            "--run",
            "2",
            "--estimator",
            "prior",
            "--prior",
            "first",
            "--prior-std-fraction",
            "1e-6",
        ],
        0,
    );
    assert!(firm.contains("data_share"), "{firm}");
}

#[test]
fn a_history_is_identified_again_kept_listed_and_deleted() {
    let workshop = two_runs();
    let arguments = ["identify", "--robot", "R01", "--each-cycle"];
    let lines = workshop.stdout(&[&arguments[..], &["--save", "again", "--json"]].concat(), 0);
    let lines: Vec<serde_json::Value> = lines.lines().map(json).collect();
    assert_eq!(lines.len(), 8, "six cycles and two runs");
    assert_eq!((count(&lines[0]["parameters"]), count(&lines[6]["statistics"])), (64, 64));
    // for the configured estimator and each cycle, the result is that of the pipeline
    let different = "SELECT count(*) FROM reestimated_parameters AS again
         JOIN cycle_parameters AS first USING (run_id, cycle, joint, parameter)
         WHERE abs(again.value - first.value) <= 1e-9 * abs(first.value)";
    assert_eq!(workshop.number(different), 6 * 64);
    let same = "SELECT count(*) FROM reestimated_statistics AS again
         JOIN parameter_statistics AS first USING (run_id, joint, parameter, \"window\")
         WHERE abs(again.sdv - first.sdv) <= 1e-6 * abs(first.sdv) AND again.cycles = first.cycles";
    assert_eq!(workshop.number(same), 2 * 64);

    workshop.stdout(&[&arguments[..], &["--estimator", "per-joint", "--save", "by-joint"]].concat(), 0);
    let rows = "SELECT count(DISTINCT seen_by_joint) FROM reestimated_parameters WHERE estimate = 'by-joint'";
    assert_eq!(workshop.number(rows), 6);
    let taken = workshop.run(&["identify", "--run", "1", "--save", "again"]);
    assert_eq!(taken.status.code(), Some(2));

    workshop.stdout(&["identify", "--run", "1", "--save", "set"], 0);
    let listed = workshop.stdout(&["parameters", "list"], 0);
    assert_eq!(listed.lines().count(), 4, "{listed}");
    assert!(workshop.stdout(&["parameters", "show", "set"], 0).contains("kg m^2"));
    let shown = workshop.run(&["parameters", "show", "again"]);
    assert!(text(&shown.stderr).contains("reestimated_parameters"));
    workshop.stdout(&["parameters", "delete", "again"], 0);
    assert_eq!(workshop.number("SELECT count(*) FROM reestimated_cycles WHERE estimate = 'again'"), 0);
    assert_eq!(workshop.stdout(&["parameters", "list", "--json"], 0).lines().count(), 2);
}
