//! Opening a database: its identity and schema, and the settings of its connections.

use std::fs::File;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use sqlx::sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection};

use super::claim::lock_file_of;
use super::engine::{
    Dialect, EngineConnectOptions, EngineConnection, EnginePool, EnginePoolOptions, catalog,
};
use super::error::StoreError;
use super::handle::Store;
use super::open_files::OpenFiles;
use super::own_host::OwnHost;
use super::schema::latest_schema;
use super::schema::on_file::{migrate, refuse_too_old, version};
use super::verified_copy::{APPLICATION_ID, SNAPSHOT};
use super::{descriptor, server, small_blocks, view_columns, write_ahead_log};
use armwatch_config::{ClusterSettings, foreign_scheme, is_on_server, shown_database};
use armwatch_model::run::FileId;

/// Longest wait of a write for another process: longer than any transaction of this program, shorter than a person
/// waits for an answer.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Pause before the journal mode is set again; another program holds that lock for milliseconds.
const LOCK_RETRY: Duration = Duration::from_millis(20);

/// Time limit of a query about the database's health.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Number of concurrent readers. A command and a page each run a few queries, and every connection keeps a thread and a
/// page cache of about 2 MB.
const READERS: u32 = 4;

/// Size of the write-ahead log after a burst: it shrinks to this.
const LOG_LIMIT_BYTES: &str = "67108864";

impl Store {
    /// Opens the database at `path`, a file or the address of a server. Creates it, and the folder of a file, if it is
    /// missing, and upgrades its schema.
    ///
    /// # Errors
    /// [`StoreError::NotADatabase`], [`StoreError::Newer`], [`StoreError::NotWritable`] and others; a refused file
    /// stays unchanged.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_as(path, &ClusterSettings::default()).await
    }

    /// Like [`Store::open`], as one of several daemons on a server. A file has one daemon.
    ///
    /// # Errors
    /// Those of [`Store::open`].
    pub async fn open_as(path: &Path, cluster: &ClusterSettings) -> Result<Self, StoreError> {
        if is_on_server(path) {
            return server::open(path, cluster, BUSY_TIMEOUT).await;
        }
        refuse_address(path)?;
        open(path, BUSY_TIMEOUT).await
    }

    /// Opens the database at `path` for reading. Nothing is created or changed, and writing fails. `None` if there is
    /// no database.
    ///
    /// # Errors
    /// Those of [`Store::open`], [`StoreError::NotReadable`], and [`StoreError::Older`] for an outdated schema.
    pub async fn open_existing(path: &Path) -> Result<Option<Self>, StoreError> {
        Self::open_existing_as(path, &ClusterSettings::default()).await
    }

    /// Like [`Store::open_existing`], on one of several hosts; `cluster` determines which files are on this host.
    ///
    /// # Errors
    /// Those of [`Store::open_existing`].
    pub async fn open_existing_as(
        path: &Path,
        cluster: &ClusterSettings,
    ) -> Result<Option<Self>, StoreError> {
        if is_on_server(path) {
            return server::open_existing(path, cluster, BUSY_TIMEOUT).await;
        }
        refuse_address(path)?;
        open_existing(path, latest_schema()).await
    }

    /// Like [`Store::open_existing_as`], but accepts the schema of an earlier version: for [`Store::backup`] and
    /// [`Store::damages`], which do not depend on it.
    ///
    /// # Errors
    /// Those of [`Store::open_existing`], except [`StoreError::Older`].
    pub async fn open_any_schema(path: &Path, cluster: &ClusterSettings) -> Result<Option<Self>, StoreError> {
        if is_on_server(path) {
            return server::open_existing(path, cluster, BUSY_TIMEOUT).await;
        }
        refuse_address(path)?;
        open_existing(path, 0).await
    }

    /// A separate handle for reading: its readers do not compete with those of this handle. `None` if the file is gone.
    ///
    /// # Errors
    /// Those of [`Store::open_existing`].
    pub async fn open_for_looking(&self) -> Result<Option<Self>, StoreError> {
        self.check_files()?;
        match self.dialect() {
            Dialect::Sqlite => open_existing(&self.path, latest_schema()).await,
            Dialect::Postgres => server::open_again(self, BUSY_TIMEOUT).await,
        }
    }

    /// A number that changes when another connection has committed. It is only comparable with earlier numbers of the
    /// same handle.
    pub async fn data_version(&self) -> Result<i64, StoreError> {
        self.checked(catalog::data_version(&self.probe).await)
    }

    /// Syncs all commits to the disk, so that they survive a loss of power. For speed, a commit alone is written to the
    /// log and not synced.
    ///
    /// # Errors
    /// [`StoreError::NotWritable`] if the disk refuses, [`StoreError::Displaced`].
    pub async fn sync(&self) -> Result<(), StoreError> {
        match self.dialect() {
            Dialect::Sqlite => {
                self.check_files()?;
                write_ahead_log::sync(&self.path).await?;
                // the files at these paths were synced; check that they contain the commits
                self.check_files()
            }
            // a server syncs with each commit, unless its administrator has configured otherwise
            Dialect::Postgres => Ok(()),
        }
    }
}

/// Opens, creates and migrates; see [`Store::open`].
pub(super) async fn open(path: &Path, busy_timeout: Duration) -> Result<Store, StoreError> {
    // Absolute, so that SQLite cannot interpret the name as ":memory:" or as an address.
    refuse_folder(path)?;
    let path: Arc<Path> = std::path::absolute(path).map_err(|e| StoreError::not_writable(path, &e))?.into();
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| StoreError::not_writable(&path, &e))?;
    }
    let options = SqliteConnectOptions::new()
        .filename(&path)
        .busy_timeout(busy_timeout)
        .foreign_keys(true)
        .disable_statement_logging();
    small_blocks::refuse_full(&path, small_blocks::LEAST_TO_WRITE_BYTES)?;
    let (found, is_snapshot) = inspect(&path, &options).await?;
    if found > 0 {
        refuse_too_old(&path, found)?;
    }
    if is_snapshot {
        return Err(StoreError::Snapshot { path: path.to_path_buf() });
    }
    if !path.exists() {
        say_new(&path);
    }
    let opened = make_file(&path).map_err(|e| StoreError::not_writable(&path, &e))?;

    let mut writing = options.clone().create_if_missing(true);
    if found == 0 {
        // `armwatch prune` can then free space while others work. In a file with tables the pragma would have no effect
        // and be written at every opening.
        writing = writing.auto_vacuum(SqliteAutoVacuum::Incremental);
    }
    let writing = writing
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Normal)
        .pragma("journal_size_limit", LOG_LIMIT_BYTES);
    let writer = writer_pool(&path, writing, busy_timeout).await?;
    let is_older = found > 0 && found < latest_schema();
    migrate(&path, &writer).await?;
    view_columns::fill(&writer).await.map_err(|e| StoreError::from_sqlx(&path, &e))?;
    if is_older {
        tracing::info!(path = %path.display(), schema = latest_schema(), "the schema of the database is up to date");
    }
    let probe = probe(options.clone());
    let readers = pool(READERS, options.read_only(true), busy_timeout)
        .await
        .map_err(|e| StoreError::from_sqlx(&path, &e))?;
    // a reader that has the log open keeps it, even if the writer's connection closes
    let read = sqlx::query("SELECT count(*) FROM sqlite_schema").execute(&readers).await;
    read.map_err(|e| StoreError::from_sqlx(&path, &e))?;
    small_blocks::reserve(&path)?;
    let files = Some(Arc::new(OpenFiles::at(&path, opened)?));
    Ok(Store {
        path,
        writer,
        readers,
        probe,
        is_read_only: false,
        is_snapshot: false,
        files,
        own_host: OwnHost::none(&ClusterSettings::default()),
    })
}

/// Creates an empty file if there is none, and returns the number of the file that SQLite will open.
fn make_file(path: &Path) -> std::io::Result<FileId> {
    const MODE_OF_SQLITE: u32 = 0o644;
    if !path.try_exists()? {
        File::options().create(true).append(true).mode(MODE_OF_SQLITE).open(path)?;
    }
    descriptor::of(path)?.metadata().map(|metadata| descriptor::id_of(&metadata))
}

/// Opens an existing database for reading only; see [`Store::open_existing`].
async fn open_existing(path: &Path, oldest: i64) -> Result<Option<Store>, StoreError> {
    if std::fs::metadata(path).map_or(true, |metadata| metadata.is_file() && metadata.len() == 0) {
        return Ok(None);
    }
    refuse_folder(path)?;
    let path: Arc<Path> = std::path::absolute(path).map_err(|e| StoreError::not_writable(path, &e))?.into();
    small_blocks::refuse_full(&path, small_blocks::LEAST_TO_READ_BYTES)?;
    let mut options = reading(&path);
    let found = match inspect(&path, &options).await {
        // SQLite creates files next to a database even to read it. If that is forbidden and no program has the database
        // open, the file alone is complete.
        Err(StoreError::NotWritable { .. }) if !write_ahead_log::has_commits(&path) => {
            options = options.immutable(true);
            inspect(&path, &options).await
        }
        found => found,
    };
    let (found, is_snapshot) = found.map_err(|error| match error {
        StoreError::NotWritable { path, detail } => StoreError::NotReadable { path, detail },
        error => error,
    })?;
    if found < oldest {
        refuse_too_old(&path, found)?;
        return Err(StoreError::Older { path: path.to_path_buf(), found, known: latest_schema() });
    }
    let probe = probe(options.clone());
    let readers = pool(READERS, options, BUSY_TIMEOUT).await.map_err(|e| StoreError::from_sqlx(&path, &e))?;
    Ok(Some(Store {
        path,
        writer: readers.clone(),
        readers,
        probe,
        is_read_only: true,
        is_snapshot,
        files: None,
        own_host: OwnHost::none(&ClusterSettings::default()),
    }))
}

/// Refuses an address of anything except PostgreSQL, which would become a file name, possibly with a password in it.
fn refuse_address(path: &Path) -> Result<(), StoreError> {
    foreign_scheme(path).map_or(Ok(()), |scheme| {
        let detail = format!("it is an address of {scheme}");
        Err(StoreError::Address { path: shown_database(path).into(), detail })
    })
}

fn refuse_folder(path: &Path) -> Result<(), StoreError> {
    match path.is_dir() {
        true => Err(StoreError::Folder { path: path.to_path_buf() }),
        false => Ok(()),
    }
}

fn reading(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .busy_timeout(BUSY_TIMEOUT)
        .read_only(true)
        .disable_statement_logging()
}

/// The writer. Converting a new file's journal to a write-ahead log needs an exclusive lock, and SQLite does not wait
/// for it: if two programs start on a new file, one has to try again.
async fn writer_pool(
    path: &Path,
    options: SqliteConnectOptions,
    busy_timeout: Duration,
) -> Result<EnginePool, StoreError> {
    let deadline = Instant::now() + busy_timeout;
    loop {
        let opened = pool(1, options.clone(), busy_timeout).await;
        match opened.map_err(|e| StoreError::from_sqlx(path, &e)) {
            Err(StoreError::Busy { .. }) if Instant::now() < deadline => tokio::time::sleep(LOCK_RETRY).await,
            outcome => return outcome,
        }
    }
}

async fn pool(
    connections: u32,
    options: SqliteConnectOptions,
    busy_timeout: Duration,
) -> sqlx::Result<EnginePool> {
    EnginePoolOptions::new()
        .max_connections(connections)
        // A request to the pool may have to wait for one that waits for another process.
        .acquire_timeout(3 * busy_timeout)
        // A connection to a file does not go stale; reopening would only lose its prepared statements.
        .idle_timeout(None)
        .max_lifetime(None)
        // SQLite ends a transaction when the disk fails under it. The connection cannot end it again, counts it as open
        // forever and would refuse the next transaction with a message that mentions no disk.
        .before_acquire(|connection, _| Box::pin(async { Ok(!connection.is_in_transaction()) }))
        .connect_with(EngineConnectOptions::Sqlite(options))
        .await
}

/// A separate reader, opened at its first use.
fn probe(options: SqliteConnectOptions) -> EnginePool {
    EnginePoolOptions::new()
        .max_connections(1)
        .acquire_timeout(PROBE_TIMEOUT)
        .idle_timeout(None)
        .max_lifetime(None)
        .connect_lazy_with(EngineConnectOptions::Sqlite(options.read_only(true).busy_timeout(PROBE_TIMEOUT)))
}

impl Store {
    /// Checks that the database answers: reads one row with a reader that nothing else uses.
    ///
    /// # Errors
    /// [`StoreError`] of the database, [`StoreError::Busy`] after two seconds, [`StoreError::Displaced`].
    pub async fn probe(&self) -> Result<(), StoreError> {
        self.check_files()?;
        let answer =
            sqlx::query("SELECT count(*) FROM (SELECT 1 FROM robot LIMIT 1) AS first").execute(&self.probe);
        self.checked(answer.await).map(|_| ())
    }
}

/// Logs that a database is created, with a warning if there was one before.
fn say_new(path: &Path) {
    let database = path.display();
    if lock_file_of(path).exists() {
        tracing::warn!(
            %database, "created an empty database: the one that a daemon worked on was deleted or moved; to go on \
                with it, stop the daemon and restore it or a backup"
        );
    } else {
        tracing::info!(%database, "created the database");
    }
}

/// Refuses a file that does not belong to this program before anything in it is changed. Returns its schema, and true
/// if it is a snapshot.
async fn inspect(path: &Path, options: &SqliteConnectOptions) -> Result<(i64, bool), StoreError> {
    // An empty file is a new database to SQLite too.
    if std::fs::metadata(path).map_or(true, |m| m.is_file() && m.len() == 0) {
        return Ok((0, false));
    }
    write_ahead_log::refuse_foreign(path)?;
    let result = match EngineConnectOptions::Sqlite(options.clone()).connect().await {
        Ok(mut connection) => {
            let identity = identity(&mut connection).await;
            connection.close().await.and(identity)
        }
        Err(error) => Err(error),
    };
    match result.map_err(|e| StoreError::from_sqlx(path, &e))? {
        FileIdentity::New => Ok((0, false)),
        FileIdentity::Ours { schema, is_snapshot } => {
            let known = latest_schema();
            if schema > known {
                return Err(StoreError::Newer { path: path.to_path_buf(), found: schema, known });
            }
            Ok((schema, is_snapshot))
        }
        FileIdentity::Foreign => Err(StoreError::NotADatabase {
            path: path.to_path_buf(),
            detail: "it is the SQLite database of another program".into(),
        }),
    }
}

enum FileIdentity {
    New,
    Ours { schema: i64, is_snapshot: bool },
    Foreign,
}

async fn identity(connection: &mut EngineConnection) -> sqlx::Result<FileIdentity> {
    let application_id: i64 = sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await?;
    let tables: i64 =
        sqlx::query_scalar("SELECT count(*) FROM sqlite_schema").fetch_one(&mut *connection).await?;
    match (application_id, tables) {
        (APPLICATION_ID, _) => {
            let schema = version(connection).await?.unwrap_or(0);
            let mark: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(connection).await?;
            Ok(FileIdentity::Ours { schema, is_snapshot: mark == SNAPSHOT })
        }
        (0, 0) => Ok(FileIdentity::New),
        _ => Ok(FileIdentity::Foreign),
    }
}
