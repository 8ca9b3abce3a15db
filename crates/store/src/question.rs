//! One statement of a person with values for its parameters, which only reads.
//!
//! A statement for a file of SQLite has a separate read-only connection. Rusqlite determines if a text is one
//! statement, which parameters it has, and if it may change something (<https://sqlite.org/c3ref/stmt_readonly.html>).
//! A statement for a server runs in a read-only transaction, over the protocol that accepts one statement.

mod asked;
mod on_server;

use std::path::Path;
use std::time::Duration;

use rusqlite::limits::Limit;
use rusqlite::{Connection, ErrorCode, OpenFlags, Statement};

pub use self::asked::{QuestionAnswer, QuestionError, SqlQuestion};
use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::public_sql::{Parameter, cell, place};
use super::table::ResultTable;
use super::write_ahead_log;

/// Longest wait of a statement for a locked database, as for other readers.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

impl Store {
    /// Answers one statement that only reads. Nothing is changed, and no file is written.
    ///
    /// # Errors
    /// [`QuestionError`].
    pub async fn ask_one(&self, question: &SqlQuestion) -> Result<QuestionAnswer, QuestionError> {
        match self.dialect() {
            Dialect::Sqlite => {
                let (path, question) = (self.path.clone(), question.clone());
                let answered = tokio::task::spawn_blocking(move || answer_of_file(&path, &question)).await;
                answered.unwrap_or_else(|error| {
                    let (path, detail) = (self.path.to_path_buf(), error.to_string());
                    Err(StoreError::Other { path, detail }.into())
                })
            }
            Dialect::Postgres => on_server::answer(self, question).await,
        }
    }
}

fn answer_of_file(path: &Path, question: &SqlQuestion) -> Result<QuestionAnswer, QuestionError> {
    let connection = connect(path).map_err(|error| StoreError::from_rusqlite(path, &error))?;
    let failed = |error: rusqlite::Error| of_statement(path, &question.statement, &error);
    let mut statement = connection.prepare(&question.statement).map_err(failed)?;
    check(&statement)?;
    let names = parameters(&statement)?;
    let (values, null_parameters) = question.values_of(&names)?;
    for (place, value) in values.into_iter().enumerate() {
        statement.raw_bind_parameter(place + 1, Parameter(value)).map_err(failed)?;
    }
    let columns: Vec<String> = statement.column_names().into_iter().map(str::to_owned).collect();
    let mut rows = statement.raw_query();
    let mut table = ResultTable { columns, rows: Vec::new() };
    while let Some(row) = rows.next().map_err(failed)? {
        let cells = (0..table.columns.len()).map(|column| row.get_ref(column).map(cell));
        table.rows.push(cells.collect::<Result<_, _>>().map_err(failed)?);
    }
    Ok(QuestionAnswer { table, null_parameters })
}

/// A connection that reads a database in a file and changes nothing.
pub(super) fn connect(path: &Path) -> Result<Connection, rusqlite::Error> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let opened = Connection::open_with_flags(path, flags).and_then(ready);
    // as in opening the store: if SQLite may not create files next to a database and no program has it open, the file
    // alone is complete
    match (opened, path.to_str()) {
        (Err(error), Some(name)) if may_not_write(&error) && !write_ahead_log::has_commits(path) => {
            let name = name.replace('%', "%25").replace('?', "%3f").replace('#', "%23");
            let address = format!("file:{name}?immutable=1");
            Connection::open_with_flags(address, flags | OpenFlags::SQLITE_OPEN_URI).and_then(ready)
        }
        (opened, _) => opened,
    }
}

fn may_not_write(error: &rusqlite::Error) -> bool {
    matches!(
        error.sqlite_error_code(),
        Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly | ErrorCode::PermissionDenied)
    )
}

/// A readable connection that no statement can make write.
fn ready(connection: Connection) -> Result<Connection, rusqlite::Error> {
    connection.busy_timeout(BUSY_TIMEOUT)?;
    connection.pragma_update(None, "query_only", true)?;
    connection.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
    connection.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(()))?;
    Ok(connection)
}

/// Refuses an empty text, and a statement that does more than reading. A statement without columns, such as ATTACH or
/// BEGIN, changes the connection or a file even if SQLite counts it as reading.
fn check(statement: &Statement<'_>) -> Result<(), QuestionError> {
    // SQLite makes no statement of a text without one
    if statement.expanded_sql().is_none() {
        return Err(QuestionError::Empty);
    }
    match statement.readonly() && statement.column_count() > 0 {
        true => Ok(()),
        false => Err(QuestionError::Changes),
    }
}

/// Names of the parameters with their first character, in order.
fn parameters(statement: &Statement<'_>) -> Result<Vec<String>, QuestionError> {
    let name = |place| match statement.parameter_name(place) {
        Some(name) if !name.starts_with('?') => Ok(name.to_owned()),
        other => Err(QuestionError::Nameless(other.unwrap_or("?").to_owned())),
    };
    (1..=statement.parameter_count()).map(name).collect()
}

/// Converts a failure of a statement to an error for the caller.
fn of_statement(path: &Path, statement: &str, error: &rusqlite::Error) -> QuestionError {
    match error {
        rusqlite::Error::SqlInputError { msg, offset, .. } => {
            QuestionError::Statement(match usize::try_from(*offset) {
                Ok(offset) => {
                    let (line, column) = place(statement, offset);
                    format!("line {line}, column {column}: {msg}")
                }
                Err(_) => msg.clone(),
            })
        }
        rusqlite::Error::MultipleStatement => QuestionError::Several,
        rusqlite::Error::ToSqlConversionFailure(reason) => QuestionError::Statement(reason.to_string()),
        rusqlite::Error::SqliteFailure(of, message) => match of.code {
            ErrorCode::ReadOnly => QuestionError::Changes,
            ErrorCode::Unknown
            | ErrorCode::TooBig
            | ErrorCode::TypeMismatch
            | ErrorCode::ParameterOutOfRange => {
                QuestionError::Statement(message.clone().unwrap_or_else(|| of.to_string()))
            }
            _ => StoreError::from_rusqlite(path, error).into(),
        },
        error => StoreError::from_rusqlite(path, error).into(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    fn database() -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a?b#1%.db");
        let made = Connection::open(&path).unwrap();
        made.execute_batch(
            "CREATE TABLE test (robot TEXT, run_id INTEGER, level REAL);
             INSERT INTO test VALUES ('Left', 1, 0.5), ('Right', 2, 1.5);",
        )
        .unwrap();
        (folder, path)
    }

    fn ask(path: &Path, statement: &str, values: &[(&str, Value)]) -> Result<ResultTable, QuestionError> {
        let values = values.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        answer_of_file(path, &SqlQuestion { statement: statement.into(), values }).map(|answer| answer.table)
    }

    #[test]
    fn one_statement_that_reads_is_answered() {
        let (_folder, path) = database();
        for one in [
            "SELECT run_id FROM test WHERE robot = 'Left';",
            "-- why\nSELECT 1 /* one */ ; ; -- no more;",
            "WITH a AS (SELECT 1 AS x) SELECT x FROM a",
            "VALUES (1)",
            "; SELECT 1",
        ] {
            let table = ask(&path, one, &[]).unwrap_or_else(|error| panic!("{one}: {error}"));
            assert_eq!(table.rows, [[Value::from(1)]], "{one}");
        }
        assert_eq!(ask(&path, "PRAGMA table_info(test)", &[]).unwrap().rows.len(), 3);
        assert!(!ask(&path, "EXPLAIN QUERY PLAN SELECT * FROM test", &[]).unwrap().rows.is_empty());
    }

    #[test]
    fn what_changes_something_or_writes_a_file_is_refused() {
        let (folder, path) = database();
        let other = folder.path().join("other.db");
        let other = other.to_str().unwrap();
        for changes in [
            format!("VACUUM INTO '{other}'").as_str(),
            format!("ATTACH '{other}' AS other").as_str(),
            "DELETE FROM test",
            "DELETE FROM test RETURNING run_id",
            "CREATE TEMP TABLE x (y)",
            "BEGIN",
            "PRAGMA journal_mode = WAL",
            "PRAGMA wal_checkpoint(TRUNCATE)",
        ] {
            let refused = ask(&path, changes, &[]);
            assert!(matches!(refused, Err(QuestionError::Changes)), "{changes}: {refused:?}");
        }
        for several in [
            "SELECT 1; SELECT 2",
            format!("SELECT 1; VACUUM INTO '{other}'").as_str(),
            "SELECT 1;/**/DELETE FROM test",
        ] {
            let refused = ask(&path, several, &[]);
            assert!(matches!(refused, Err(QuestionError::Several)), "{several}: {refused:?}");
        }
        for empty in ["", " \n", ";", "-- nothing", "/* nothing */ ;"] {
            let refused = ask(&path, empty, &[]);
            assert!(matches!(refused, Err(QuestionError::Empty)), "{empty:?}: {refused:?}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(ask(&path, "SELECT * FROM test", &[]).unwrap().rows.len(), 2);
    }

    #[test]
    fn parameters_have_values_by_name_or_are_named() {
        let (_folder, path) = database();
        let statement = "SELECT run_id FROM test WHERE robot = :robot AND level > @level AND level > $level";
        let given = [("robot", Value::from("Right")), ("level", Value::from(1))];
        assert_eq!(ask(&path, statement, &given).unwrap().rows, [[Value::from(2)]]);

        let too_many = [&given[..], &[("joint", Value::from(1))]].concat();
        let said = ask(&path, statement, &too_many).unwrap_err().to_string();
        assert!(said.contains("no parameter joint") && said.contains(":robot, @level"), "{said}");
        let said = ask(&path, "SELECT 1", &given[..1]).unwrap_err().to_string();
        assert!(said.contains("write :robot"), "{said}");
        let twice = [&given[..], &given[..1]].concat();
        assert!(matches!(ask(&path, statement, &twice), Err(QuestionError::Twice(_))));
        for nameless in ["SELECT ?", "SELECT ?1"] {
            assert!(matches!(ask(&path, nameless, &[]), Err(QuestionError::Nameless(_))), "{nameless}");
        }

        let statement =
            "SELECT count(*) FROM test WHERE robot = coalesce(:robot, robot) AND level > :level".into();
        let question = SqlQuestion { statement, values: vec![("level".into(), Value::from(0))] };
        let answer = answer_of_file(&path, &question).unwrap();
        assert_eq!(
            (answer.table.rows, answer.null_parameters),
            (vec![vec![Value::from(2)]], vec![":robot".into()])
        );
    }

    #[test]
    fn a_wrong_statement_is_told_with_its_place() {
        let (_folder, path) = database();
        let said = ask(&path, "SELECT robot,\n  missing FROM test", &[]).unwrap_err().to_string();
        assert_eq!(said, "line 2, column 3: no such column: missing");
    }
}
