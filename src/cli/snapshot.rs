//! `armwatch snapshot`: a copy of the stored data, for readers.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::output;
use armwatch_store::StoreError;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch snapshot /srv/share/armwatch.db
  armwatch snapshot fleet.db --db /var/lib/armwatch/armwatch.db

The snapshot is one file that is never changed: any user, mount or computer can read it, with armwatch and with
other programs. The daemon may run meanwhile. All views have the same rows as in the database. Only the factors of
cycles are missing, which `identify` and `verify` need. [snapshot] in the configuration makes the daemon write
such a file.")]
pub(super) struct SnapshotArgs {
    /// File to write; an existing file is replaced
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

pub(super) fn snapshot(global: &Global, args: &SnapshotArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let file = args.file.display();
    let bytes = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let bytes = store.snapshot(&args.file).await;
        store.close().await?;
        bytes.map_err(|error| match error {
            StoreError::NotASnapshot { .. } => CliError::Usage(error.to_string()),
            error => CliError::Store(error),
        })
    })?;
    if global.json {
        output::json(&json!({"file": file.to_string(), "bytes": bytes}));
    } else {
        output::line(&format!("{file}: {:.1} MB", bytes as f64 / 1e6));
    }
    Ok(EXIT_DONE)
}
