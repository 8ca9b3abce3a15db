//! `armwatch alerts list`

use std::cmp::Reverse;

use jiff::Timestamp;

use super::anomaly_texts;
use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::unknown_robot::require_robot;
use armwatch_model::anomaly::{AnomalyKind, Severity};
use armwatch_store::{AlarmState, AnomalyRow, Store};

/// The requested anomalies; an empty list selects all.
pub(super) struct Wanted<'a> {
    pub(super) robot: Option<&'a str>,
    pub(super) states: &'a [AlarmState],
    pub(super) severities: &'a [Severity],
    pub(super) kinds: &'a [AnomalyKind],
    pub(super) all: bool,
}

impl Wanted<'_> {
    fn includes(&self, row: &AnomalyRow) -> bool {
        let state = match self.states.is_empty() {
            true => self.all || !row.state.is_closed(),
            false => self.states.contains(&row.state),
        };
        state
            && self.robot.is_none_or(|name| row.robot == name)
            && (self.severities.is_empty() || self.severities.contains(&row.severity))
            && (self.kinds.is_empty() || self.kinds.contains(&row.kind))
    }
}

pub(super) async fn list(
    global: &Global,
    store: &Store,
    wanted: &Wanted<'_>,
    now: Timestamp,
) -> Result<u8, CliError> {
    let known = anomaly_texts::all(store, now).await?;
    let mut rows: Vec<&AnomalyRow> = known.iter().filter(|row| wanted.includes(row)).collect();
    rows.sort_by_key(|row| {
        (row.state.is_closed(), Reverse(row.severity), Reverse(row.last_seen_at), row.anomaly_id)
    });
    if rows.is_empty()
        && let Some(robot) = wanted.robot
    {
        require_robot(store, robot).await?;
    }
    if global.json {
        rows.iter().for_each(output::json);
        return Ok(EXIT_DONE);
    }
    if rows.is_empty() {
        output::line(&nothing(store, wanted, &known).await?);
        return Ok(EXIT_DONE);
    }
    let cells = |row: &&AnomalyRow| {
        vec![
            row.anomaly_id.to_string(),
            output::coloured(row.severity.name()),
            anomaly_texts::state(row),
            row.robot.clone(),
            row.joint_number().map_or_else(|| "arm".into(), |number| number.to_string()),
            row.kind.to_string(),
            anomaly_texts::minute(row.first_seen_at),
            anomaly_texts::minute(row.last_seen_at),
        ]
    };
    let header = ["id", "severity", "state", "robot", "joint", "kind", "first seen", "last seen"];
    let table = output::table(&header, &rows.iter().map(cells).collect::<Vec<_>>());
    let mut lines = table.lines();
    output::line(lines.next().unwrap_or_default());
    for (line, row) in lines.zip(&rows) {
        output::line(line);
        output::line(&format!("    {}", row.message));
    }
    output::print_hint(
        "`armwatch alerts show ID` has the evidence; `ack`, `shelve`, `resolve` and `false-alarm` answer one",
    );
    Ok(EXIT_DONE)
}

/// Message if no anomaly matches.
async fn nothing(store: &Store, wanted: &Wanted<'_>, known: &[AnomalyRow]) -> Result<String, CliError> {
    let closed = known.iter().filter(|row| row.state.is_closed()).count();
    let asks = wanted.all
        || wanted.robot.is_some()
        || !(wanted.states.is_empty() && wanted.severities.is_empty() && wanted.kinds.is_empty());
    Ok(match (known.len(), asks) {
        (0, _) => {
            let runs = store.counts().await?.complete_runs;
            format!("no anomaly has been found in {runs} complete runs")
        }
        (count, true) => {
            format!("none of the {count} anomalies matches; `armwatch alerts list --all` shows them")
        }
        (_, false) => format!("no anomaly is open; {closed} are closed, which `--all` shows"),
    })
}
