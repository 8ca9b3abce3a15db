//! A folder of its own for each test, the real binary, and a look into the database.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{Connection, Row, TypeInfo, ValueRef};

use crate::canon::canonical_dump;

/// Longest wait for something that happens within a second on an idle machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// Views of the public contract, with what orders their rows.
pub const VIEWS: [(&str, &str); 17] = [
    ("temperatures", "run_id, cycle, sensor, joint"),
    ("production_checks", "run_id, cycle, joint"),
    ("runs", "run_id"),
    ("cycles", "run_id, cycle"),
    ("cycle_parameters", "run_id, cycle, joint, parameter"),
    ("cycle_rmsd", "run_id, cycle, joint, stage"),
    ("friction_points", "run_id, cycle, joint, speed_fraction, direction"),
    ("warmup_fits", "robot, run_id, joint, speed_fraction"),
    ("parameter_statistics", "run_id, joint, parameter, \"window\""),
    ("anomalies", "anomaly_id"),
    ("fleet_health", "robot, joint"),
    ("warming_contrast", "run_id, cycle, joint"),
    ("parameter_sets", "parameter_set, joint, parameter"),
    ("parameter_set_sources", "parameter_set, run_id, cycle"),
    ("reestimated_cycles", "estimate, run_id, cycle, seen_by_joint"),
    ("reestimated_parameters", "estimate, run_id, cycle, seen_by_joint, joint, parameter"),
    ("reestimated_statistics", "estimate, run_id, seen_by_joint, joint, parameter, \"window\""),
];

/// A test's own folder with a configuration that watches `inbox` and stores in `armwatch.db`.
pub struct Workshop {
    folder: tempfile::TempDir,
}

impl Workshop {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fs::create_dir(folder.path().join("inbox")).expect("an inbox");
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let config = format!(
            "[watch]\nfolders = [\"inbox\"]\nscan_interval_s = 0.1\nsettle_s = 0.2\n\n[[robot]]\nname = \"*\"\n\
             description = \"{0}/config/robots/er3a.toml\"\nlayout = \"{0}/config/exports/native.toml\"\n",
            root.display()
        );
        fs::write(folder.path().join("armwatch.toml"), config).expect("a configuration");
        Self { folder }
    }

    /// Sets a key of the section `[watch]`.
    pub fn set(&self, key: &str, value: &str) {
        let path = self.path("armwatch.toml");
        let text = fs::read_to_string(&path).expect("the configuration");
        let others: Vec<&str> = text.lines().filter(|line| !line.starts_with(key)).collect();
        let set = others.join("\n").replacen("[watch]", &format!("[watch]\n{key} = {value}"), 1);
        fs::write(path, set + "\n").expect("a configuration");
    }

    /// Describes all robots by another shipped description, such as `scara`.
    pub fn describe(&self, model: &str) {
        let path = self.path("armwatch.toml");
        let text = fs::read_to_string(&path).expect("the configuration");
        fs::write(path, text.replace("er3a.toml", &format!("{model}.toml"))).expect("a configuration");
    }

    /// Takes exports of so many columns, as the simulator names those without signals, as logs of ordinary work of
    /// robots of this description.
    pub fn watch_work(&self, model: &str, columns: usize) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).display();
        let path = self.path("armwatch.toml");
        let text = fs::read_to_string(&path).expect("the configuration");
        let entry = format!(
            "[[robot]]\nname = \"*\"\nfiles = \"*_Col{columns}_*\"\ndescription = \"{root}/config/robots/{model}.toml\"\n\
             layout = \"{root}/config/exports/production.toml\"\n\n[[robot]]"
        );
        fs::write(path, text.replacen("[[robot]]", &entry, 1)).expect("a configuration");
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn inbox(&self, name: &str) -> PathBuf {
        self.path("inbox").join(name)
    }

    /// Copies a reference export into the folder under its own name.
    pub fn add_reference(&self, folder: &str) -> PathBuf {
        let target = self.path(folder).join(REFERENCE_NAME);
        fs::copy(reference(REFERENCE_NAME), &target).expect("a copy");
        target
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_armwatch"));
        command.args(arguments).current_dir(self.folder.path()).env_remove("ARMWATCH_CONFIG");
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("the program starts")
    }

    /// Runs and returns standard output, with exit status `code` asserted.
    pub fn stdout(&self, arguments: &[&str], code: i32) -> String {
        let output = self.run(arguments);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "armwatch {arguments:?}\n{out}\n{err}");
        out
    }

    /// Writes exports with the simulator.
    pub fn simulate(&self, folder: &str, arguments: &[&str]) -> Vec<PathBuf> {
        let all = [&["simulate", "-o", folder, "--truth", "truth"], arguments].concat();
        let out = self.stdout(&all, 0);
        out.lines().map(|line| self.path(line.split(" (").next().expect("a path"))).collect()
    }

    pub fn daemon(&self) -> Daemon {
        let child = self.command(&["run"]).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        Daemon { child: child.expect("the daemon starts") }
    }

    /// As [`Workshop::daemon`], with its log at the end of the file `daemon.log`.
    pub fn daemon_with_log(&self) -> Daemon {
        let log = fs::OpenOptions::new().create(true).append(true).open(self.path("daemon.log"));
        let child = self.command(&["run"]).stdout(Stdio::null()).stderr(log.expect("a log")).spawn();
        Daemon { child: child.expect("the daemon starts") }
    }

    /// What daemons have written into `daemon.log`.
    pub fn log(&self) -> String {
        fs::read_to_string(self.path("daemon.log")).unwrap_or_default()
    }

    /// Rows of a query on `armwatch.db`, each a line with cells separated by `|`.
    pub fn query(&self, sql: &str) -> Vec<String> {
        query(&self.path("armwatch.db"), sql)
    }

    pub fn number(&self, sql: &str) -> i64 {
        self.query(sql).first().and_then(|cell| cell.parse().ok()).unwrap_or(-1)
    }

    /// Waits until a query gives the wanted number.
    pub fn wait_for(&self, sql: &str, wanted: i64) {
        let start = Instant::now();
        loop {
            let found = if self.path("armwatch.db").exists() { self.number(sql) } else { -1 };
            if found == wanted {
                return;
            }
            assert!(start.elapsed() < PATIENCE, "{sql} stays at {found}, wanted {wanted}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until something holds.
    pub fn wait_until(&self, mut holds: impl FnMut() -> bool) {
        let start = Instant::now();
        while !holds() {
            assert!(start.elapsed() < PATIENCE, "it does not come to hold; the log says\n{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until what every robot's history says stands on all of its complete runs.
    pub fn wait_for_conclusions(&self) {
        self.wait_for("SELECT COUNT(*) FROM robot WHERE history <> concluded", 0);
    }

    /// As [`Workshop::dump`], comparable with that of a database that was filled in another order.
    pub fn canonical_dump(&self) -> String {
        canonical_dump(&self.path("armwatch.db"))
    }

    /// Every row of every public view, in a fixed order.
    pub fn dump(&self) -> String {
        self.wait_for_conclusions();
        let mut dump = String::new();
        for (view, order) in VIEWS {
            dump.push_str(&format!("# {view}\n"));
            for row in self.query(&format!("SELECT * FROM {view} ORDER BY {order}")) {
                dump.push_str(&row);
                dump.push('\n');
            }
        }
        dump
    }
}

/// A running daemon, killed when the test ends.
pub struct Daemon {
    pub child: Child,
}

impl Daemon {
    pub fn signal(&self, name: &str) {
        let done = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Waits for the daemon's end and returns its exit status.
    pub fn end(mut self) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status.code();
            }
            assert!(start.elapsed() < PATIENCE, "the daemon does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub const REFERENCE_NAME: &str = "R00_20260105_0847_Col23_20s_cycle5.csv.gz";

pub fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference").join(name)
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub fn query(database: &Path, sql: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new()
            .filename(database)
            .read_only(true)
            .busy_timeout(Duration::from_secs(10));
        let Ok(mut connection) = SqliteConnection::connect_with(&options).await else { return Vec::new() };
        let rows = sqlx::query(sqlx::AssertSqlSafe(sql)).fetch_all(&mut connection).await;
        let rows = match rows {
            Ok(rows) => rows,
            // the daemon may be creating the schema just now
            Err(error) if error.to_string().contains("no such table") => Vec::new(),
            Err(error) => panic!("{sql}: {error}"),
        };
        rows.iter().map(cells).collect()
    })
}

fn cells(row: &SqliteRow) -> String {
    let shown = (0..row.columns().len()).map(|i| {
        let value = row.try_get_raw(i).expect("a cell");
        if value.is_null() {
            return String::new();
        }
        match value.type_info().name() {
            "INTEGER" => row.get::<i64, _>(i).to_string(),
            "REAL" => row.get::<f64, _>(i).to_string(),
            "BLOB" => format!("{:02x?}", row.get::<Vec<u8>, _>(i)),
            _ => row.get::<String, _>(i),
        }
    });
    shown.collect::<Vec<_>>().join("|")
}

/// Asserts that two dumps are alike, and shows the first rows that are not.
pub fn assert_alike(found: &str, expected: &str, of: &str) {
    let differing: Vec<String> = found
        .lines()
        .zip(expected.lines())
        .filter(|(found, expected)| found != expected)
        .take(3)
        .map(|(found, expected)| format!("found    {found}\nexpected {expected}"))
        .collect();
    let lines = [found, expected].map(|dump| dump.lines().count());
    assert!(found == expected, "{of}: {lines:?} lines\n{}", differing.join("\n"));
}
