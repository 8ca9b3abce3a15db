//! The one place that prints: results on standard output, words on standard error.

use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;

use anstyle::Style;

/// Why results could not be printed, the first time that happened.
static FAILED: OnceLock<String> = OnceLock::new();

/// Prints a line of results. A reader that went away, as in `armwatch ... | head`, is not an error; of any other
/// failure [`failure`] tells at the end.
pub fn line(text: &str) {
    note(writeln!(std::io::stdout().lock(), "{text}"));
}

/// Prints lines of results as they come; ends where they cannot be printed.
pub fn lines(lines: impl Iterator<Item = String>) {
    let mut stdout = std::io::BufWriter::new(std::io::stdout().lock());
    for line in lines {
        if let Err(error) = writeln!(stdout, "{line}") {
            return note(Err(error));
        }
    }
    note(stdout.flush());
}

/// Why results could not be printed, such as a full disk; `None` where all were.
pub fn failure() -> Option<String> {
    note(std::io::stdout().lock().flush());
    FAILED.get().cloned()
}

fn note(printed: std::io::Result<()>) {
    if let Err(error) = printed
        && error.kind() != ErrorKind::BrokenPipe
    {
        let _ = FAILED.set(error.to_string());
    }
}

/// The text in a style on a terminal, plain elsewhere and where `NO_COLOR` is set.
pub fn styled(text: &str, style: Style) -> String {
    let plain =
        !std::io::stdout().is_terminal() || std::env::var_os("NO_COLOR").is_some_and(|set| !set.is_empty());
    if plain { text.to_owned() } else { format!("{style}{text}{style:#}") }
}

/// Prints a line of words.
pub fn print_hint(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Prints an error.
pub fn print_error(error: &dyn std::fmt::Display) {
    print_hint(&format!("armwatch: {error}"));
}

/// Prints a result as one line of JSON.
pub fn json(value: &serde_json::Value) {
    line(&value.to_string());
}

/// A table with a header, columns padded to their widest cell.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([header[column].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let render = |cells: Vec<&str>| -> String {
        let padded: Vec<String> = cells
            .iter()
            .zip(&widths)
            .map(|(cell, width)| format!("{cell}{}", " ".repeat(width - cell.chars().count().min(*width))))
            .collect();
        padded.join("  ").trim_end().to_owned()
    };
    let mut lines = vec![render(header.to_vec())];
    lines.extend(rows.iter().map(|row| render(row.iter().map(String::as_str).collect())));
    lines.join("\n")
}
