//! A question and its possible errors.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::error::StoreError;
use crate::table::ResultTable;

/// A statement with the values of its parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SqlQuestion {
    /// One statement that only reads.
    pub statement: String,
    /// Values by the name of the parameter, without its first character: null, numbers or texts. Parameters without a
    /// value are NULL.
    pub values: Vec<(String, Value)>,
}

/// Answer to a question.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct QuestionAnswer {
    /// Columns and rows.
    pub table: ResultTable,
    /// Parameters of the statement without a value, with their first character: they were NULL.
    pub null_parameters: Vec<String>,
}

/// Reason why a question has no answer.
#[derive(Debug, thiserror::Error)]
pub enum QuestionError {
    /// The text contains only spaces, comments and semicolons.
    #[error("there is no statement: give one, such as `armwatch sql \"SELECT * FROM fleet_health\"`")]
    Empty,
    /// The text has more than one statement.
    #[error(
        "there are several statements: `armwatch sql` accepts one that reads; call it once per statement, \
        or join them with WITH or UNION ALL"
    )]
    Several,
    /// The statement would change something, write a file, or return no rows.
    #[error(
        "the statement does not only read: `armwatch sql` takes SELECT, WITH, VALUES and EXPLAIN, and the database is \
         opened for reading only; `armwatch backup FILE` copies the database, `armwatch export` writes views into files, \
         and the other commands of armwatch change what is stored"
    )]
    Changes,
    /// A value has no parameter.
    #[error(
        "the statement has no parameter {name}: {}",
        if .known.is_empty() { format!("it has none; write :{name} at the place of the value") }
        else { format!("it has {}", .known.join(", ")) }
    )]
    NoParameter {
        /// The name of the value.
        name: String,
        /// Parameters of the statement.
        known: Vec<String>,
    },
    /// Two values have one name.
    #[error("--param {0} is given twice: give one value per parameter")]
    Twice(String),
    /// A parameter has no name.
    #[error(
        "the statement has the parameter {0}, which has no name: write :NAME in its place, and give --param NAME=VALUE"
    )]
    Nameless(String),
    /// The engine does not understand the statement, or cannot execute it.
    #[error("{0}")]
    Statement(String),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl SqlQuestion {
    /// The values of the statement's parameters `names`, in their order, and the names of those without a value, which
    /// are NULL.
    pub(super) fn values_of(&self, names: &[String]) -> Result<(Vec<&Value>, Vec<String>), QuestionError> {
        let mut given = BTreeSet::new();
        if let Some((name, _)) = self.values.iter().find(|(name, _)| !given.insert(name)) {
            return Err(QuestionError::Twice(name.clone()));
        }
        let is_of = |name: &String| names.iter().any(|of| bare(of) == name);
        if let Some((name, _)) = self.values.iter().find(|(name, _)| !is_of(name)) {
            return Err(QuestionError::NoParameter { name: name.clone(), known: names.to_vec() });
        }
        let value =
            |name: &String| self.values.iter().find(|(of, _)| of == bare(name)).map(|(_, value)| value);
        let without: Vec<String> = names.iter().filter(|name| value(name).is_none()).cloned().collect();
        Ok((names.iter().map(|name| value(name).unwrap_or(&Value::Null)).collect(), without))
    }
}

/// The name of a parameter without its first character, which only marks a parameter.
fn bare(parameter: &str) -> &str {
    parameter.strip_prefix([':', '@', '$']).unwrap_or(parameter)
}
