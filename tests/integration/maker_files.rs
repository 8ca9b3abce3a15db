//! Files of manufacturers give the same results as the native export of the same test.

use std::fs;

use crate::binary_files::{bag, bag_layout, channel, parquet, table};
use crate::canon::dump_of_recording;
use crate::small;
use crate::support::{Workshop, query};

/// A scale in the header of a trace, and times in ms, cost the last digit. The identification multiplies that by its condition
/// number.
const SCALED: f64 = 1e-9;

/// Asserts that two dumps have the same cells, with numbers equal to the relative `tolerance`.
fn assert_close(found: &str, expected: &str, tolerance: f64, of: &str) {
    assert_eq!(found.lines().count(), expected.lines().count(), "{of}");
    let mut view = "";
    for (found, expected) in found.lines().zip(expected.lines()) {
        view = expected.strip_prefix("# ").unwrap_or(view);
        let [cells, wanted] = [found, expected].map(|line| line.split('|').collect::<Vec<_>>());
        let is_close = |(cell, wanted): (&&str, &&str)| match (cell.parse::<f64>(), wanted.parse::<f64>()) {
            (Ok(cell), Ok(wanted)) => (cell - wanted).abs() <= tolerance * wanted.abs().max(1.0),
            _ => cell == wanted,
        };
        let same = cells.len() == wanted.len() && cells.iter().zip(&wanted).all(is_close);
        assert!(same, "{of}, {view}:\n{found}\n{expected}");
    }
}

/// Stages that a column gives, and those that follow from the motion: a bag of joint states has no other.
const BY_COLUMN: &str = "column = \"stage\"\nbetween = [0]\nexcitation = [1]\nfriction = [2]\nwarming = [3]\n[if_present]\ncycle \
                         = \"cycle\"\nfriction_joint = \"joint\"\nfriction_level = \"level\"";
const BY_MOTION: &str = "kind = \"motion\"";

/// A layout; `rest` are its stages and what is below them.
fn layout(
    delimiter: &str,
    time: &str,
    [position, velocity, torque]: [&str; 3],
    unit: &str,
    rest: &str,
) -> String {
    format!(
        "name = \"a\"\ndelimiter = \"{delimiter}\"\nheader = true\n[time]\n{time}\n[position]\n{position}\nunit = \
         \"rad\"\n[velocity]\n{velocity}\nunit = \"rad/s\"\n[torque]\n{torque}\nunit = \"{unit}\"\n[stage]\n{rest}\n"
    )
}

/// Each joint has a column `PREFIX_1` and so on.
fn numbered(prefix: &str) -> String {
    format!("column = \"{prefix}_{{joint}}\"")
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

/// Writes the files of one kind, and the configuration `KIND.toml` with their layout.
fn write_kind(workshop: &Workshop, kind: &str, layout: &str, files: &[(&str, Vec<u8>)]) {
    fs::create_dir(workshop.path(kind)).expect("a folder");
    for (name, bytes) in files {
        fs::write(workshop.path(&format!("{kind}/R01_20260105_0847{name}")), bytes).expect("written");
    }
    fs::write(workshop.path(&format!("{kind}_layout.toml")), layout).expect("written");
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    let native = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/native.toml");
    let er3a = concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots/er3a.toml");
    let config = config.replace(native, &format!("{kind}_layout.toml")).replace(er3a, "arm.toml");
    fs::write(workshop.path(&format!("{kind}.toml")), config).expect("written");
}

#[test]
fn one_test_in_eight_formats_gives_the_same_rows_in_all_views() {
    let workshop = Workshop::new();
    // the arm with drives of 2 Nm/A
    let er3a =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots/er3a.toml")).expect("an arm");
    fs::write(workshop.path("arm.toml"), er3a.replace("[[joint]]\n", "[[joint]]\ndrive_gain_nm_a = 2.0\n"))
        .expect("written");
    let export =
        workshop.simulate("made", &["--cycles", "1", "--warming-s", "0", "--rate-hz", "50"]).remove(0);
    let text = fs::read_to_string(&export).expect("an export");
    let (names, columns) = table(&text);
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let [position, velocity, torque] = ["pos", "vel", "trq"].map(|of| channel(&names, &columns, of));

    let seconds = "column = \"time\"\nunit = \"s\"";
    let [pos, vel, trq] = ["pos", "vel", "trq"].map(numbered);
    let native = layout(",", seconds, [&pos, &vel, &trq], "Nm", BY_COLUMN);
    write_kind(&workshop, "native", &native, &[(".csv", text.clone().into_bytes())]);
    let by_motion = layout(",", seconds, [&pos, &vel, &trq], "Nm", BY_MOTION);
    write_kind(&workshop, "motion", &by_motion, &[(".csv", text.clone().into_bytes())]);

    // the recorder of RTDE has currents, counts joints from 0, and writes blanks between fields
    let channels = [("pos", "actual_q"), ("vel", "actual_qd"), ("trq", "actual_current")];
    let of_rtde = |name: &&str| {
        let (channel, joint) = name.split_once('_').unwrap_or((*name, "1"));
        let known = channels.iter().find(|(native, _)| *native == channel);
        let joint = joint.parse::<u32>().expect("a joint") - 1;
        known.map_or_else(|| (*name).to_owned(), |(_, rtde)| format!("{rtde}_{joint}"))
    };
    let mut rtde = names.iter().map(of_rtde).collect::<Vec<_>>().join(" ") + "\n";
    for row in 0..columns[0].len() {
        let cell = |(name, values): (&&str, &Vec<f64>)| {
            format!("{:?}", if name.starts_with("trq") { 0.5 * values[row] } else { values[row] })
        };
        rtde += &(names.iter().zip(&columns).map(cell).collect::<Vec<_>>().join(" ") + "\n");
    }
    let lists = channels.map(|(_, rtde)| {
        format!("columns = {:?}", (0..6).map(|joint| format!("{rtde}_{joint}")).collect::<Vec<_>>())
    });
    let of_blanks = layout("blank", seconds, lists.each_ref().map(String::as_str), "A", BY_COLUMN);
    write_kind(&workshop, "rtde", &of_blanks, &[(".csv", rtde.into_bytes())]);

    let of_channel = |prefix: &str| {
        let line = |line: &str| {
            // the stages are with the positions
            let is_of = |name: &str| match name {
                "time" => true,
                "stage" | "cycle" | "joint" | "level" => prefix == "pos",
                _ => name.starts_with(prefix),
            };
            let cells = line.split(',').zip(&names).filter(|(_, name)| is_of(name));
            cells.map(|(cell, _)| cell).collect::<Vec<_>>().join(",") + "\n"
        };
        text.lines().map(line).collect::<String>().into_bytes()
    };
    let parts = format!("{BY_COLUMN}\n[parts]\nnames = [\"pos\", \"vel\", \"trq\"]\nmatch = \"time\"\n");
    write_kind(
        &workshop,
        "channels",
        &layout(",", seconds, [&pos, &vel, &trq], "Nm", &parts),
        &[("_pos.csv", of_channel("pos")), ("_vel.csv", of_channel("vel")), ("_trq.csv", of_channel("trq"))],
    );
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    let half = lines.len() * 2 / 5;
    write_kind(
        &workshop,
        "parts",
        &native,
        &[
            ("_part0.csv", lines[..half].concat().into_bytes()),
            ("_part1.csv", [lines[0], &lines[half..].concat()].concat().into_bytes()),
        ],
    );

    let (header, values) = trace(&names, &rows);
    write_kind(&workshop, "trace", &native, &[(".dat", header.into_bytes()), (".r64", values)]);
    let milliseconds = "column = \"scope_time_ms\"\nunit = \"ms\"";
    let of_scope = layout(",", milliseconds, [&pos, &vel, &trq], "Nm", BY_COLUMN);
    write_kind(&workshop, "scope", &of_scope, &[(".csv", scope(&names, &rows).into_bytes())]);
    write_kind(&workshop, "parquet", &native, &[(".parquet", parquet(&names, &columns))]);
    let joints: Vec<String> = (1..=6).map(|joint| format!("joint_{joint}")).collect();
    let moment = |time: &f64| 1_767_602_820_000_000_000 + (time * 1e9).round() as u64;
    let moments: Vec<u64> = columns[0].iter().map(moment).collect();
    let bag = bag(&moments, &joints, [&position, &velocity, &torque]);
    write_kind(&workshop, "mcap", &bag_layout(BY_MOTION), &[(".mcap", bag)]);

    let ingested = |kind: &str| {
        let (database, config) = (format!("{kind}.db"), format!("{kind}.toml"));
        workshop.stdout(&["ingest", kind, "--db", &database, "--config", &config], 0);
        // all files of the export are its identity
        let again = workshop.stdout(&["ingest", kind, "--db", &database, "--config", &config], 0);
        assert!(again.contains("0 stored, 1 known"), "{kind}: {again}");
        dump_of_recording(&workshop.path(&database))
    };
    let [by_column, by_motion] = ["native", "motion"].map(ingested);
    for database in ["native.db", "motion.db"] {
        let points = query(&workshop.path(database), "SELECT count(*) FROM friction_points").concat();
        assert!(points.parse::<u32>().is_ok_and(|points| points > 50), "{points} friction points");
    }
    for (kind, expected, tolerance) in [
        ("rtde", &by_column, 0.0),
        ("channels", &by_column, 0.0),
        ("parts", &by_column, 0.0),
        ("trace", &by_column, SCALED),
        ("scope", &by_column, SCALED),
        ("parquet", &by_column, 0.0),
        ("mcap", &by_motion, 0.0),
    ] {
        assert_close(&ingested(kind), expected, tolerance, kind);
    }
}

#[test]
fn a_trace_that_was_not_copied_to_its_end_is_refused_and_taken_when_it_is_whole() {
    let workshop = small::workshop();
    let export = small::export("R01", 1, 5);
    let text = std::str::from_utf8(&export.bytes).expect("text");
    let (names, _) = table(text);
    let rows: Vec<Vec<&str>> = text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let (header, whole) = trace(&names, &rows);
    let values = workshop.inbox("R01_20260105_0847.r64");
    fs::write(workshop.inbox("R01_20260105_0847.dat"), header).expect("written");
    fs::write(workshop.inbox("PROGRAM.dat"), "DEFDAT PROGRAM").expect("written");
    fs::write(&values, &whole[..whole.len() / 2]).expect("written");
    let cut = workshop.run(&["ingest", "inbox"]);
    let said = format!("{}{}", String::from_utf8_lossy(&cut.stdout), String::from_utf8_lossy(&cut.stderr));
    assert!(
        said.contains("bytes of channels, and R01_20260105_0847.r64 has")
            && said.contains("copy the .dat and .r64"),
        "{said}"
    );
    fs::write(&values, &whole).expect("written");
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.query("SELECT status FROM runs WHERE superseded_by_run_id IS NULL"), ["complete"]);
}
