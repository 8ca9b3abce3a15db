//! Anomalies in words and as JSON.

use jiff::Timestamp;

use crate::cli::context::CliError;
use armwatch_store::{AlarmState, AnomalyRow, NotDone, Store};

/// Most numbers that are proposed instead of one that does not exist.
const PROPOSED: usize = 3;

/// All anomalies in their state at `now`: one whose shelving has expired is open, even if no writing program has noted
/// it yet.
pub(in crate::cli) async fn all(store: &Store, now: Timestamp) -> Result<Vec<AnomalyRow>, CliError> {
    let mut rows = store.anomalies_after(0).await?;
    for row in rows.iter_mut().filter(|row| row.shelved_until.is_some_and(|until| until <= now)) {
        row.state = AlarmState::Open;
        row.shelved_until = None;
    }
    Ok(rows)
}

/// The anomaly of this number.
pub(super) async fn find(store: &Store, id: i64, now: Timestamp) -> Result<AnomalyRow, CliError> {
    let mut rows = all(store, now).await?;
    if let Some(place) = rows.iter().position(|row| row.anomaly_id == id) {
        return Ok(rows.swap_remove(place));
    }
    if !store.anomaly_history(id).await?.is_empty() {
        return Err(withdrawn(id));
    }
    Err(CliError::Usage(unknown(id, &rows)))
}

/// Error for an anomaly that is no longer in the history.
pub(super) fn withdrawn(id: i64) -> CliError {
    CliError::Usage(format!(
        "{}; `SELECT * FROM anomaly_history WHERE anomaly_id = {id}` says what happened to it",
        NotDone::Withdrawn(id)
    ))
}

/// Message for a number without an anomaly.
pub(super) fn unknown(id: i64, rows: &[AnomalyRow]) -> String {
    let mut numbers: Vec<i64> = rows.iter().map(|row| row.anomaly_id).collect();
    if numbers.is_empty() {
        return format!("{}; there are no anomalies", NotDone::Unknown(id));
    }
    numbers.sort_by_key(|number| (number.abs_diff(id), *number));
    numbers.truncate(PROPOSED);
    numbers.sort_unstable();
    let numbers: Vec<String> = numbers.iter().map(i64::to_string).collect();
    format!(
        "{}; did you mean {}? `armwatch alerts list --all` shows all",
        NotDone::Unknown(id),
        numbers.join(" or ")
    )
}

/// A time to the minute, UTC.
pub(in crate::cli) fn minute(time: Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%MZ").to_string()
}

/// `joint 3`, or `whole arm`.
pub(in crate::cli) fn place(row: &AnomalyRow) -> String {
    row.joint_number().map_or_else(|| "whole arm".to_owned(), |number| format!("joint {number}"))
}

/// `drift on R07, joint 3`.
pub(in crate::cli) fn name(row: &AnomalyRow) -> String {
    format!("{} on {}, {}", row.kind, row.robot, place(row))
}

/// The state with its details.
pub(in crate::cli) fn state(row: &AnomalyRow) -> String {
    match row.shelved_until {
        Some(until) => format!("{} until {}", row.state.name(), minute(until)),
        None => row.state.name().replace('_', " "),
    }
}

/// A value with four significant digits, or `-` if there is none.
pub(super) fn figure(value: Option<f64>) -> String {
    let Some(value) = value.filter(|value| value.is_finite()) else { return "-".into() };
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0);
    // between 0 and 9
    format!("{value:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_digits() {
        let shown = [1.19312, 0.05, 20.6666, 1234.56, 0.0].map(|value| figure(Some(value)));
        assert_eq!(shown, ["1.193", "0.05000", "20.67", "1235", "0"]);
        assert_eq!((figure(None), figure(Some(f64::NAN))), ("-".into(), "-".into()));
    }
}
