//! A separate folder for each test, the real binary, and queries of the database.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{Connection, Row, TypeInfo, ValueRef};

use crate::canon;

/// Longest wait for an event that takes less than a second on an idle machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A command that runs this long hangs: the longest of a quick test takes half a minute on an idle machine.
const LONGEST_COMMAND: Duration = Duration::from_secs(600);

/// Time between two checks of a condition.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);

/// Waits until a condition is true, and panics with the text of `missing` if it stays false.
#[track_caller]
pub fn wait_until(mut is_so: impl FnMut() -> bool, missing: impl FnOnce() -> String) {
    let start = Instant::now();
    while !is_so() {
        if start.elapsed() > PATIENCE {
            panic!("after {PATIENCE:?}: {}", missing());
        }
        pass(LOOK_INTERVAL);
    }
}

/// Waits for a time that is part of the scenario: the pace of a writer, the life of a process that is killed. For
/// results, use [`wait_until`].
pub fn pass(time: Duration) {
    thread::sleep(time);
}

/// Log levels of daemons in tests: they include every scan of the folders, so that a test can wait for one.
pub const LOG_LEVELS: &str = "warn,armwatch=trace";

/// A test's folder with a configuration that watches `inbox` and stores in `armwatch.db`.
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

    /// Changes the configuration.
    pub fn configure(&self, change: impl FnOnce(String) -> String) {
        let path = self.path("armwatch.toml");
        let text = fs::read_to_string(&path).expect("the configuration");
        fs::write(path, change(text)).expect("a configuration");
    }

    /// Sets a key of the section `[watch]`.
    pub fn set(&self, key: &str, value: &str) {
        self.configure(|text| {
            let others: Vec<&str> = text.lines().filter(|line| !line.starts_with(key)).collect();
            others.join("\n").replacen("[watch]", &format!("[watch]\n{key} = {value}"), 1) + "\n"
        });
    }

    /// Sets the layout or the description (`key`) of all robots to a file of the folder.
    pub fn use_file(&self, key: &str, file: &str) {
        let own = format!("{key} = \"{file}\"");
        self.configure(|text| {
            let lines = text.lines().map(|line| if line.starts_with(key) { &own } else { line });
            lines.collect::<Vec<_>>().join("\n") + "\n"
        });
    }

    /// Sets another shipped description, such as `scara`, for all robots.
    pub fn describe(&self, model: &str) {
        self.configure(|text| text.replace("er3a.toml", &format!("{model}.toml")));
    }

    /// Configures exports with this number of columns, named as the simulator does without signals, as production logs
    /// of robots of this description.
    pub fn watch_work(&self, model: &str, columns: usize) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).display();
        let entry = format!(
            "[[robot]]\nname = \"*\"\nfiles = \"*_Col{columns}_*\"\ndescription = \"{root}/config/robots/{model}.toml\"\n\
             layout = \"{root}/config/exports/production.toml\"\n\n[[robot]]"
        );
        self.configure(|text| text.replacen("[[robot]]", &entry, 1));
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn inbox(&self, name: &str) -> PathBuf {
        self.path("inbox").join(name)
    }

    /// Copies a reference export into the folder with its original name.
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

    /// Runs to the end; a program that hangs is killed, and its status is then none. Its child processes, which have
    /// its pipes, are killed with it.
    pub fn run(&self, arguments: &[&str]) -> Output {
        let mut command = self.command(arguments);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        let child = command.spawn().expect("the program starts");
        let group = format!("-{}", child.id());
        let (ended, watched) = mpsc::channel::<()>();
        let watch = thread::spawn(move || {
            if watched.recv_timeout(LONGEST_COMMAND) == Err(mpsc::RecvTimeoutError::Timeout) {
                let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            }
        });
        let output = child.wait_with_output().expect("an end");
        drop(ended);
        watch.join().expect("no panic");
        output
    }

    /// Runs and returns standard output, with exit status `code` asserted.
    pub fn stdout(&self, arguments: &[&str], code: i32) -> String {
        self.said(arguments, code)[0].clone()
    }

    /// Runs and returns standard error, with exit status `code` asserted.
    pub fn stderr(&self, arguments: &[&str], code: i32) -> String {
        self.said(arguments, code)[1].clone()
    }

    fn said(&self, arguments: &[&str], code: i32) -> [String; 2] {
        let output = self.run(arguments);
        let [out, err] = [text(&output.stdout), text(&output.stderr)];
        assert_eq!(output.status.code(), Some(code), "armwatch {arguments:?}\n{out}\n{err}");
        [out, err]
    }

    /// Writes exports with the simulator.
    pub fn simulate(&self, folder: &str, arguments: &[&str]) -> Vec<PathBuf> {
        let all = [&["simulate", "-o", folder, "--truth", "truth"], arguments].concat();
        let out = self.stdout(&all, 0);
        out.lines().map(|line| self.path(line.split(" (").next().expect("a path"))).collect()
    }

    /// Starts a daemon that appends its whole log to the file `daemon.log`.
    pub fn daemon(&self) -> Daemon {
        let log = fs::OpenOptions::new().create(true).append(true).open(self.path("daemon.log"));
        let mut command = self.command(&["run"]);
        command.env("ARMWATCH_LOG", LOG_LEVELS).stdout(Stdio::null()).stderr(log.expect("a log"));
        Daemon { child: command.spawn().expect("the daemon starts") }
    }

    /// Times when daemons have ended a scan of their folders, with the rest of the log line.
    fn looks(&self) -> Vec<(Timestamp, String)> {
        let log = self.log();
        let look = |line: &str| {
            let (time, said) = line.split_once(' ')?;
            Some((time.parse().ok()?, said.split_once("scanned the watched folders")?.1.to_owned()))
        };
        log.lines().filter_map(look).collect()
    }

    /// Scans that began after a time: the first that ended after it may have begun before.
    fn looks_since(&self, time: Timestamp) -> Vec<(Timestamp, String)> {
        self.looks().into_iter().filter(|(at, _)| *at > time).skip(1).collect()
    }

    /// Waits until the daemon has scanned the present state of its folders.
    pub fn wait_for_a_look(&self) {
        self.wait_for_looks_over(Duration::ZERO);
    }

    /// Waits until the daemon has scanned the present state of its folders, and again after this time.
    pub fn wait_for_looks_over(&self, time: Duration) {
        let called = Timestamp::now();
        let enough = || {
            let looks = self.looks_since(called);
            let (first, last) = (looks.first(), looks.last());
            first.zip(last).is_some_and(|(first, last)| last.0.duration_since(first.0).unsigned_abs() >= time)
        };
        wait_until(enough, || format!("the daemon does not look\n{}", self.log()));
    }

    /// Waits until the daemon has scanned the present state of its folders and has no work left: every file is read or
    /// cannot be read, and all conclusions are made. No more results of the present files can appear.
    pub fn wait_until_idle(&self) {
        let called = Timestamp::now();
        let idle = |look: &(Timestamp, String)| look.1.ends_with("waiting=0 open=0 to_conclude=0");
        let is_idle = || self.looks_since(called).iter().any(idle);
        wait_until(is_idle, || format!("the daemon does not come to rest\n{}", self.log()));
    }

    /// Content of `daemon.log`.
    pub fn log(&self) -> String {
        fs::read_to_string(self.path("daemon.log")).unwrap_or_default()
    }

    /// Rows of a query on `armwatch.db`, one line each, with cells separated by `|`.
    pub fn query(&self, sql: &str) -> Vec<String> {
        query(&self.path("armwatch.db"), sql)
    }

    pub fn number(&self, sql: &str) -> i64 {
        self.query(sql).first().and_then(|cell| cell.parse().ok()).unwrap_or(-1)
    }

    /// Waits until a query returns the wanted number.
    pub fn wait_for(&self, sql: &str, wanted: i64) {
        let found = || if self.path("armwatch.db").exists() { self.number(sql) } else { -1 };
        wait_until(|| found() == wanted, || format!("{sql} stays at {}, wanted {wanted}", found()));
    }

    /// Waits until a condition is true.
    pub fn wait_until(&self, mut holds: impl FnMut() -> bool) {
        wait_until(&mut holds, || format!("it does not come to hold; the log says\n{}", self.log()));
    }

    /// Waits until the conclusions of every robot include all of its complete runs.
    pub fn wait_for_conclusions(&self) {
        self.wait_for("SELECT COUNT(*) FROM robot WHERE history <> concluded", 0);
    }

    /// Like [`Workshop::dump`], comparable with that of a database that was filled in another order.
    pub fn canonical_dump(&self) -> String {
        canon::canonical_dump(&self.path("armwatch.db"))
    }

    /// Every row of every public view, in a fixed order, after the conclusions are made.
    pub fn dump(&self) -> String {
        self.wait_for_conclusions();
        canon::dump(&self.path("armwatch.db"))
    }
}

/// A running daemon, killed when the test ends.
pub struct Daemon {
    pub child: Child,
}

impl Daemon {
    pub fn signal(&self, name: &str) {
        #[cfg(target_os = "linux")]
        if ["TERM", "INT", "HUP"].contains(&name) {
            wait_until(|| self.catches(name), || format!("the daemon does not come to catch SIG{name}"));
        }
        let done = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Returns true if the daemon already catches a signal, or has ended; before that the signal kills it.
    #[cfg(target_os = "linux")]
    fn catches(&self, signal: &str) -> bool {
        let Ok(status) = fs::read_to_string(format!("/proc/{}/status", self.child.id())) else { return true };
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        let caught = field("SigCgt:").and_then(|mask| u64::from_str_radix(mask, 16).ok()).unwrap_or(0);
        let number = match signal {
            "HUP" => 1,
            "INT" => 2,
            _ => 15,
        };
        caught & (1 << (number - 1)) != 0 || field("State:").is_some_and(|state| state.starts_with('Z'))
    }

    /// Ends the daemon as a service manager does.
    pub fn stop(self) {
        self.signal("TERM");
        assert_eq!(self.end(), Some(0));
    }

    /// Waits for the daemon's end and returns its exit status.
    pub fn end(mut self) -> Option<i32> {
        end_of(&mut self.child, || "the daemon does not end".to_owned())
    }

    /// Waits until the daemon has read a growing file to its present end.
    #[cfg(target_os = "linux")]
    pub fn wait_until_read(&self, path: &Path) {
        let length = || fs::metadata(path).map_or(0, |metadata| metadata.len());
        let position = || self.position(path);
        wait_until(
            || position() == Some(length()),
            || format!("{} is read to {:?} of {}", path.display(), position(), length()),
        );
    }

    /// Position of the daemon in a file that it reads.
    #[cfg(target_os = "linux")]
    fn position(&self, path: &Path) -> Option<u64> {
        let process = PathBuf::from(format!("/proc/{}", self.child.id()));
        let wanted = path.canonicalize().ok()?;
        let files = fs::read_dir(process.join("fd")).ok()?.flatten();
        let of_path = files.filter(|file| fs::read_link(file.path()).is_ok_and(|target| target == wanted));
        let position = |file: fs::DirEntry| {
            let told = fs::read_to_string(process.join("fdinfo").join(file.file_name())).ok()?;
            told.lines().find_map(|line| line.strip_prefix("pos:")?.trim().parse().ok())
        };
        of_path.filter_map(position).max()
    }

    /// On other systems the position is unknown: waits longer than two scans of a growing file take.
    #[cfg(not(target_os = "linux"))]
    pub fn wait_until_read(&self, _path: &Path) {
        pass(Duration::from_millis(500));
    }
}

/// Waits for the end of a process and returns its exit status.
pub fn end_of(child: &mut Child, missing: impl FnOnce() -> String) -> Option<i32> {
    let mut status = None;
    let mut has_ended = || {
        status = child.try_wait().expect("a child");
        status.is_some()
    };
    wait_until(&mut has_ended, missing);
    status.and_then(|status| status.code())
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

/// Peak memory of a process so far, kB; `None` if it has ended.
pub fn peak_kb(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().trim_end_matches(" kB").parse().ok()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Rows of a statement, as text. None if there is no database yet, or if one is being created. After a daemon was
/// killed, a database may briefly fail to open.
pub fn query(database: &Path, sql: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let mut answer = None;
    let failure = std::cell::RefCell::new(String::new());
    wait_until(
        || {
            if std::fs::metadata(database).map_or(true, |file| file.len() == 0) {
                answer = Some(Vec::new());
                return true;
            }
            match runtime.block_on(rows_of(database, sql)) {
                Ok(rows) => answer = Some(rows),
                // the daemon may be creating the schema
                Err(error) if error.to_string().contains("no such table") => answer = Some(Vec::new()),
                Err(error) => *failure.borrow_mut() = error.to_string(),
            }
            answer.is_some()
        },
        || format!("{}: {sql}: {}", database.display(), failure.borrow()),
    );
    answer.unwrap_or_default()
}

async fn rows_of(database: &Path, sql: &str) -> Result<Vec<String>, sqlx::Error> {
    let options =
        SqliteConnectOptions::new().filename(database).read_only(true).busy_timeout(Duration::from_secs(10));
    let mut connection = SqliteConnection::connect_with(&options).await?;
    let rows = sqlx::query(sqlx::AssertSqlSafe(sql)).fetch_all(&mut connection).await?;
    Ok(rows.iter().map(cells).collect())
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

/// Asserts that two dumps are equal; otherwise shows the views with another number of rows, and the first differing
/// rows.
pub fn assert_alike(found: &str, expected: &str, of: &str) {
    let differing: Vec<String> = found
        .lines()
        .zip(expected.lines())
        .filter(|(found, expected)| found != expected)
        .take(3)
        .map(|(found, expected)| format!("found    {found}\nexpected {expected}"))
        .collect();
    let (rows, wanted) = (rows_by_view(found), rows_by_view(expected));
    let views: Vec<String> = wanted
        .iter()
        .filter(|(view, rows_wanted)| rows.get(*view) != Some(rows_wanted))
        .map(|(view, wanted)| format!("{view}: {} of {wanted} rows", rows.get(view).copied().unwrap_or(0)))
        .collect();
    assert!(found == expected, "{of}: {views:?}\n{}", differing.join("\n"));
}

/// Rows of each view of a dump.
fn rows_by_view(dump: &str) -> BTreeMap<&str, usize> {
    let mut rows = BTreeMap::new();
    let mut view = "";
    for line in dump.lines() {
        match line.strip_prefix("# ") {
            Some(next) => view = next,
            None => *rows.entry(view).or_default() += usize::from(!line.is_empty()),
        }
    }
    rows
}

/// Questions of `examples/questions.sql`, each with its statement.
pub fn example_questions() -> Vec<(String, String)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/questions.sql");
    let text = fs::read_to_string(path).expect("the example questions");
    let sections = text.split("\n-- ## ").skip(1);
    let questions = sections.filter_map(|section| section.split_once(";\n")?.0.split_once('\n'));
    questions.map(|(question, statement)| (question.to_owned(), statement.to_owned())).collect()
}

/// Words of a command line as in a shell; text between double quotes is one word.
pub fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (place, part) in line.split('"').enumerate() {
        match place % 2 {
            0 => words.extend(part.split_whitespace().map(str::to_owned)),
            _ => words.push(part.to_owned()),
        }
    }
    words
}
