//! Names in a statement that SQLite's authoriser cannot distinguish from those of the database: tables of WITH.
//!
//! SQLite reports the view that reads a table by its name in the statement, and a table of WITH may have the name of a
//! view. This module therefore finds these names, with the same tokens as SQLite (`tokenize.c`).

use std::collections::{BTreeMap, BTreeSet};

/// First word of a statement, and the names of its tables of WITH, in lower case.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Names {
    pub(super) first: Option<String>,
    pub(super) with: BTreeSet<String>,
    /// Minimum of the statement's tokens after SQLite has replaced each name of a table of WITH by the table. It does
    /// so while it prepares a statement, when nothing can stop it.
    pub(super) expanded: usize,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum SqlToken {
    /// A name or a keyword.
    Word(String),
    /// A name in quotes, or a text: SQLite accepts each as the other.
    Quoted(String),
    Open,
    Close,
    Other,
}

impl SqlToken {
    fn is(&self, keyword: &str) -> bool {
        matches!(self, Self::Word(word) if word == keyword)
    }
}

impl Names {
    /// Reads a statement. Finds every name that may be a table of WITH, including doubtful ones.
    ///
    /// # Errors
    /// A sentence on characters that a statement must not contain.
    pub(super) fn of(statement: &str) -> Result<Self, String> {
        let tokens = tokens(statement)?;
        let first = match tokens.first() {
            Some(SqlToken::Word(word)) => Some(word.clone()),
            _ => None,
        };
        let tables: Vec<(String, &[SqlToken])> =
            (0..tokens.len()).filter_map(|at| table_of_with(tokens.get(at..)?)).collect();
        let expanded = Expansion { tables: &tables, known: BTreeMap::new() }.of(&tokens);
        let with = tables.into_iter().map(|(name, _)| name).collect();
        Ok(Self { first, with, expanded })
    }
}

/// Lengths of tables of WITH after expansion of the names in them.
struct Expansion<'t> {
    tables: &'t [(String, &'t [SqlToken])],
    /// `None` while a table is being expanded: one that names itself is inserted once.
    known: BTreeMap<String, Option<usize>>,
}

impl Expansion<'_> {
    fn of(&mut self, tokens: &[SqlToken]) -> usize {
        let mut sum = tokens.len();
        for token in tokens {
            let (SqlToken::Word(name) | SqlToken::Quoted(name)) = token else { continue };
            if self.tables.iter().any(|(table, _)| table == name) {
                sum = sum.saturating_add(self.of_table(name));
            }
        }
        sum
    }

    fn of_table(&mut self, name: &str) -> usize {
        if let Some(known) = self.known.get(name) {
            return known.unwrap_or(0);
        }
        self.known.insert(name.to_owned(), None);
        let tables = self.tables;
        let bodies = tables.iter().filter(|(table, _)| table == name);
        let sum = bodies.fold(0_usize, |sum, (_, body)| sum.saturating_add(self.of(body)));
        self.known.insert(name.to_owned(), Some(sum));
        sum
    }
}

/// The name and the body at the front of `NAME [(COLUMNS)] AS [[NOT] MATERIALIZED] (BODY)`.
fn table_of_with(tokens: &[SqlToken]) -> Option<(String, &[SqlToken])> {
    let (SqlToken::Word(name) | SqlToken::Quoted(name), mut rest) = tokens.split_first()? else {
        return None;
    };
    if rest.first() == Some(&SqlToken::Open) {
        let columns = rest.iter().position(|token| *token == SqlToken::Close)?;
        rest = rest.get(columns + 1..)?;
    }
    rest = rest.strip_prefix(&[SqlToken::Word("as".into())])?;
    while rest.first().is_some_and(|token| token.is("not") || token.is("materialized")) {
        rest = rest.get(1..)?;
    }
    (rest.first() == Some(&SqlToken::Open)).then(|| (name.clone(), within(rest)))
}

/// Tokens between the bracket at the front and the matching one.
fn within(tokens: &[SqlToken]) -> &[SqlToken] {
    let mut depth = 0_usize;
    let end = tokens.iter().position(|token| {
        match token {
            SqlToken::Open => depth += 1,
            SqlToken::Close => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth == 0
    });
    tokens.get(1..end.unwrap_or(tokens.len())).unwrap_or_default()
}

fn tokens(statement: &str) -> Result<Vec<SqlToken>, String> {
    const BYTE_ORDER_MARK: char = '\u{feff}';
    let mut tokens = Vec::new();
    let mut rest = statement;
    while let Some(first) = rest.chars().next() {
        let after = rest.get(first.len_utf8()..).unwrap_or_default();
        rest = match first {
            ' ' | '\t' | '\n' | '\x0c' | '\r' | BYTE_ORDER_MARK => after,
            '-' if after.starts_with('-') => after.split_once('\n').map_or("", |(_, next)| next),
            '/' if after.starts_with('*') => {
                after.get(1..).and_then(|inside| inside.split_once("*/")).map_or("", |(_, next)| next)
            }
            '\'' | '"' | '`' | '[' => {
                let (name, next) = quoted(after, first);
                tokens.push(SqlToken::Quoted(name));
                next
            }
            // the text after such a parameter may contain a quote
            '$' | '@' | '#' | ':' => return Err("write parameters as ?1, ?2, ...".into()),
            '\0' => return Err("a statement has no character 0".into()),
            '(' => {
                tokens.push(SqlToken::Open);
                after
            }
            ')' => {
                tokens.push(SqlToken::Close);
                after
            }
            _ if is_of_name(first) => {
                let end = rest.find(|c| !is_of_name(c)).unwrap_or(rest.len());
                let (word, next) = rest.split_at(end);
                tokens.push(SqlToken::Word(word.to_ascii_lowercase()));
                next
            }
            _ => {
                tokens.push(SqlToken::Other);
                after
            }
        };
    }
    Ok(tokens)
}

/// The text in quotes, and the rest; a doubled quote is one quote in the text.
fn quoted(text: &str, quote: char) -> (String, &str) {
    if quote == '[' {
        let (name, next) = text.split_once(']').unwrap_or((text, ""));
        return (name.to_ascii_lowercase(), next);
    }
    let (mut name, mut rest) = (String::new(), text);
    while let Some((part, next)) = rest.split_once(quote) {
        name.push_str(part);
        match next.strip_prefix(quote) {
            Some(more) => {
                name.push(quote);
                rest = more;
            }
            None => return (name.to_ascii_lowercase(), next),
        }
    }
    name.push_str(rest);
    (name.to_ascii_lowercase(), "")
}

fn is_of_name(character: char) -> bool {
    character.is_ascii_alphanumeric() || character == '_' || character == '$' || !character.is_ascii()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(statement: &str) -> Vec<String> {
        Names::of(statement).unwrap().with.into_iter().collect()
    }

    #[test]
    fn tables_of_with_are_found_however_they_are_written() {
        for one in [
            "WITH runs AS (SELECT 1) SELECT 2",
            "with RUNS as(select 1) select 2",
            "WITH RECURSIVE runs(a, b) AS NOT MATERIALIZED (SELECT 1, 2) SELECT 2",
            "WITH \"runs\" AS MATERIALIZED (SELECT 1) SELECT 2",
            "WITH [Runs] AS /* ( */ (SELECT 1) SELECT 2",
            "WITH 'runs' -- not this '\n AS (SELECT 1) SELECT 2",
            "SELECT * FROM (WITH `runs` AS (SELECT 1) SELECT 2)",
            "WITH \u{feff}runs AS (SELECT 1) SELECT 2",
        ] {
            assert_eq!(with(one), ["runs"], "{one}");
        }
        assert_eq!(
            with("SELECT 1 AS runs, 'x AS (' AS y, cast(a AS text) FROM runs AS r -- x AS ("),
            [""; 0]
        );
        assert_eq!(with("WITH a AS (SELECT 'it''s'), b AS (SELECT 1) SELECT 2"), ["a", "b"]);
    }

    #[test]
    fn what_is_put_in_is_counted() {
        let expanded = |statement: &str| Names::of(statement).unwrap().expanded;
        assert_eq!(expanded("SELECT 1, 2"), 4);
        let names: Vec<String> =
            (1..200).map(|i| format!("a{i} AS (SELECT x.c FROM a{0} x, a{0} y)", i - 1)).collect();
        assert_eq!(expanded(&format!("WITH a0 AS (SELECT 1), {} SELECT 1", names.join(", "))), usize::MAX);
        let own = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT * FROM n";
        assert!(expanded(own) < 100, "{}", expanded(own));
    }

    #[test]
    fn what_could_hide_a_name_is_refused() {
        for hidden in ["SELECT $a(') FROM runs", "SELECT :a", "SELECT @a", "SELECT #a", "SELECT \0"] {
            assert!(Names::of(hidden).is_err(), "{hidden}");
        }
        assert_eq!(Names::of("/* why */ SELECT ?1, '$a'").unwrap().first.as_deref(), Some("select"));
    }
}
