//! Columns of an export.

use std::fmt;

/// One column of an export.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Column {
    /// By its name in the header; without a header, the name is its number.
    Name(String),
    /// By its number, from 1, regardless of the header.
    Number(usize),
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => f.write_str(name),
            Self::Number(number) => write!(f, "{number}"),
        }
    }
}

/// A column with its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaledColumn {
    /// The column.
    pub column: Column,
    /// Factor from the column's unit to SI.
    pub to_si: f64,
}

/// The columns of a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JointColumns {
    /// By a name with a placeholder: `{joint}` is the joint's number from 1, `{joint+6}` that number plus 6.
    Pattern(String),
    /// Individually, from the base outwards.
    Each(Vec<Column>),
    /// The export has none.
    NotRecorded,
}

impl JointColumns {
    /// The column of the joint with the number `number`, from 1; `None` beyond the end of a list.
    pub fn of_joint(&self, number: usize) -> Option<Column> {
        match self {
            Self::Pattern(pattern) => Some(Column::Name(expanded(pattern, number))),
            Self::Each(columns) => columns.get(number.checked_sub(1)?).cloned(),
            Self::NotRecorded => None,
        }
    }
}

/// A name with the joint's number inserted: `{joint}` is the number, `{joint+6}` that number plus 6.
fn expanded(pattern: &str, joint: usize) -> String {
    if let Some((before, rest)) = pattern.split_once("{joint+")
        && let Some((added, after)) = rest.split_once('}')
        && let Ok(added) = added.parse::<usize>()
    {
        return format!("{before}{}{after}", joint + added);
    }
    pattern.replace("{joint}", &joint.to_string())
}
