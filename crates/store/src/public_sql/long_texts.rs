//! Functions of SQLite that compare each place of one value with all of another one: on two long texts they run for
//! minutes, and nothing can stop a function while it runs.

use rusqlite::functions::{Context, FunctionFlags};
use rusqlite::types::{ToSqlOutput, Value, ValueRef};
use rusqlite::{Connection, Error, params_from_iter};

/// The functions, with their numbers of arguments; the first two arguments are compared.
const FUNCTIONS: [(&str, i32); 5] = [("instr", 2), ("replace", 3), ("trim", 2), ("ltrim", 2), ("rtrim", 2)];

/// Most comparisons of one call, bytes times bytes: some tenths of a second.
const MOST_COMPARISONS: usize = 100_000_000;

/// Bounds the functions of a connection. Their results are those of SQLite, computed by a connection without tables.
pub(super) fn bound(connection: &Connection) -> Result<(), Error> {
    let flags =
        FunctionFlags::SQLITE_UTF8 | FunctionFlags::SQLITE_DETERMINISTIC | FunctionFlags::SQLITE_INNOCUOUS;
    for (name, arguments) in FUNCTIONS {
        let original = Connection::open_in_memory()?;
        let places: Vec<String> = (1..=arguments).map(|place| format!("?{place}")).collect();
        let statement = format!("SELECT {name}({})", places.join(", "));
        connection.create_scalar_function(name, arguments, flags, move |called| {
            if length(called, 0).saturating_mul(length(called, 1)) > MOST_COMPARISONS {
                let sentence = format!("{name} needs shorter values: comparing these would take too long");
                return Err(Error::UserFunctionError(sentence.into()));
            }
            let values = (0..called.len()).map(|place| ToSqlOutput::Borrowed(called.get_raw(place)));
            original.query_row(&statement, params_from_iter(values), |row| row.get::<_, Value>(0))
        })?;
    }
    Ok(())
}

/// Length of an argument in bytes; for a number, the largest length of its digits.
fn length(called: &Context<'_>, place: usize) -> usize {
    const NUMBER: usize = 32;
    match called.get_raw(place) {
        ValueRef::Null => 0,
        ValueRef::Integer(_) | ValueRef::Real(_) => NUMBER,
        ValueRef::Text(bytes) | ValueRef::Blob(bytes) => bytes.len(),
    }
}
