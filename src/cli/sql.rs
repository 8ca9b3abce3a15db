//! `armwatch sql`: questions in SQL.

use std::io::{IsTerminal, Read};

use clap::Args;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::rows::{self, RowArgs};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch sql \"SELECT robot, joint, status FROM fleet_health\"
  armwatch sql \"SELECT * FROM cycles WHERE run_id = 12\" --csv > cycles.csv
  armwatch sql --json < dashboards/open_anomalies.sql

The database is opened for reading only: no statement changes anything, and the daemon may run. docs/schema.md
describes the views; `armwatch sql \"SELECT name FROM sqlite_schema WHERE type = 'view'\"` lists them.")]
pub(super) struct SqlArgs {
    /// Statement of SQLite; without one it is read from standard input
    #[arg(value_name = "QUERY")]
    query: Option<String>,
    #[command(flatten)]
    rows: RowArgs,
}

pub(super) fn sql(global: &Global, args: &SqlArgs) -> Result<u8, CliError> {
    let statement = statement(args)?;
    let config = global.read_config()?;
    let table = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let table = store.ask(&statement).await.map_err(rows::as_cli_error);
        store.close().await?;
        table
    })?;
    rows::print(&table, args.rows, global.json, "no row")?;
    Ok(EXIT_DONE)
}

fn statement(args: &SqlArgs) -> Result<String, CliError> {
    if let Some(query) = &args.query {
        return Ok(query.clone());
    }
    let mut stdin = std::io::stdin().lock();
    if stdin.is_terminal() {
        return Err(CliError::Usage(
            "give a statement: armwatch sql \"SELECT * FROM fleet_health\", or one on standard input".into(),
        ));
    }
    let mut text = String::new();
    stdin.read_to_string(&mut text).map_err(|error| CliError::Io(format!("standard input: {error}")))?;
    Ok(text)
}
