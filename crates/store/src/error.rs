//! Errors of the database, each with a remedy.

use std::path::{Path, PathBuf};

use super::engine::sqlstate::{ServerFault, fault_of};
use armwatch_config::is_on_server;

/// An error of the database. Every message names the file and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another writer holds the lock for longer than the busy timeout. The caller can try again.
    #[error(
        "database {} stayed locked by another writer ({detail}); try again, or end the other program that writes to it",
        .path.display()
    )]
    Busy {
        /// Database file.
        path: PathBuf,
        /// Message of SQLite or the pool.
        detail: String,
    },
    /// The disk is full or fails.
    #[error("disk refused a write or a read of database {} ({detail}); free space there or check the disk", .path.display())]
    Full {
        /// Database file.
        path: PathBuf,
        /// Message of SQLite.
        detail: String,
    },
    /// The file or its folder cannot be created, opened or written.
    #[error(
        "cannot open or write database {} ({detail}); check that its folder exists, is a folder and may be written, \
         or name another file",
        .path.display()
    )]
    NotWritable {
        /// Database file.
        path: PathBuf,
        /// Message of the system or SQLite.
        detail: String,
    },
    /// The file, or a file that a program has left next to it, cannot be read.
    #[error(
        "cannot read database {} ({detail}); check that this user may read it and the files next to it that \
        end with -wal and -shm, or read a copy of all three",
        .path.display()
    )]
    NotReadable {
        /// Database file.
        path: PathBuf,
        /// Message of the system or SQLite.
        detail: String,
    },
    /// A snapshot would overwrite something else.
    #[error("{} exists and is not a snapshot; name another file, or move this one away", .path.display())]
    NotASnapshot {
        /// The file.
        path: PathBuf,
    },
    /// A backup would overwrite something else.
    #[error("{} is not changed ({detail}); name another file, or move this one away", .path.display())]
    NotABackup {
        /// The file.
        path: PathBuf,
        /// Actual kind of the file.
        detail: String,
    },
    /// The file is a snapshot, which is read-only.
    #[error("{} is a snapshot, which can only be read; name its source database", .path.display())]
    Snapshot {
        /// The file.
        path: PathBuf,
    },
    /// The file is a snapshot, but the operation needs the factors of cycles.
    #[error(
        "{} is a snapshot, a copy for readers without the factors of cycles, so that {without}; name its \
        source database with --db",
        .path.display()
    )]
    NoFactorsInSnapshot {
        /// The file.
        path: PathBuf,
        /// The operation that is impossible without them.
        without: &'static str,
    },
    /// The path of the database is a folder.
    #[error("{} is a folder, not a database; name the file in it, such as {}", .path.display(), .path.join("armwatch.db").display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The file is not a database of armwatch.
    #[error("{} is not an armwatch database ({detail}); name another file, or move this one away", .path.display())]
    NotADatabase {
        /// The file.
        path: PathBuf,
        /// Actual kind of the file.
        detail: String,
    },
    /// A newer program made the schema.
    #[error(
        "database {} has schema {found}, this program knows up to {known}; use the newer program, or name another file",
        .path.display()
    )]
    Newer {
        /// Database file.
        path: PathBuf,
        /// Schema version of the file.
        found: i64,
        /// Latest schema version of this program.
        known: i64,
    },
    /// An older program made the schema, and the database is open read-only.
    #[error(
        "database {} has schema {found}, this program {known}; `armwatch run` and `armwatch ingest` upgrade it",
        .path.display()
    )]
    Older {
        /// Database file.
        path: PathBuf,
        /// Schema version of the file.
        found: i64,
        /// Schema version of this program.
        known: i64,
    },
    /// The schema is too old to be upgraded.
    #[error(
        "database {} has schema {found}, and this program upgrades schemas from {oldest}; open it once with \
        a program that has schema 50, or move it away and ingest the exports again",
        .path.display()
    )]
    TooOld {
        /// Database file.
        path: PathBuf,
        /// Schema version of the file.
        found: i64,
        /// Oldest schema version that can be upgraded.
        oldest: i64,
    },
    /// The content is damaged.
    #[error(
        "database {} is damaged ({detail}); move it away and ingest the exports again, or restore a copy",
        .path.display()
    )]
    Corrupt {
        /// Database file.
        path: PathBuf,
        /// Message of SQLite.
        detail: String,
    },
    /// The open database is no longer the file at its path.
    #[error(
        "database {} was moved, deleted or replaced while it was open ({detail}); nothing more is stored: \
        restore it or a backup and start again, and stop every program that uses a database before you move or \
        restore it",
        .path.display()
    )]
    Displaced {
        /// Database file.
        path: PathBuf,
        /// The file, and what happened to it.
        detail: String,
    },
    /// The write-ahead log next to a database belongs to another database.
    #[error(
        "{} belongs to another database than {}, as after a restore: delete it and {}-shm, or move them away, and start again",
        .log.display(), .path.display(), .path.display()
    )]
    ForeignLog {
        /// Database file.
        path: PathBuf,
        /// The log.
        log: PathBuf,
    },
    /// The lock file of the daemon cannot be opened.
    #[error(
        "cannot open the lock file {} of database {} ({detail}); give it to the user of the daemon with `chown`, or delete it \
         while no daemon runs",
        .lock.display(), .path.display()
    )]
    LockFile {
        /// Database file.
        path: PathBuf,
        /// The lock file next to it.
        lock: PathBuf,
        /// Message of the system.
        detail: String,
    },
    /// Another daemon works on the database.
    #[error(
        "another armwatch daemon{} works on database {}; stop it first, or name another database",
        .process.map(|number| format!(" (process {number})")).unwrap_or_default(), .path.display()
    )]
    Claimed {
        /// Database file.
        path: PathBuf,
        /// Number of its process, if known.
        process: Option<u32>,
    },
    /// Another daemon of this host, or one without a name, works on a database on a server.
    #[error(
        "another armwatch daemon{} works on database {}; stop it first, or give each daemon its own name \
        with `armwatch run --host NAME`",
        if .host.is_empty() { String::new() } else { format!(" called {host}") }, .path.display()
    )]
    HostAtWork {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Name of the daemon; empty for one without a name.
        host: String,
    },
    /// The lease of this program has ended, and other daemons have claimed its work. The caller can try again.
    #[error(
        "the lease of this program on database {} has ended, and others have taken over its work; it \
        continues automatically; raise lease_s under [cluster] if this happens often",
        .path.display()
    )]
    LeaseEnded {
        /// Address of the database, without a password.
        path: PathBuf,
    },
    /// A rule of the schema refuses the values. The database itself is intact.
    #[error("database {} refuses these values ({detail}); please report this with the export", .path.display())]
    Refused {
        /// Database file.
        path: PathBuf,
        /// The rule.
        detail: String,
    },
    /// Results were offered for a run that accepts none.
    #[error(
        "run {run_id} in database {} is not being stored; it was discarded or quarantined in the meantime; \
        ingest its export again",
        .path.display()
    )]
    RunNotOpen {
        /// Database file.
        path: PathBuf,
        /// Key of the run.
        run_id: i64,
    },
    /// The server of the database does not answer, or has ended the connection. The caller can try again.
    #[error(
        "no server answers for database {} ({detail}); check that it runs at that host and port, accepts \
        connections from this computer (listen_addresses, pg_hba.conf), and that no firewall is between",
        .path.display()
    )]
    Unreachable {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Message of the system or the server.
        detail: String,
    },
    /// The server refuses the login.
    #[error(
        "the server refuses the user of {} ({detail}); check name and password (in the address, in \
        ~/.pgpass or in PGPASSWORD), and the server's pg_hba.conf",
        .path.display()
    )]
    Login {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Message of the server.
        detail: String,
    },
    /// The server presents a certificate that this program does not accept.
    #[error(
        "the certificate of the server of {} is not accepted ({detail}); name the file of the authority that signed it with \
         sslrootcert=FILE in the address, and the server as its certificate names it",
        .path.display()
    )]
    Certificate {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Fault of the certificate.
        detail: String,
    },
    /// The server has no such database.
    #[error("database {} does not exist ({detail}); create it with `createdb --encoding UTF8`", .path.display())]
    NoDatabase {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Message of the server.
        detail: String,
    },
    /// The user lacks a right.
    #[error(
        "the user of {} may not do this ({detail}); the first start needs `GRANT CREATE ON DATABASE`, or an empty schema \
         armwatch that this user may create in, and tables are written by the user that made them",
        .path.display()
    )]
    Rights {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Message of the server.
        detail: String,
    },
    /// The server is older than the schema requires.
    #[error(
        "the server of database {} is PostgreSQL {version}, which is too old; use 13 or later, tested with 15",
        .path.display()
    )]
    ServerTooOld {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Version that the server reports.
        version: String,
    },
    /// The address is malformed.
    #[error(
        "the address {} is not valid ({detail}); write it as postgres://user@host:5432/name",
        .path.display()
    )]
    Address {
        /// The address, without a password.
        path: PathBuf,
        /// Fault of the address.
        detail: String,
    },
    /// Only the programs of the server perform the operation.
    #[error("the server is responsible for {what} of database {}; {instead}", .path.display())]
    OnServer {
        /// Address of the database, without a password.
        path: PathBuf,
        /// The operation.
        what: &'static str,
        /// How to do it on the server.
        instead: String,
    },
    /// Any other error of a server.
    #[error("database {} failed ({detail}); start again, and read the log of the server", .path.display())]
    Server {
        /// Address of the database, without a password.
        path: PathBuf,
        /// Message of the server.
        detail: String,
    },
    /// Any other error.
    #[error("database {} failed ({detail}); start again, and check the file with `PRAGMA integrity_check`", .path.display())]
    Other {
        /// Database file.
        path: PathBuf,
        /// Message of the driver.
        detail: String,
    },
}

impl StoreError {
    pub(super) fn not_writable(path: &Path, error: &std::io::Error) -> Self {
        Self::NotWritable { path: path.to_path_buf(), detail: error.to_string() }
    }

    /// Returns true if no later call can succeed, so that the process should stop. The store stays usable after a busy
    /// database, a server that does not answer, refused values or a run that is gone.
    pub fn is_fatal(&self) -> bool {
        !matches!(
            self,
            Self::Busy { .. }
                | Self::Unreachable { .. }
                | Self::Refused { .. }
                | Self::RunNotOpen { .. }
                | Self::LeaseEnded { .. }
        )
    }

    /// Converts an error of the driver.
    pub(super) fn from_sqlx(path: &Path, error: &sqlx::Error) -> Self {
        if is_on_server(path) {
            return Self::of_server(path, error);
        }
        let path = path.to_path_buf();
        let detail = error.to_string();
        match error {
            sqlx::Error::Database(database) => {
                let code = database.code().and_then(|code| code.parse().ok()).unwrap_or(0);
                Self::from_code(path, code, database.to_string())
            }
            sqlx::Error::PoolTimedOut => Self::Busy { path, detail },
            sqlx::Error::Io(io) if io.kind() == std::io::ErrorKind::StorageFull => {
                Self::Full { path, detail }
            }
            sqlx::Error::Io(_) => Self::NotWritable { path, detail },
            sqlx::Error::Encode(_) => Self::Refused { path, detail },
            sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. } | sqlx::Error::RowNotFound => {
                Self::Corrupt { path, detail }
            }
            _ => Self::Other { path, detail },
        }
    }

    /// Converts an error of the driver for a database on a server.
    fn of_server(path: &Path, error: &sqlx::Error) -> Self {
        let path = path.to_path_buf();
        let detail = match error {
            sqlx::Error::Database(error) => error.message().to_owned(),
            error => error.to_string(),
        };
        match (fault_of(error), error) {
            (Some(ServerFault::Busy | ServerFault::Cancelled), _) => Self::Busy { path, detail },
            (None, sqlx::Error::Io(io)) if io.to_string().contains("peer certificate") => {
                Self::Certificate { path, detail: io.to_string() }
            }
            (Some(ServerFault::Unreachable), _)
            | (None, sqlx::Error::Io(_) | sqlx::Error::PoolTimedOut | sqlx::Error::BeginFailed) => {
                Self::Unreachable { path, detail }
            }
            (Some(ServerFault::Login), _) => Self::Login { path, detail },
            (Some(ServerFault::NoDatabase), _) => Self::NoDatabase { path, detail },
            (Some(ServerFault::Rights), _) => Self::Rights { path, detail },
            (Some(ServerFault::Full), _) => Self::Full { path, detail },
            (Some(ServerFault::Refused), _) | (None, sqlx::Error::Encode(_)) => {
                Self::Refused { path, detail }
            }
            (Some(ServerFault::Corrupt), _)
            | (None, sqlx::Error::Decode(_) | sqlx::Error::ColumnDecode { .. } | sqlx::Error::RowNotFound) => {
                Self::Corrupt { path, detail }
            }
            (None, sqlx::Error::Configuration(_) | sqlx::Error::Tls(_)) => Self::Address { path, detail },
            _ => Self::Server { path, detail },
        }
    }

    /// Converts an error of the blocking driver.
    pub(super) fn from_rusqlite(path: &Path, error: &rusqlite::Error) -> Self {
        let code = error.sqlite_error().map_or(0, |of| of.extended_code);
        Self::from_code(path.to_path_buf(), code, error.to_string())
    }

    /// Result codes: <https://www.sqlite.org/rescode.html>; the low byte is the primary one.
    pub(super) fn from_code(path: PathBuf, code: i32, detail: String) -> Self {
        match code & 0xff {
            5 | 6 => Self::Busy { path, detail },
            10 | 13 => Self::Full { path, detail },
            3 | 8 | 14 | 23 => Self::NotWritable { path, detail },
            11 => Self::Corrupt { path, detail },
            19 | 20 => Self::Refused { path, detail },
            26 => Self::NotADatabase { path, detail },
            _ => Self::Other { path, detail },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_names_the_file_and_a_remedy() {
        let path = Path::new("/data/fleet.db");
        for code in [5, 6, 10, 778, 13, 8, 14, 11, 19, 787, 26, 1] {
            let error = StoreError::from_code(path.to_path_buf(), code, "cause".into());
            let message = error.to_string();
            assert!(message.contains("/data/fleet.db") && message.contains("cause"), "{code}: {message}");
            assert!(message.contains(';'), "no remedy for {code}: {message}");
        }
    }

    #[test]
    fn every_message_of_a_server_names_the_address_and_a_remedy() {
        let path = || PathBuf::from("postgres://armwatch@db/fleet");
        let detail = || "cause".to_owned();
        for error in [
            StoreError::Unreachable { path: path(), detail: detail() },
            StoreError::Login { path: path(), detail: detail() },
            StoreError::Certificate { path: path(), detail: detail() },
            StoreError::NoDatabase { path: path(), detail: detail() },
            StoreError::Rights { path: path(), detail: detail() },
            StoreError::ServerTooOld { path: path(), version: "12.1, which causes".into() },
            StoreError::Address { path: path(), detail: detail() },
            StoreError::OnServer { path: path(), what: "a backup", instead: detail() },
            StoreError::Server { path: path(), detail: detail() },
        ] {
            let message = error.to_string();
            assert!(
                message.contains("postgres://armwatch@db/fleet") && message.contains("cause"),
                "{message}"
            );
            assert!(message.contains(';'), "no remedy: {message}");
            assert_eq!(error.is_fatal(), !matches!(error, StoreError::Unreachable { .. }), "{message}");
        }
    }

    #[test]
    fn only_what_leaves_the_store_usable_is_not_fatal() {
        let fatal = |code| StoreError::from_code(PathBuf::new(), code, String::new()).is_fatal();
        assert!(!fatal(5) && !fatal(261) && !fatal(19));
        assert!(fatal(13) && fatal(778) && fatal(11) && fatal(26) && fatal(1));
    }
}
