//! A statement for PostgreSQL, whose parameters are numbered and typed.

use serde_json::Value;
use sqlx::{AssertSqlSafe, Executor, SqlSafeStr, Statement};

use super::asked::{QuestionAnswer, QuestionError, SqlQuestion};
use crate::engine::begin_reading;
use crate::handle::Store;
use crate::table::{AskError, ResultTable, cells, names};

/// Answers one statement that only reads.
pub(super) async fn answer(store: &Store, question: &SqlQuestion) -> Result<QuestionAnswer, QuestionError> {
    let (statement, null_parameters) = with_values(question)?;
    let text = || AssertSqlSafe(statement.clone()).into_sql_str();
    let failed = |error: sqlx::Error| match store.ask_error(&error) {
        AskError::Store(error) => QuestionError::Store(error),
        AskError::Statement(text) | AskError::NoView(text) => QuestionError::Statement(text),
    };
    let mut transaction = begin_reading(&store.readers).await.map_err(failed)?;
    let columns = names((&mut *transaction).prepare(text()).await.map_err(failed)?.columns());
    // COPY, VACUUM, SET and the like have none; some of them write files even in a read-only transaction
    if columns.is_empty() {
        return Err(QuestionError::Changes);
    }
    let rows = sqlx::query(text()).fetch_all(&mut *transaction).await.map_err(failed)?;
    let rows = rows.iter().map(cells).collect::<Result<_, _>>().map_err(failed)?;
    Ok(QuestionAnswer { table: ResultTable { columns, rows }, null_parameters })
}

/// The statement with its parameters, `:name`, replaced by literals, and the names of the NULL ones. A literal takes
/// the type of the value it is compared with, as in psql (`:'name'`); a bound value would need a type.
fn with_values(question: &SqlQuestion) -> Result<(String, Vec<String>), QuestionError> {
    let pieces = pieces(&question.statement)?;
    let mut names: Vec<String> = Vec::new();
    for piece in &pieces {
        if let StatementPart::Parameter(name) = piece
            && !names.iter().any(|known| known == name)
        {
            names.push((*name).to_owned());
        }
    }
    let (values, null_parameters) = question.values_of(&names)?;
    let literal_of = |name: &str| {
        let found = names.iter().position(|known| known == name).and_then(|place| values.get(place));
        literal(found.copied().unwrap_or(&Value::Null))
    };
    let filled = pieces.iter().map(|piece| match piece {
        StatementPart::Text(text) => (*text).to_owned(),
        StatementPart::Parameter(name) => literal_of(name),
    });
    Ok((filled.collect(), null_parameters))
}

/// A value as a literal, escaped independently of the settings of the server.
fn literal(value: &Value) -> String {
    let text = match value {
        Value::Null => return "NULL".into(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    format!(" E'{}'", text.replace('\\', "\\\\").replace('\'', "''"))
}

/// A part of a statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum StatementPart<'s> {
    Text(&'s str),
    /// Includes its colon.
    Parameter(&'s str),
}

/// Splits a statement at its parameters, by the tokens of PostgreSQL (its documentation, "Lexical Structure").
fn pieces(statement: &str) -> Result<Vec<StatementPart<'_>>, QuestionError> {
    let mut pieces = Vec::new();
    let (mut rest, mut before) = (statement, "");
    let (mut has_begun, mut has_ended) = (false, false);
    while let Some(first) = rest.chars().next() {
        let (length, is_said) = token(rest, first, before)?;
        let (taken, next) = rest.split_at_checked(length).unwrap_or((rest, ""));
        if first == ';' {
            has_ended = has_begun;
        } else if is_said {
            if has_ended {
                return Err(QuestionError::Several);
            }
            has_begun = true;
        }
        let is_parameter = first == ':' && taken.chars().nth(1).is_some_and(begins_name);
        pieces.push(if is_parameter { StatementPart::Parameter(taken) } else { StatementPart::Text(taken) });
        (rest, before) = (next, taken);
    }
    if has_begun { Ok(pieces) } else { Err(QuestionError::Empty) }
}

/// Length in bytes of the first token, which follows the token `before`, and true if it has a meaning: spaces, comments
/// and semicolons have none.
fn token(rest: &str, first: char, before: &str) -> Result<(usize, bool), QuestionError> {
    let after = rest.get(first.len_utf8()..).unwrap_or_default();
    let name = || rest.find(|c| !is_of_name(c)).unwrap_or(rest.len());
    Ok(match first {
        '-' if after.starts_with('-') => (rest.find('\n').unwrap_or(rest.len()), false),
        '/' if after.starts_with('*') => (comment(rest), false),
        '\'' => (quoted(rest, '\'', before.eq_ignore_ascii_case("e")), true),
        '"' => (quoted(rest, '"', false), true),
        '$' => {
            let tag = after.find(|c| !is_of_name(c) || c == '$').unwrap_or(after.len());
            if after.get(tag..).is_some_and(|next| next.starts_with('$')) {
                let mark = rest.get(..tag + 2).unwrap_or(rest);
                let inside = rest.get(mark.len()..).unwrap_or_default();
                (inside.find(mark).map_or(rest.len(), |end| end + 2 * mark.len()), true)
            } else {
                return Err(QuestionError::Nameless(rest.get(..=tag).unwrap_or("$").to_owned()));
            }
        }
        ':' if after.starts_with([':', '=']) => (2, true),
        ':' if after.starts_with(begins_name) => {
            (1 + after.find(|c| !is_of_name(c)).unwrap_or(after.len()), true)
        }
        // `E'...'` is a word of one letter and a text
        c if is_of_name(c) => (name(), true),
        c => (c.len_utf8(), !c.is_whitespace() && c != ';'),
    })
}

/// Length in bytes of a comment at the front, which may contain others.
fn comment(rest: &str) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while let Some(here) = rest.get(at..).filter(|here| !here.is_empty()) {
        if here.starts_with("/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if here.starts_with("*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                return at;
            }
        } else {
            at += here.chars().next().map_or(1, char::len_utf8);
        }
    }
    rest.len()
}

/// Length in bytes of a text or name in quotes at the front. Two quotes in a row end one text and begin another, which
/// the next call reads.
fn quoted(rest: &str, quote: char, has_escapes: bool) -> usize {
    let mut is_escaped = false;
    for (at, c) in rest.char_indices().skip(1) {
        match c {
            _ if is_escaped => is_escaped = false,
            '\\' if has_escapes => is_escaped = true,
            c if c == quote => {
                let end = at + 1;
                let again = rest.get(end..).unwrap_or_default();
                return match again.starts_with(quote) {
                    true => end + quoted(again, quote, has_escapes),
                    false => end,
                };
            }
            _ => {}
        }
    }
    rest.len()
}

fn begins_name(c: char) -> bool {
    c.is_ascii_alphabetic() || c == '_' || !c.is_ascii()
}

fn is_of_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '$' || !c.is_ascii()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(statement: &str, values: &[(&str, Value)]) -> Result<String, QuestionError> {
        let values = values.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        with_values(&SqlQuestion { statement: statement.into(), values }).map(|(filled, _)| filled)
    }

    #[test]
    fn parameters_become_literals_and_nothing_else_does() {
        let robot = [("robot", Value::from("O'N\\x"))];
        assert_eq!(filled("SELECT :robot", &robot).unwrap(), "SELECT  E'O''N\\\\x'");
        let untouched = "SELECT '1'::int, ':robot', E'\\':robot', 'it'':robot', \":robot\", $$:robot$$, $a$ $$ :robot $a$ \
                         -- :robot\n /* :robot /* */ :robot */, x[1:2]; ";
        assert_eq!(filled(untouched, &[]).unwrap(), untouched);
        let number = [("run", Value::from(3))];
        assert_eq!(filled("WHERE a=:run OR b=:run", &number).unwrap(), "WHERE a= E'3' OR b= E'3'");
    }

    #[test]
    fn one_statement_is_told_from_none_and_several() {
        for empty in ["", ";", "-- x", "/* /* */ */ ;"] {
            assert!(matches!(filled(empty, &[]), Err(QuestionError::Empty)), "{empty}");
        }
        assert!(matches!(filled("SELECT 1; SELECT 2", &[]), Err(QuestionError::Several)));
        assert!(filled("; SELECT ';' ; -- x", &[]).is_ok());
        assert!(matches!(filled("SELECT $1", &[]), Err(QuestionError::Nameless(name)) if name == "$1"));
        let without = SqlQuestion { statement: "SELECT :a".into(), ..SqlQuestion::default() };
        assert_eq!(with_values(&without).unwrap(), ("SELECT NULL".to_owned(), vec![":a".to_owned()]));
    }
}
