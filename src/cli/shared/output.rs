//! All printing: results on standard output, messages on standard error.
//!
//! Lines for people show hidden characters ([`text::is_hidden`]), which may occur in the name of a file, as `\u{1b}`: a
//! terminal would interpret them. JSON shows them as `\u001b`. CSV is printed unchanged, except on a terminal.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;

use anstream::adapter::strip_str;
use anstream::{AutoStream, ColorChoice};
use anstyle::{AnsiColor, Style};
use serde::Serialize;

use armwatch_model::text;

/// Why results could not be printed, the first time that happened.
static FAILED: OnceLock<String> = OnceLock::new();

/// Prints a line of results for people. A closed reader, as in `armwatch ... | head`, is not an error; [`failure`]
/// reports any other failure at the end.
pub fn line(text: &str) {
    note(writeln!(std::io::stdout().lock(), "{}", in_colour(&on_one_line(text))));
}

/// Prints several lines of results for people, such as a [`table`]. Foreign text must have passed [`text::shown`],
/// since its line feeds would start new lines here.
pub fn block(text: &str) {
    text.split('\n').for_each(line);
}

/// Prints results for programs unchanged, with the end of a line.
pub fn data(text: &str) {
    lines(std::iter::once(text.to_owned()));
}

/// Prints lines of results for programs as they arrive; stops if they cannot be printed. On a terminal, hidden
/// characters are shown.
pub fn lines(lines: impl Iterator<Item = String>) {
    let stdout = std::io::stdout();
    let is_for_people = stdout.is_terminal();
    let mut stdout = std::io::BufWriter::new(stdout.lock());
    for line in lines {
        let line = if is_for_people { text::shown_lines(&line) } else { Cow::Borrowed(line.as_str()) };
        if let Err(error) = writeln!(stdout, "{line}") {
            return note(Err(error));
        }
    }
    note(stdout.flush());
}

/// Why results could not be printed, such as a full disk; `None` if all were printed.
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

/// Start of a style of this program, instead of the escape character, until the line is printed, so that an escape
/// character in the name of a file is distinct. Unicode assigns it to no character.
const STYLE: char = '\u{fdd0}';

/// The escape character, which begins terminal commands.
const ESCAPE: char = '\u{1b}';

/// The text in a style if standard output supports it: on a terminal, unless `NO_COLOR` is set.
pub fn styled(text: &str, style: Style) -> String {
    let plain = AutoStream::choice(&std::io::stdout()) == ColorChoice::Never;
    if plain { text.to_owned() } else { in_style(text, style) }
}

fn in_style(text: &str, style: Style) -> String {
    let marked = |code: String| code.replace(ESCAPE, STYLE.encode_utf8(&mut [0; 4]));
    format!("{}{text}{}", marked(style.to_string()), marked(format!("{style:#}")))
}

/// A text with the styles of this program in terminal codes.
fn in_colour(shown: &str) -> Cow<'_, str> {
    match shown.contains(STYLE) {
        true => shown.replace(STYLE, ESCAPE.encode_utf8(&mut [0; 4])).into(),
        false => shown.into(),
    }
}

/// Returns true if a text continues like a colour code after its escape character: `[31m`.
fn is_style(rest: &str) -> bool {
    let numbers = rest.strip_prefix('[').and_then(|rest| rest.split_once('m'));
    numbers.is_some_and(|(numbers, _)| numbers.bytes().all(|byte| byte.is_ascii_digit() || byte == b';'))
}

/// A text on one line for people: styles of this program unchanged, other hidden characters shown.
fn on_one_line(text: &str) -> Cow<'_, str> {
    let mut parts = text.split(STYLE);
    let first = text::shown(parts.next().unwrap_or_default());
    let mut rest = parts.peekable();
    if rest.peek().is_none() {
        return first;
    }
    let mut shown = first.into_owned();
    for part in rest {
        match is_style(part) {
            true => shown.push(STYLE),
            false => shown.extend(STYLE.escape_unicode()),
        }
        shown.push_str(&text::shown(part));
    }
    shown.into()
}

/// A word for a severity, a status or an outcome in its colour; other words unchanged.
pub fn coloured(word: &str) -> String {
    style_of(word).map_or_else(|| word.to_owned(), |style| styled(word, style))
}

/// Style for the urgency of a word.
fn style_of(word: &str) -> Option<Style> {
    Some(match word {
        "critical" => AnsiColor::Red.on_default().bold(),
        "warning" => AnsiColor::Yellow.on_default().bold(),
        "quarantined" | "unreadable" | "refused" => AnsiColor::Red.on_default(),
        "doubtful" => AnsiColor::Yellow.on_default(),
        "overdue" | "unknown" => AnsiColor::Magenta.on_default(),
        "info" => AnsiColor::Blue.on_default(),
        "learning" | "streaming" => AnsiColor::Cyan.on_default(),
        "ok" | "resolved" => AnsiColor::Green.on_default(),
        _ => return None,
    })
}

/// The text padded with spaces to a width; colours have no width.
pub fn padded(text: &str, width: usize) -> String {
    format!("{text}{}", " ".repeat(width.saturating_sub(shown_width(text))))
}

fn shown_width(text: &str) -> usize {
    strip_str(&in_colour(&on_one_line(text))).to_string().chars().count()
}

/// A count with its noun, in the plural unless the count is one.
pub fn counted<N: Display + PartialEq + From<u8>>(count: N, noun: &str) -> String {
    let ending = if count == N::from(1) { "" } else { "s" };
    format!("{count} {noun}{ending}")
}

/// Prints a hint.
pub fn print_hint(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", text::shown(text));
}

/// Prints an error.
pub fn print_error(error: &dyn std::fmt::Display) {
    print_hint(&format!("armwatch: {error}"));
}

/// Prints a result as one line of JSON, its keys sorted.
pub fn json(result: &impl Serialize) {
    match serde_json::to_value(result) {
        Ok(value) => json_lines(std::iter::once(value.to_string())),
        Err(error) => note(Err(error.into())),
    }
}

/// Prints results as lines of JSON.
pub fn json_lines(of: impl Iterator<Item = String>) {
    lines(of.map(|line| text::json(&line).into_owned()));
}

/// Narrowest width of a shortened column of long text.
const NARROWEST: usize = 16;

/// Prints a table. On a terminal, long text is cut to its width; otherwise it is complete. Columns in `in_colour`
/// contain words for a status.
pub fn print_table(header: &[&str], rows: &[Vec<String>], in_colour: &[&str]) {
    let width = std::io::stdout().is_terminal().then(terminal_size::terminal_size).flatten();
    let rows: Vec<Vec<String>> =
        rows.iter().map(|row| row.iter().map(|cell| text::shown(cell).into_owned()).collect()).collect();
    let mut rows = match width {
        Some((terminal_size::Width(width), _)) => fitted(header, &rows, usize::from(width)),
        None => rows,
    };
    let is_cut = rows.iter().flatten().any(|cell| cell.ends_with(ELLIPSIS));
    for (column, _) in header.iter().enumerate().filter(|(_, name)| in_colour.contains(name)) {
        for cell in rows.iter_mut().filter_map(|row| row.get_mut(column)) {
            *cell = coloured(cell);
        }
    }
    block(&table(header, &rows));
    if is_cut {
        print_hint("long text is cut to this terminal; --json, or a file or pipe as output, has all of it");
    }
}

/// Replaces the rest of a text.
const ELLIPSIS: char = '\u{2026}';

/// Rows with shortened text columns, the widest first, until the table has this width or nothing can be cut.
fn fitted(header: &[&str], rows: &[Vec<String>], width: usize) -> Vec<Vec<String>> {
    let is_text = |cell: &String| cell.contains(' ') || cell.chars().count() > 2 * NARROWEST;
    let widest = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([header[column].chars().count()]).max().unwrap_or(0)
    };
    let mut widths: Vec<usize> = (0..header.len()).map(widest).collect();
    let can_cut: Vec<bool> =
        (0..header.len()).map(|column| rows.iter().any(|row| row.get(column).is_some_and(is_text))).collect();
    let gaps = 2 * header.len().saturating_sub(1);
    while widths.iter().sum::<usize>() + gaps > width {
        let widest = (0..widths.len()).filter(|&of| can_cut[of] && widths[of] > NARROWEST);
        let Some(widest) = widest.max_by_key(|&of| widths[of]) else { break };
        widths[widest] -= 1;
    }
    let cut = |(cell, width): (&String, &usize)| match cell.chars().count() > *width {
        true => cell.chars().take(width - 1).chain([ELLIPSIS]).collect(),
        false => cell.clone(),
    };
    rows.iter().map(|row| row.iter().zip(&widths).map(cut).collect()).collect()
}

/// A table with a header, columns padded to their widest cell; colours have no width, and a row is one line.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let shown = |row: &Vec<String>| row.iter().map(|cell| on_one_line(cell).into_owned()).collect();
    let rows: Vec<Vec<String>> = rows.iter().map(shown).collect();
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| shown_width(cell));
        cells.chain([header[column].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let render = |cells: Vec<&str>| -> String {
        let cells: Vec<String> =
            cells.iter().zip(&widths).map(|(cell, width)| padded(cell, *width)).collect();
        cells.join("  ").trim_end().to_owned()
    };
    let mut lines = vec![render(header.to_vec())];
    lines.extend(rows.iter().map(|row| render(row.iter().map(String::as_str).collect())));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_text_is_cut_to_the_terminal_and_figures_are_not() {
        let header = ["run", "value", "reason"];
        let row = |reason: &str| vec!["12".to_owned(), "0.123456".to_owned(), reason.to_owned()];
        let rows = [row("joint 4: the torque signal stands at 0 while the joint moves"), row("-")];
        let cut = fitted(&header, &rows, 40);
        assert_eq!(cut[0], ["12", "0.123456", "joint 4: the torque sign\u{2026}"]);
        assert_eq!(table(&header, &cut).lines().map(|line| line.chars().count()).max(), Some(40));
        assert_eq!(cut[1], rows[1]);
        assert_eq!(fitted(&header, &rows, 200), rows);
        let narrow = fitted(&header, &rows, 5);
        assert_eq!(narrow[0][2].chars().count(), NARROWEST, "{narrow:?}");
    }

    #[test]
    fn colours_take_no_width() {
        let red = AnsiColor::Red.on_default();
        let row = |word: String| vec![word, "x".to_owned()];
        let text = table(&["status", ""], &[row(in_style("ok", red)), row("critical".into())]);
        let plain = strip_str(&in_colour(&text)).to_string();
        assert_eq!(plain, "status\nok        x\ncritical  x");
        assert_eq!((style_of("critical").is_some(), style_of("R07")), (true, None));
    }

    #[test]
    fn a_terminal_obeys_the_program_and_no_name_of_a_file() {
        let named = "known  R00\u{1b}[31m_\u{7}\r\u{9b}2J\u{202e}.csv: run 1\nstored R01";
        let shown = "known  R00\\u{1b}[31m_\\u{7}\\r\\u{9b}2J\\u{202e}.csv: run 1\\nstored R01";
        assert_eq!(on_one_line(named), shown);
        let row = |name: &str| vec![name.to_owned(), "1".to_owned()];
        assert_eq!(table(&["name", "run"], &[row("a\nb")]), "name  run\na\\nb  1");
        let bold = AnsiColor::Red.on_default().bold();
        let styled = format!("a {}\n", in_style("critical", bold));
        assert_eq!(in_colour(&on_one_line(&styled)), format!("a {bold}critical{bold:#}\\n"));
        // the start character of this program's styles gives a name at most a colour
        assert_eq!(on_one_line("\u{fdd0}[2J\u{fdd0}"), "\\u{fdd0}[2J\\u{fdd0}");
    }
}
