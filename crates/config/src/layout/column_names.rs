//! Reads the names of columns, which must be unique, and their units.

use super::column::{Column, JointColumns};
use crate::toml::table::{Table, Value};
use armwatch_model::robot::name::composed;

/// A unit in the notation of files and its factor to SI.
pub(crate) type NamedUnit = (&'static str, f64);

/// The name of a factor in a list of units.
#[expect(clippy::float_cmp, reason = "factors are copied from one list, never computed")]
pub(crate) fn named_unit(units: &[NamedUnit], to_si: f64) -> Option<&'static str> {
    units.iter().find(|(_, factor)| *factor == to_si).map(|(name, _)| *name)
}

/// Columns given so far, so that none is read twice; a name with a placeholder for the joint's number is stored
/// unchanged.
#[derive(Default)]
pub(crate) struct ColumnNames(pub(crate) Vec<Column>);

impl ColumnNames {
    /// One column, by name or number.
    pub(crate) fn take(&mut self, value: &Value<'_>) -> Option<Column> {
        let column = match value.is_integer() {
            true => Column::Number(usize::try_from(value.integer(1..=MAX_COLUMN)?).ok()?),
            false => Column::Name(composed(value.text()?).into_owned()),
        };
        if let Column::Name(name) = &column
            && joint_places(name) > 0
        {
            value.refuse(format!("is one column and must not contain {JOINT}"), None);
            return None;
        }
        self.add(value, column)
    }

    /// The columns of all joints: one name with a placeholder for the joint's number, or individually.
    pub(crate) fn take_joints(&mut self, table: &Table<'_>) -> Option<JointColumns> {
        let (which, value) = table.one_of(&["column", "columns"])?;
        match which {
            0 => self.take_pattern(&value).map(JointColumns::Pattern),
            _ => {
                let columns: Vec<_> = value.items()?.iter().map(|item| self.take(item)).collect();
                columns.into_iter().collect::<Option<_>>().map(JointColumns::Each)
            }
        }
    }

    /// One name for the columns of all joints.
    fn take_pattern(&mut self, value: &Value<'_>) -> Option<String> {
        let pattern = &*composed(value.text()?);
        let problem = match joint_places(pattern) {
            0 => format!("must contain {JOINT}, as the place of the joint's number from 1"),
            1 => return self.add(value, Column::Name(pattern.to_owned())).map(|_| pattern.to_owned()),
            _ => format!("must contain {JOINT} only once"),
        };
        value.refuse(problem, Some("or write columns = [..] with a name or number per joint".into()));
        None
    }

    pub(crate) fn add(&mut self, value: &Value<'_>, column: Column) -> Option<Column> {
        if self.0.contains(&column) {
            value.refuse("another key already reads this column".into(), None);
            return None;
        }
        self.0.push(column.clone());
        Some(column)
    }
}

pub(crate) fn read_unit(value: &Value<'_>, units: &[NamedUnit]) -> Option<f64> {
    let given = value.text()?;
    let factor = units.iter().find(|(name, _)| *name == given).map(|&(_, factor)| factor);
    if factor.is_none() {
        let known: Vec<_> = units.iter().map(|(name, _)| *name).collect();
        value.refuse(format!("unknown unit, must be one of {}", known.join(", ")), None);
    }
    factor
}

/// Placeholder of the joint's number, from 1, in the name of a column.
pub(crate) const JOINT: &str = "{joint}";

/// Largest number of a column: no export of a robot arm is wider.
const MAX_COLUMN: i64 = 10_000;

/// Number of placeholders for the joint's number in a name, with or without an added number.
fn joint_places(name: &str) -> usize {
    let with_sum = |rest: &str| {
        let (digits, _) = rest.split_once('}').unwrap_or(("", ""));
        !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit())
    };
    let sums = name.match_indices("{joint+").filter(|(at, opening)| with_sum(&name[at + opening.len()..]));
    name.matches(JOINT).count() + sums.count()
}
