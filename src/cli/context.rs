//! Shared parts of all commands: common options, errors and exit statuses, the store and the runtime.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use tokio_util::sync::CancellationToken;

use crate::pipeline::context::PipelineError;
use crate::telemetry::LogFormat;
use armwatch_config::{
    Config, ConfigErrors, ConfigSource, KINDS_OF_DATABASE, foreign_scheme, shown_database,
};
use armwatch_store::{Store, StoreError};

/// All done.
pub const EXIT_DONE: u8 = 0;

/// Done, but something was quarantined, or a check found a difference.
pub const EXIT_FOUND: u8 = 1;

/// The command line or the configuration is wrong.
pub const EXIT_USAGE: u8 = 2;

/// A fault of the program itself.
pub const EXIT_INTERNAL: u8 = 70;

/// The database or a file could not be read or written.
pub const EXIT_IO: u8 = 74;

/// Stopped by a signal before everything was done; stored results stay.
pub const EXIT_STOPPED: u8 = 130;

/// Heading of the options of every command.
pub(super) const GLOBAL_HEADING: &str = "Global options";

/// Environment variable of benchmarks: if it is set, numerics run as on a processor without wide registers.
pub const ANY_PROCESSOR: &str = "ARMWATCH_ANY_PROCESSOR";

/// Options of every command.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = GLOBAL_HEADING)]
pub struct Global {
    /// Database file or postgres://USER@HOST/NAME, instead of the configured one
    #[arg(long, global = true, value_name = "DATABASE")]
    pub db: Option<PathBuf>,
    /// Configuration file [default: the first of $ARMWATCH_CONFIG, config/armwatch.toml, armwatch.toml and the
    /// shipped settings]
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print results as JSON, one object per line
    #[arg(long, global = true)]
    pub json: bool,
    /// Print more log lines; twice for all
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Print fewer log lines; twice for errors only
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "verbose")]
    pub quiet: u8,
    /// Form of log lines: text for people, or one JSON object per line
    #[arg(long, global = true, value_name = "FORMAT", value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
}

impl Global {
    /// The same options with the configuration file that is found now.
    pub fn pinned(&self) -> Self {
        let config = match ConfigSource::locate(self.config.as_deref()) {
            ConfigSource::Argument(path)
            | ConfigSource::Environment(path)
            | ConfigSource::WorkingDirectory(path) => Some(path),
            ConfigSource::Shipped => None,
        };
        Self { config, ..self.clone() }
    }

    /// The configuration, with the command line's database.
    ///
    /// # Errors
    /// [`CliError::Config`] for an invalid configuration, [`CliError::Usage`] for an address of another kind of server.
    pub fn read_config(&self) -> Result<Config, CliError> {
        let (mut config, _) = Config::find(self.config.as_deref())?;
        if let Some(db) = &self.db {
            if let Some(scheme) = foreign_scheme(db) {
                return Err(CliError::Usage(format!(
                    "--db cannot be an address of {scheme}; {KINDS_OF_DATABASE}"
                )));
            }
            config.database.clone_from(db);
        }
        Ok(config)
    }
}

/// Why a command ended early.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// The configuration is wrong.
    #[error("{0}")]
    Config(#[from] ConfigErrors),
    /// The command line is inconsistent or impossible.
    #[error("{0}")]
    Usage(String),
    /// A file could not be read or written.
    #[error("{0}")]
    Io(String),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The pipeline cannot continue.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A fault of the program itself.
    #[error("internal error: {0}")]
    Internal(String),
}

impl CliError {
    /// Exit status of the process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Config(_) | Self::Usage(_) => EXIT_USAGE,
            Self::Io(_) | Self::Store(_) | Self::Pipeline(PipelineError::Store(_)) => EXIT_IO,
            Self::Pipeline(PipelineError::Task(_)) | Self::Internal(_) => EXIT_INTERNAL,
        }
    }
}

/// Most threads for blocking work: reading an export takes up to three, and `watch.live_files` is at most a thousand.
/// Threads start when there is work for them.
const MOST_BLOCKING_THREADS: usize = 4096;

/// The asynchronous runtime of a command.
///
/// # Errors
/// [`CliError::Internal`] if the system provides no threads.
pub fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .max_blocking_threads(MOST_BLOCKING_THREADS)
        .build()
        .map_err(|error| CliError::Internal(format!("no runtime: {error}")))
}

/// Opens the database of a command that only reads: nothing is created or migrated, so that a user without write
/// permission can query it.
pub(super) async fn open_to_read(config: &Config) -> Result<Store, CliError> {
    let store = Store::open_existing_as(&config.database, &config.cluster).await?;
    store.ok_or_else(|| no_database(config))
}

/// Like [`open_to_read`], also with the schema of an earlier version.
pub(super) async fn open_any_schema(config: &Config) -> Result<Store, CliError> {
    let store = Store::open_any_schema(&config.database, &config.cluster).await?;
    store.ok_or_else(|| no_database(config))
}

/// Opens the database of a command that changes stored data. A database file must exist: for a mistyped name, an empty
/// one would be created, which would then report that the requested data is unknown.
pub(super) async fn open_to_change(config: &Config) -> Result<Store, CliError> {
    require_database(config)?;
    open_store(config).await
}

/// Refuses a database file that does not exist.
pub(super) fn require_database(config: &Config) -> Result<(), CliError> {
    let is_none =
        |file: &Path| std::fs::metadata(file).map_or(true, |found| found.is_file() && found.len() == 0);
    match config.database_file() {
        Some(file) if is_none(file) => Err(no_database(config)),
        _ => Ok(()),
    }
}

fn no_database(config: &Config) -> CliError {
    CliError::Io(format!(
        "there is no database {}: `armwatch run` and `armwatch ingest` create it; name another one with --db",
        shown_database(&config.database)
    ))
}

/// Opens the database of a command that writes; creates it if there is none.
///
/// # Errors
/// [`CliError::Store`] if the database cannot be opened.
pub async fn open_store(config: &Config) -> Result<Store, CliError> {
    Ok(Store::open_as(&config.database, &config.cluster).await?)
}

/// Like [`open_store`]; `None` if `stop` comes first, which leaves the database unchanged.
pub(super) async fn open_store_until(
    stop: &CancellationToken,
    config: &Config,
) -> Result<Option<Store>, CliError> {
    stop.run_until_cancelled(open_store(config)).await.transpose()
}

pub(super) fn shared(config: Config) -> Arc<Config> {
    Arc::new(config)
}
