//! A real arm: the recording of a Stäubli TX40, coupled wrist, motor side, no time column.

use crate::support::{Workshop, reference};

/// Relative error of each joint's torque in an independent computation: position low-pass at 100 Hz, decimated to 50
/// Hz, slow rows omitted, 61 parameters by least squares.
const INDEPENDENT: [f64; 6] = [0.039, 0.036, 0.066, 0.072, 0.089, 0.074];

/// Published friction of this arm: viscous fv in Nm s/rad, Coulomb fs in Nm.
const PUBLISHED_FV: [f64; 6] = [8.1, 5.6, 2.0, 1.1, 1.9, 0.64];
const PUBLISHED_FS: [f64; 6] = [7.0, 8.1, 6.3, 2.5, 3.0, 0.24];

fn ingested() -> Workshop {
    let workshop = Workshop::new();
    let (export, config) = (reference("tx40/TX40_0000-4000ms_5kHz.csv.gz"), reference("tx40/armwatch.toml"));
    let [export, config] = [&export, &config].map(|path| path.to_str().expect("a path"));
    let out = workshop.stdout(&["ingest", export, "--config", config], 0);
    assert!(out.contains("1 cycle, 20000 rows"), "{out}");
    workshop
}

fn reals(workshop: &Workshop, sql: &str) -> Vec<f64> {
    workshop.query(sql).iter().map(|cell| cell.parse().expect("a number")).collect()
}

#[test]
fn the_torque_is_explained_as_well_as_by_an_independent_computation() {
    let workshop = ingested();
    let ours = reals(
        &workshop,
        "SELECT moving_relative_rmsd FROM cycle_rmsd WHERE stage = 'excitation' ORDER BY joint",
    );
    for (joint, (ours, theirs)) in (1..).zip(ours.iter().zip(INDEPENDENT)) {
        assert!(*ours <= theirs, "joint {joint}: {ours} against {theirs}");
        assert!(*ours > 0.3 * theirs, "joint {joint}: {ours} is too good to be true");
    }
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_parameters"), 61);
}

#[test]
fn friction_is_near_what_was_published() {
    let workshop = ingested();
    for (name, published) in [("fv", PUBLISHED_FV), ("fs", PUBLISHED_FS)] {
        let sql = format!("SELECT value FROM cycle_parameters WHERE parameter = '{name}' ORDER BY joint");
        for (joint, (ours, published)) in (1..).zip(reals(&workshop, &sql).iter().zip(published)) {
            // 4 s of the 9 s were recorded: that makes a difference of a tenth, and of half a Nm of Coulomb friction
            let tolerance = 0.1 * published + if name == "fs" { 0.5 } else { 0.05 };
            assert!(
                (ours - published).abs() < tolerance,
                "{name} of joint {joint}: {ours}, published {published}"
            );
        }
    }
}

/// A law of load is chosen only if it lowers the error on held-out rows.
#[test]
fn laws_of_load_are_compared_on_held_out_rows_of_the_recording() {
    let workshop = ingested();
    let config = reference("tx40/armwatch.toml");
    let config = config.to_str().expect("a path");
    let arguments = ["identify", "--run", "1", "--choose-friction", "--json", "--config", config];
    let told: serde_json::Value = serde_json::from_str(&workshop.stdout(&arguments, 0)).expect("JSON");
    assert_eq!(told["held_out_sets"], 4);
    let joints = told["joints"].as_array().expect("joints");
    assert_eq!(joints.len(), 6);
    let remarks = told["remarks"].as_array().expect("remarks");
    for joint in joints {
        let laws = joint["laws"].as_array().expect("laws");
        // four seconds do not show every law; a remark names each omitted one
        assert_eq!(laws.len() + remarks.len(), 5, "{told}");
        assert!(laws.iter().any(|law| law["load_friction"] == "linear"), "{joint}");
        let error = |name: &serde_json::Value| {
            let law = laws.iter().find(|law| law["load_friction"] == *name).expect("a law");
            law["held_out_relative_rmsd"].as_f64().expect("an error")
        };
        let (plain, chosen) = (error(&"none".into()), error(&joint["needs"]));
        assert!(chosen <= plain && (0.01..0.3).contains(&chosen), "{joint}");
    }
    let text = workshop.stdout(&["identify", "--run", "1", "--choose-friction", "--config", config], 0);
    assert!(text.contains("torque error on held-out rows (4 sets)"), "{text}");
}
