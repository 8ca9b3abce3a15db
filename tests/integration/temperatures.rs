//! Temperatures from the simulated controller to the friction index.

use std::fs;

use crate::canon::canonical_dump;
use crate::support::{Workshop, query};

/// Queries whose rows are the same for recordings with and without temperatures.
const SHARED: [&str; 4] = [
    "SELECT run_id, cycle, joint, parameter, value, std_error FROM cycle_parameters ORDER BY 1, 2, 3, 4",
    "SELECT run_id, cycle, joint, stage, rmsd_nm, moving_rmsd_nm FROM cycle_rmsd ORDER BY 1, 2, 3, 4",
    "SELECT run_id, cycle, joint, speed_fraction, direction, torque_nm FROM friction_points ORDER BY 1, 2, 3, 4, 5",
    "SELECT cycle, remarks FROM cycles ORDER BY run_id, cycle",
];

/// Two runs of some cycles; a friction map needs six.
fn simulated(folder: &str, cycles: &str, more: &[&str]) -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(|config| config + "\n[detect]\nbaseline_runs = 2\n");
    let shape =
        ["--runs", "2", "--cycles", cycles, "--warming-s", "0", "--name", "Warm", "--interval-h", "20"];
    workshop.simulate(folder, &[&shape[..], more].concat());
    workshop
}

#[test]
fn recorded_temperatures_reach_the_index_and_leave_all_else_alone() {
    let (with, without) = (simulated("inbox", "6", &["--temperatures"]), simulated("inbox", "6", &[]));
    for workshop in [&with, &without] {
        workshop.stdout(&["ingest", "inbox"], 0);
    }
    for sql in SHARED {
        assert_eq!(with.query(sql), without.query(sql), "{sql}");
    }
    assert_eq!(without.query("SELECT count(*) FROM temperatures"), ["0"]);
    // six motors and the ambient temperature
    let rows = with.query("SELECT run_id, sensor, count(*) FROM temperatures GROUP BY 1, 2 ORDER BY 1, 2");
    assert_eq!(rows, ["1|ambient|6", "1|motor|36", "2|ambient|6", "2|motor|36"]);
    let cold = "SELECT count(*) FROM temperatures WHERE NOT temperature_degc BETWEEN 15 AND 70";
    assert_eq!(with.query(cold), ["0"]);
    let rises = "SELECT min(last.temperature_degc - first.temperature_degc) > 3
                 FROM temperatures AS first JOIN temperatures AS last USING (run_id, joint)
                 WHERE first.cycle = 1 AND last.cycle = 6";
    assert_eq!(with.query(rises), ["1"]);
    let source = "SELECT DISTINCT thermal_source, slow_min IS NULL, warm_degc > cold_degc FROM friction_map";
    assert_eq!(with.query(source), ["motor_temperature|1|1"]);
    assert_eq!(without.query(source), ["motion|0|"]);
    let said = with.stdout(&["friction", "--robot", "Warm", "--index"], 0);
    assert!(said.contains("thermal state") && said.contains("motor_temperature"), "{said}");
}

#[test]
fn the_order_of_exports_does_not_matter_with_temperatures() {
    let workshop = simulated("exports", "2", &["--temperatures", "both", "--temperature-step-k", "1"]);
    let mut files: Vec<String> = fs::read_dir(workshop.path("exports"))
        .expect("exports")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".csv"))
        .collect();
    files.sort();
    assert!(files[0].contains("_Col30_"), "{files:?}");
    let said = workshop.stdout(&["explain", &format!("exports/{}", files[0])], 0);
    assert!(
        said.contains("motor_temperature_6_degc (degC)") && said.contains("ambient temperature: "),
        "{said}"
    );
    for (database, order) in [("forth.db", [0, 1]), ("back.db", [1, 0])] {
        for at in order {
            let file = format!("exports/{}", files[at]);
            workshop.stdout(&["--db", database, "ingest", &file], 0);
        }
    }
    let dump = |database: &str| canonical_dump(&workshop.path(database));
    assert_eq!(dump("forth.db"), dump("back.db"));
    assert!(dump("forth.db").contains("# temperatures\n"));
    let whole = "SELECT count(*) FROM temperatures WHERE sensor = 'ambient' AND temperature_degc IS NOT NULL";
    assert_eq!(query(&workshop.path("forth.db"), whole), ["4"]);
}
