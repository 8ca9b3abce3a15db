//! Conversion between the types of the program and the values of columns.

use jiff::Timestamp;
use serde::{Serialize, Serializer};
use sqlx::Row;

use crate::engine::EngineRow;
use armwatch_model::analysis::{IdentifiedParameter, Rmsd};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};

/// Most rows in one multi-row statement. With at most 20 columns this stays far below SQLite's 32766 variables.
pub(super) const ROWS_PER_STATEMENT: usize = 256;

/// NULL for a value that is not finite: neither JSON nor most tools could represent it.
pub(super) fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Numbers as a JSON array; non-finite ones become zero.
pub(super) fn json_numbers(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|value| finite(*value).unwrap_or(0.0).to_string()).collect();
    format!("[{}]", texts.join(","))
}

/// Keys as a JSON array.
pub(super) fn json_list(keys: &[i64]) -> String {
    let texts: Vec<String> = keys.iter().map(i64::to_string).collect();
    format!("[{}]", texts.join(","))
}

/// A count as SQLite stores it. No count comes near the limit.
pub(super) fn count(value: impl TryInto<i64>) -> i64 {
    value.try_into().unwrap_or(i64::MAX)
}

/// Number of a joint as people read it.
pub(super) fn joint_number(joint: JointIndex) -> i64 {
    count(joint.number())
}

/// Reads a joint number.
pub(super) fn joint(row: &EngineRow, column: &str) -> sqlx::Result<JointIndex> {
    let number: i64 = row.try_get(column)?;
    usize::try_from(number).ok().and_then(JointIndex::from_number).ok_or_else(|| unknown(column, number))
}

/// Reads a parameter with its error: columns joint, name, value, std_error, degrees_of_freedom.
pub(super) fn identified(row: &EngineRow) -> sqlx::Result<IdentifiedParameter> {
    let known = |column| Ok::<f64, sqlx::Error>(row.try_get::<Option<f64>, _>(column)?.unwrap_or(f64::NAN));
    Ok(IdentifiedParameter {
        id: parameter(row, "joint", "name")?,
        value: row.try_get("value")?,
        std_error: known("std_error")?,
        degrees_of_freedom: known("degrees_of_freedom")?,
    })
}

/// Reads a count that is never negative.
pub(super) fn size<T: TryFrom<i64>>(row: &EngineRow, column: &str) -> sqlx::Result<T> {
    let value: i64 = row.try_get(column)?;
    T::try_from(value).map_err(|_| unknown(column, value))
}

/// Reads integer microseconds UTC.
pub(super) fn time(row: &EngineRow, column: &str) -> sqlx::Result<Timestamp> {
    let microseconds: i64 = row.try_get(column)?;
    Timestamp::from_microsecond(microseconds).map_err(|_| unknown(column, microseconds))
}

/// Reads integer microseconds UTC that may be absent.
pub(super) fn known_time(row: &EngineRow, column: &str) -> sqlx::Result<Option<Timestamp>> {
    match row.try_get::<Option<i64>, _>(column)? {
        Some(_) => time(row, column).map(Some),
        None => Ok(None),
    }
}

/// Reads an element of a closed list by its name.
pub(super) fn named<T: Copy>(
    row: &EngineRow,
    column: &str,
    all: &[T],
    name: impl Fn(T) -> &'static str,
) -> sqlx::Result<T> {
    let text: &str = row.try_get(column)?;
    all.iter().copied().find(|&item| name(item) == text).ok_or_else(|| unknown(column, text))
}

/// Reads a parameter from its joint and name.
pub(super) fn parameter(row: &EngineRow, joint_column: &str, name_column: &str) -> sqlx::Result<ParameterId> {
    let joint = joint(row, joint_column)?;
    let text: &str = row.try_get(name_column)?;
    ParameterKind::all()
        .map(|kind| ParameterId { joint, kind })
        .find(|id| id.name() == text)
        .ok_or_else(|| unknown(name_column, text))
}

/// A parameter as [`ParameterId`] writes it: `J2_mPx`.
pub(super) fn standard_parameter(word: &str) -> Option<ParameterId> {
    let (number, name) = word.strip_prefix('J')?.split_once('_')?;
    let joint = JointIndex::from_number(number.parse().ok()?)?;
    ParameterKind::all().map(|kind| ParameterId { joint, kind }).find(|id| id.name() == name)
}

/// The terms of a grouping such as `J2_mPx + 0.27 J3_m - J4_mPz`; unknown terms are omitted.
pub(super) fn grouping_terms(grouping: &str) -> Vec<(f64, ParameterId)> {
    let (mut sign, mut factor) = (1.0, 1.0);
    let mut found = Vec::new();
    for word in grouping.split_whitespace() {
        if let Some(id) = standard_parameter(word) {
            found.push((sign * factor, id));
            (sign, factor) = (1.0, 1.0);
        } else if let Ok(number) = word.parse::<f64>() {
            factor = number;
        } else {
            sign = if word == "-" { -1.0 } else { 1.0 };
        }
    }
    found
}

/// Error for a row whose content no program of this version has written.
pub(super) fn unreadable(table: &str, key: i64) -> sqlx::Error {
    sqlx::Error::Decode(
        format!("row {key} of table {table} has content that this program does not know").into(),
    )
}

fn unknown(column: &str, value: impl std::fmt::Debug) -> sqlx::Error {
    sqlx::Error::Decode(format!("column {column} holds {value:?}, which this program does not know").into())
}

/// NULL for a deviation over no rows, which is unknown and not zero.
pub(super) fn of_some_rows(rmsd: Rmsd, value: f64) -> Option<f64> {
    if rmsd.samples == 0 { None } else { finite(value) }
}

/// A time as the views show it: RFC 3339 in UTC, always with milliseconds.
///
/// The rounding is that of SQLite, which counts milliseconds from the noon of 4714 BC in floating point, so that the
/// text equals that of the view to the last digit.
pub fn time_in_views(time: Timestamp) -> String {
    /// Milliseconds from that noon to 1970.
    const TO_1970: f64 = 210_866_760_000_000.0;
    let milliseconds = (time.as_microsecond() as f64 / 1e6 * 1000.0 + TO_1970 + 0.5).floor() - TO_1970;
    let rounded = Timestamp::from_millisecond(milliseconds as i64).unwrap_or(time);
    rounded.strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string()
}

/// Serializes a time of a row as the views show it.
pub(crate) fn in_views<S: Serializer>(time: &Timestamp, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&time_in_views(*time))
}

/// Serializes a time that may be absent.
pub(crate) fn known_in_views<S: Serializer>(
    time: &Option<Timestamp>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    time.map(time_in_views).serialize(serializer)
}

/// Reads a time as a view shows it.
pub(super) fn time_text(row: &EngineRow, column: &str) -> sqlx::Result<Timestamp> {
    let text: &str = row.try_get(column)?;
    text.parse().map_err(|error: jiff::Error| sqlx::Error::Decode(error.to_string().into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_testing::er3a;

    #[test]
    fn times_have_milliseconds_and_are_rounded_as_the_views_round() {
        let shown = |microseconds| time_in_views(Timestamp::from_microsecond(microseconds).expect("a time"));
        assert_eq!(shown(0), "1970-01-01T00:00:00.000Z");
        assert_eq!(shown(1_767_602_820_000_000), "2026-01-05T08:47:00.000Z");
        assert_eq!(shown(1_767_602_820_250_000), "2026-01-05T08:47:00.250Z");
        // result of `strftime('%Y-%m-%dT%H:%M:%fZ', microseconds / 1000000.0, 'unixepoch')`
        assert_eq!(shown(1_767_602_820_000_484), "2026-01-05T08:47:00.000Z");
        assert_eq!(shown(1_767_602_820_000_493), "2026-01-05T08:47:00.001Z");
        assert_eq!(shown(1_767_602_820_999_500), "2026-01-05T08:47:01.000Z");
        let of_a_nanosecond: Timestamp = "2026-01-05T08:47:00.123456789Z".parse().expect("a time");
        assert_eq!(time_in_views(of_a_nanosecond), "2026-01-05T08:47:00.123Z");
    }

    #[test]
    fn a_grouping_is_read_as_it_is_written() {
        let base = base_parameters(&er3a()).unwrap();
        for (index, kept) in base.kept.iter().enumerate() {
            let read = grouping_terms(&base.grouping_formula(index));
            assert_eq!(read[0], (1.0, *kept));
            assert_eq!(read.len(), base.grouping[index].len() + 1);
            for ((coefficient, id), term) in read[1..].iter().zip(&base.grouping[index]) {
                assert_eq!(*id, term.id);
                assert!((coefficient - term.coefficient).abs() < 1e-5 * term.coefficient.abs());
            }
        }
    }
}
