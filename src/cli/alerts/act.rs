//! Answers to anomalies: `armwatch alerts ack`, `shelve`, `resolve`, `false-alarm`, `reopen`.

use jiff::{SignedDuration, Timestamp};
use serde_json::json;

use super::anomaly_texts;
use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::user::user;
use armwatch_store::{AlarmAction, NotDone, Store, time_in_views};

pub(super) const ACKNOWLEDGE: AlarmAction = AlarmAction::Acknowledge;
pub(super) const REOPEN: AlarmAction = AlarmAction::Reopen;
pub(super) const RESOLVE: AlarmAction = AlarmAction::Resolve;
pub(super) const FALSE_ALARM: AlarmAction = AlarmAction::FalseAlarm;

/// The selected anomalies, the user, and the reason.
pub(super) struct AlarmCommand<'a> {
    pub(super) ids: &'a [i64],
    pub(super) by: Option<&'a str>,
    pub(super) why: Option<&'a str>,
}

/// The time `days` days later.
pub(super) fn days_after(now: Timestamp, days: i64) -> Result<Timestamp, CliError> {
    now.checked_add(SignedDuration::from_hours(24 * days))
        .map_err(|error| CliError::Usage(format!("{days} days from now: {error}")))
}

pub(super) async fn shelve(
    global: &Global,
    store: &Store,
    deed: &AlarmCommand<'_>,
    until: Timestamp,
    now: Timestamp,
) -> Result<u8, CliError> {
    if until <= now {
        return Err(CliError::Usage(format!(
            "--until {} has passed (it is {} now); give a later time, or --days N",
            anomaly_texts::minute(until),
            anomaly_texts::minute(now)
        )));
    }
    act(global, store, deed, AlarmAction::Shelve(until)).await
}

pub(super) async fn act(
    global: &Global,
    store: &Store,
    deed: &AlarmCommand<'_>,
    action: AlarmAction,
) -> Result<u8, CliError> {
    let by = deed.by.map_or_else(user, str::to_owned);
    let mut ids = deed.ids.to_vec();
    ids.sort_unstable();
    ids.dedup();
    match store.act_on_anomalies(&ids, action, &by, deed.why).await? {
        Ok(_) => {}
        Err(NotDone::Withdrawn(id)) => return Err(anomaly_texts::withdrawn(id)),
        Err(NotDone::Unknown(id)) => {
            return Err(CliError::Usage(anomaly_texts::unknown(id, &store.anomalies_after(0).await?)));
        }
        Err(reason @ NotDone::TooLong(_)) => {
            return Err(CliError::Usage(format!("{reason}{}", others(&ids))));
        }
        Err(reason @ NotDone::NotFrom { anomaly_id, .. }) => {
            return Err(CliError::Usage(format!(
                "{reason}{}; `armwatch alerts show {anomaly_id}` shows the person and the time",
                others(&ids)
            )));
        }
    }
    for row in store.anomalies_after(0).await?.iter().filter(|row| ids.contains(&row.anomaly_id)) {
        if global.json {
            let until = row.shelved_until.map(time_in_views);
            output::json(&json!({
                "anomaly_id": row.anomaly_id, "robot": row.robot, "state": row.state, "shelved_until": until,
                "by": by, "why": deed.why,
            }));
        } else {
            let why = deed.why.map(|why| format!(": {why}")).unwrap_or_default();
            output::line(&format!(
                "{}  anomaly {} ({}) by {by}{why}",
                anomaly_texts::state(row),
                row.anomaly_id,
                anomaly_texts::name(row)
            ));
        }
    }
    Ok(EXIT_DONE)
}

/// Text about the others if one of several anomalies is refused.
fn others(ids: &[i64]) -> &'static str {
    if ids.len() > 1 { "; the others were not changed either" } else { "" }
}
