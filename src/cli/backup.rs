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

The backup is one file with all data at one moment, including factors; the daemon may run meanwhile. The command
first checks the pages of the database. It writes the copy next to FILE, verifies it (integrity, references, a
hash of all values of every table) and then renames it. An earlier backup of that name therefore stays until the
new one is complete. The command does not replace any other file at FILE, nor a database in use. The schema may be
that of an earlier version of armwatch. A snapshot cannot be backed up, because it has no factors. The backup
needs as much space as the database. To restore, stop the daemon and put the backup in the place of the database:
see docs/operations.md. For a copy for other readers, use `armwatch snapshot`.")]
pub(super) struct BackupArgs {
    /// File to write; an earlier backup is replaced
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
            "{file}: {:.1} MB, verified; {rows} rows in {} tables, all equal to the database",
            backup.bytes as f64 / 1e6,
            backup.rows.len()
        ));
    }
    Ok(EXIT_DONE)
}
