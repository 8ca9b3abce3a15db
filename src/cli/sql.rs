//! `armwatch sql`: queries in SQL.

use std::io::{IsTerminal, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::Value;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::output;
use super::shared::rows::{self, RowArgs};
use super::shared::views::{self, view_names};
use armwatch_store::{QuestionAnswer, QuestionError, SqlQuestion};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch sql \"SELECT robot, joint, status FROM fleet_health\"
  armwatch sql \"SELECT * FROM cycles WHERE run_id = 12\" --csv > cycles.csv
  armwatch sql \"SELECT * FROM runs WHERE robot = :robot\" --param robot=Left
  armwatch sql --file dashboards/friction_index_by_run.sql \\
      --param robot=Left --param joint=3
  armwatch sql --file dashboards/open_anomalies.sql --json
  armwatch sql --schema
  armwatch sql --schema friction_index

The command runs one statement that only reads: SELECT, WITH, VALUES or EXPLAIN. It opens the database read only
and writes no file; the daemon may run. `armwatch backup` copies the database, `armwatch export` writes views into
files. A parameter is :NAME in the statement; SQLite also accepts @NAME and $NAME. A parameter without --param is
NULL, and a message names it. The files in dashboards/ rely on this for optional parameters. On a server, put a
space after a colon that precedes a name but begins no parameter.

--schema lists the views and explains their columns; docs/schema.md and the view view_columns do the same. --json
renames further columns of the same name to name_2, name_3 and so on. Use AS in the statement to choose another
name.")]
pub(super) struct SqlArgs {
    /// Statement in the SQL of SQLite, or of PostgreSQL for a database on a server [default: read from standard
    /// input]
    #[arg(value_name = "QUERY")]
    query: Option<String>,
    /// Read the statement from a file; - means standard input
    #[arg(long, value_name = "PATH", conflicts_with = "query")]
    file: Option<PathBuf>,
    /// Value of the parameter :NAME of the statement; may be repeated. Numbers are passed as numbers, everything else
    /// as text
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = named_value)]
    params: Vec<(String, Value)>,
    /// List the public views, or the columns of one with type, unit and meaning; needs no database
    #[arg(long, value_name = "VIEW", num_args = 0..=1, conflicts_with_all = ["query", "file", "params"],
          value_parser = view_names(), hide_possible_values = true)]
    schema: Option<Option<String>>,
    #[command(flatten)]
    rows: RowArgs,
}

pub(super) fn sql(global: &Global, args: &SqlArgs) -> Result<u8, CliError> {
    if let Some(view) = &args.schema {
        return schema(global, args.rows, view.as_deref());
    }
    let question = SqlQuestion { statement: statement(args)?, values: args.params.clone() };
    let config = global.read_config()?;
    let QuestionAnswer { table, null_parameters } = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let answer = store.ask_one(&question).await;
        store.close().await?;
        answer.map_err(|error| match error {
            QuestionError::Store(error) => CliError::Store(error),
            error => CliError::Usage(error.to_string()),
        })
    })?;
    if !null_parameters.is_empty() {
        output::print_hint(&format!(
            "NULL, because no --param NAME=VALUE gives a value: {}",
            null_parameters.join(", ")
        ));
    }
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
        output::block(&told);
    }
    Ok(EXIT_DONE)
}

fn statement(args: &SqlArgs) -> Result<String, CliError> {
    match (&args.query, &args.file) {
        (Some(query), _) => Ok(query.clone()),
        (None, Some(file)) if file != Path::new("-") => std::fs::read_to_string(file).map_err(|error| {
            let file = file.display();
            CliError::Io(format!(
                "cannot read the statement in {file} ({error}); check the path given with --file"
            ))
        }),
        (None, file) => from_standard_input(file.is_some()),
    }
}

/// If standard input is not requested and a person has typed no statement, an error explains that instead of waiting.
fn from_standard_input(is_asked_for: bool) -> Result<String, CliError> {
    let mut stdin = std::io::stdin().lock();
    if stdin.is_terminal() && !is_asked_for {
        return Err(CliError::Usage(
            "give a statement: armwatch sql \"SELECT * FROM fleet_health\", a file with --file, or one on standard input"
                .into(),
        ));
    }
    let mut text = String::new();
    stdin.read_to_string(&mut text).map_err(|error| CliError::Io(format!("standard input: {error}")))?;
    Ok(text)
}

/// Reads `NAME=VALUE`; the name may begin with `:`, `@` or `$`, like in the statement.
fn named_value(text: &str) -> Result<(String, Value), String> {
    let (name, value) = text.split_once('=').unwrap_or((text, ""));
    let name = name.trim().trim_start_matches([':', '@', '$']);
    if name.is_empty() || !text.contains('=') {
        return Err("write NAME=VALUE, such as robot=Left".into());
    }
    Ok((name.to_owned(), number(value).unwrap_or_else(|| Value::from(value))))
}

/// A value as a number, if it is written as one. Digits with a leading zero, as in the name of a robot, are text.
fn number(text: &str) -> Option<Value> {
    let digits = text.trim_start_matches('-');
    let is_code = digits.len() > 1 && digits.starts_with('0') && !digits.starts_with("0.");
    let begins_as_number = digits.starts_with(|c: char| c.is_ascii_digit() || c == '.');
    if is_code || !begins_as_number {
        return None;
    }
    let whole = text.parse::<i64>().ok().map(Value::from);
    whole.or_else(|| text.parse::<f64>().ok().filter(|real| real.is_finite()).map(Value::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_numbers_where_they_are_written_as_numbers() {
        for (text, value) in [
            ("x=3", Value::from(3)),
            ("x=-3", Value::from(-3)),
            ("x=0.5", Value::from(0.5)),
            (":x=1e3", Value::from(1e3)),
            ("x=0", Value::from(0)),
            ("x=", Value::from("")),
            ("x=007", Value::from("007")),
            ("x=a=b", Value::from("a=b")),
            ("x=inf", Value::from("inf")),
            ("@x=R 01", Value::from("R 01")),
        ] {
            assert_eq!(named_value(text), Ok(("x".to_owned(), value)), "{text}");
        }
        for wrong in ["x", "=3", ":=3", ""] {
            assert!(named_value(wrong).is_err_and(|said| said.contains("NAME=VALUE")), "{wrong}");
        }
    }
}
