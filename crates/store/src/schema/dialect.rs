//! Statements of `migrations/`, which are written for SQLite, converted to the SQL of either engine.

use std::borrow::Cow;

use crate::engine::Dialect;

/// A statement that creates or changes something.
#[derive(Debug)]
pub(super) struct Statement {
    /// Name of the object that the statement creates, the word after `TABLE`, `INDEX`, `TRIGGER` or `VIEW`; empty for
    /// other statements.
    pub name: String,
    /// In the SQL of the engine.
    pub sql: String,
    /// Columns that repeat a time as text, with the column of the time.
    texts: Vec<(String, String)>,
}

/// Parts of a column definition around the name of the time that the column repeats as text.
const TEXT_OF_TIME: [&str; 2] = [" GENERATED ALWAYS AS (time_text(", ")) STORED"];

/// The statements of a file. A statement ends with `;` at the end of a line, a trigger with the line `END;`. Comments
/// between statements are skipped.
pub(super) fn statements(text: &str, engine: Dialect) -> Vec<Statement> {
    let mut found = Vec::new();
    let mut statement = String::new();
    for line in text.lines() {
        if statement.is_empty() && (line.is_empty() || line.starts_with("--")) {
            continue;
        }
        statement.push_str(line);
        let ends = match statement.starts_with("CREATE TRIGGER ") {
            true => line == "END;",
            false => line.ends_with(';'),
        };
        if ends {
            found.push(translated(&statement, engine));
            statement.clear();
        } else {
            statement.push('\n');
        }
    }
    found
}

fn translated(statement: &str, engine: Dialect) -> Statement {
    let mut words = statement.split_whitespace();
    let name = words.find(|word| ["TABLE", "INDEX", "TRIGGER", "VIEW"].contains(word)).and(words.next());
    let name = name.unwrap_or_default().to_owned();
    let (sql, texts) = match engine {
        Dialect::Sqlite => without_texts_of_times(statement),
        Dialect::Postgres => (for_server(statement), Vec::new()),
    };
    Statement { name, sql, texts }
}

/// Removes generated columns: SQLite has them, but DuckDB does not see them.
fn without_texts_of_times(statement: &str) -> (String, Vec<(String, String)>) {
    let [before, after] = TEXT_OF_TIME;
    let mut texts = Vec::new();
    let line = |line: &str| {
        let Some((column, rest)) = line.split_once(before) else { return line.to_owned() };
        let Some((time, rest)) = rest.split_once(after) else { return line.to_owned() };
        let name = column.split_whitespace().next().unwrap_or_default();
        texts.push((name.to_owned(), time.to_owned()));
        format!("{column}{rest}")
    };
    let lines: Vec<String> = statement.lines().map(line).collect();
    (lines.join("\n"), texts)
}

/// Triggers of SQLite that fill the columns of a table which repeat a time as text.
pub(super) fn times_as_text(table: &Statement) -> Vec<Statement> {
    if table.texts.is_empty() {
        return Vec::new();
    }
    let of = &table.name;
    let set = |(text, time): &(String, String)| {
        format!("{text} = strftime('%Y-%m-%dT%H:%M:%fZ', NEW.{time} / 1000000.0, 'unixepoch')")
    };
    let set: Vec<String> = table.texts.iter().map(set).collect();
    let times: Vec<&str> = table.texts.iter().map(|(_, time)| time.as_str()).collect();
    let events = [("as_text", "INSERT".to_owned()), ("change", format!("UPDATE OF {}", times.join(", ")))];
    let trigger = |(end, event): &(&str, String)| {
        let (name, set) = (format!("{of}_times_{end}"), set.join(", "));
        let sql = format!(
            "CREATE TRIGGER {name} AFTER {event} ON {of}\nBEGIN\n    UPDATE {of} SET {set} WHERE rowid = NEW.rowid;\nEND;"
        );
        Statement { name, sql, texts: Vec::new() }
    };
    events.iter().map(trigger).collect()
}

fn for_server(statement: &str) -> String {
    let statement = statement.replace("--server ", "");
    let first: Vec<&str> = statement.split_whitespace().take(2).collect();
    match first.as_slice() {
        ["CREATE" | "ALTER", "TABLE"] => {
            let lines: Vec<String> = statement.lines().map(|line| with_types(&column(line))).collect();
            lines.join("\n")
        }
        ["CREATE", "TRIGGER"] => trigger(&statement).unwrap_or(statement),
        ["CREATE", "VIEW"] => statement.replace("group_concat(", "string_agg("),
        _ => statement.replace(" COLLATE BINARY", ""),
    }
}

/// Converts a line of a table, except for its types. Flags become booleans, a key of a table counts up, and the options
/// of the table are dropped.
fn column(line: &str) -> Cow<'_, str> {
    if let Some(end) = line.find(" IN (0, 1))")
        && let Some(begin) = line[..end].rfind(" CHECK (")
    {
        let flag = format!("{}{}", &line[..begin], &line[end + " IN (0, 1))".len()..]);
        let flag = flag.replace(" INTEGER", " boolean");
        return flag.replace("DEFAULT 0", "DEFAULT FALSE").replace("DEFAULT 1", "DEFAULT TRUE").into();
    }
    if line.contains(" INTEGER PRIMARY KEY") && !line.contains("REFERENCES") && !line.contains("CHECK") {
        let line = line.replace(" AUTOINCREMENT", "");
        return line.replace(" PRIMARY KEY", " GENERATED BY DEFAULT AS IDENTITY PRIMARY KEY").into();
    }
    match line.starts_with(") STRICT") {
        true => ");".into(),
        false => line.into(),
    }
}

/// Converts names of types, outside texts and comments. Texts compare by their bytes, as in SQLite.
fn with_types(line: &str) -> String {
    let (code, comment) = line.split_at(line.find("--").unwrap_or(line.len()));
    let mut result = String::with_capacity(2 * line.len());
    for (place, part) in code.split('\'').enumerate() {
        if place > 0 {
            result.push('\'');
        }
        // every second part is within quotes
        if place % 2 == 1 {
            result.push_str(part);
            continue;
        }
        for word in part.split_inclusive(|c: char| !c.is_ascii_alphanumeric() && c != '_') {
            let end = word.trim_end_matches(|c: char| !c.is_ascii_alphanumeric() && c != '_').len();
            result.push_str(match &word[..end] {
                "INTEGER" => "bigint",
                "REAL" => "double precision",
                "TEXT" => "text COLLATE \"C\"",
                "BLOB" => "bytea",
                other => other,
            });
            result.push_str(&word[end..]);
        }
    }
    result + comment
}

/// Converts a trigger to one with a function. PostgreSQL allows no query in the condition, so the function checks the
/// condition then.
fn trigger(statement: &str) -> Option<String> {
    let (name, rest) = statement.strip_prefix("CREATE TRIGGER ")?.split_once(char::is_whitespace)?;
    let (head, body) = rest.split_once("\nBEGIN\n")?;
    let body = body.strip_suffix("\nEND;")?;
    let (event, condition) = match head.split_once("\nWHEN ") {
        Some((event, condition)) => (event, Some(condition)),
        None => (head, None),
    };
    let (when, body) = match condition {
        Some(query) if query.contains("SELECT") => {
            (String::new(), format!("    IF {query} THEN\n{body}\n    END IF;"))
        }
        Some(condition) => (format!("\nWHEN ({condition})"), body.to_owned()),
        None => (String::new(), body.to_owned()),
    };
    let result = if event.starts_with("BEFORE DELETE") { "OLD" } else { "NULL" };
    Some(format!(
        "CREATE FUNCTION {name}() RETURNS trigger LANGUAGE plpgsql AS $$\nBEGIN\n{body}\n    RETURN {result};\nEND $$;\n\
         CREATE TRIGGER {name} {event}\nFOR EACH ROW{when}\nEXECUTE FUNCTION {name}();"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn server(text: &str) -> String {
        statements(text, Dialect::Postgres).remove(0).sql
    }

    #[test]
    fn tables_get_the_types_of_the_server() {
        let table = "-- Robots.\nCREATE TABLE robot (\n    robot_id INTEGER PRIMARY KEY AUTOINCREMENT,\n\
             \x20   -- TEXT in a comment\n    name TEXT NOT NULL DEFAULT 'REAL',\n    torque REAL,\n    hash BLOB CHECK (length(hash) = 32),\n\
             \x20   watched INTEGER NOT NULL DEFAULT 0 CHECK (watched IN (0, 1)),\n    run_id INTEGER PRIMARY KEY REFERENCES run,\n\
             \x20   seen_at INTEGER NOT NULL,\n    seen_at_text TEXT GENERATED ALWAYS AS (time_text(seen_at)) STORED\n) STRICT, WITHOUT ROWID;\n";
        assert_eq!(
            server(table),
            "CREATE TABLE robot (\n    robot_id bigint GENERATED BY DEFAULT AS IDENTITY PRIMARY KEY,\n\
             \x20   -- TEXT in a comment\n    name text COLLATE \"C\" NOT NULL DEFAULT 'REAL',\n    torque double precision,\n\
             \x20   hash bytea CHECK (length(hash) = 32),\n    watched boolean NOT NULL DEFAULT FALSE,\n\
             \x20   run_id bigint PRIMARY KEY REFERENCES run,\n    seen_at bigint NOT NULL,\n\
             \x20   seen_at_text text COLLATE \"C\" GENERATED ALWAYS AS (time_text(seen_at)) STORED\n);"
        );
        let of_file = statements(table, Dialect::Sqlite).remove(0);
        assert_eq!(of_file.name, "robot");
        assert!(of_file.sql.contains("    seen_at_text TEXT\n"), "{}", of_file.sql);
        let names: Vec<_> = times_as_text(&of_file).into_iter().map(|trigger| trigger.name).collect();
        assert_eq!(names, ["robot_times_as_text", "robot_times_change"]);
    }

    #[test]
    fn a_column_that_is_added_gets_the_type_of_the_server() {
        let added =
            "ALTER TABLE robot ADD COLUMN spare INTEGER NOT NULL DEFAULT 0 CHECK (spare IN (0, 1));\n";
        assert_eq!(server(added), "ALTER TABLE robot ADD COLUMN spare boolean NOT NULL DEFAULT FALSE;");
    }

    #[test]
    fn a_trigger_becomes_a_function_and_its_trigger() {
        let text = "CREATE TRIGGER goes AFTER DELETE ON run\nWHEN OLD.status = 'x'\nBEGIN\n    DELETE FROM y;\nEND;\n";
        assert_eq!(
            server(text),
            "CREATE FUNCTION goes() RETURNS trigger LANGUAGE plpgsql AS $$\nBEGIN\n    DELETE FROM y;\n    RETURN NULL;\n\
             END $$;\nCREATE TRIGGER goes AFTER DELETE ON run\nFOR EACH ROW\nWHEN (OLD.status = 'x')\nEXECUTE FUNCTION goes();"
        );
        let asked = "CREATE TRIGGER asks BEFORE DELETE ON run\nWHEN EXISTS (SELECT 1 FROM z)\nBEGIN\n    DELETE FROM y;\nEND;\n";
        let asked = server(asked);
        assert!(asked.contains(
            "    IF EXISTS (SELECT 1 FROM z) THEN\n    DELETE FROM y;\n    END IF;\n    RETURN OLD;"
        ));
        assert!(!asked.contains("WHEN"), "{asked}");
    }

    #[test]
    fn every_statement_has_a_name_of_its_own() {
        for engine in [Dialect::Sqlite, Dialect::Postgres] {
            let texts = [super::super::TABLES, &super::super::DERIVED.concat()].concat();
            let mut names: Vec<String> = statements(&texts, engine).into_iter().map(|of| of.name).collect();
            let count = names.len();
            names.sort();
            names.dedup();
            assert!(names.len() == count && !names.contains(&String::new()), "{names:?}");
        }
    }
}
