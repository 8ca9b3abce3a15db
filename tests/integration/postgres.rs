//! The same exports stored in a SQLite file and on a PostgreSQL server: every public view and every command has the
//! same output. The server is a private one, of the installed package; without the package, the tests print a message
//! and end.

mod encrypted;
mod server;
mod several_daemons;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use server::{Server, dump, dump_in_any_order, is_made, is_open};

use crate::small::{self, Export, export, work};
use crate::support::{Daemon, Workshop, assert_alike, end_of, pass, text, wait_until};

fn rows(dump: &str, view: &str) -> usize {
    let rest = dump.split_once(&format!("# {view}\n")).expect("a view").1;
    rest.lines().take_while(|line| !line.starts_with("# ")).filter(|line| !line.is_empty()).count()
}

/// Output of a command without its duration.
fn without_time(out: &str) -> String {
    let said = |line: &str| match line.split_once("\"took_s\":") {
        Some((before, after)) => before.to_owned() + after.trim_start_matches(|of: char| of != '}'),
        None => line.to_owned(),
    };
    out.lines().map(said).collect::<Vec<_>>().join("\n")
}

/// Returns true if the log shows that a daemon has opened its database.
fn is_watching(said: &str) -> bool {
    said.contains(" watching database=")
}

/// A folder with a database of each engine, and commands for both.
struct Both {
    workshop: Workshop,
    databases: [String; 2],
}

impl Both {
    fn new(workshop: Workshop, server: &Server) -> Self {
        let file = workshop.path("armwatch.db").to_str().expect("a path").to_owned();
        Self { workshop, databases: [file, server.fleet()] }
    }

    /// Starts a daemon again, like its service unit, if it ended because the server was stopped while the daemon was
    /// starting. Later the daemon must survive every stop of the server.
    fn revive(&self, life: &mut (Daemon, usize), daemon: &impl Fn() -> (Daemon, usize)) {
        let Some(ended) = life.0.child.try_wait().expect("a child") else { return };
        let log = self.workshop.log();
        let is_due = ended.code() == Some(74) && !is_watching(&log[life.1..]);
        assert!(is_due, "the daemon ended by itself: {ended:?}\n{log}");
        *life = daemon();
    }

    /// Runs the same command on both and asserts the same status and output.
    fn stdout(&self, arguments: &[&str], code: i32) -> String {
        let [file, server] = self.databases.each_ref().map(|database| {
            let out = self.workshop.stdout(&[&["--db", database][..], arguments].concat(), code);
            without_time(&out).replace(database.as_str(), "DATABASE")
        });
        assert_eq!(server, file, "{arguments:?}");
        file
    }

    /// Compares both and returns the common content.
    fn dump(&self, when: &str) -> String {
        let [file, server] = self.databases.each_ref().map(|database| dump(&self.workshop, database));
        assert_alike(&server, &file, when);
        file
    }

    fn add(&self, export: &Export) {
        self.workshop.add(export);
    }
}

/// Plain and compressed tests, production logs before and between them, a fault, a copy, and a rewritten export.
#[test]
fn both_engines_keep_the_same_of_the_same_exports() {
    let Some(server) = Server::start() else { return };
    let both = Both::new(small::watching_work(), &server);
    for export in [
        export("A", 1, 5),
        export("A", 11, 6).gzip(),
        export("A", 12, 7),
        export("B", 2, 5).zstd(),
        export("C", 3, 5).spoiled(),
        work("A", 21, 3),
        work("A", 22, 6),
        export("F", 6, 5),
    ] {
        both.add(&export);
    }
    both.stdout(&["ingest", "inbox", "--json"], 1);
    let first = both.dump("the first exports");
    for view in ["runs", "cycles", "cycle_parameters", "friction_points", "quarantine", "production_checks"] {
        assert!(rows(&first, view) > 0, "no row in {view}");
    }
    // rewritten with the same name, a copy with another name, and a corrected export
    both.add(&export("F", 7, 5));
    both.add(&export("A", 1, 5).named("again.csv"));
    both.add(&export("C", 3, 5));
    both.stdout(&["ingest", "inbox", "--json"], 0);
    both.dump("what came again");
    for question in [
        &["status"][..],
        &["robots"],
        &["runs", "--json"],
        &["cycles", "--json"],
        &["alerts", "list"],
        &["rmsd", "--run", "2"],
        &["identify", "--run", "2", "--save", "kept"],
    ] {
        both.stdout(question, 0);
    }
    both.dump("kept parameters");
    let exported = both.databases.each_ref().map(|database| {
        let folder =
            both.workshop.path(if database.starts_with("postgres") { "of_server" } else { "of_file" });
        let of = folder.to_str().expect("a path");
        both.workshop
            .stdout(&["export", "--db", database, "--robot", "A", "--since", "2026-01-06", "--csv", of], 0);
        sorted_lines(&folder.join("cycle_rmsd.csv"))
    });
    assert!(exported[0].len() > 1);
    assert_eq!(exported[1], exported[0]);
    for database in &both.databases {
        both.workshop.stdout(&["prune", "--db", database, "--older-than", "0"], 0);
    }
    both.dump("factors are gone");
    for (subject, database) in [("2", &both.databases[1]), ("A", &both.databases[1])] {
        both.workshop.stdout(&["report", subject, "-o", "report.html", "--db", database], 0);
    }
}

fn sorted_lines(file: &Path) -> Vec<String> {
    let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines.sort_unstable();
    lines
}

/// A joint that wears: conclusions, and the actions of users on an alarm.
#[test]
fn an_alarm_has_the_same_life_on_both_engines() {
    let Some(server) = Server::start() else { return };
    let both = Both::new(Workshop::new(), &server);
    let fault = ["--fault", "wear:joint=3,from=5,rate=0.08"];
    let shape = ["--runs", "8", "--cycles", "2", "--name", "R01", "--seed", "11"];
    both.workshop.simulate("made", &[&shape[..], &fault].concat());
    both.stdout(&["ingest", "made", "--json"], 0);
    let found = both.dump("a joint that wears");
    for view in ["anomalies", "anomaly_history", "fleet_health", "warmup_fits"] {
        assert!(rows(&found, view) > 0, "no row in {view}");
    }
    let listed = both.stdout(&["alerts", "list", "--state", "open", "--json"], 0);
    let first: Value = serde_json::from_str(listed.lines().next().expect("an alarm")).expect("JSON");
    let id = first["anomaly_id"].to_string();
    let by = ["--by", "mueller", "--why", "seen"];
    both.stdout(&[&["alerts", "ack", &id][..], &by].concat(), 0);
    let day = jiff::Timestamp::now() + jiff::SignedDuration::from_hours(24 * 30);
    let day = day.strftime("%Y-%m-%d").to_string();
    both.stdout(&[&["alerts", "shelve", &id, "--until", &day][..], &by].concat(), 0);
    both.dump("shelved");
    both.stdout(&[&["alerts", "false-alarm", &id][..], &by].concat(), 0);
    both.stdout(
        &["maintenance", "R01", "--joint", "3", "--what", "gearbox", "--at", "2026-01-08", "--by", "m"],
        0,
    );
    both.dump("a gearbox changed");
    both.stdout(&["maintenance", "--remove", "1"], 0);
    both.dump("and taken back");
}

/// The daemon is killed twice while it stores, and ends with the same rows as an uninterrupted command.
#[test]
fn a_killed_daemon_goes_on_where_the_server_has_it() {
    let Some(server) = Server::start() else { return };
    let both = Both::new(small::watching_work(), &server);
    for (robot, seed) in [("A", 1), ("B", 2), ("D", 8), ("E", 9)] {
        both.add(&export(robot, seed, 5));
    }
    let growing = export("G", 4, 5);
    let path = both.workshop.inbox(&growing.name);
    fs::write(&path, &growing.bytes[..growing.bytes.len() / 2]).expect("written");
    let daemon = || {
        let log = fs::OpenOptions::new().create(true).append(true).open(both.workshop.path("daemon.log"));
        let mut command = both.workshop.command(&["run", "--db", &both.databases[1]]);
        command.stdout(Stdio::null()).stderr(log.expect("a log"));
        command.spawn().expect("the daemon starts")
    };
    let cycles = || {
        let there = server.sql_in("fleet", "SELECT CAST(to_regclass('armwatch.cycle') AS text)");
        if there != ["armwatch.cycle"] && there != ["cycle"] {
            return 0;
        }
        server.sql_in("fleet", "SELECT CAST(count(*) AS text) FROM armwatch.cycle")[0].parse().unwrap_or(0)
    };
    for more in [1, 2] {
        let wanted = cycles() + more;
        let mut child = daemon();
        wait_until(|| cycles() >= wanted, || format!("{} cycles\n{}", cycles(), both.workshop.log()));
        child.kill().expect("killed");
        child.wait().expect("ended");
    }
    fs::write(&path, &growing.bytes).expect("written");
    let lives = || both.workshop.log().matches(" watching ").count();
    let before = lives();
    let mut child = daemon();
    wait_until(|| lives() > before, || both.workshop.log());
    let second = end_of(&mut daemon(), || both.workshop.log());
    let open = "SELECT CAST(count(*) AS text) FROM armwatch.run WHERE status = 'complete'";
    wait_until(|| server.sql_in("fleet", open) == ["5"], || both.workshop.log());
    // the server is restarted while the daemon runs
    server.control("restart");
    both.add(&export("H", 5, 5));
    wait_until(|| server.sql_in("fleet", open) == ["6"], || both.workshop.log());
    let stale = "SELECT CAST(count(*) AS text) FROM armwatch.robot WHERE history <> concluded";
    wait_until(|| server.sql_in("fleet", stale) == ["0"], || both.workshop.log());
    let term = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
    assert!(term.expect("kill runs").success());
    assert_eq!(end_of(&mut child, || both.workshop.log()), Some(0));
    assert_eq!(second, Some(74), "a second daemon: {}", both.workshop.log());
    both.workshop.stdout(&["ingest", "inbox"], 0);
    let [file, server] =
        both.databases.each_ref().map(|database| dump_in_any_order(&both.workshop, database));
    assert_alike(&server, &file, "killed");
}

/// Number of events of a test that takes minutes, from `ARMWATCH_KILLS`.
fn events() -> u32 {
    std::env::var("ARMWATCH_KILLS").ok().map_or(60, |count| count.parse().expect("a number of kills"))
}

/// In many rounds and at random times, the daemon is killed, the server is stopped and started, or all connections are
/// cut. The final content is the same as from an undisturbed command with a file.
fn disturbed(most: u32) {
    let Some(server) = Server::start() else { return };
    let both = Both::new(small::watching_work(), &server);
    for (robot, seed) in [("A", 1), ("B", 2), ("D", 8)] {
        both.add(&export(robot, seed, 5));
        both.add(&export(robot, seed + 20, 6));
        both.add(&work(robot, seed + 40, 6));
    }
    both.add(&export("C", 3, 5).spoiled());
    both.workshop.stdout(&["ingest", "inbox", "--db", &both.databases[0]], 1);
    let golden = dump_in_any_order(&both.workshop, &both.databases[0]);
    let seed =
        std::env::var("ARMWATCH_SEED").ok().map_or_else(rand::random, |seed| seed.parse().expect("a seed"));
    println!("ARMWATCH_SEED={seed}");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut events, mut round) = ([0; 3], 0);
    while events.iter().sum::<u32>() < most {
        round += 1;
        let name = format!("fleet{round}");
        server.sql(&format!("CREATE DATABASE {name}"));
        let address = server.fleet().replace("/fleet?", &format!("/{name}?"));
        // with the length of the log at its start
        let daemon = || {
            let logged = both.workshop.log().len();
            let log = fs::OpenOptions::new().create(true).append(true).open(both.workshop.path("daemon.log"));
            let mut command = both.workshop.command(&["run", "--db", &address]);
            command.stdout(Stdio::null()).stderr(log.expect("a log"));
            (Daemon { child: command.spawn().expect("the daemon starts") }, logged)
        };
        let mut life = daemon();
        // a round has so many events that some fall into every phase, and few enough to finish
        for _ in 0..random.random_range(4..10) {
            pass(Duration::from_millis(random.random_range(20..900)));
            both.revive(&mut life, &daemon);
            let event = random.random_range(0..3);
            events[event] += 1;
            match event {
                0 => {
                    drop(life);
                    life = daemon();
                }
                1 if is_open(&server, &name) => server.control("restart"),
                _ if is_open(&server, &name) => {
                    server.sql(
                        "SELECT CAST(count(pg_terminate_backend(pid)) AS text) FROM pg_stat_activity
                         WHERE application_name = 'armwatch'",
                    );
                }
                // a starting daemon finds no server, and ends
                _ => {}
            }
        }
        let left = "SELECT CAST((SELECT count(*) FROM armwatch.run WHERE status <> 'streaming') || ' '
                                || (SELECT count(*) FROM armwatch.robot WHERE history <> concluded) AS text)";
        wait_until(
            || {
                both.revive(&mut life, &daemon);
                is_made(&server, &name) && server.sql_in(&name, left) == ["10 0"]
            },
            || both.workshop.log(),
        );
        life.0.signal("TERM");
        assert_eq!(life.0.end(), Some(0), "{}", both.workshop.log());
        assert_alike(&dump_in_any_order(&both.workshop, &address), &golden, &format!("round {round}"));
        println!("round {round}: {events:?} kills, falls of the server, cuts of connections");
    }
}

#[test]
fn a_few_kills_of_daemon_and_server_change_nothing() {
    disturbed(8);
}

#[test]
#[ignore = "minutes: 60 kills of the daemon, falls of the server and cuts of connections, or as many as ARMWATCH_KILLS says"]
fn many_kills_of_daemon_and_server_change_nothing() {
    disturbed(events());
}

/// Operations that a server does not support are refused with a remedy.
#[test]
fn what_a_server_refuses_is_told_in_plain_words() {
    let Some(server) = Server::start() else { return };
    let workshop = small::workshop();
    let told = |arguments: &[&str], code: i32| workshop.stderr(arguments, code);
    let fleet = server.fleet();
    assert!(told(&["runs", "--db", &fleet], 74).contains("there is no database postgres:///fleet"));
    workshop.stdout(&["ingest", "inbox", "--db", &fleet], 0);
    let nobody = "postgres://armwatch:secret@127.0.0.1:1/fleet";
    let said = told(&["ingest", "inbox", "--db", nobody], 74);
    assert!(said.contains("no server answers for database postgres://armwatch@127.0.0.1:1/fleet"), "{said}");
    assert!(!said.contains("secret"), "{said}");
    let gone = server.fleet().replace("/fleet?", "/other?");
    assert!(told(&["ingest", "inbox", "--db", &gone], 74).contains("createdb"));
    server.sql("CREATE ROLE reader LOGIN");
    let reader = server.fleet().replace("user=armwatch", "user=reader");
    assert!(told(&["runs", "--db", &reader], 74).contains("the user of"));
    let unknown = server.fleet().replace("user=armwatch", "user=unknown");
    assert!(told(&["runs", "--db", &unknown], 74).contains("refuses the user"));
    assert!(told(&["backup", "copy.db", "--db", &fleet], 74).contains("pg_dump --schema armwatch"));
    assert!(told(&["snapshot", "copy.db", "--db", &fleet], 74).contains("GRANT SELECT"));
    assert!(told(&["sql", "--db", &fleet, "DELETE FROM run"], 2).contains("reading only"));
    assert!(told(&["sql", "--db", &fleet, "DELETE FROM run RETURNING run_id"], 2).contains("read-only"));
    assert!(told(&["sql", "--db", &fleet, "SELECT 1; SELECT 2"], 2).contains("several statements"));
    assert!(told(&["sql", "--db", &fleet, "/* nothing */ ;"], 2).contains("there is no statement"));
    for statement in [
        "SELECT set_config('transaction_read_only', 'off', false)",
        "SELECT set_config('transaction_isolation', 'serializable', false)",
        "SELECT CAST('x' AS integer)",
        "SELECT 1 / 0",
        "SELECT repeat('x', 2000000000)",
    ] {
        let said = told(&["sql", "--db", &fleet, statement], 2);
        assert!(!said.contains("start again"), "{statement}: {said}");
    }
    assert!(
        told(&["sql", "--db", &fleet, "COPY runs TO '/tmp/armwatch-runs'"], 2).contains("does not only read")
    );
    let by_robot = "SELECT count(*) AS runs FROM runs WHERE robot = :robot AND run_id > :run";
    assert!(
        told(&["sql", "--db", &fleet, by_robot, "--param", "run=0"], 0).contains("NULL, because no --param")
    );
    let asked =
        ["sql", "--db", &fleet, "--json", by_robot, "--param", "robot=it's nobody", "--param", "run=0"];
    assert_eq!(workshop.stdout(&asked, 0).trim(), r#"{"runs":0}"#);
    assert!(told(&["sql", "--db", &fleet, "SELECT robo FROM runs"], 2).contains("robo"));
    let doctor = text(&workshop.run(&["doctor", "--all", "--db", &fleet]).stdout);
    assert!(doctor.contains("has the schema of this program") && doctor.contains("pg_amcheck"), "{doctor}");
    server.sql_in("fleet", "UPDATE armwatch.schema_version SET version = 1000");
    assert!(told(&["runs", "--db", &fleet], 74).contains("use the newer program"));
    server.sql("CREATE DATABASE latin TEMPLATE template0 ENCODING 'LATIN1' LOCALE 'C'");
    let latin = server.fleet().replace("/fleet?", "/latin?");
    assert!(told(&["ingest", "inbox", "--db", &latin], 74).contains("UTF8"));
}

/// After migration, a database of an earlier version on a server has the rows of a file with the same content, the
/// granted rights, and the unchanged sequence of keys.
#[test]
fn an_earlier_version_on_a_server_keeps_its_rows() {
    let Some(server) = Server::start() else { return };
    let fixtures = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/migrations");
    let unpacked = |name: &str| {
        let packed = fs::read(format!("{fixtures}/{name}.zst")).expect("a fixture");
        zstd::decode_all(&packed[..]).expect("unpacked")
    };
    server.sql("CREATE ROLE reader");
    for schema in [46, 50] {
        let name = format!("earlier{schema}");
        server.sql(&format!("CREATE DATABASE {name}"));
        let there = String::from_utf8(unpacked(&format!("{schema:04}.postgres.sql"))).expect("text");
        server.sql_in(&name, &there);
        let grants =
            "GRANT USAGE ON SCHEMA armwatch TO reader; GRANT SELECT ON armwatch.runs, armwatch.run TO reader";
        server.sql_in(&name, grants);
        let last_run = "SELECT CAST(last_value AS text) FROM armwatch.run_run_id_seq";
        let given = server.sql_in(&name, last_run);
        let workshop = small::workshop();
        let file = workshop.path("earlier.db");
        fs::write(&file, unpacked(&format!("{schema:04}.db"))).expect("a database");
        let both = Both {
            workshop,
            databases: [
                file.to_str().expect("a path").to_owned(),
                server.fleet().replace("/fleet", &format!("/{name}")),
            ],
        };
        let refused = both.workshop.run(&["status", "--db", &both.databases[1]]);
        assert!(text(&refused.stderr).contains("upgrade it"), "{}", text(&refused.stderr));
        for database in &both.databases {
            both.workshop.stdout(&["ingest", "inbox", "--db", database], 0);
        }
        let [in_file, on_server] =
            both.databases.each_ref().map(|database| without_event_numbers(&dump(&both.workshop, database)));
        assert_alike(&on_server, &in_file, &format!("schema {schema}"));
        let rows_of = in_file;
        for view in
            ["runs", "cycles", "cycle_parameters", "maintenance_log", "deliveries", "baseline_changes"]
        {
            assert!(rows(&rows_of, view) > 0, "no row in {view}");
        }
        assert_eq!(server.sql_in(&name, last_run), given);
        let may = "SELECT CAST(has_table_privilege('reader', 'armwatch.runs', 'SELECT') AS text)";
        assert_eq!(server.sql_in(&name, may), ["true"]);
        let made = |database: &str| server.sql_in(database, DEFINITIONS);
        if schema == 46 {
            both.workshop.stdout(&["ingest", "inbox", "--db", &server.fleet()], 0);
        }
        assert_eq!(made(&name), made("fleet"), "schema {schema} and a new database");
    }
}

/// Rows of views without the numbers of events: each engine continues its earlier numbers.
fn without_event_numbers(rows: &str) -> String {
    let without =
        |row: &str| match row.strip_prefix("{\"anomaly_event_id\":").and_then(|row| row.split_once(',')) {
            Some((_, rest)) => format!("{{{rest}\n"),
            None => format!("{row}\n"),
        };
    rows.lines().map(without).collect()
}

/// Definitions in the schema of a server: columns, constraints, indexes, triggers, functions and views.
const DEFINITIONS: &str = "
    SELECT format('%s.%s %s %s %s %s', t.relname, a.attname, format_type(a.atttypid, a.atttypmod), a.attnotnull,
                  a.attidentity, pg_get_expr(d.adbin, d.adrelid))
    FROM pg_class AS t JOIN pg_attribute AS a ON a.attrelid = t.oid
    LEFT JOIN pg_attrdef AS d ON d.adrelid = t.oid AND d.adnum = a.attnum
    WHERE t.relnamespace = CAST('armwatch' AS regnamespace) AND t.relkind IN ('r', 'v') AND a.attnum > 0
    UNION ALL
    SELECT format('%s %s %s', CAST(conrelid AS regclass), conname, pg_get_constraintdef(oid)) FROM pg_constraint
    WHERE connamespace = CAST('armwatch' AS regnamespace)
    UNION ALL
    SELECT indexdef FROM pg_indexes WHERE schemaname = 'armwatch'
    UNION ALL
    SELECT pg_get_triggerdef(g.oid) FROM pg_trigger AS g JOIN pg_class AS t ON t.oid = g.tgrelid
    WHERE t.relnamespace = CAST('armwatch' AS regnamespace) AND NOT g.tgisinternal
    UNION ALL
    SELECT pg_get_viewdef(oid) FROM pg_class
    WHERE relnamespace = CAST('armwatch' AS regnamespace) AND relkind = 'v'
    UNION ALL
    SELECT CAST(relname AS text) FROM pg_class
    WHERE relnamespace = CAST('armwatch' AS regnamespace) AND relkind IN ('S', 'r')
    ORDER BY 1";

/// An administrator creates a schema for a user without that right; one with foreign content is left unchanged.
#[test]
fn an_empty_schema_is_taken_and_one_of_another_program_is_refused() {
    let Some(server) = Server::start() else { return };
    let workshop = small::workshop();
    workshop.add(&export("A", 1, 5));
    server.sql("CREATE ROLE plant LOGIN");
    let cases = [
        ("owned", "CREATE SCHEMA armwatch AUTHORIZATION plant", true),
        (
            "granted",
            "CREATE SCHEMA armwatch; GRANT USAGE, CREATE ON SCHEMA armwatch TO plant;
             ALTER DEFAULT PRIVILEGES IN SCHEMA armwatch GRANT SELECT ON TABLES TO plant",
            true,
        ),
        (
            "used",
            "CREATE SCHEMA armwatch AUTHORIZATION plant; CREATE TABLE armwatch.notes (text text)",
            false,
        ),
        (
            "function",
            "CREATE SCHEMA armwatch AUTHORIZATION plant;
             CREATE FUNCTION armwatch.one() RETURNS integer LANGUAGE sql AS 'SELECT 1'",
            false,
        ),
    ];
    for (database, statement, is_taken) in cases {
        server.sql(&format!("CREATE DATABASE {database}"));
        server.sql_in(database, statement);
        let address = server.fleet().replace("/fleet?", &format!("/{database}?"));
        let address = address.replace("user=armwatch", "user=plant");
        let output = workshop.run(&["ingest", "inbox", "--db", &address]);
        let said = text(&output.stderr);
        match is_taken {
            true => {
                assert_eq!(output.status.code(), Some(0), "{database}: {said}");
                assert!(is_made(&server, database), "{database}");
                // the scheme is not case-sensitive
                let again = address.replace("postgres://", "PostgreSQL://");
                assert_eq!(workshop.stdout(&["runs", "--db", &again], 0).lines().count(), 2);
            }
            false => {
                assert_eq!(output.status.code(), Some(74), "{database}: {said}");
                assert!(said.contains("of another program"), "{database}: {said}");
            }
        }
    }
    server.sql("CREATE DATABASE closed");
    server.sql_in("closed", "CREATE SCHEMA armwatch; GRANT USAGE ON SCHEMA armwatch TO plant");
    let closed = server.fleet().replace("/fleet?", "/closed?").replace("user=armwatch", "user=plant");
    let said = workshop.stderr(&["ingest", "inbox", "--db", &closed], 74);
    assert!(said.contains("permission denied") && said.contains("may create in"), "{said}");
}

/// Tables, columns and types are those of the file, except for those that only one engine needs.
#[test]
fn tables_and_views_of_both_engines_have_the_same_columns() {
    let Some(server) = Server::start() else { return };
    let both = Both::new(small::workshop(), &server);
    both.stdout(&["ingest", "inbox"], 0);
    let of_file = both.workshop.query(
        "SELECT t.name, c.name, CASE WHEN t.type = 'view' THEN '' ELSE lower(c.type) END, c.\"notnull\"
         FROM sqlite_schema AS t JOIN pragma_table_info(t.name) AS c
         WHERE t.type IN ('table', 'view') AND t.name NOT LIKE 'sqlite%'
         ORDER BY t.name, c.cid",
    );
    let of_server = server.sql_in(
        "fleet",
        "SELECT CAST(t.relname AS text), CAST(a.attname AS text),
                CASE WHEN t.relkind = 'v' THEN ''
                     ELSE CASE format_type(a.atttypid, a.atttypmod) WHEN 'bigint' THEN 'integer' WHEN 'boolean' THEN 'integer'
                          WHEN 'double precision' THEN 'real' WHEN 'bytea' THEN 'blob'
                          ELSE format_type(a.atttypid, a.atttypmod) END END,
                CASE WHEN a.attnotnull THEN '1' ELSE '0' END
         FROM pg_class AS t JOIN pg_attribute AS a ON a.attrelid = t.oid
         WHERE t.relnamespace = CAST('armwatch' AS regnamespace) AND t.relkind IN ('r', 'v') AND a.attnum > 0
         ORDER BY t.relname, a.attnum",
    );
    // a key is never NULL, but SQLite does not declare that
    let without_null = |lines: &[String]| -> Vec<String> {
        lines.iter().map(|line| line.rsplit_once('|').expect("four cells").0.to_owned()).collect()
    };
    assert_eq!(without_null(&of_server), without_null(&of_file));
    assert!(of_file.len() > 500, "{} columns", of_file.len());
    let indexes = both
        .workshop
        .query("SELECT name FROM sqlite_schema WHERE type = 'index' AND sql IS NOT NULL ORDER BY name");
    let there = server.sql_in(
        "fleet",
        "SELECT CAST(c.relname AS text) FROM pg_class AS c JOIN pg_index AS i ON i.indexrelid = c.oid
         WHERE c.relnamespace = CAST('armwatch' AS regnamespace)
               AND NOT EXISTS (SELECT 1 FROM pg_constraint AS k WHERE k.conindid = c.oid)
         ORDER BY c.relname",
    );
    assert_eq!(there, indexes);
}
