//! A failure of one robot affects only that robot. A trigger in the database simulates refused values.

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Executor};

use crate::support::Workshop;

const FAULTS: &str = "SELECT robot, tries > 0, reason LIKE '%poisoned%' FROM conclusion_faults";

const OF_B: &str = "SELECT COUNT(*) FROM robot WHERE name = 'B' AND history > 0 AND history = concluded";

/// Makes the database refuse conclusions of robot A.
fn poison(workshop: &Workshop) {
    change(
        workshop,
        "CREATE TRIGGER poison BEFORE UPDATE OF concluded ON robot WHEN NEW.name = 'A'
         BEGIN SELECT RAISE(ABORT, 'poisoned'); END",
    );
}

fn change(workshop: &Workshop, sql: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(workshop.path("armwatch.db"));
        let mut connection = options.connect().await.expect("a connection");
        connection.execute(AssertSqlSafe(sql)).await.expect("a change");
    });
}

fn put(workshop: &Workshop, robot: &str, seed: &str) {
    let shape = ["--cycles", "3", "--warming-s", "5", "--name", robot, "--seed", seed];
    let start = format!("2026-01-{seed}T08:47:00Z");
    workshop.simulate("inbox", &[&shape[..], &["--start", &start]].concat());
}

#[test]
fn a_robot_whose_conclusions_are_refused_is_marked_and_holds_up_nobody() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    poison(&workshop);
    put(&workshop, "A", "11");
    put(&workshop, "B", "12");
    let daemon = workshop.daemon();
    workshop.wait_for(OF_B, 1);
    workshop.wait_for("SELECT COUNT(*) FROM conclusion_faults", 1);
    assert_eq!(workshop.query(FAULTS), ["A|1|1"]);
    daemon.stop();
    let said = |level: &str| {
        let log = workshop.log();
        log.lines().filter(|line| line.contains(level) && line.contains("poisoned")).count()
    };
    assert_eq!((said("ERROR"), said("WARN")), (1, 0), "{}", workshop.log());

    // a restart reports it once, and continues with the others
    let daemon = workshop.daemon();
    put(&workshop, "B", "13");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE robot = 'B' AND status = 'complete'", 2);
    workshop.wait_for(OF_B, 1);
    assert_eq!((said("ERROR"), said("WARN")), (1, 1), "{}", workshop.log());

    // the reason is removed, and another run is tried at once
    change(&workshop, "DROP TRIGGER poison");
    put(&workshop, "A", "14");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE robot = 'A' AND status = 'complete'", 2);
    workshop.wait_for_conclusions();
    assert_eq!(workshop.number("SELECT COUNT(*) FROM conclusion_faults"), 0);
    daemon.stop();
}

#[test]
fn one_shot_ingestion_concludes_the_others_and_says_which_it_could_not() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    poison(&workshop);
    put(&workshop, "A", "11");
    put(&workshop, "B", "12");
    let said = workshop.stderr(&["ingest", "inbox"], 70);
    assert!(said.contains("A: no new conclusion") && said.contains("poisoned"), "{said}");
    assert_eq!(workshop.number(OF_B), 1);
}
