//! `armwatch sql`: questions in SQL.

use std::io::{IsTerminal, Read};

use clap::Args;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::output;
use super::shared::rows::{self, RowArgs};
use super::shared::views::{self, view_names};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch sql \"SELECT robot, joint, status FROM fleet_health\"
  armwatch sql \"SELECT * FROM cycles WHERE run_id = 12\" --csv > cycles.csv
  armwatch sql --json < dashboards/open_anomalies.sql
  armwatch sql --schema
  armwatch sql --schema friction_index

The database is opened for reading only: no statement changes anything, and the daemon may run. --schema says which
views there are, and what their columns mean; so do docs/schema.md and the view view_columns.")]
pub(super) struct SqlArgs {
    /// Statement of SQLite, or of PostgreSQL for a database on a server; without one it is read from standard input
    #[arg(value_name = "QUERY")]
    query: Option<String>,
    /// List the public views, or the columns of one: type, unit, meaning; no database is needed
    #[arg(long, value_name = "VIEW", num_args = 0..=1, conflicts_with = "query", value_parser = view_names(),
          hide_possible_values = true)]
    schema: Option<Option<String>>,
    #[command(flatten)]
    rows: RowArgs,
}

pub(super) fn sql(global: &Global, args: &SqlArgs) -> Result<u8, CliError> {
    if let Some(view) = &args.schema {
        return schema(global, args.rows, view.as_deref());
    }
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

fn schema(global: &Global, rows: RowArgs, name: Option<&str>) -> Result<u8, CliError> {
    let (table, told) = match name.and_then(views::view) {
        Some(view) => (views::columns(view), views::columns_told(view)),
        None => (views::list(), views::told()),
    };
    if rows.is_csv() || global.json {
        rows::print(&table, rows, global.json, "no view")?;
    } else {
        output::line(&told);
    }
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
