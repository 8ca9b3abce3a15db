//! The public views: their names as values of arguments, and the meaning of their columns.

use clap::builder::PossibleValuesParser;
use serde_json::Value;

use super::output;
use armwatch_store::{PublicView, ResultTable, ViewColumn, public_views};

/// Characters per line of text.
const LINE: usize = 100;

/// The public views, as values of an argument.
pub(in crate::cli) fn view_names() -> PossibleValuesParser {
    PossibleValuesParser::new(public_views().iter().map(|view| view.name.as_str()))
}

/// The public view of this name.
pub(in crate::cli) fn view(name: &str) -> Option<&'static PublicView> {
    public_views().iter().find(|view| view.name == name)
}

/// All views, each with the meaning of a row.
pub(in crate::cli) fn list() -> ResultTable {
    let row = |view: &PublicView| [&view.name, &view.row_is].map(|text| Value::from(text.as_str())).into();
    ResultTable {
        columns: ["view_name", "row_is"].map(str::to_owned).into(),
        rows: public_views().iter().map(row).collect(),
    }
}

/// The columns of a view, as listed in the view `view_columns`.
pub(in crate::cli) fn columns(view: &PublicView) -> ResultTable {
    let names = ["view_name", "column_name", "position", "type", "unit", "nullable", "null_when", "meaning"];
    let row = |(place, column): (usize, &ViewColumn)| {
        vec![
            view.name.as_str().into(),
            column.name.as_str().into(),
            place.into(),
            column.kind.as_str().into(),
            column.unit.as_deref().into(),
            i64::from(column.null_when.is_some()).into(),
            column.null_when.as_deref().into(),
            column.meaning.as_str().into(),
        ]
    };
    ResultTable {
        columns: names.map(str::to_owned).into(),
        rows: (1..).zip(&view.columns).map(row).collect(),
    }
}

/// All views for people.
pub(in crate::cli) fn told() -> String {
    let width = public_views().iter().map(|view| view.name.len()).max().unwrap_or(0);
    let line = |view: &PublicView| hanging(&format!("{:width$}", view.name), &view.row_is);
    public_views().iter().map(line).collect::<Vec<_>>().join("\n")
}

/// The columns of a view for people.
pub(in crate::cli) fn columns_told(view: &PublicView) -> String {
    let head = |column: &ViewColumn| {
        vec![column.name.clone(), column.kind.clone(), column.unit.clone().unwrap_or_else(|| "-".into())]
    };
    let table =
        output::table(&["column", "type", "unit"], &view.columns.iter().map(head).collect::<Vec<_>>());
    let width = table.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    let meaning = |column: &ViewColumn| match &column.null_when {
        Some(when) => format!("{}; NULL {when}", column.meaning),
        None => column.meaning.clone(),
    };
    let meanings = std::iter::once("meaning".to_owned()).chain(view.columns.iter().map(meaning));
    let line = |(head, meaning): (&str, String)| hanging(&format!("{head:width$}"), &meaning);
    let lines: Vec<String> = table.lines().zip(meanings).map(line).collect();
    format!("{}: a row is {}\n\n{}", view.name, view.row_is, lines.join("\n"))
}

/// Text after a head, in lines that begin below the first word.
fn hanging(head: &str, words: &str) -> String {
    let margin = head.chars().count() + 2;
    let (mut text, mut length) = (format!("{head}  "), margin);
    for (place, word) in words.split_whitespace().enumerate() {
        let characters = word.chars().count();
        if place > 0 && length + 1 + characters > LINE {
            text.push_str(&format!("\n{:margin$}", ""));
            length = margin;
        } else if place > 0 {
            text.push(' ');
            length += 1;
        }
        text.push_str(word);
        length += characters;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_go_on_under_the_first_one() {
        let told = hanging("rows", &"word ".repeat(40));
        let lines: Vec<&str> = told.lines().collect();
        assert!(lines.len() == 3 && lines.iter().all(|line| line.len() <= LINE), "{told}");
        assert!(lines[0].starts_with("rows  word") && lines[1].starts_with("      word"), "{told}");
    }
}
