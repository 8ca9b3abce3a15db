//! `torque`, `rmsd` and `friction`: stored results as values and as pictures.

use std::collections::BTreeMap;
use std::path::Path;

use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::support::{REFERENCE_NAME, Workshop, reference, text};

/// Tolerance between two methods for the same rows: sums of squares, and norms of triangular factors.
const EQUAL: f64 = 1e-9;

/// The reference export, ingested from a folder that is not watched.
fn archived() -> Workshop {
    let workshop = Workshop::new();
    std::fs::create_dir(workshop.path("exports")).expect("a folder");
    workshop.add_reference("exports");
    workshop.stdout(&["ingest", "exports"], 0);
    workshop
}

/// The cells of a CSV line that the sums need.
struct Row {
    time: f64,
    stage: String,
    joint: usize,
    measured: f64,
    residual: f64,
    moving: bool,
    counted: bool,
}

fn rows(csv: &str) -> Vec<Row> {
    let mut lines = csv.lines();
    let header = "time_s,stage,joint,q_rad,qd_rad_s,measured_nm,estimated_nm,residual_nm,moving,counted";
    assert_eq!(lines.next(), Some(header));
    lines
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            assert_eq!(cells.len(), 10, "{line}");
            let real = |at: usize| cells[at].parse::<f64>().expect("a number");
            assert!((real(5) - real(6) - real(7)).abs() <= 1e-12 * real(5).abs().max(1.0), "{line}");
            Row {
                time: real(0),
                stage: cells[1].into(),
                joint: cells[2].parse().expect("a joint"),
                measured: real(5),
                residual: real(7),
                moving: cells[8] == "1",
                counted: cells[9] == "1",
            }
        })
        .collect()
}

/// RMSD, relative RMSD and number of the rows.
fn rmsd<'a>(rows: impl Iterator<Item = &'a Row>) -> (f64, f64, usize) {
    let (mut deviation, mut measured, mut count) = (0.0, 0.0, 0);
    for row in rows {
        deviation += row.residual * row.residual;
        measured += row.measured * row.measured;
        count += 1;
    }
    ((deviation / f64::from(count)).sqrt(), (deviation / measured).sqrt(), count as usize)
}

/// Compares the rows of a cycle with the view `cycle_rmsd`, each stage and joint, all and moving rows. Returns the
/// number of compared values.
fn assert_stored_rmsd(workshop: &Workshop, rows: &[Row], chosen: &str) -> usize {
    let sql = format!(
        "SELECT joint, stage, rmsd_nm, relative_rmsd, samples, moving_rmsd_nm, moving_relative_rmsd, moving_samples \
         FROM cycle_rmsd WHERE {chosen}"
    );
    let mut compared = 0;
    for stored in workshop.query(&sql) {
        let cells: Vec<&str> = stored.split('|').collect();
        let joint: usize = cells[0].parse().expect("a joint");
        for (moving, figures) in [(false, &cells[2..5]), (true, &cells[5..8])] {
            let samples: usize = figures[2].parse().expect("a count");
            let of = rows.iter().filter(|row| {
                row.counted
                    && row.joint == joint
                    && (cells[1] == "all" || row.stage == cells[1])
                    && (row.moving || !moving)
            });
            let (value, relative, count) = rmsd(of);
            assert_eq!(count, samples, "{stored}");
            if samples > 0 {
                for (ours, theirs) in [(value, figures[0]), (relative, figures[1])] {
                    let theirs: f64 = theirs.parse().expect("a number");
                    assert!((ours - theirs).abs() <= EQUAL * theirs, "{stored}: {ours}");
                    compared += 1;
                }
            }
        }
    }
    compared
}

#[test]
fn the_rows_of_a_cycle_give_its_stored_rmsd() {
    let workshop = archived();
    let own = "cycle = 2 AND verification = 'self'";
    let output = workshop.run(&["torque", "--run", "1", "--cycle", "2"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(!text(&output.stderr).contains("no longer"), "{}", text(&output.stderr));
    let counted = rows(&text(&output.stdout));
    assert!(counted.iter().all(|row| row.counted));
    // six joints, four scopes, all and moving rows, RMSD and relative RMSD
    assert_eq!(assert_stored_rmsd(&workshop, &counted, own), 96);

    let all = rows(&workshop.stdout(&["torque", "--run", "1", "--cycle", "2", "--all-rows"], 0));
    let cycle_rows = workshop.number("SELECT rows FROM cycles WHERE cycle = 2");
    assert_eq!(all.len() as i64, 6 * cycle_rows);
    assert!(all.len() > counted.len());
    assert_eq!(assert_stored_rmsd(&workshop, &all, own), 96);

    let friction =
        rows(&workshop.stdout(&["torque", "--run", "1", "--cycle", "2", "--stage", "friction"], 0));
    assert!(friction.iter().all(|row| row.stage == "friction"));
    assert_eq!(assert_stored_rmsd(&workshop, &friction, &format!("{own} AND stage = 'friction'")), 24);
}

#[test]
fn so_do_those_of_a_motor_side_recording_and_of_foreign_parameters() {
    let workshop = Workshop::new();
    let (export, config) = (reference("tx40/TX40_0000-4000ms_5kHz.csv.gz"), reference("tx40/armwatch.toml"));
    let [export, config] = [&export, &config].map(|path| path.to_str().expect("a path"));
    workshop.stdout(&["ingest", export, "--config", config], 0);
    let out = workshop.stdout(&["torque", "--run", "1", "--cycle", "1", "--config", config], 0);
    assert_eq!(assert_stored_rmsd(&workshop, &rows(&out), "verification = 'self'"), 48);
    // another configuration describes another arm
    let output = workshop.stderr(&["torque", "--run", "1", "--cycle", "1"], 2);
    assert!(output.contains("another description"), "{output}");

    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--runs", "2", "--cycles", "2", "--warming-s", "5"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop.stdout(&["verify", "--parameters", "2", "--against", "1", "--store"], 0);
    let out = workshop.stdout(&["torque", "--run", "1", "--cycle", "1", "--parameters", "2"], 0);
    let cross = "run_id = 1 AND cycle = 1 AND verification = 'cross' AND reference_run_id = 2";
    assert_eq!(assert_stored_rmsd(&workshop, &rows(&out), cross), 96);
}

#[test]
fn thinned_rows_keep_the_peaks_of_every_joint() {
    let workshop = archived();
    let of = |more: &[&str]| {
        rows(&workshop.stdout(&[&["torque", "--run", "1", "--cycle", "1"], more].concat(), 0))
    };
    let (all, thinned) = (of(&[]), of(&["--points", "120"]));
    for joint in 1..=6 {
        let largest = |rows: &[Row], value: fn(&Row) -> f64| {
            rows.iter().filter(|row| row.joint == joint).map(value).fold(f64::NEG_INFINITY, f64::max)
        };
        for value in [|row: &Row| row.residual, |row: &Row| -row.residual, |row: &Row| row.measured] {
            let (kept, whole) = (largest(&thinned, value), largest(&all, value));
            assert!((kept - whole).abs() < f64::EPSILON, "joint {joint}: {kept} {whole}");
        }
        let times: Vec<f64> = thinned.iter().filter(|row| row.joint == joint).map(|row| row.time).collect();
        assert!((40..=120).contains(&times.len()), "{}", times.len());
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
    }
}

#[test]
fn torque_as_json_is_one_object_a_joint_with_columns() {
    let workshop = archived();
    let out =
        workshop.stdout(&["torque", "--run", "1", "--cycle", "1", "--stage", "excitation", "--json"], 0);
    let objects: Vec<serde_json::Value> =
        out.lines().map(|line| serde_json::from_str(line).expect("an object")).collect();
    assert_eq!(objects.len(), 6);
    for (joint, object) in (1..).zip(&objects) {
        assert_eq!(object["joint"], joint);
        let columns = object["rows"].as_object().expect("columns");
        assert_eq!(columns.len(), 9);
        let rows = object["samples"].as_u64().expect("a count");
        assert!(
            rows > 1000 && columns.values().all(|of| of.as_array().is_some_and(|of| of.len() as u64 == rows))
        );
    }
    let sql = "SELECT rmsd_nm FROM cycle_rmsd WHERE cycle = 1 AND joint = 4 AND stage = 'excitation'";
    let stored: f64 = workshop.query(sql)[0].parse().expect("a number");
    let ours = objects[3]["rmsd_nm"].as_f64().expect("a number");
    assert!((ours - stored).abs() <= EQUAL * stored, "{ours} {stored}");
}

#[test]
fn an_export_is_found_again_or_asked_for_but_never_mistaken() {
    let workshop = archived();
    let asked = ["torque", "--run", "1", "--cycle", "1", "--points", "8"];
    let expected = workshop.stdout(&asked, 0);
    let (taken, moved) = (workshop.path("exports").join(REFERENCE_NAME), workshop.path("moved.csv.gz"));
    std::fs::rename(&taken, &moved).expect("moved");

    let said = workshop.stderr(&asked, 74);
    assert!(said.contains("--source FILE") && said.contains(REFERENCE_NAME), "{said}");
    assert_eq!(workshop.stdout(&[&asked[..], &["--source", "moved.csv.gz"]].concat(), 0), expected);

    // the watched folder is searched
    std::fs::copy(&moved, workshop.inbox(REFERENCE_NAME)).expect("a copy");
    assert_eq!(workshop.stdout(&asked, 0), expected);
    std::fs::remove_file(workshop.inbox(REFERENCE_NAME)).expect("removed");

    // a changed file is not the run's, whatever its name, until its content is restored
    let plain = crate::bad_input::decompressed();
    std::fs::write(&taken, plain.replacen("0.1", "0.2", 1)).expect("written");
    for more in [&[][..], &["--source", taken.to_str().expect("a path")]] {
        let output = workshop.stderr(&[&asked[..], more].concat(), 74);
        assert!(output.contains("has other content"), "{output}");
    }
    std::fs::rename(&moved, &taken).expect("moved back");
    assert_eq!(workshop.stdout(&asked, 0), expected);
}

#[test]
fn what_there_is_nothing_of_is_said() {
    let workshop = archived();
    for (arguments, said) in [
        (&["torque", "--run", "9", "--cycle", "1"][..], "there is no run 9"),
        (&["torque", "--run", "1", "--cycle", "9"], "cycles 1 to 5"),
        (&["torque", "--run", "1", "--cycle", "1", "--parameters", "cold"], "neither a run"),
        (&["torque", "--run", "1", "--cycle", "1", "--plot", "a.png"], ".svg or .html"),
        (&["rmsd", "--run", "9"], "there is no run 9"),
        (&["rmsd", "--run", "1", "--joint", "7"], "no joint 7"),
        (&["friction", "--run", "9"], "there is no run 9"),
        (&["friction", "--robot", "Left"], "there are runs of: R00"),
        (&["friction", "--robot", "R00", "--index"], "R00 has no friction index"),
        (&["friction", "--run", "1", "--joint", "7"], "R00 has 6 joints, but no joint 7"),
        (&["friction", "--robot", "R00", "--index", "--joint", "7"], "R00 has 6 joints, but no joint 7"),
        (
            &["torque", "--run", "1", "--cycle", "1", "--source", "none.csv"],
            "none.csv: there is no such file",
        ),
    ] {
        let output = workshop.stderr(arguments, 2);
        assert!(output.contains(said), "{arguments:?}: {output}");
    }
    let output = workshop.stderr(&["torque", "--run", "1", "--cycle", "1", "-o", "nowhere/a.csv"], 74);
    assert!(output.contains("in an existing folder"), "{output}");
    on_a_full_disk_the_remedy_is_room(&workshop);

    // the export is not overwritten, whatever name is used for it
    let export = format!("exports/../exports/{REFERENCE_NAME}");
    let before = std::fs::read(workshop.path(&export)).expect("the export");
    let output = workshop.stderr(&["torque", "--run", "1", "--cycle", "1", "-o", &export], 2);
    assert!(output.contains("so it is not replaced"), "{output}");
    assert_eq!(std::fs::read(workshop.path(&export)).expect("the export"), before);

    delete_run(&workshop, 1);
    let output = workshop.stderr(&["torque", "--run", "1", "--cycle", "1"], 2);
    assert!(output.contains("there is no run 1"), "{output}");
}

/// `/dev/full` accepts no byte, like a full disk; it is no file, and therefore is not checked.
fn on_a_full_disk_the_remedy_is_room(workshop: &Workshop) {
    if !Path::new("/dev/full").exists() {
        println!("skipped: there is no /dev/full");
        return;
    }
    std::os::unix::fs::symlink("/dev/full", workshop.path("full.html")).expect("a link");
    for arguments in [
        &["torque", "--run", "1", "--cycle", "1", "-o", "/dev/full"][..],
        &["friction", "--run", "1", "-o", "/dev/full"],
        &["rmsd", "--run", "1", "--plot", "full.html"],
        &["report", "R00", "-o", "full.html"],
    ] {
        let said = workshop.stderr(arguments, 74);
        assert!(
            said.contains("; free space there, or name a place on another disk"),
            "{arguments:?}: {said}"
        );
    }
}

/// Results only replace results: the database in use with its other files, exports, and files of the configuration stay
/// unchanged.
#[test]
fn results_are_written_over_earlier_results_only() {
    let workshop = archived();
    let plain = crate::bad_input::decompressed();
    std::fs::write(workshop.path("plain.csv"), &plain).expect("an export");
    for target in ["armwatch.db", "armwatch.db-wal", "armwatch.db-shm", "plain.csv", "armwatch.toml"] {
        let before = std::fs::read(workshop.path(target)).ok();
        for arguments in [
            &["torque", "--run", "1", "--cycle", "1"][..],
            &["friction", "--run", "1"],
            &["robot", "urdf", "--run", "1"],
            &["trajectory", "test", "--robot", "er3a"],
        ] {
            let said = workshop.stderr(&[arguments, &["-o", target]].concat(), 2);
            assert!(said.contains(target) && said.contains("name another file"), "{arguments:?}: {said}");
        }
        assert_eq!(std::fs::read(workshop.path(target)).ok(), before, "{target}");
    }
    std::os::unix::fs::symlink("armwatch.db", workshop.path("link.html")).expect("a link");
    for arguments in
        [&["report", "R00", "-o", "link.html"][..], &["rmsd", "--run", "1", "--plot", "link.html"]]
    {
        let output = workshop.stderr(arguments, 2);
        assert!(output.contains("it is a database"), "{output}");
    }
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs"), 1);

    // each again, over its own and over another's
    for arguments in [
        &["torque", "--run", "1", "--cycle", "1", "--points", "8"][..],
        &["friction", "--run", "1"],
        &["torque", "--run", "1", "--cycle", "2", "--points", "8"],
    ] {
        workshop.stdout(&[arguments, &["-o", "results.csv"]].concat(), 0);
    }
    let csv = std::fs::read_to_string(workshop.path("results.csv")).expect("the last results");
    assert!(csv.starts_with("time_s,stage,joint,"), "{csv}");
}

fn delete_run(workshop: &Workshop, run_id: i64) {
    let path = workshop.path("armwatch.db");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(path).foreign_keys(true);
        let mut database = SqliteConnection::connect_with(&options).await.expect("the database");
        let deleted =
            sqlx::query("DELETE FROM run WHERE run_id = ?").bind(run_id).execute(&mut database).await;
        assert_eq!(deleted.expect("deleted").rows_affected(), 1);
        database.close().await.expect("closed");
    });
}

#[test]
fn a_cycle_without_parameters_says_why_and_takes_others() {
    let workshop = Workshop::new();
    let plain = crate::bad_input::decompressed();
    // the excitation of cycle 2 is marked as between stages
    let lines = plain.lines().map(|line| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if cells[20] == "2" && cells[19] == "1" {
            cells[19] = "0";
        }
        cells.join(",")
    });
    let name = REFERENCE_NAME.trim_end_matches(".gz");
    std::fs::write(workshop.inbox(name), lines.collect::<Vec<_>>().join("\n") + "\n").expect("an export");
    workshop.stdout(&["ingest", "inbox"], 0);
    let said = workshop.stderr(&["torque", "--run", "1", "--cycle", "2"], 2);
    assert!(said.contains("no excitation stage") && said.contains("--parameters"), "{said}");
    let out = workshop.stdout(&["torque", "--run", "1", "--cycle", "2", "--parameters", "1:1"], 0);
    assert!(rows(&out).iter().any(|row| row.stage == "warming"));
    let out = workshop.stdout(&["rmsd", "--run", "1", "--joint", "1"], 0);
    assert!(out.contains("cycle 2 has no parameters: the cycle has no excitation stage"), "{out}");
}

/// Number of occurrences of each element in a picture.
fn elements(svg: &str) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for tag in svg.split('<').skip(1).filter(|tag| !tag.starts_with('/')) {
        let name: String = tag.chars().take_while(|c| c.is_ascii_alphabetic()).collect();
        *counts.entry(name).or_default() += 1;
    }
    counts
}

fn picture(workshop: &Workshop, arguments: &[&str], name: &str) -> String {
    workshop.stdout(&[arguments, &["--plot", name]].concat(), 0);
    std::fs::read_to_string(workshop.path(name)).expect("a picture")
}

#[test]
fn pictures_show_six_panels_and_need_no_other_file() {
    let workshop = archived();
    for (arguments, circles) in [
        (&["torque", "--run", "1", "--cycle", "1"][..], 0),
        (&["rmsd", "--run", "1"], 6 * 4 * 5),
        (&["friction", "--run", "1", "--speed", "0.6"], 6 * 5 * 2),
        (&["friction", "--run", "1", "--over", "speed"], 6 * 5 * 4),
        (&["friction", "--run", "1", "--over", "runs"], 6 * 5),
    ] {
        let svg = picture(&workshop, arguments, "a.svg");
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{arguments:?}");
        assert_eq!(svg.matches("class=\"name\"").count(), 6, "{arguments:?}");
        for joint in 1..=6 {
            assert!(svg.contains(&format!(">joint {joint}")), "{arguments:?}: joint {joint}");
        }
        let counts = elements(&svg);
        let found = counts.get("circle").copied().unwrap_or(0);
        assert!(found >= circles && counts["path"] > 6 * 8, "{arguments:?}: {counts:?}");
        assert!(svg.len() < 1 << 20, "{arguments:?}: {} bytes", svg.len());
        let html = picture(&workshop, arguments, "a.html");
        assert!(html.starts_with("<!DOCTYPE html>") && html.contains("</svg>"), "{arguments:?}");
    }
    let svg = picture(&workshop, &["torque", "--run", "1", "--cycle", "1"], "a.svg");
    for said in ["excitation stage", "friction stage", "warming stage", "torque, Nm", "RMSD"] {
        assert!(svg.contains(said), "{said}");
    }
    assert!(!Path::new(&workshop.path("a.csv")).exists());
}

#[test]
fn rmsd_by_cycle_is_what_the_views_hold() {
    let workshop = archived();
    let out = workshop.stdout(&["rmsd", "--run", "1", "--json"], 0);
    let objects: Vec<serde_json::Value> =
        out.lines().map(|line| serde_json::from_str(line).expect("an object")).collect();
    assert_eq!(objects.len(), 5);
    assert!(objects.iter().all(|of| of["rmsd"].as_array().is_some_and(|of| of.len() == 24)));
    let contrast = &objects[2]["warming_contrast"][4];
    assert_eq!(contrast["joint"], 5);
    let stored = workshop.query(
        "SELECT start_moving_rmsd_nm, end_rmsd_nm FROM warming_contrast WHERE cycle = 3 AND joint = 5",
    );
    let ours = [&contrast["start"]["moving_rmsd_nm"], &contrast["end"]["rmsd_nm"]];
    let ours = ours.map(|value| value.as_f64().expect("a number").to_string());
    assert_eq!(stored, [ours.join("|")]);

    let table = workshop.stdout(&["rmsd", "--run", "1", "--joint", "5", "--figure", "nm"], 0);
    let cycle = table.lines().find(|line| line.starts_with("3 ")).expect("cycle 3");
    let cells: Vec<&str> = cycle.split_whitespace().collect();
    assert_eq!(cells.len(), 13, "{table}");
    let shown: f64 = workshop
        .query("SELECT rmsd_nm FROM cycle_rmsd WHERE cycle = 3 AND joint = 5 AND stage = 'all'")[0]
        .parse()
        .expect("a number");
    // after the six values of moving rows
    assert_eq!(cells[10], format!("{shown:.4}"));
    assert!(table.contains("deviation") && !table.contains("joint 4"), "{table}");
}

#[test]
fn friction_fits_made_again_are_those_that_were_stored() {
    let workshop = archived();
    let out = workshop.stdout(&["friction", "--run", "1", "--json"], 0);
    let columns =
        "model, a_nm, a_std_error_nm, b_nm, t1_min, t1_std_error_min, c_nm, t2_min, rmsd_nm, samples";
    let mut points = 0;
    for line in out.lines() {
        let object: serde_json::Value = serde_json::from_str(line).expect("an object");
        let stored = workshop.query(&format!(
            "SELECT {columns} FROM warmup_fits WHERE run_id = 1 AND joint = {} AND speed_fraction = {}",
            object["joint"], object["speed_fraction"]
        ));
        for (name, stored) in columns.split(", ").zip(stored[0].split('|')) {
            match (&object[name], stored.parse::<f64>()) {
                (serde_json::Value::Null, _) => assert_eq!(stored, "", "{name}"),
                (serde_json::Value::String(model), _) => assert_eq!(stored, model),
                (value, stored) => {
                    let (ours, stored) = (value.as_f64().expect("a number"), stored.expect("a number"));
                    assert!((ours - stored).abs() <= EQUAL * stored.abs(), "{name}: {ours} {stored}");
                }
            }
        }
        points += object["points"].as_array().map_or(0, Vec::len);
    }
    assert_eq!(
        out.lines().count() as i64,
        workshop.number("SELECT COUNT(*) FROM warmup_fits WHERE run_id = 1")
    );
    assert_eq!(points as i64, workshop.number("SELECT COUNT(*) FROM friction_points"));

    workshop.stdout(&["friction", "--robot", "R00", "--joint", "3", "-o", "points.csv"], 0);
    let csv = std::fs::read_to_string(workshop.path("points.csv")).expect("the points");
    let of_joint = workshop.number("SELECT COUNT(*) FROM friction_points WHERE joint = 3");
    assert_eq!(csv.lines().count() as i64, 1 + of_joint);
    let squares = csv.lines().skip(1).filter_map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), 13, "{line}");
        (cells[5] == "0.6").then(|| {
            let real = |at: usize| cells[at].parse::<f64>().expect("a number");
            (real(8).abs() - real(12)).powi(2)
        })
    });
    let squares: Vec<f64> = squares.collect();
    let rmsd = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let sql = "SELECT rmsd_nm FROM warmup_fits WHERE run_id = 1 AND joint = 3 AND speed_fraction = 0.6";
    let stored: f64 = workshop.query(sql)[0].parse().expect("a number");
    assert!((rmsd - stored).abs() <= EQUAL * stored, "{rmsd} {stored}");
}
