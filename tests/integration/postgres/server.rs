//! A private PostgreSQL server for tests, and the whole content of a database.

use std::ffi::OsString;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Map, Value};
use sqlx::postgres::PgConnectOptions;
use sqlx::{AssertSqlSafe, Connection, Row};

use crate::support::{Workshop, pass};
use armwatch_store::public_views;

/// Folder of the server's programs: `ARMWATCH_POSTGRES`, or that of Debian's package.
fn programs() -> PathBuf {
    std::env::var_os("ARMWATCH_POSTGRES").unwrap_or_else(|| "/usr/lib/postgresql/15/bin".into()).into()
}

/// A private server, with its files in a temporary folder and a socket there as its only address.
pub struct Server {
    folder: tempfile::TempDir,
    disk: Option<Disk>,
    /// Port of the socket, and of the address of this machine if it listens there.
    port: u16,
    listens: bool,
}

/// A separate file system for the data of a server, which can be filled. A process keeps it mounted.
struct Disk(Child);

impl Disk {
    const MEGABYTES: u32 = 400;

    /// Returns `None` if the machine has no such file system.
    fn mount(at: &Path) -> Option<Self> {
        let script = "mount -t tmpfs -o size=$0m,mode=777 tmpfs \"$1\" && echo there && exec sleep infinity";
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-c", script, &Self::MEGABYTES.to_string()]).arg(at);
        let mut keeper = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().ok()?;
        let mut said = String::new();
        let out = keeper.stdout.take()?;
        BufReader::new(out).read_line(&mut said).ok()?;
        let disk = Self(keeper);
        if said.trim() == "there" { Some(disk) } else { None }
    }

    /// A path for processes outside this file system.
    fn path(&self, path: &Path) -> PathBuf {
        Path::new("/proc")
            .join(self.0.id().to_string())
            .join("root")
            .join(path.strip_prefix("/").expect("from the root"))
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Server {
    /// Returns `None`, with a message on standard error, if the server's programs are not installed.
    pub fn start() -> Option<Self> {
        Self::start_on(false)
    }

    /// Like [`Self::start`], on a file system that can be filled, if the machine has one.
    pub fn start_on_its_own_disk() -> Option<Self> {
        Self::start_on(true)
    }

    fn start_on(own_disk: bool) -> Option<Self> {
        if !programs().join("initdb").exists() {
            eprintln!("skipped: no PostgreSQL in {}", programs().display());
            return None;
        }
        let folder = tempfile::Builder::new().prefix("pg").tempdir_in("/tmp").expect("a folder");
        fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777)).expect("a folder for all");
        let mut server = Self { folder, disk: None, port: 5432, listens: false };
        let data = server.data();
        if own_disk && rustix::process::getuid().is_root() {
            fs::create_dir(data.parent().expect("a folder")).expect("a mount point");
            server.disk = Disk::mount(data.parent().expect("a folder"));
        }
        let data = data.to_str().expect("a path");
        let made = server.program(
            "initdb",
            &["-D", data, "-U", "armwatch", "-A", "trust", "-E", "UTF8", "--locale=C.UTF-8", "-N"],
        );
        assert!(made, "initdb");
        server.control("start");
        server.sql("CREATE DATABASE fleet");
        Some(server)
    }

    pub fn data(&self) -> PathBuf {
        self.folder.path().join("disk/data")
    }

    /// Runs a program of the server, which refuses to run as root.
    fn program(&self, name: &str, arguments: &[&str]) -> bool {
        let program = programs().join(name);
        let of_user = match rustix::process::getuid().is_root() {
            true => {
                vec!["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups"]
            }
            false => Vec::new(),
        };
        let keeper = self.disk.as_ref().map(|disk| disk.0.id().to_string());
        let of_disk = keeper.iter().flat_map(|keeper| ["nsenter", "--mount", "--target", keeper.as_str()]);
        let mut words = of_disk.chain(of_user).map(OsString::from).chain([program.into_os_string()]);
        let mut command = Command::new(words.next().expect("a program"));
        command.args(words);
        command.args(arguments).current_dir(self.folder.path()).stdout(Stdio::null());
        command.status().expect("it starts").success()
    }

    pub fn control(&self, action: &str) {
        assert!(self.try_control(action), "pg_ctl {action}");
    }

    fn try_control(&self, action: &str) -> bool {
        let (data, folder) = (self.data(), self.folder.path().display());
        let addresses = if self.listens { "127.0.0.1" } else { "" };
        let options = format!(
            "-k {folder} -p {} -c listen_addresses='{addresses}' -c fsync=off -c max_connections=60",
            self.port
        );
        let log = self.folder.path().join("log");
        let paths = [data.to_str().expect("a path"), log.to_str().expect("a path")];
        self.program(
            "pg_ctl",
            &["-D", paths[0], "-l", paths[1], "-o", &options, "-m", "immediate", "-w", "-s", action],
        )
    }

    /// Fills the file system of the server for a time; returns `false` if it has no separate one.
    pub fn fill_disk_for(&self, time: Duration) -> bool {
        let Some(disk) = &self.disk else { return false };
        let filler = disk.path(&self.data().with_file_name("filler"));
        let mut file = fs::File::create(&filler).expect("a file");
        let block = vec![0; 1 << 16];
        while file.write_all(&block).is_ok() {}
        pass(time);
        drop(file);
        fs::remove_file(filler).expect("removed");
        // it may have stopped, since it could not write its log
        if !self.try_control("status") {
            self.control("start");
        }
        true
    }

    pub fn fleet(&self) -> String {
        format!("postgres:///fleet?host={}&port={}&user=armwatch", self.folder.path().display(), self.port)
    }

    /// Makes it listen at `localhost`, encrypted, for users with a password. Returns the port and the file of the
    /// authority that signed its certificate; `None`, with a message on standard error, without `openssl`.
    pub fn listen_encrypted(&mut self) -> Option<(u16, PathBuf)> {
        let at = |name: &str| self.folder.path().join(name);
        let certificate = at("ca.crt");
        fs::write(at("names"), "subjectAltName=DNS:localhost\n").expect("a file");
        let made = [
            "req -new -x509 -days 2 -nodes -subj /CN=authority -keyout ca.key -out ca.crt",
            "req -new -nodes -subj /CN=localhost -keyout server.key -out server.csr",
            "x509 -req -in server.csr -CA ca.crt -CAkey ca.key -CAcreateserial -days 2 -extfile names -out server.crt",
        ];
        for words in made {
            let mut command = Command::new("openssl");
            command.args(words.split(' ')).current_dir(self.folder.path()).stderr(Stdio::null());
            if !command.status().is_ok_and(|status| status.success()) {
                eprintln!("skipped: no certificate can be made with openssl");
                return None;
            }
        }
        // separate copies, since the server refuses a key that another user may read
        let data = self.data();
        for name in ["server.key", "server.crt"] {
            let copy = data.join(name);
            fs::copy(at(name), &copy).expect("a copy");
            fs::set_permissions(&copy, fs::Permissions::from_mode(0o600)).expect("private");
            let of = fs::metadata(&data).expect("the data");
            std::os::unix::fs::chown(&copy, Some(of.uid()), Some(of.gid())).expect("the server's");
        }
        let free =
            std::net::TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("a port").port();
        self.control("stop");
        (self.port, self.listens) = (free, true);
        let mut settings =
            fs::OpenOptions::new().append(true).open(data.join("postgresql.conf")).expect("settings");
        writeln!(settings, "ssl = on").expect("written");
        let rules = "local all all trust\nhostssl all all 127.0.0.1/32 scram-sha-256\n";
        fs::write(data.join("pg_hba.conf"), rules).expect("written");
        self.control("start");
        Some((free, certificate))
    }

    /// Rows of a statement in the database `postgres`, one line each.
    pub fn sql(&self, statement: &str) -> Vec<String> {
        self.sql_in("postgres", statement)
    }

    pub fn sql_in(&self, database: &str, statement: &str) -> Vec<String> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let options = PgConnectOptions::new_without_pgpass()
            .socket(self.folder.path())
            .port(self.port)
            .username("armwatch")
            .database(database);
        runtime.block_on(async {
            let mut connection = sqlx::PgConnection::connect_with(&options).await.expect("a connection");
            let rows = sqlx::raw_sql(AssertSqlSafe(statement.to_owned())).fetch_all(&mut connection).await;
            let cell = |row: &sqlx::postgres::PgRow, column: usize| -> String {
                row.try_get::<Option<String>, _>(column).ok().flatten().unwrap_or_default()
            };
            let rows = rows.unwrap_or_else(|error| panic!("{statement}: {error}"));
            let line = |row| (0..Row::len(row)).map(|column| cell(row, column)).collect::<Vec<_>>().join("|");
            rows.iter().map(line).collect()
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // it may have ended already
        self.try_control("stop");
    }
}

/// Columns that depend on the machine, its clock and the path of the exports.
pub const OF_THE_MACHINE: [(&str, &str); 15] = [
    ("runs", "host"),
    ("quarantine", "tries"),
    ("quarantine", "first_at"),
    ("quarantine", "last_at"),
    ("quarantine", "retry_asked_at"),
    ("quarantine", "dismissed_at"),
    ("quarantine", "fault_id"),
    ("anomaly_history", "at"),
    ("baseline_changes", "formed_at"),
    ("baseline_changes", "replaced_at"),
    ("maintenance_log", "recorded_at"),
    ("deliveries", "key"),
    ("deliveries", "due_at"),
    ("conclusion_faults", "first_at"),
    ("conclusion_faults", "last_at"),
];

/// Views of actions of the program and of people, with their times.
pub const OF_DEEDS: [&str; 3] = ["anomaly_history", "baseline_changes", "maintenance_log"];

/// Every row of every public view, in the program's output from a database, with all digits of numbers. Both engines
/// have the same rows after the same exports in the same order.
pub fn dump(workshop: &Workshop, database: &str) -> String {
    rows_of_views(workshop, database, |_, _| true)
}

pub fn rows_of_views(workshop: &Workshop, database: &str, is_told: impl Fn(&str, &str) -> bool) -> String {
    let mut dump = String::new();
    for view in public_views() {
        let name = view.name.as_str();
        // contents depend on the running programs, not on the exports
        if name == "hosts" {
            continue;
        }
        let asked = format!("SELECT * FROM {name}");
        let rows = workshop.stdout(&["sql", "--db", database, "--json", &asked], 0);
        let told = |line: &str| {
            let mut row: Map<String, Value> = serde_json::from_str(line).expect("JSON");
            row.retain(|column, _| !OF_THE_MACHINE.contains(&(name, column)) && is_told(name, column));
            Value::Object(row).to_string()
        };
        let mut rows: Vec<String> = rows.lines().map(told).filter(|row| row != "{}").collect();
        rows.sort_unstable();
        dump.push_str(&format!("# {name}\n{}\n", rows.join("\n")));
    }
    dump
}

/// Like [`dump`], for databases with the same exports in another order: without the numbers of rows, and without
/// actions and their times.
pub fn dump_in_any_order(workshop: &Workshop, database: &str) -> String {
    rows_of_views(workshop, database, |view, column| {
        !OF_DEEDS.contains(&view) && !column.ends_with("_id") && (view, column) != ("baselines", "epoch")
    })
}

pub fn is_made(server: &Server, database: &str) -> bool {
    let there = "SELECT CAST(to_regclass('armwatch.schema_version') IS NOT NULL AS text)";
    server.sql_in(database, there) == ["true"]
}

/// Returns true if a daemon works on a database: it has created the schema, and holds its claim.
pub fn is_open(server: &Server, database: &str) -> bool {
    let claims =
        "SELECT CAST(count(*) AS text) FROM pg_locks AS held JOIN pg_database AS of ON of.oid = held.database
                  WHERE held.locktype = 'advisory' AND held.objsubid = 1 AND of.datname = current_database()";
    is_made(server, database) && server.sql_in(database, claims) == ["1"]
}
