//! Files of manufacturers give the same results as the native export of the same test.

use std::fs;

use crate::support::{Workshop, query};

/// The binary files keep all digits, except that a scale of the header costs the last one. The identification
/// multiplies that error by its condition number.
const EQUAL: f64 = 1e-7;

fn figures(workshop: &Workshop, database: &str) -> Vec<f64> {
    let tables = [
        "SELECT rmsd_nm, moving_relative_rmsd FROM cycle_rmsd ORDER BY cycle, joint, stage",
        "SELECT value, std_error FROM parameters ORDER BY cycle, name",
        "SELECT torque_nm, std_nm FROM friction_points ORDER BY cycle, joint, minute",
    ];
    let rows = tables.iter().flat_map(|sql| query(&workshop.path(database), sql));
    rows.flat_map(|row| row.split('|').filter_map(|cell| cell.parse().ok()).collect::<Vec<f64>>()).collect()
}

/// The columns of an export as a trace, `stem.dat` and `stem.r64`.
fn trace(names: &[&str], rows: &[Vec<&str>]) -> (String, Vec<u8>) {
    let mut header =
        "DIAEXTENDED  {@:ENGLISH\r\n#BEGINGLOBALHEADER\r\n112,High -> Low\r\n#ENDGLOBALHEADER\r\n".to_owned();
    for (at, name) in names.iter().enumerate() {
        header += &format!(
            "#BEGINCHANNELHEADER\r\n200,{name}\r\n210,EXPLIZIT\r\n211,a.r64\r\n213,BLOCK\r\n214,REAL64\r\n220,{}\r\n\
             221,{}\r\n240,0\r\n241,0.001\r\n#ENDCHANNELHEADER\r\n",
            rows.len(),
            at + 1
        );
    }
    let values = rows.iter().flatten().map(|cell| 1e3 * cell.parse::<f64>().expect("a number"));
    (header, values.flat_map(f64::to_le_bytes).collect())
}

/// The same in the format of TwinCAT Scope, in German.
fn scope(names: &[&str], rows: &[Vec<&str>]) -> String {
    let line = |cells: Vec<String>| cells.join("\t") + "\r\n";
    let mut text =
        "Name\tScope\r\nFile\tC:\\a.csv\r\nStarttime of export\t132959733843760000\r\n\r\n\r\n".to_owned();
    text += &line(names[1..].iter().map(|name| format!("Name\t{name}")).collect());
    text += &line(names[1..].iter().map(|_| "SampleTime[ms]\t20".to_owned()).collect());
    text += "\r\n";
    for row in rows {
        let time = (1e3 * row[0].parse::<f64>().expect("a time")).round();
        text += &line(row[1..].iter().map(|cell| format!("{time}\t{}", cell.replace('.', ","))).collect());
    }
    text + "EOF\r\n"
}

#[test]
fn a_trace_and_a_scope_export_give_the_results_of_the_native_export() {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--cycles", "1", "--warming-s", "0"]);
    workshop.stdout(&["ingest", "inbox", "--db", "native.db"], 0);
    let expected = figures(&workshop, "native.db");
    assert!(expected.len() > 150, "{} figures", expected.len());
    let export =
        fs::read_dir(workshop.path("inbox")).expect("a folder").map(|entry| entry.expect("a file").path());
    let export = export
        .into_iter()
        .find(|path| path.extension().is_some_and(|ending| ending == "csv"))
        .expect("an export");
    let text = fs::read_to_string(&export).expect("an export");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();

    for folder in ["trace", "scope"] {
        fs::create_dir(workshop.path(folder)).expect("a folder");
    }
    let (header, values) = trace(&names, &rows);
    fs::write(workshop.path("trace/R01_20260105_0847.dat"), header).expect("written");
    fs::write(workshop.path("trace/R01_20260105_0847.r64"), values).expect("written");
    fs::write(workshop.path("trace/PROGRAM.dat"), "DEFDAT PROGRAM").expect("written");
    fs::write(workshop.path("scope/R01_20260105_0847.csv"), scope(&names, &rows)).expect("written");
    let native = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/native.toml");
    let layout = fs::read_to_string(native).expect("a layout");
    let scope_layout =
        layout.replace("column = \"time\"\nunit = \"s\"", "column = \"scope_time_ms\"\nunit = \"ms\"");
    assert_ne!(layout, scope_layout);
    fs::write(workshop.path("scope.toml"), scope_layout).expect("written");
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    fs::write(workshop.path("of_scope.toml"), config.replace(native, "scope.toml")).expect("written");

    for (folder, config) in [("trace", "armwatch.toml"), ("scope", "of_scope.toml")] {
        let database = format!("{folder}.db");
        workshop.stdout(&["ingest", folder, "--db", &database, "--config", config], 0);
        let found = figures(&workshop, &database);
        assert_eq!(found.len(), expected.len(), "{folder}");
        for (a, b) in found.iter().zip(&expected) {
            assert!((a - b).abs() <= EQUAL * b.abs().max(1.0), "{folder}: {a} {b}");
        }
        // the identity of the export includes all its files
        let again = workshop.run(&["ingest", folder, "--db", &database, "--config", config]);
        assert!(String::from_utf8_lossy(&again.stdout).contains("known"), "{again:?}");
    }

    // an incompletely copied trace is refused, and stored when it is complete
    fs::create_dir(workshop.path("late")).expect("a folder");
    let whole = fs::read(workshop.path("trace/R01_20260105_0847.r64")).expect("values");
    fs::copy(workshop.path("trace/R01_20260105_0847.dat"), workshop.path("late/R01_20260105_0847.dat"))
        .expect("copied");
    fs::write(workshop.path("late/R01_20260105_0847.r64"), &whole[..whole.len() / 2]).expect("written");
    let cut = workshop.run(&["ingest", "late", "--db", "late.db"]);
    let said = format!("{}{}", String::from_utf8_lossy(&cut.stdout), String::from_utf8_lossy(&cut.stderr));
    assert!(
        said.contains("bytes of channels, and R01_20260105_0847.r64 has")
            && said.contains("copy the .dat and .r64"),
        "{said}"
    );
    fs::write(workshop.path("late/R01_20260105_0847.r64"), &whole).expect("written");
    workshop.stdout(&["ingest", "late", "--db", "late.db"], 0);
    assert_eq!(figures(&workshop, "late.db").len(), expected.len());
}
