//! Opening a database on a PostgreSQL server: its identity and schema, and the settings of its connections.

mod schema;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use sqlx::postgres::PgConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::engine::host_lock::HostLock;
use super::engine::{EngineConnectOptions, EngineConnection, EnginePool, EnginePoolOptions};
use super::error::StoreError;
use super::handle::Store;
use super::own_host::OwnHost;
use super::view_columns;
use armwatch_config::{ClusterSettings, shown_database};

/// Time limit of a query about the database's health.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// Time limit of a connection to the server.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// Number of concurrent readers, as with SQLite: a command and a page each run a few queries, and a connection is a
/// process of the server.
const READERS: u32 = 4;

/// Schemas in search order. The schema of armwatch precedes that of the server, so that its functions are found first.
const SEARCH_PATH: (&str, &str) = ("search_path", "armwatch,pg_catalog");

/// The server ends a transaction that is idle for the time of a lease: others wait for the locks of a program that
/// hangs.
const IDLE_LIMIT: &str = "idle_in_transaction_session_timeout";

/// Seconds of silence after which the connection is probed. A host that is switched off sends nothing.
const KEEPALIVE: (&str, &str) = ("tcp_keepalives_idle", "60");

/// Opens the database at an address, and creates its tables if there are none; see [`Store::open`].
pub(super) async fn open(
    address: &Path,
    cluster: &ClusterSettings,
    busy_timeout: Duration,
) -> Result<Store, StoreError> {
    let path: Arc<Path> = Path::new(&shown_database(address)).into();
    let options = options(&path, address)?;
    let mut connection = connect(&path, &options).await?;
    let made = schema::make(&path, &mut connection).await;
    // the tables are committed, or the error is returned; a failed close changes neither
    let _ = connection.close().await;
    made?;
    let [lock_timeout, idle_limit] = [busy_timeout, cluster.lease].map(|of| of.as_millis().to_string());
    let writing = [("lock_timeout", lock_timeout.as_str()), (IDLE_LIMIT, idle_limit.as_str())];
    let writing = options.clone().options(writing);
    let lock = HostLock::of(cluster.host.as_deref().unwrap_or_default());
    let control = pool(1, busy_timeout).connect_lazy_with(EngineConnectOptions::Postgres(writing.clone()));
    let writer =
        lock.of_writer(pool(1, busy_timeout)).connect_lazy_with(EngineConnectOptions::Postgres(writing));
    let own_host = OwnHost::new(cluster, lock, Some(control));
    view_columns::fill(&writer).await.map_err(|error| StoreError::from_sqlx(&path, &error))?;
    let (readers, probe) = readers(&options, busy_timeout);
    let is_read_only = false;
    Ok(Store { path, writer, readers, probe, is_read_only, is_snapshot: false, files: None, own_host })
}

/// Opens an existing database for reading only; see [`Store::open_existing`].
pub(super) async fn open_existing(
    address: &Path,
    cluster: &ClusterSettings,
    timeout: Duration,
) -> Result<Option<Store>, StoreError> {
    let path: Arc<Path> = Path::new(&shown_database(address)).into();
    look(path.clone(), options(&path, address)?, OwnHost::none(cluster), timeout).await
}

/// Another handle for reading the same database.
pub(super) async fn open_again(store: &Store, timeout: Duration) -> Result<Option<Store>, StoreError> {
    match &*store.readers.connect_options() {
        EngineConnectOptions::Postgres(options) => {
            look(store.path.clone(), options.clone(), store.own_host.to_look(), timeout).await
        }
        EngineConnectOptions::Sqlite(_) => Ok(None),
    }
}

async fn look(
    path: Arc<Path>,
    options: PgConnectOptions,
    own_host: OwnHost,
    timeout: Duration,
) -> Result<Option<Store>, StoreError> {
    let mut connection = connect(&path, &options).await?;
    let found = schema::check(&path, &mut connection).await;
    let _ = connection.close().await;
    if !found? {
        return Ok(None);
    }
    let (readers, probe) = readers(&options, timeout);
    let writer = readers.clone();
    let is_read_only = true;
    Ok(Some(Store { path, writer, readers, probe, is_read_only, is_snapshot: false, files: None, own_host }))
}

fn options(path: &Path, address: &Path) -> Result<PgConnectOptions, StoreError> {
    let options: PgConnectOptions =
        address.to_str().unwrap_or_default().parse().map_err(|error: sqlx::Error| StoreError::Address {
            path: path.to_path_buf(),
            detail: error.to_string(),
        })?;
    Ok(options.application_name("armwatch").options([SEARCH_PATH, KEEPALIVE]).disable_statement_logging())
}

/// The first connection, which reports its error unchanged. A pool would try again and report a timeout.
async fn connect(path: &Path, options: &PgConnectOptions) -> Result<EngineConnection, StoreError> {
    match tokio::time::timeout(CONNECT_TIMEOUT, options.connect()).await {
        Ok(connected) => {
            connected.map(EngineConnection::Postgres).map_err(|error| StoreError::from_sqlx(path, &error))
        }
        Err(_) => Err(StoreError::Unreachable {
            path: path.to_path_buf(),
            detail: format!("no answer within {} s", CONNECT_TIMEOUT.as_secs()),
        }),
    }
}

/// Connections that only read, and the one for queries about the database's health.
fn readers(options: &PgConnectOptions, timeout: Duration) -> (EnginePool, EnginePool) {
    let options = options.clone().options([("default_transaction_read_only", "on")]);
    let limit = PROBE_TIMEOUT.as_millis().to_string();
    let probing = options.clone().options([("statement_timeout", limit.as_str())]);
    let readers = pool(READERS, timeout).connect_lazy_with(EngineConnectOptions::Postgres(options));
    let probe = pool(1, timeout).acquire_timeout(PROBE_TIMEOUT);
    (readers, probe.connect_lazy_with(EngineConnectOptions::Postgres(probing)))
}

fn pool(connections: u32, busy_timeout: Duration) -> EnginePoolOptions {
    EnginePoolOptions::new()
        .max_connections(connections)
        // A request to the pool may have to wait for one that waits for another process.
        .acquire_timeout(3 * busy_timeout)
        .idle_timeout(None)
        .max_lifetime(None)
        // the caller that waits for a server reports that it is gone
        .acquire_slow_level(log::LevelFilter::Off)
}
