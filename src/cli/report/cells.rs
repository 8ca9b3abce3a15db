//! Rows of views as cells of a page.

use serde_json::Value;

use crate::cli::context::CliError;
use crate::cli::shared::rows::as_cli_error;
use crate::report::page::{PageBlock, PageTable, TableCell};
use armwatch_store::{Store, ViewRows};

/// Most rows that are read from a view; a run of a day has fewer.
const MOST_ROWS: usize = 1_000_000;

/// Significant digits of a value.
const DIGITS: f64 = 4.0;

/// Rows of a view with these values in these columns, in the order of a column.
pub(super) async fn rows(
    store: &Store,
    view: &str,
    filters: &[(&str, &str)],
    order: &str,
) -> Result<Vec<Value>, CliError> {
    let wanted = ViewRows {
        filters: filters.iter().map(|(column, value)| ((*column).to_owned(), (*value).to_owned())).collect(),
        order: Some((order.to_owned(), false)),
        limit: MOST_ROWS,
    };
    let table = store.rows_of_view(view, &wanted).await.map_err(as_cli_error)?;
    Ok(table.objects().collect())
}

/// A text of a row; empty if there is none.
pub(super) fn text<'a>(row: &'a Value, column: &str) -> &'a str {
    row[column].as_str().unwrap_or_default()
}

/// A whole number of a row; 0 if there is none.
pub(super) fn count(row: &Value, column: &str) -> i64 {
    row[column].as_i64().unwrap_or_default()
}

/// A value with four significant digits; `-` if unknown.
pub(super) fn figure(value: Option<f64>) -> String {
    let Some(value) = value.filter(|value| value.is_finite()) else { return "-".into() };
    if value == 0.0 {
        return "0".into();
    }
    let exponent = value.abs().log10().floor();
    if !(-4.0..7.0).contains(&exponent) {
        return format!("{value:.*e}", DIGITS as usize - 1);
    }
    format!("{value:.*}", (DIGITS - 1.0 - exponent).max(0.0) as usize)
}

/// A fraction in per cent.
pub(super) fn percent(fraction: Option<f64>) -> String {
    match fraction.filter(|fraction| fraction.is_finite()) {
        Some(fraction) => format!("{:.1} %", 100.0 * fraction),
        None => "-".into(),
    }
}

/// A change in per cent, with its sign.
pub(super) fn change(fraction: Option<f64>) -> String {
    match fraction.filter(|fraction| fraction.is_finite()) {
        // rounded first, and 0.0 added, so that zero has no minus sign
        Some(fraction) => format!("{:+.1} %", (1000.0 * fraction).round() / 10.0 + 0.0),
        None => "-".into(),
    }
}

/// The cell of a number.
pub(super) fn number(value: Option<f64>) -> TableCell {
    TableCell::Number(figure(value))
}

/// The cell of a text.
pub(super) fn words(text: impl Into<String>) -> TableCell {
    TableCell::Words(text.into())
}

/// The cell of a whole number.
pub(super) fn whole(value: impl std::fmt::Display) -> TableCell {
    TableCell::Number(value.to_string())
}

/// A stored time to the minute.
pub(super) fn minute(stored: &str) -> String {
    match stored.parse::<jiff::Timestamp>() {
        Ok(time) => crate::cli::alerts::anomaly_texts::minute(time),
        Err(_) => stored.to_owned(),
    }
}

/// A table, or a sentence if it would have no rows.
pub(super) fn table(caption: &str, header: &[&str], rows: Vec<Vec<TableCell>>, nothing: &str) -> PageBlock {
    if rows.is_empty() {
        return PageBlock::Note(nothing.to_owned());
    }
    let header = header.iter().map(|name| (*name).to_owned()).collect();
    PageBlock::Table(PageTable { caption: caption.to_owned(), header, rows })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_digits_and_what_is_not_known_a_dash() {
        let shown = [1.19312, 0.05, -20.6666, 12_345.6, 0.0, 3.2e-7].map(|value| figure(Some(value)));
        assert_eq!(shown, ["1.193", "0.05000", "-20.67", "12346", "0", "3.200e-7"]);
        assert_eq!((figure(None), figure(Some(f64::NAN))), ("-".into(), "-".into()));
        assert_eq!(
            (percent(Some(0.1234)), change(Some(0.0)), change(None)),
            ("12.3 %".into(), "+0.0 %".into(), "-".into())
        );
    }

    #[test]
    fn a_table_without_rows_is_a_sentence() {
        assert_eq!(table("t", &["a"], Vec::new(), "none yet"), PageBlock::Note("none yet".into()));
    }
}
