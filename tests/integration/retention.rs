//! Retention of data: results forever, factors as long as configured.

use std::fs;

use serde_json::Value;

use crate::canon::{self, assert_sound};
use crate::small::{self, export, work};
use crate::support::{Workshop, assert_alike, query, text};

/// Days of a year.
const YEAR: f64 = 365.0;

/// A test, and two production logs that were compared with it.
fn stored() -> Workshop {
    let workshop = small::watching_work();
    for file in [export("A", 1, 5), work("A", 21, 6), work("A", 22, 7)] {
        workshop.add(&file);
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

fn objects(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).expect("an object")).collect()
}

const FACTORS_OF_LOGS: &str =
    "SELECT count(*) FROM torque_factor JOIN cycle USING (cycle_id) WHERE run_id > 1";

#[test]
fn windows_of_a_log_come_to_have_one_factor_and_the_log_verifies_as_before() {
    let workshop = stored();
    let before = workshop.canonical_dump();
    let (windows, factors) = (
        workshop.number("SELECT count(*) FROM cycles WHERE run_id > 1 AND status = 'complete'"),
        workshop.number(FACTORS_OF_LOGS),
    );
    assert!(windows >= 4 && factors >= 4 * 4, "{windows} {factors}");
    let verify = ["verify", "--parameters", "1", "--against", "2", "--against", "3", "--json"];
    let own = objects(&workshop.stdout(&verify, 0));

    // by default all factors are too young, and a dry run changes nothing
    let young = workshop.stdout(&["prune"], 0);
    assert!(
        young.contains("those of tests are kept for 120 days, those of production for 7 days"),
        "{young}"
    );
    let planned = workshop.stdout(&["prune", "--dry-run", "--older-than", "0"], 0);
    assert!(planned.contains("would be joined") && planned.contains("nothing was changed"), "{planned}");
    assert!(
        !planned.contains("would be deleted"),
        "the only test is the one that work is held against: {planned}"
    );
    assert_eq!(workshop.number(FACTORS_OF_LOGS), factors);

    let done = objects(&workshop.stdout(&["prune", "--older-than", "0", "--json"], 0));
    assert_eq!(done.len(), 2, "{done:?}");
    assert_eq!(
        (&done[0]["robot"], &done[0]["kind"], &done[0]["runs"], done[0]["cycles"].as_i64()),
        (&"A".into(), &"production".into(), &2.into(), Some(windows))
    );
    assert_eq!(workshop.number(FACTORS_OF_LOGS), 0);
    let joined = "SELECT count(*), count(DISTINCT run_id), count(DISTINCT run_id || joint || stage || motion) FROM log_factor";
    let joined = workshop.query(joined);
    let parts: Vec<i64> = joined[0].split('|').map(|cell| cell.parse().expect("a number")).collect();
    assert!(
        parts[1] == 2 && parts[0] == parts[2] && parts[0] <= 2 * 4 * 2,
        "one a joint and motion: {parts:?}"
    );
    assert_alike(&workshop.canonical_dump(), &before, "results are kept");
    assert_sound(&workshop.path("armwatch.db"), "after joining");

    for (own, joined) in own.iter().zip(objects(&workshop.stdout(&verify, 0))) {
        assert_eq!((&own["run_id"], &own["cycles"]), (&joined["run_id"], &joined["cycles"]));
        assert_eq!(joined["passed_over"], own["passed_over"], "windows too short for a filter");
        let of = |verified: &Value| verified["rmsd"].as_array().expect("figures").clone();
        assert_eq!(of(own).len(), 4, "a log has no stages");
        for (own, joined) in of(own).iter().zip(of(&joined)) {
            assert_eq!(
                (&own["joint"], &own["stage"], &own["samples"]),
                (&joined["joint"], &joined["stage"], &joined["samples"])
            );
            for figure in ["rmsd_nm", "relative_rmsd", "moving_rmsd_nm", "moving_relative_rmsd"] {
                match (own[figure].as_f64(), joined[figure].as_f64()) {
                    (Some(own), Some(joined)) => {
                        assert!((own - joined).abs() <= 1e-9 * own, "{figure}: {own} {joined}");
                    }
                    (own, joined) => assert_eq!(own, joined, "{figure}"),
                }
            }
        }
    }

    // commands that need pruned factors say so; the test has its factors
    for (arguments, said) in [
        (
            &["identify", "--run", "2", "--cycles", "1"][..],
            "they expired and were joined with those of the other windows",
        ),
        (&["verify", "--parameters", "1", "--against", "2", "--store"], "omit --store"),
    ] {
        let refused = workshop.stderr(arguments, 2);
        assert!(refused.contains(said), "{arguments:?}: {refused}");
    }
    workshop.stdout(&["identify", "--run", "1"], 0);
    workshop.stdout(&["torque", "--run", "2", "--cycle", "1"], 0);
    let again = workshop.stdout(&["prune", "--older-than", "0"], 0);
    assert!(again.contains("no factors have expired"), "{again}");

    // after rereading, a log has separate factors for its windows
    workshop.stdout(&["ingest", "--again", "2"], 0);
    assert_eq!(workshop.number("SELECT count(*) FROM log_factor WHERE run_id = 2"), 0);
    assert!(workshop.number(FACTORS_OF_LOGS) > 0);
    assert_alike(&workshop.canonical_dump(), &before, "read again");
}

#[test]
fn the_daemon_joins_what_has_had_its_time() {
    let workshop = stored();
    let before = workshop.canonical_dump();
    workshop.configure(|config| format!("[retention]\nfactors_of_production_days = 0\n\n{config}"));
    let daemon = workshop.daemon();
    workshop.wait_for(FACTORS_OF_LOGS, 0);
    workshop.wait_until_idle();
    daemon.stop();
    assert!(workshop.log().contains("factors have expired"), "{}", workshop.log());
    assert_alike(&workshop.canonical_dump(), &before, "results are kept");
}

#[test]
fn what_is_no_age_and_no_database_is_refused() {
    let workshop = Workshop::new();
    let refused = workshop.run(&["prune", "--older-than", "-3"]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    let refused = workshop.stderr(&["prune"], 74);
    assert!(refused.contains("there is no database"), "{refused}");
    assert!(!workshop.path("armwatch.db").exists());
}

/// Used bytes, of factors with the data that is kept as long as them, and of the rest: pages without their free space.
fn used(workshop: &Workshop) -> [f64; 2] {
    let of = |factors: u8| {
        let sql = format!(
            "SELECT sum(pgsize - unused) FROM dbstat
             WHERE (name LIKE '%factor%' OR name LIKE '%evidence%') = {factors}"
        );
        workshop.number(&sql) as f64
    };
    [of(1), of(0)]
}

/// The numbers in the row of the table of sizes that begins with `name`, kB.
fn documented(name: &str) -> Vec<f64> {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/schema.md");
    let page = fs::read_to_string(page).expect("the page");
    let row = page.lines().find(|line| line.starts_with(&format!("| {name} |"))).expect("a row").to_owned();
    row.split('|').filter_map(|cell| cell.trim().parse().ok()).collect()
}

/// The pages of a table are filled to about nine tenths, and a small database has parts of constant size.
fn assert_like(what: &str, used_bytes: f64, documented_kb: f64) {
    let share = used_bytes / (1000.0 * documented_kb);
    assert!(
        (0.7..1.1).contains(&share),
        "{what}: {used_bytes:.0} bytes are used, {documented_kb} kB documented"
    );
}

#[test]
fn the_size_of_a_cycle_and_a_window_is_the_documented_one() {
    let workshop = Workshop::new();
    workshop.watch_work("er3a", 1 + 3 * 6);
    // results of a window do not depend on its length
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/production.toml");
    let layout =
        fs::read_to_string(shipped).expect("the layout").replace("window_s = 60.0", "window_s = 6.0");
    fs::write(workshop.path("short_windows.toml"), layout).expect("written");
    workshop.configure(|config| {
        config.replace(shipped, workshop.path("short_windows.toml").to_str().expect("text"))
    });

    let take = |folder: &str, arguments: &[&str]| {
        let shape = ["--warming-s", "5", "--name", "R07"];
        workshop.simulate(folder, &[&shape[..], arguments].concat());
        workshop.stdout(&["ingest", folder], 0);
        used(&workshop)
    };
    let with_one = take("first", &["--cycles", "3", "--start", "2026-01-05T08:00:00Z"]);
    let with_two = take("second", &["--cycles", "6", "--start", "2026-01-06T08:00:00Z"]);
    let cycle = [0, 1].map(|of| (with_two[of] - with_one[of]) / 6.0);
    let work = ["--cycles", "1", "--start", "2026-01-07T08:00:00Z", "--stage-signal", "none"];
    let with_work = take("work", &work);
    let windows =
        workshop.number("SELECT count(*) FROM cycles WHERE run_id = 3 AND status = 'complete'") as f64;
    assert!(windows > 10.0, "{windows}");
    let window = [0, 1].map(|of| (with_work[of] - with_two[of]) / windows);

    let (of_cycle, of_window) = (documented("cycle of a test"), documented("window of production"));
    let of_log = documented("log whose windows were joined");
    println!(
        "used by a cycle {cycle:?}, by a window {window:?} bytes; documented {of_cycle:?}, {of_window:?} kB"
    );
    assert_like("factors of a cycle", cycle[0], of_cycle[0]);
    assert_like("results of a cycle", cycle[1], of_cycle[1]);
    // in six seconds some joints only move or only rest; in a minute each does both, like in the whole log below
    assert!(window[0] < 1100.0 * of_window[0], "{window:?}");
    assert_eq!(of_window[0], of_log[0]);
    assert_like("results of a window", window[1], of_window[1]);

    workshop.stdout(&["prune", "--older-than", "0"], 0);
    let joined = used(&workshop);
    assert_like("factors of a log", joined[0] - with_two[0], of_log[0]);

    // a robot-year as in the page: 24 cycles per day, one window per minute, three logs per day
    let setting = |key: &str| -> f64 {
        let config = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/armwatch.toml"));
        let line = config.expect("it").lines().find_map(|line| Some(line.strip_prefix(key)?.to_owned()));
        line.expect("a setting").trim_start_matches([' ', '=']).parse().expect("days")
    };
    let tests = 24.0 * (of_cycle[0] * setting("factors_of_tests_days") + of_cycle[1] * YEAR);
    let day = 1440.0;
    let work = day * (of_window[0] * setting("factors_of_production_days") + of_window[1] * YEAR);
    let gigabytes = (tests + work + 3.0 * YEAR * of_log[0]) / 1e6;
    let page = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/schema.md")).expect("the page");
    let row = page.lines().find(|line| line.starts_with("| as shipped")).expect("a row");
    assert!(row.contains(&format!("| {gigabytes:.1} GB |")), "{gigabytes} {row}");
    assert!(gigabytes < 2.0, "{gigabytes}");
}

#[test]
fn a_backup_is_the_whole_database_and_takes_the_place_of_a_backup_only() {
    let workshop = small::watching_work();
    let file = export("A", 1, 5);
    workshop.add(&file);
    workshop.stdout(&["ingest", "inbox"], 0);
    let factors = "SELECT count(*), sum(length(factor)) FROM torque_factor";
    let own = workshop.query(factors);
    let said = workshop.stdout(&["backup", "out/armwatch.db"], 0);
    assert!(said.starts_with("out/armwatch.db: ") && said.contains("all equal to the database"), "{said}");
    let copy = workshop.path("out/armwatch.db");
    assert_eq!(query(&copy, factors), own);
    assert_eq!(query(&copy, "PRAGMA auto_vacuum"), ["2"]);
    assert_sound(&copy, "the backup");
    assert_alike(&canon::canonical_dump(&copy), &workshop.canonical_dump(), "the backup");

    // a second backup to the same path, with JSON output
    let done = objects(&workshop.stdout(&["backup", "out/armwatch.db", "--json"], 0));
    assert_eq!((&done[0]["rows"]["run"], &done[0]["rows_compared"]), (&1.into(), &true.into()));
    assert_eq!(done[0]["bytes"], fs::metadata(&copy).expect("a file").len());
    assert_eq!(fs::read_dir(workshop.path("out")).expect("a folder").count(), 1, "nothing is left beside it");

    // the restored database accepts new exports
    workshop.add(&export("A", 2, 6));
    fs::copy(&copy, workshop.path("restored.db")).expect("a copy");
    let taken = workshop.stdout(&["ingest", "inbox", "--db", "restored.db"], 0);
    assert!(taken.contains("1 stored, 1 known"), "{taken}");

    // other files are not overwritten
    fs::write(workshop.path("notes.txt"), "not a database").expect("written");
    for other in ["notes.txt", "armwatch.db", "inbox"] {
        let refused = workshop.stderr(&["backup", other], 2);
        assert!(refused.contains("is not changed"), "{refused}");
    }
    assert_eq!(fs::read(workshop.path("notes.txt")).expect("it"), b"not a database");
    let daemon = workshop.daemon();
    workshop.wait_until_idle();
    let refused = workshop.run(&["backup", "armwatch.db", "--db", "restored.db"]);
    assert!(text(&refused.stderr).contains("is in use"), "{}", text(&refused.stderr));
    workshop.stdout(&["backup", "beside.db"], 0);
    daemon.stop();
}
