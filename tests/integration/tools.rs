//! Tests with different tools: declared ones raise no alarm, others raise a single one that tells the mass.

use std::fs;
use std::path::Path;

use crate::support::{Workshop, query};

const CENTRE: &str = "0.03,0,0.08";

/// The ER3A with friction under load.
fn describe(workshop: &Workshop) {
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robots/er3a.toml");
    let robot = fs::read_to_string(robot).expect("the description");
    fs::write(workshop.path("er3a.toml"), format!("load_friction = \"linear\"\n{robot}")).expect("written");
}

fn configure(workshop: &Workshop, database: &str, tools: &str) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).display();
    let config = format!(
        "database = \"{database}.db\"\n[[robot]]\nname = \"*\"\ndescription = \"er3a.toml\"\n\
         layout = \"{root}/config/exports/native.toml\"\n{tools}"
    );
    fs::write(workshop.path(&format!("{database}.toml")), config).expect("a configuration");
}

fn tool(files: &str, mass: &str) -> String {
    format!(
        "[[tool]]\nfiles = \"{files}\"\nmass_kg = {mass}\ncentre_of_mass_m = [{CENTRE}]\n\
         inertia_about_centre_of_mass_kg_m2 = {{ xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0 }}\n"
    )
}

/// A test of the day with a tool of this mass, kg, which its file name tells.
fn record(workshop: &Workshop, day: usize, mass: &str) {
    let (start, seed) = (format!("2026-01-{day:02}T08:47:00Z"), day.to_string());
    let shape = ["--warming-s", "20", "--gear-efficiency", "0.93", "--start", &start, "--seed", &seed];
    let load = match mass {
        "0" => vec![],
        _ => vec!["--load-mass-kg", mass, "--load-centre-m", CENTRE],
    };
    for export in workshop.simulate("made", &[&shape[..], &load].concat()) {
        let name = workshop.inbox(&format!("R01_202601{day:02}_0847_tool{mass}.csv"));
        fs::rename(export, name).expect("a name");
    }
}

fn anomalies(workshop: &Workshop, database: &str) -> Vec<String> {
    let config = format!("{database}.toml");
    workshop.stdout(&["ingest", "inbox", "-q", "--config", &config], 0);
    let columns = "kind || ' ' || coalesce(joint, 'arm') || ' ' || message";
    query(
        &workshop.path(&format!("{database}.db")),
        &format!("SELECT {columns} FROM anomalies WHERE severity <> 'info' ORDER BY anomaly_id"),
    )
}

#[test]
fn declared_tools_raise_no_alarm_and_others_one_with_their_mass() {
    let workshop = Workshop::new();
    describe(&workshop);
    for day in 1..=10 {
        record(&workshop, day, if day < 7 { "0" } else { ["2", "0.8"][day % 2] });
    }
    let tools = [tool("*_tool0.8*", "0.8"), tool("*_tool2*", "2")].concat();
    configure(&workshop, "declared", &tools);
    let found = anomalies(&workshop, "declared");
    assert!(found.is_empty(), "{found:#?}");
    let check = workshop.stdout(&["config", "check", "--config", "declared.toml"], 0);
    assert!(check.contains("carrying a tool of 0.8 kg"), "{check}");

    configure(&workshop, "bare", "");
    let found = anomalies(&workshop, "bare");
    assert_eq!(found.len(), 1, "{found:#?}");
    assert!(found[0].starts_with("payload arm"), "{found:#?}");
    // the interval is that of `armwatch payload`
    let runs = query(&workshop.path("bare.db"), "SELECT run_id FROM runs ORDER BY started_at");
    let ask = ["payload", "--config", "bare.toml", "--empty", &runs[5], "--loaded", &runs[9], "--json"];
    let measured: serde_json::Value = serde_json::from_str(&workshop.stdout(&ask, 0)).expect("JSON");
    let end = |key: &str| measured["quantities"][0][key].as_f64().expect("shown");
    let (low, high) = (end("interval_low"), end("interval_high"));
    assert!((low..=high).contains(&2.0), "{low} {high}");
    assert!(found[0].contains(&format!("95 % interval {low:.2} to {high:.2} kg")), "{found:#?}");
}
