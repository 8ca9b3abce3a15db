//! `armwatch backup`: a copy of everything that is stored.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_any_schema, runtime};
use super::shared::output;
use armwatch_store::StoreError;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch backup /backup/armwatch.db
  armwatch backup /backup/fleet.db --db /var/lib/armwatch/armwatch.db --json

Everything as of one moment, factors too, in one file; the daemon may run meanwhile. The pages of the database are checked
first. The copy is written next to FILE, verified (integrity, references, a hash of all values of every table) and
renamed, so that an earlier backup of that name stays until the new one is whole. Anything else at FILE, and a database that
is in use, is left alone. The schema may be that of an earlier version of armwatch. Of a snapshot, which has no factors, no
backup is made. It needs as much room as the database. To restore, stop the daemon and put it in the place of the database,
see docs/operations.md. For a copy that others read, there is `armwatch snapshot`.")]
pub(super) struct BackupArgs {
    /// File to write; an earlier backup that is there is replaced
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

pub(super) fn backup(global: &Global, args: &BackupArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let file = args.file.display();
    let backup = runtime()?.block_on(async {
        let store = open_any_schema(&config).await?;
        let backup = store.backup(&args.file).await;
        store.close().await?;
        backup.map_err(|error| match error {
            StoreError::NotABackup { .. } | StoreError::NoFactorsInSnapshot { .. } => {
                CliError::Usage(error.to_string())
            }
            error => CliError::Store(error),
        })
    })?;
    let rows: u64 = backup.rows.iter().map(|(_, rows)| rows).sum();
    if global.json {
        let by_table: serde_json::Map<_, _> =
            backup.rows.iter().map(|(table, rows)| (table.clone(), json!(rows))).collect();
        output::json(&json!({
            "file": file.to_string(), "bytes": backup.bytes, "rows": by_table, "rows_compared": true,
        }));
    } else {
        output::line(&format!(
            "{file}: {:.1} MB, whole; {rows} rows in {} tables, each as in the database",
            backup.bytes as f64 / 1e6,
            backup.rows.len()
        ));
    }
    Ok(EXIT_DONE)
}
