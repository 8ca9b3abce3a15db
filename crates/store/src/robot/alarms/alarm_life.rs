//! Actions of people on anomalies, the end of shelving and of maintenance, and the history of each anomaly.

use jiff::{SignedDuration, Timestamp};
use serde::Serialize;
use sqlx::Row;

use super::alarm_state::{AlarmState, EventKind, Life};
use super::anomalies::{AnomalyEvent, Person, record};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::windows;
use crate::values::{in_views, joint, named, time, time_text};
use armwatch_model::anomaly::Severity;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::robot::JointIndex;

/// Longest shelving of a critical anomaly, days. Its severity cannot rise any more, so that nothing else would end the
/// shelving.
const MOST_DAYS_CRITICAL: i64 = 90;

/// Action of a person on an anomaly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlarmAction {
    /// Withdraws an earlier answer: the alarm is open again.
    Reopen,
    /// Acknowledges it. Also ends its shelving or maintenance, or withdraws that it is resolved or a false alarm.
    Acknowledge,
    /// Silences it until then, unless its severity rises. A critical one is shelved for 90 days at most.
    Shelve(Timestamp),
    /// Reports maintenance of the robot after which no run has shown if the anomaly is gone.
    Maintain,
    /// Reports that its cause is gone. A later run that shows it opens it again.
    Resolve,
    /// Reports that nothing was wrong. The episode stays closed.
    FalseAlarm,
}

impl AlarmAction {
    /// Its event.
    pub fn event(self) -> EventKind {
        match self {
            Self::Reopen => EventKind::Reopened,
            Self::Acknowledge => EventKind::Acknowledged,
            Self::Shelve(_) => EventKind::Shelved,
            Self::Maintain => EventKind::Maintenance,
            Self::Resolve => EventKind::Resolved,
            Self::FalseAlarm => EventKind::FalseAlarm,
        }
    }

    fn state(self) -> AlarmState {
        match self {
            Self::Reopen => AlarmState::Open,
            Self::Acknowledge => AlarmState::Acknowledged,
            Self::Shelve(_) => AlarmState::Shelved,
            Self::Maintain => AlarmState::Maintenance,
            Self::Resolve => AlarmState::Resolved,
            Self::FalseAlarm => AlarmState::FalseAlarm,
        }
    }

    /// True if it is possible for an anomaly in this state; `ended` is true if later runs no longer show the anomaly.
    fn is_possible(self, state: AlarmState, ended: bool) -> bool {
        match self {
            // an ended anomaly needs no attention, but can still be marked as a false alarm
            Self::FalseAlarm => state != AlarmState::FalseAlarm,
            Self::Reopen => !ended && state != AlarmState::Open,
            Self::Acknowledge => !ended && state != AlarmState::Acknowledged,
            Self::Shelve(_) => !ended && !state.is_closed(),
            Self::Maintain => !ended && !state.is_closed() && state != AlarmState::Maintenance,
            Self::Resolve => state != AlarmState::Resolved,
        }
    }
}

/// Reason why an action was refused; none of the named anomalies was changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotDone {
    /// There is no anomaly of this number.
    #[error("there is no anomaly {0}")]
    Unknown(i64),
    /// The history no longer contains it.
    #[error("anomaly {0} was withdrawn: later tests show that it is none")]
    Withdrawn(i64),
    /// The time is too long for shelving a critical anomaly.
    #[error(
        "anomaly {0} is critical and can be shelved for {MOST_DAYS_CRITICAL} days at most; give an earlier time"
    )]
    TooLong(i64),
    /// The action is impossible in this state.
    #[error("anomaly {anomaly_id} is {} already: {}", standing(*state), remedy(*state, *ended))]
    NotFrom {
        /// The anomaly.
        anomaly_id: i64,
        /// Its state.
        state: AlarmState,
        /// True if later runs no longer show it.
        ended: bool,
    },
}

/// Text of a state after "the anomaly is".
fn standing(state: AlarmState) -> &'static str {
    match state {
        AlarmState::FalseAlarm => "a false alarm",
        AlarmState::Maintenance => "in maintenance",
        AlarmState::Open | AlarmState::Acknowledged | AlarmState::Shelved | AlarmState::Resolved => {
            state.name()
        }
    }
}

fn remedy(state: AlarmState, ended: bool) -> &'static str {
    match state {
        _ if ended => "later tests no longer show it, so no action is needed",
        AlarmState::Resolved | AlarmState::FalseAlarm => "reopen it to undo this",
        _ => "nothing was changed",
    }
}

/// A row of the view `anomaly_history`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AnomalyHistoryRow {
    /// Database key of the event; later ones have larger keys.
    #[serde(skip)]
    pub anomaly_event_id: i64,
    /// The anomaly.
    #[serde(skip)]
    pub anomaly_id: i64,
    /// The individual robot.
    #[serde(skip)]
    pub robot: String,
    /// The joint; `None` if the cause affects the whole arm.
    #[serde(skip)]
    pub joint: Option<JointIndex>,
    /// Present kind of the anomaly, such as `drift`.
    #[serde(skip)]
    pub kind: String,
    /// Time by the machine's clock.
    #[serde(serialize_with = "in_views")]
    pub at: Timestamp,
    /// Kind of the event.
    pub what: EventKind,
    /// Severity of the anomaly at that time.
    pub severity: Severity,
    /// Its score at that time.
    pub score: Option<f64>,
    /// Its value at that time.
    pub value: Option<f64>,
    /// Its message at that time.
    pub message: String,
    /// The person; `None` if the program is the author.
    pub who: Option<String>,
    /// The person's reason.
    pub why: Option<String>,
    /// Latest run that had shown it at that time.
    pub run_id: Option<i64>,
    /// The quantity of `value`.
    pub quantity: Quantity,
    /// Unit of `value`.
    pub unit: Option<&'static str>,
}

/// Results of a joint in one complete test, as evidence for an anomaly.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SeriesRun {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording.
    #[serde(serialize_with = "in_views")]
    pub started_at: Timestamp,
    /// The joint.
    pub joint: JointIndex,
    /// Friction at equal temperature relative to the joint's baseline, 1 = unchanged.
    pub friction_index: Option<f64>,
    /// Standard error of `friction_index`.
    pub friction_index_std_error: Option<f64>,
    /// Warm friction, Nm.
    pub warm_friction_nm: Option<f64>,
    /// Median over the cycles of the moving relative RMSD of the excitation stage, a fraction.
    pub moving_relative_rmsd: Option<f64>,
    /// Swing of that RMSD between cycles, a fraction.
    pub rmsd_swing: Option<f64>,
}

impl Store {
    /// Stores a person's comment on an anomaly in any state. Returns the event.
    pub async fn comment_on_anomaly(
        &self,
        anomaly_id: i64,
        who: &str,
        text: &str,
    ) -> Result<Result<AnomalyEvent, NotDone>, StoreError> {
        self.note(anomaly_id, EventKind::Commented, Person { who, why: Some(text) }, None).await
    }

    /// Assigns an anomaly to a person, or with `None` to no one, and stores who did that.
    pub async fn assign_anomaly(
        &self,
        anomaly_id: i64,
        to: Option<&str>,
        who: &str,
    ) -> Result<Result<AnomalyEvent, NotDone>, StoreError> {
        self.note(anomaly_id, EventKind::Assigned, Person { who, why: to }, Some(to)).await
    }

    async fn note(
        &self,
        anomaly_id: i64,
        what: EventKind,
        by: Person<'_>,
        assignee: Option<Option<&str>>,
    ) -> Result<Result<AnomalyEvent, NotDone>, StoreError> {
        let mut transaction = self.begin().await?;
        let noted = note(&mut transaction, anomaly_id, what, by, assignee).await;
        let noted = self.checked(noted)?;
        if noted.is_ok() {
            self.commit(transaction).await?;
        }
        Ok(noted)
    }

    /// Applies `action` to all of these anomalies, or to none if it is impossible for one of them, and stores who did
    /// it and why.
    pub async fn act_on_anomalies(
        &self,
        ids: &[i64],
        action: AlarmAction,
        who: &str,
        why: Option<&str>,
    ) -> Result<Result<Vec<AnomalyEvent>, NotDone>, StoreError> {
        let mut transaction = self.begin().await?;
        let acted = act(&mut transaction, ids, action, Person { who, why }).await;
        let acted = self.checked(acted)?;
        if acted.is_ok() {
            self.commit(transaction).await?;
        }
        Ok(acted)
    }

    /// Opens shelved anomalies whose time ended before `clock`, and those in maintenance that a run after the
    /// maintenance shows or whose window has ended. Puts open ones whose window has begun into maintenance. Returns the
    /// events.
    pub async fn end_shelving(&self, clock: Timestamp) -> Result<Vec<AnomalyEvent>, StoreError> {
        // readers do not wait for writers, and usually there is nothing to do
        let shelved = self.checked(shelved_before(&self.readers, clock).await)?;
        let worked_on = self.checked(shown_after_work(&self.readers).await)?;
        let over = self.checked(windows::over(&self.readers, clock).await)?;
        let waiting = self.checked(windows::waiting(&self.readers, clock).await)?;
        if shelved.is_empty() && worked_on.is_empty() && over.is_empty() && waiting.is_empty() {
            return Ok(Vec::new());
        }
        let mut transaction = self.begin().await?;
        let ended = end_shelving(&mut transaction, clock).await;
        let ended = self.checked(ended)?;
        self.commit(transaction).await?;
        Ok(ended)
    }

    /// Events of an anomaly, in order.
    pub async fn anomaly_history(&self, anomaly_id: i64) -> Result<Vec<AnomalyHistoryRow>, StoreError> {
        self.checked(history(&self.readers, Some(anomaly_id), (0, i64::MAX)).await)
    }

    /// These events, in order of time.
    pub async fn anomaly_events(
        &self,
        events: &[AnomalyEvent],
    ) -> Result<Vec<AnomalyHistoryRow>, StoreError> {
        let keys = || events.iter().map(|event| event.anomaly_event_id);
        let (Some(first), Some(last)) = (keys().min(), keys().max()) else { return Ok(Vec::new()) };
        let mut rows = self.checked(history(&self.readers, None, (first - 1, last)).await)?;
        // another program may have written between them
        rows.retain(|row| keys().any(|key| key == row.anomaly_event_id));
        Ok(rows)
    }

    /// Results of a robot's joints in its complete tests, by start and joint.
    pub async fn evidence(&self, robot: &str) -> Result<Vec<SeriesRun>, StoreError> {
        self.checked(evidence(&self.readers, robot).await)
    }
}

async fn act(
    connection: &mut EngineConnection,
    ids: &[i64],
    action: AlarmAction,
    by: Person<'_>,
) -> sqlx::Result<Result<Vec<AnomalyEvent>, NotDone>> {
    let mut events = Vec::new();
    for &anomaly_id in ids {
        let Some(known) = find(&mut *connection, anomaly_id).await? else {
            return Ok(Err(NotDone::Unknown(anomaly_id)));
        };
        if known.withdrawn {
            return Ok(Err(NotDone::Withdrawn(anomaly_id)));
        }
        let KnownAnomaly { state, ended, .. } = known;
        if !action.is_possible(state, ended) {
            return Ok(Err(NotDone::NotFrom { anomaly_id, state, ended }));
        }
        let longest = Timestamp::now() + SignedDuration::from_hours(24 * MOST_DAYS_CRITICAL);
        if matches!(action, AlarmAction::Shelve(until) if until > longest)
            && known.severity == Severity::Critical
        {
            return Ok(Err(NotDone::TooLong(anomaly_id)));
        }
        let mut life = Life::of(action.state());
        match action {
            AlarmAction::Shelve(until) => life.shelved_until = Some(until),
            AlarmAction::Resolve => life.resolved_seen_at = Some(known.last_seen_at),
            AlarmAction::Reopen
            | AlarmAction::Acknowledge
            | AlarmAction::Maintain
            | AlarmAction::FalseAlarm => {}
        }
        set_life(&mut *connection, anomaly_id, &life).await?;
        events.push(record(&mut *connection, anomaly_id, action.event(), Some(by)).await?);
    }
    Ok(Ok(events))
}

async fn note(
    connection: &mut EngineConnection,
    anomaly_id: i64,
    what: EventKind,
    by: Person<'_>,
    assignee: Option<Option<&str>>,
) -> sqlx::Result<Result<AnomalyEvent, NotDone>> {
    match find(&mut *connection, anomaly_id).await? {
        None => return Ok(Err(NotDone::Unknown(anomaly_id))),
        Some(known) if known.withdrawn => return Ok(Err(NotDone::Withdrawn(anomaly_id))),
        Some(_) => {}
    }
    if let Some(assignee) = assignee {
        sqlx::query("UPDATE anomaly SET assignee = $1 WHERE anomaly_id = $2")
            .bind_all((assignee, anomaly_id))
            .execute(&mut *connection)
            .await?;
    }
    record(connection, anomaly_id, what, Some(by)).await.map(Ok)
}

struct KnownAnomaly {
    state: AlarmState,
    ended: bool,
    withdrawn: bool,
    severity: Severity,
    last_seen_at: Timestamp,
}

async fn find(executor: impl EngineExecutor<'_>, anomaly_id: i64) -> sqlx::Result<Option<KnownAnomaly>> {
    sqlx::query("SELECT state, ended, withdrawn, severity, last_seen_at FROM anomaly WHERE anomaly_id = $1")
        .bind(anomaly_id)
        .try_map(|row: EngineRow| {
            Ok(KnownAnomaly {
                state: named(&row, "state", &AlarmState::ALL, AlarmState::name)?,
                ended: row.try_get("ended")?,
                withdrawn: row.try_get("withdrawn")?,
                severity: named(&row, "severity", &Severity::ALL, Severity::name)?,
                last_seen_at: time(&row, "last_seen_at")?,
            })
        })
        .fetch_optional(executor)
        .await
}

async fn set_life(executor: impl EngineExecutor<'_>, anomaly_id: i64, life: &Life) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE anomaly SET state = $1, shelved_until = $2, resolved_seen_at = $3 WHERE anomaly_id = $4",
    )
    .bind_all((life.state.name(), life.shelved_until.map(Timestamp::as_microsecond)))
    .bind_all((life.resolved_seen_at.map(Timestamp::as_microsecond), anomaly_id))
    .run(executor)
    .await
}

/// Shelved anomalies whose time has ended.
async fn shelved_before(executor: impl EngineExecutor<'_>, clock: Timestamp) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT anomaly_id FROM anomaly
         WHERE state = 'shelved' AND shelved_until <= $1 AND NOT withdrawn
         ORDER BY anomaly_id",
    )
    .bind(clock.as_microsecond())
    .fetch_all(executor)
    .await
}

async fn end_shelving(
    connection: &mut EngineConnection,
    clock: Timestamp,
) -> sqlx::Result<Vec<AnomalyEvent>> {
    let mut events = Vec::new();
    for anomaly_id in shelved_before(&mut *connection, clock).await? {
        set_life(&mut *connection, anomaly_id, &Life::of(AlarmState::Open)).await?;
        events.push(record(&mut *connection, anomaly_id, EventKind::Unshelved, None).await?);
    }
    let mut back = shown_after_work(&mut *connection).await?;
    back.extend(windows::over(&mut *connection, clock).await?);
    for anomaly_id in back {
        events.extend(open_again(&mut *connection, anomaly_id).await?);
    }
    events.extend(windows::hold(connection, clock).await?);
    Ok(events)
}

/// Anomalies in maintenance that a run shows which began with the latest maintenance of their place or after it. The
/// robot's conclusion must already include that maintenance, which ends most of them.
async fn shown_after_work(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT anomaly.anomaly_id
         FROM anomaly JOIN robot ON robot.robot_id = anomaly.robot_id
         WHERE anomaly.state = 'maintenance' AND anomaly.shelved_until IS NULL
               AND NOT anomaly.ended AND NOT anomaly.withdrawn
               AND robot.history = robot.concluded
               AND anomaly.last_seen_at >= (
                   SELECT max(maintenance.at) FROM maintenance
                   WHERE maintenance.robot_id = anomaly.robot_id
                         AND (maintenance.joint IS NULL OR maintenance.joint = anomaly.joint))
         ORDER BY anomaly.anomaly_id",
    )
    .fetch_all(executor)
    .await
}

/// Puts an anomaly into maintenance from any state.
pub(in crate::robot) async fn maintain(
    connection: &mut EngineConnection,
    anomaly_id: i64,
    by: Person<'_>,
) -> sqlx::Result<AnomalyEvent> {
    let action = AlarmAction::Maintain;
    set_life(&mut *connection, anomaly_id, &Life::of(action.state())).await?;
    record(connection, anomaly_id, action.event(), Some(by)).await
}

/// Puts an anomaly into maintenance until the end of a window.
pub(in crate::robot) async fn maintain_until(
    connection: &mut EngineConnection,
    anomaly_id: i64,
    until: Timestamp,
    by: Person<'_>,
) -> sqlx::Result<AnomalyEvent> {
    let life = Life { shelved_until: Some(until), ..Life::of(AlarmState::Maintenance) };
    set_life(&mut *connection, anomaly_id, &life).await?;
    record(connection, anomaly_id, EventKind::Maintenance, Some(by)).await
}

/// Opens an anomaly that was in maintenance. One that was withdrawn causes no event: if it is found again, it is open.
pub(in crate::robot) async fn open_again(
    connection: &mut EngineConnection,
    anomaly_id: i64,
) -> sqlx::Result<Option<AnomalyEvent>> {
    set_life(&mut *connection, anomaly_id, &Life::of(AlarmState::Open)).await?;
    let known = find(&mut *connection, anomaly_id).await?;
    match known {
        Some(KnownAnomaly { withdrawn: false, .. }) => {
            record(connection, anomaly_id, EventKind::Reopened, None).await.map(Some)
        }
        _ => Ok(None),
    }
}

/// Events of one anomaly or all, with keys above the first and up to the second bound, in order.
async fn history(
    executor: impl EngineExecutor<'_>,
    anomaly_id: Option<i64>,
    (after, last): (i64, i64),
) -> sqlx::Result<Vec<AnomalyHistoryRow>> {
    sqlx::query(
        "SELECT anomaly_event_id, anomaly_id, robot, joint, kind, at, what, severity, score, value, message, who, why,
                run_id, quantity
         FROM anomaly_history
         WHERE anomaly_id = coalesce($1, anomaly_id) AND anomaly_event_id > $2 AND anomaly_event_id <= $3
         ORDER BY anomaly_event_id",
    )
    .bind_all((anomaly_id, after, last))
    .try_map(|row: EngineRow| history_row(&row))
    .fetch_all(executor)
    .await
}

fn history_row(row: &EngineRow) -> sqlx::Result<AnomalyHistoryRow> {
    let of_joint: Option<i64> = row.try_get("joint")?;
    let quantity = named(row, "quantity", &Quantity::ALL, Quantity::name)?;
    Ok(AnomalyHistoryRow {
        anomaly_event_id: row.try_get("anomaly_event_id")?,
        anomaly_id: row.try_get("anomaly_id")?,
        robot: row.try_get("robot")?,
        joint: of_joint.map(|_| joint(row, "joint")).transpose()?,
        kind: row.try_get("kind")?,
        at: time_text(row, "at")?,
        what: named(row, "what", &EventKind::ALL, EventKind::name)?,
        severity: named(row, "severity", &Severity::ALL, Severity::name)?,
        score: row.try_get("score")?,
        value: row.try_get("value")?,
        message: row.try_get("message")?,
        who: row.try_get("who")?,
        why: row.try_get("why")?,
        run_id: row.try_get("run_id")?,
        quantity,
        unit: quantity.unit(),
    })
}

async fn evidence(executor: impl EngineExecutor<'_>, robot: &str) -> sqlx::Result<Vec<SeriesRun>> {
    sqlx::query(
        "SELECT run.run_id, run.started_at, summary.joint, summary.warm_friction_nm, summary.relative_rmsd,
                summary.rmsd_swing, friction_index.friction_index, friction_index.friction_index_std_error
         FROM run
         JOIN robot USING (robot_id)
         JOIN run_joint_summary AS summary USING (run_id)
         LEFT JOIN friction_index ON friction_index.run_id = run.run_id AND friction_index.joint = summary.joint
         WHERE robot.name = $1 AND run.status = 'complete' AND run.kind = 'test'
         ORDER BY run.started_at, run.run_id, summary.joint",
    )
    .bind(robot)
    .try_map(|row: EngineRow| {
        Ok(SeriesRun {
            run_id: row.try_get("run_id")?,
            started_at: time(&row, "started_at")?,
            joint: joint(&row, "joint")?,
            friction_index: row.try_get("friction_index")?,
            friction_index_std_error: row.try_get("friction_index_std_error")?,
            warm_friction_nm: row.try_get("warm_friction_nm")?,
            moving_relative_rmsd: row.try_get("relative_rmsd")?,
            rmsd_swing: row.try_get("rmsd_swing")?,
        })
    })
    .fetch_all(executor)
    .await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_already_is_said_as_a_sentence() {
        let said = |state| NotDone::NotFrom { anomaly_id: 1, state, ended: false }.to_string();
        for state in AlarmState::ALL {
            assert!(!said(state).contains('_'), "{}", said(state));
        }
        assert!(said(AlarmState::FalseAlarm).starts_with("anomaly 1 is a false alarm already: "));
        assert!(said(AlarmState::Maintenance).starts_with("anomaly 1 is in maintenance already: "));
        assert!(said(AlarmState::Acknowledged).starts_with("anomaly 1 is acknowledged already: "));
    }
}
