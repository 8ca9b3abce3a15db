//! Untrusted statements of people and programs: they can only read the public views, within limits.
//!
//! Each statement has a separate read-only connection. SQLite asks an authoriser while it prepares the statement
//! (<https://sqlite.org/c3ref/set_authorizer.html>). Limits bound the values that a statement may build, and a handler
//! stops it at its time limit. The rest of the program uses other connections.

mod long_texts;
mod names;

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rusqlite::hooks::{AuthAction, AuthContext, Authorization};
use rusqlite::limits::Limit;
use rusqlite::types::{ToSqlOutput, Value as SqlValue, ValueRef};
use rusqlite::{Connection, ErrorCode, OpenFlags, ToSql, params_from_iter};
use serde_json::Value;

use self::names::Names;
use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::table::{ResultTable, hexadecimal};

/// Longest statement, bytes.
const LONGEST_STATEMENT: usize = 16 << 10;

/// Most tokens of a statement after expansion of the tables of WITH. For a longer one, SQLite uses memory and time
/// before its first step, and none of its limits bounds that.
const MOST_TOKENS: usize = 4000;

/// Longest wait of a statement for a locked database. Readers hardly ever wait if there is a write-ahead log.
const BUSY_TIMEOUT: Duration = Duration::from_secs(2);

/// Instructions of SQLite's virtual machine between two checks of the clock, some ten microseconds.
const STEPS_BETWEEN_LOOKS: i32 = 1000;

/// Limits of a statement: bytes of one value, depth of expressions, arms of `UNION`, instructions, length of a pattern,
/// no attached database, no further thread. SQLite compares a pattern with each place of a value, and nothing can stop
/// it during that.
const LIMITS: [(Limit, i32); 7] = [
    (Limit::SQLITE_LIMIT_LENGTH, 1 << 20),
    (Limit::SQLITE_LIMIT_EXPR_DEPTH, 200),
    (Limit::SQLITE_LIMIT_COMPOUND_SELECT, 100),
    (Limit::SQLITE_LIMIT_VDBE_OP, 1 << 20),
    (Limit::SQLITE_LIMIT_LIKE_PATTERN_LENGTH, 100),
    (Limit::SQLITE_LIMIT_ATTACHED, 0),
    (Limit::SQLITE_LIMIT_WORKER_THREADS, 0),
];

/// Readable tables besides the views: the list of all objects, and tables that SQLite makes from a value.
const ALSO_READ: [&str; 4] = ["sqlite_schema", "sqlite_master", "json_each", "json_tree"];

/// Limits of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SqlLimits {
    /// Rows.
    pub rows: usize,
    /// Bytes of all values.
    pub bytes: usize,
    /// Time from its start to its last row.
    pub time: Duration,
}

/// Answer to a statement within its limits.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SqlAnswer {
    /// Columns and rows.
    pub table: ResultTable,
    /// True if there are more rows than the limit.
    pub truncated: bool,
}

/// Reason why a statement has no answer.
#[derive(Debug, thiserror::Error)]
pub enum SqlError {
    /// SQLite does not understand it; with the place, if SQLite names one.
    #[error("{}{sentence}", at.map_or_else(String::new, |(line, column)| format!("line {line}, column {column}: ")))]
    Statement {
        /// The fault.
        sentence: String,
        /// Line and column, counted from 1, in characters.
        at: Option<(usize, usize)>,
    },
    /// It would do or read something forbidden.
    #[error("{0}")]
    Forbidden(String),
    /// It exceeded its time limit, or no one waits for the answer any more.
    #[error(
        "the statement was stopped after {0} s; ask for fewer rows or one robot, or ask a snapshot of the database \
         (`armwatch snapshot`)"
    )]
    TooSlow(f64),
    /// Its rows exceed the limit of bytes.
    #[error("the answer is larger than {0} bytes; ask for fewer columns or rows")]
    TooLarge(usize),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Store {
    /// Answers one `SELECT` over the public views. It blocks its thread; `abandoned` stops it early.
    ///
    /// `parameters` are the values of `?1`, `?2`, ...: null, truth values, numbers or texts.
    ///
    /// # Errors
    /// [`SqlError`].
    pub fn ask_within(
        &self,
        statement: &str,
        parameters: &[Value],
        limits: SqlLimits,
        abandoned: &Arc<AtomicBool>,
    ) -> Result<SqlAnswer, SqlError> {
        if self.dialect() == Dialect::Postgres {
            let path = self.path.display();
            return Err(SqlError::Forbidden(format!(
                "the database is on a server, so query it there: `psql {path}`, as a user who may only \
                read, with the views in schema armwatch"
            )));
        }
        let names = Names::of(statement).map_err(SqlError::Forbidden)?;
        if statement.len() > LONGEST_STATEMENT {
            return Err(SqlError::Forbidden(format!("a statement has at most {LONGEST_STATEMENT} bytes")));
        }
        if names.expanded > MOST_TOKENS {
            let sentence = format!("after expansion of WITH, a statement has at most {MOST_TOKENS} words");
            return Err(SqlError::Forbidden(sentence));
        }
        if !names.first.as_deref().is_some_and(|first| ["select", "with", "values"].contains(&first)) {
            return Err(SqlError::Forbidden(
                "give one statement that begins with SELECT, WITH or VALUES".into(),
            ));
        }
        let asking = Asking { store: self, statement, limits, begun: Instant::now() };
        let connection = asking.connect()?;
        asking.guard(&connection, names, abandoned, |connection| asking.rows(connection, parameters))?
    }
}

/// A statement that is being answered.
struct Asking<'s> {
    store: &'s Store,
    statement: &'s str,
    limits: SqlLimits,
    begun: Instant,
}

impl Asking<'_> {
    fn connect(&self) -> Result<Connection, SqlError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let opened = Connection::open_with_flags(&self.store.path, flags);
        let connection = opened.map_err(|error| self.broken(&error))?;
        let set = || {
            connection.busy_timeout(BUSY_TIMEOUT)?;
            connection.pragma_update(None, "query_only", true)?;
            long_texts::bound(&connection)?;
            LIMITS.iter().try_for_each(|(limit, value)| connection.set_limit(*limit, *value).map(|_| ()))
        };
        set().map_err(|error| self.broken(&error))?;
        Ok(connection)
    }

    /// Runs `answer` on a connection that can only read the public views, and only until the time limit.
    fn guard<T>(
        &self,
        connection: &Connection,
        names: Names,
        abandoned: &Arc<AtomicBool>,
        answer: impl FnOnce(&Connection) -> Result<T, rusqlite::Error>,
    ) -> Result<T, SqlError> {
        let schema = KnownSchema::read(connection).map_err(|error| self.broken(&error))?;
        if let Some(taken) = names.with.iter().find(|name| schema.is_taken(name)) {
            return Err(SqlError::Forbidden(format!(
                "the database uses the name {taken} itself; give the table of WITH another name"
            )));
        }
        let views = schema.views.iter().cloned().collect::<Vec<_>>().join(", ");
        let refused: Arc<Mutex<Option<String>>> = Arc::default();
        let told = Arc::clone(&refused);
        let authoriser = move |asked: AuthContext<'_>| match schema.judge(&asked, &names.with) {
            Ok(()) => Authorization::Allow,
            Err(reason) => {
                told.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
                Authorization::Deny
            }
        };
        let (deadline, abandoned) = (self.begun + self.limits.time, Arc::clone(abandoned));
        let over = move || Instant::now() >= deadline || abandoned.load(Ordering::Relaxed);
        connection
            .authorizer(Some(authoriser))
            .and_then(|()| connection.progress_handler(STEPS_BETWEEN_LOOKS, Some(over)))
            .map_err(|error| self.broken(&error))?;
        let answered = answer(connection);
        let refused = refused.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (answered, refused) {
            (Ok(answer), None) => Ok(answer),
            (_, Some(reason)) => Err(SqlError::Forbidden(format!("{reason}; the views are {views}"))),
            (Err(error), None) => Err(self.failed(&error)),
        }
    }

    fn rows(
        &self,
        connection: &Connection,
        parameters: &[Value],
    ) -> Result<Result<SqlAnswer, SqlError>, rusqlite::Error> {
        let mut prepared = connection.prepare(self.statement)?;
        if !prepared.readonly() || prepared.is_explain() != 0 {
            return Ok(Err(SqlError::Forbidden("the statement does more than read".into())));
        }
        let columns = prepared.column_names().into_iter().map(str::to_owned).collect();
        let mut rows = prepared.query(params_from_iter(parameters.iter().map(Parameter)))?;
        let mut answer = SqlAnswer { table: ResultTable { columns, rows: Vec::new() }, truncated: false };
        let mut bytes = 0;
        while let Some(row) = rows.next()? {
            if answer.table.rows.len() == self.limits.rows {
                answer.truncated = true;
                break;
            }
            let cells: Vec<Value> = (0..answer.table.columns.len())
                .map(|column| row.get_ref(column).map(cell))
                .collect::<Result<_, _>>()?;
            bytes += cells.iter().map(bytes_of).sum::<usize>();
            if bytes > self.limits.bytes {
                return Ok(Err(SqlError::TooLarge(self.limits.bytes)));
            }
            answer.table.rows.push(cells);
        }
        Ok(Ok(answer))
    }

    /// Converts a failure during the answer to an error for the caller.
    fn failed(&self, error: &rusqlite::Error) -> SqlError {
        let plain = |sentence: String| SqlError::Statement { sentence, at: None };
        match error {
            rusqlite::Error::SqlInputError { msg, offset, .. } => {
                let at = usize::try_from(*offset).ok().map(|offset| place(self.statement, offset));
                SqlError::Statement { sentence: msg.clone(), at }
            }
            rusqlite::Error::MultipleStatement => plain("there are several statements; send one".into()),
            rusqlite::Error::InvalidParameterCount(given, wanted) => {
                plain(format!("the statement has {wanted} parameters, and {given} values were given"))
            }
            rusqlite::Error::ToSqlConversionFailure(reason) => plain(reason.to_string()),
            rusqlite::Error::SqliteFailure(of, message) => match of.code {
                ErrorCode::OperationInterrupted => SqlError::TooSlow(self.limits.time.as_secs_f64()),
                ErrorCode::Unknown
                | ErrorCode::TooBig
                | ErrorCode::TypeMismatch
                | ErrorCode::ParameterOutOfRange => plain(message.clone().unwrap_or_else(|| of.to_string())),
                _ => self.broken(error),
            },
            error => self.broken(error),
        }
    }

    fn broken(&self, error: &rusqlite::Error) -> SqlError {
        let path = self.store.path.to_path_buf();
        SqlError::Store(match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
                StoreError::Busy { path, detail: error.to_string() }
            }
            _ => StoreError::NotReadable { path, detail: error.to_string() },
        })
    }
}

/// Names in the database, in lower case.
struct KnownSchema {
    views: BTreeSet<String>,
    /// Names after WITH inside views. SQLite asks the authoriser for them as it does for views.
    inside: BTreeSet<String>,
    tables: BTreeSet<String>,
}

impl KnownSchema {
    fn read(connection: &Connection) -> Result<Self, rusqlite::Error> {
        // SQLite declares these tables at their first use, and then asks the authoriser as if they were created
        connection.query_row("SELECT count(*) FROM json_each('[]'), json_tree('[]')", [], |_| Ok(()))?;
        let mut schema = Self { views: BTreeSet::new(), inside: BTreeSet::new(), tables: BTreeSet::new() };
        let mut listed = connection.prepare(
            "SELECT type, lower(name), coalesce(sql, '') FROM sqlite_schema WHERE type IN ('view', 'table')",
        )?;
        let mut rows = listed.query([])?;
        while let Some(row) = rows.next()? {
            let (kind, name, statement): (String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
            if kind == "view" {
                schema.inside.extend(Names::of(&statement).map(|names| names.with).unwrap_or_default());
                // the view's own name precedes its AS
                schema.inside.remove(&name);
                schema.views.insert(name);
            } else {
                schema.tables.insert(name);
            }
        }
        Ok(schema)
    }

    /// True if a table of WITH with this name could be confused with an object of the database.
    fn is_taken(&self, name: &str) -> bool {
        self.views.contains(name) || self.inside.contains(name) || self.tables.contains(name)
    }

    /// Checks that a statement whose WITH has the names `with` may do this.
    fn judge(&self, asked: &AuthContext<'_>, with: &BTreeSet<String>) -> Result<(), String> {
        let is_public = |name: &str| self.views.contains(name) || ALSO_READ.contains(&name);
        match asked.action {
            AuthAction::Select | AuthAction::Recursive => Ok(()),
            AuthAction::Function { function_name }
                if !function_name.eq_ignore_ascii_case("load_extension") =>
            {
                Ok(())
            }
            AuthAction::Read { table_name, column_name } => {
                let table = table_name.to_ascii_lowercase();
                let within = asked.accessor.map(str::to_ascii_lowercase);
                let is_in_view =
                    within.is_some_and(|name| self.views.contains(&name) || self.inside.contains(&name));
                // if the statement uses no column of a joined table, SQLite does not name the view
                let reads_no_column =
                    column_name.is_empty() && (self.is_taken(&table) || with.contains(&table));
                if is_public(&table) || is_in_view || reads_no_column {
                    return Ok(());
                }
                Err(format!(
                    "{table_name} is not public: its columns may change with any version of the program"
                ))
            }
            _ => Err("a statement may only read".into()),
        }
    }
}

/// A value for a parameter of a statement.
pub(crate) struct Parameter<'v>(pub(crate) &'v Value);

impl ToSql for Parameter<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        let integer = |number: i64| Ok(ToSqlOutput::Owned(SqlValue::Integer(number)));
        match self.0 {
            Value::Null => Ok(ToSqlOutput::Owned(SqlValue::Null)),
            Value::Bool(value) => integer(i64::from(*value)),
            Value::Number(number) => match (number.as_i64(), number.as_f64()) {
                (Some(number), _) => integer(number),
                (None, Some(number)) => Ok(ToSqlOutput::Owned(SqlValue::Real(number))),
                _ => Err(not_a_parameter()),
            },
            Value::String(text) => Ok(ToSqlOutput::Borrowed(ValueRef::Text(text.as_bytes()))),
            _ => Err(not_a_parameter()),
        }
    }
}

fn not_a_parameter() -> rusqlite::Error {
    rusqlite::Error::ToSqlConversionFailure("a parameter is null, true, false, a number or a text".into())
}

pub(crate) fn cell(value: ValueRef<'_>) -> Value {
    match value {
        ValueRef::Null => Value::Null,
        ValueRef::Integer(number) => Value::from(number),
        ValueRef::Real(number) => Value::from(number),
        ValueRef::Text(text) => Value::from(String::from_utf8_lossy(text)),
        ValueRef::Blob(bytes) => Value::from(hexadecimal(bytes)),
    }
}

/// Approximate bytes of a value in an answer.
fn bytes_of(value: &Value) -> usize {
    const NUMBER: usize = 20;
    value.as_str().map_or(NUMBER, str::len)
}

/// Line and column of a byte of a text, counted from 1, in characters.
pub(crate) fn place(text: &str, offset: usize) -> (usize, usize) {
    let before: String =
        text.char_indices().take_while(|(at, _)| *at < offset).map(|(_, character)| character).collect();
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|character| *character != '\n').count() + 1;
    (line, column)
}

#[cfg(test)]
mod tests;
