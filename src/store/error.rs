//! Why the database could not be used, as a person can act on it.

use std::path::{Path, PathBuf};

/// Why the database could not be used. Every message names the file and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another writer holds the lock for longer than the busy timeout. Worth another try.
    #[error(
        "database {} stayed locked by another writer ({detail}); try again, or end the other program that writes to it",
        .path.display()
    )]
    Busy {
        /// Database file.
        path: PathBuf,
        /// What SQLite or the pool said.
        detail: String,
    },
    /// The disk is full or fails.
    #[error("disk refused a write or a read of database {} ({detail}); free space there or check the disk", .path.display())]
    Full {
        /// Database file.
        path: PathBuf,
        /// What SQLite said.
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
        /// What the system or SQLite said.
        detail: String,
    },
    /// The file, or what a program has left beside it, cannot be read.
    #[error(
        "cannot read database {} ({detail}); check that this user may read it and the files beside it that end with -wal \
         and -shm, or read a copy of all three",
        .path.display()
    )]
    NotReadable {
        /// Database file.
        path: PathBuf,
        /// What the system or SQLite said.
        detail: String,
    },
    /// A copy for readers would be written over something else.
    #[error("{} is there and no snapshot; name another file, or move this one away", .path.display())]
    NotASnapshot {
        /// The file.
        path: PathBuf,
    },
    /// A backup would be written over something else.
    #[error("{} is left alone ({detail}); name another file, or move this one away", .path.display())]
    NotABackup {
        /// The file.
        path: PathBuf,
        /// What it is.
        detail: String,
    },
    /// A copy for readers, which nothing may write to.
    #[error("{} is a snapshot, which can only be read; name the database that it was made of", .path.display())]
    Snapshot {
        /// The file.
        path: PathBuf,
    },
    /// The file is something else.
    #[error("{} is not an armwatch database ({detail}); name another file, or move this one away", .path.display())]
    NotADatabase {
        /// The file.
        path: PathBuf,
        /// What it is instead.
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
    /// An older program made the schema, and it is only read.
    #[error(
        "database {} has schema {found}, this program {known}; `armwatch run` and `armwatch ingest` bring it up to date",
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
    /// The content is damaged.
    #[error(
        "database {} is damaged ({detail}); move it away and ingest the exports again, or restore a copy",
        .path.display()
    )]
    Corrupt {
        /// Database file.
        path: PathBuf,
        /// What SQLite said.
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
        /// Number of its process, where it has left one.
        process: Option<u32>,
    },
    /// A rule of the schema refuses the values. The database itself is well.
    #[error("database {} refuses these values ({detail}); please report this with the export", .path.display())]
    Refused {
        /// Database file.
        path: PathBuf,
        /// The rule.
        detail: String,
    },
    /// Results were offered for a run that takes none.
    #[error(
        "run {run_id} in database {} is not being stored; it was discarded or quarantined meanwhile, ingest its export again",
        .path.display()
    )]
    RunNotOpen {
        /// Database file.
        path: PathBuf,
        /// Key of the run.
        run_id: i64,
    },
    /// Anything else.
    #[error("database {} failed ({detail}); start again, and check the file with `PRAGMA integrity_check`", .path.display())]
    Other {
        /// Database file.
        path: PathBuf,
        /// What happened.
        detail: String,
    },
}

impl StoreError {
    pub(super) fn not_writable(path: &Path, error: &std::io::Error) -> Self {
        Self::NotWritable { path: path.to_path_buf(), detail: error.to_string() }
    }

    /// Whether no later call will do better: the process should stop. A busy database, refused
    /// values and a run that is gone leave the store usable.
    #[must_use]
    pub fn is_fatal(&self) -> bool {
        !matches!(self, Self::Busy { .. } | Self::Refused { .. } | Self::RunNotOpen { .. })
    }

    /// Puts an error of the driver into the words of this type.
    pub(super) fn from_sqlx(path: &Path, error: &sqlx::Error) -> Self {
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

    /// The same for a migration that failed.
    pub(super) fn from_migrate(path: &Path, error: &sqlx::migrate::MigrateError) -> Self {
        use sqlx::migrate::MigrateError;
        match error {
            MigrateError::Execute(source) | MigrateError::ExecuteMigration(source, _) => {
                Self::from_sqlx(path, source)
            }
            other => Self::NotADatabase { path: path.to_path_buf(), detail: other.to_string() },
        }
    }

    /// Result codes: <https://www.sqlite.org/rescode.html>; the low byte is the primary one.
    fn from_code(path: PathBuf, code: i32, detail: String) -> Self {
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
    fn only_what_leaves_the_store_usable_is_not_fatal() {
        let fatal = |code| StoreError::from_code(PathBuf::new(), code, String::new()).is_fatal();
        assert!(!fatal(5) && !fatal(261) && !fatal(19));
        assert!(fatal(13) && fatal(778) && fatal(11) && fatal(26) && fatal(1));
    }
}
