//! Rows of the database as a table, as CSV or as JSON.

use clap::Args;
use serde_json::Value;

use super::output;
use crate::cli::context::CliError;
use armwatch_store::{AskError, ResultTable};

/// Significant digits of numbers in a table; CSV and JSON contain all.
const DIGITS: usize = 6;

/// How rows are printed.
#[derive(Debug, Clone, Copy, Args)]
pub struct RowArgs {
    /// Print rows as CSV, with all digits
    #[arg(long, conflicts_with = "json")]
    csv: bool,
}

impl RowArgs {
    /// Returns true if rows are printed as CSV.
    pub fn is_csv(self) -> bool {
        self.csv
    }
}

/// Prints rows in the requested form; a table without rows is replaced by `nothing`.
///
/// # Errors
/// [`CliError::Internal`] if rows cannot be written as CSV.
pub fn print(table: &ResultTable, args: RowArgs, json: bool, nothing: &str) -> Result<(), CliError> {
    if json {
        output::json_lines(table.objects().map(|object| object.to_string()));
    } else if args.csv {
        let text = csv(table).map_err(|error| CliError::Internal(format!("CSV: {error}")))?;
        output::data(text.trim_end_matches('\n'));
    } else if table.rows.is_empty() {
        output::line(nothing);
    } else {
        let header: Vec<&str> = table.columns.iter().map(String::as_str).collect();
        let rows: Vec<Vec<String>> = table.rows.iter().map(|row| row.iter().map(shown).collect()).collect();
        output::print_table(&header, &rows, &["status", "severity", "health"]);
    }
    Ok(())
}

/// Converts the error of an SQL query to that of a command.
pub fn as_cli_error(error: AskError) -> CliError {
    match error {
        AskError::Statement(text) | AskError::NoView(text) => CliError::Usage(text),
        AskError::Store(error) => CliError::Store(error),
    }
}

fn csv(table: &ResultTable) -> Result<String, Box<dyn std::error::Error>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&table.columns)?;
    for row in &table.rows {
        writer.write_record(row.iter().map(exact))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

fn exact(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// A value in a table: one line, numbers rounded, `-` for none.
fn shown(value: &Value) -> String {
    match value {
        Value::Null => "-".into(),
        Value::String(text) => text.clone(),
        Value::Number(number) => match (number.as_i64(), number.as_f64()) {
            (None, Some(real)) => rounded(real),
            _ => number.to_string(),
        },
        other => other.to_string(),
    }
}

fn rounded(value: f64) -> String {
    let exponent = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    if !(-5.0..DIGITS as f64).contains(&exponent) {
        return format!("{value:.*e}", DIGITS - 1);
    }
    // between 0 and 10
    let decimals = (DIGITS as f64 - 1.0 - exponent) as usize;
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_to_what_one_reads() {
        let cases = [
            (0.0, "0"),
            (1.0, "1"),
            (0.708_680_076, "0.70868"),
            (12.485_265, "12.4853"),
            (123_456.7, "123457"),
            (1_234_567.0, "1.23457e6"),
            (-0.001_668, "-0.001668"),
            (1.5e-9, "1.50000e-9"),
        ];
        for (value, text) in cases {
            assert_eq!(rounded(value), text);
        }
    }

    #[test]
    fn csv_quotes_what_it_must_and_leaves_null_empty() {
        let table = ResultTable {
            columns: vec!["robot".into(), "reason".into(), "value".into()],
            rows: vec![
                vec!["R01".into(), "a, \"b\"".into(), Value::Null],
                vec!["R02".into(), Value::Null, 0.1.into()],
            ],
        };
        assert_eq!(csv(&table).expect("text"), "robot,reason,value\nR01,\"a, \"\"b\"\"\",\nR02,,0.1\n");
    }
}
