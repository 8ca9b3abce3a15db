//! Anomalies and health of a robot: stored rows are made to agree with the outcome of its history.

use std::collections::HashMap;

use jiff::Timestamp;
use sqlx::{QueryBuilder, Row};

use super::alarm_state::{AlarmState, Announcement, Before, EventKind, Life, Now, go_on};
use super::episodes::{Episode, RUNS_APART, Starts, is_another_fault, is_told_of_arm, same};
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::robot::{settled as settled_history, windows};
use crate::values::{count, finite, joint_number, known_time, named};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Alternative, Anomaly, AnomalyKind, Findings, JointHealth, Severity};
use armwatch_model::run::RunKind;

/// An event of an anomaly, as a row of the view `anomaly_history`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnomalyEvent {
    /// Database key of the event; later ones have larger keys.
    pub anomaly_event_id: i64,
    /// The anomaly.
    pub anomaly_id: i64,
    /// Kind of the event.
    pub what: EventKind,
}

/// Changes made by a reconciliation.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Reconciled {
    /// Events of anomalies, in the order of the audit table; empty if the history shows the same as before.
    pub events: Vec<AnomalyEvent>,
}

impl Reconciled {
    /// Keys of the anomalies that became open: new ones, and those seen again after they were closed.
    pub fn opened(&self) -> Vec<i64> {
        self.of(&[EventKind::Opened, EventKind::Reopened])
    }

    /// Keys of those that ended, or that the findings no longer contain.
    pub fn ended(&self) -> Vec<i64> {
        self.of(&[EventKind::Ended, EventKind::Withdrawn])
    }

    fn of(&self, kinds: &[EventKind]) -> Vec<i64> {
        let events = self.events.iter().filter(|event| kinds.contains(&event.what));
        events.map(|event| event.anomaly_id).collect()
    }
}

pub(in crate::robot) struct StoredAnomaly {
    pub(in crate::robot) anomaly_id: i64,
    pub(in crate::robot) episode: Episode,
    pub(in crate::robot) before: Before,
    /// The only test that shows it, if that was incomplete when it was found.
    pub(in crate::robot) open_test: Option<OpenTestOf>,
}

/// A test that was incomplete when an anomaly was found in it.
pub(in crate::robot) struct OpenTestOf {
    pub(in crate::robot) run_id: i64,
    is_streaming: bool,
    is_complete: bool,
}

impl StoredAnomaly {
    /// True if only a test that is still being written shows it.
    fn is_provisional(&self) -> bool {
        self.open_test.as_ref().is_some_and(|test| test.is_streaming)
    }

    /// Reason why the history no longer contains it, given the present findings; `None` without a special reason.
    fn why_withdrawn(&self, found: &[Episode], starts: &Starts) -> Option<&'static str> {
        match &self.open_test {
            Some(test) if test.is_complete => Some("not borne out by the whole test"),
            Some(_) => Some("the test was not read to its end"),
            None => {
                is_told_of_arm(&self.episode, found, starts).then_some("part of one alarm of the arm now")
            }
        }
    }
}

/// Makes the stored anomalies and health of a robot agree with `findings`, the outcome of its whole history, and stores
/// the events. `settled` has anomalies of the outcome by the key of the settled history; they are not examined further.
/// Anomalies settled earlier are no part of the outcome.
///
/// An episode keeps its number, its audit and the answers of people. Everything else that is shown depends only on the
/// history, not on the knowledge at earlier times. This includes the first run of the episode, which a new fit may
/// move; the events keep the run that showed it when it was announced. An episode that the history no longer contains
/// is withdrawn. One that only a test still being written shows stays until that test is complete. Shelving until
/// `clock` or earlier ends. Call this in a transaction.
pub(crate) async fn reconcile(
    connection: &mut EngineConnection,
    robot_id: i64,
    findings: &Findings,
    settled: &[(i64, &[Anomaly])],
    clock: Timestamp,
) -> sqlx::Result<Reconciled> {
    let stored = stored_anomalies(&mut *connection, robot_id).await?;
    let starts = run_starts(&mut *connection, robot_id, &stored).await?;
    let episodes: Vec<Episode> = stored.iter().map(|of| of.episode.clone()).collect();
    let now_settled = settled.iter().flat_map(|(by, of)| of.iter().map(|anomaly| (anomaly, Some(*by))));
    let anomalies: Vec<(&Anomaly, Option<i64>)> =
        now_settled.chain(findings.anomalies.iter().map(|anomaly| (anomaly, None))).collect();
    let found: Vec<Episode> = anomalies.iter().map(|(anomaly, _)| episode(anomaly)).collect();
    let chosen = same(&episodes, &found, &starts);
    let mut events = Vec::new();
    for (o, known) in stored.iter().enumerate() {
        // an anomaly that ended before it was announced causes no event
        let is_news = !known.episode.withdrawn && !known.is_provisional() && !chosen.contains(&Some(o));
        if is_news {
            withdraw_anomaly(&mut *connection, known.anomaly_id).await?;
        }
        if is_news && (known.before.told.is_some() || !known.before.life.state.is_closed()) {
            let (what, why) = (EventKind::Withdrawn, known.why_withdrawn(&found, &starts));
            events.push(record_because(&mut *connection, known.anomaly_id, what, why).await?);
        }
    }
    for ((anomaly, settled_by), known) in anomalies.into_iter().zip(chosen) {
        let Some(known) = known.map(|o| &stored[o]) else {
            let state = if anomaly.ended { AlarmState::Resolved } else { AlarmState::Open };
            let id = insert_anomaly(&mut *connection, robot_id, anomaly, state, None).await?;
            settled_history::settle_anomaly(&mut *connection, id, settled_by).await?;
            if !anomaly.ended {
                events.push(record(&mut *connection, id, EventKind::Opened, None).await?);
            }
            continue;
        };
        let kinds = (known.episode.kind, anomaly.kind);
        let now = Now {
            shown: Announcement { severity: anomaly.severity, score: finite(anomaly.score).map(f64::abs) },
            ended: anomaly.ended,
            last_seen_at: anomaly.last_seen_at,
            corrected: kinds.0 != kinds.1,
            is_another_fault: is_another_fault(kinds.0, kinds.1),
        };
        let (life, happened) = go_on(&known.before, &now, clock);
        update_anomaly(&mut *connection, known.anomaly_id, anomaly, &life, None).await?;
        for what in happened {
            events.push(record(&mut *connection, known.anomaly_id, what, None).await?);
        }
        settled_history::settle_anomaly(&mut *connection, known.anomaly_id, settled_by).await?;
    }
    replace_health(&mut *connection, robot_id, &findings.health).await?;
    set_expected_by(&mut *connection, robot_id, findings.expected_by).await?;
    events.extend(windows::hold(connection, clock).await?);
    Ok(Reconciled { events })
}

pub(in crate::robot) fn episode(of: &Anomaly) -> Episode {
    Episode {
        joint: of.joint.map(joint_number),
        kind: of.kind,
        quantity: of.quantity,
        from: of.onset.at.min(of.first_seen_at).as_microsecond(),
        to: of.last_seen_at.as_microsecond(),
        ended: of.ended,
        withdrawn: false,
    }
}

/// All anomalies of a robot that are not settled, including withdrawn ones, by number.
pub(in crate::robot) async fn stored_anomalies(
    connection: &mut EngineConnection,
    robot_id: i64,
) -> sqlx::Result<Vec<StoredAnomaly>> {
    let mut said = told(&mut *connection, robot_id).await?;
    sqlx::query(
        "SELECT anomaly_id, joint, anomaly.kind, quantity, severity, score, first_seen_at, last_seen_at, onset_at, state,
                shelved_until, resolved_seen_at, ended, withdrawn, open_run_id, open_run.status = 'streaming' AS is_streaming,
                open_run.status = 'complete' AS is_complete, open_run.started_at AS open_start
         FROM anomaly
         LEFT JOIN run AS open_run ON open_run.run_id = anomaly.open_run_id
         WHERE anomaly.robot_id = $1 AND settled_history_id IS NULL
         ORDER BY anomaly_id",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| {
        let anomaly_id = row.try_get("anomaly_id")?;
        let first: i64 = row.try_get("first_seen_at")?;
        let onset: Option<i64> = row.try_get("onset_at")?;
        // the start of an open test may still move
        let open_start: Option<i64> = row.try_get("open_start")?;
        let open_test = match row.try_get("open_run_id")? {
            Some(run_id) => Some(OpenTestOf {
                run_id,
                is_streaming: row.try_get("is_streaming")?,
                is_complete: row.try_get("is_complete")?,
            }),
            None => None,
        };
        let state = named(&row, "state", &AlarmState::ALL, AlarmState::name)?;
        let (mut told, shelved_severity) = said.remove(&anomaly_id).unwrap_or_default();
        if told.is_none() && !state.is_closed() {
            // stored by a version that wrote no events
            told = Some(shown(&row)?);
        }
        Ok(StoredAnomaly {
            anomaly_id,
            episode: Episode {
                joint: row.try_get("joint")?,
                kind: named(&row, "kind", &AnomalyKind::ALL, AnomalyKind::name)?,
                quantity: named(&row, "quantity", &Quantity::ALL, Quantity::name)?,
                from: open_start.unwrap_or_else(|| onset.map_or(first, |onset| onset.min(first))),
                to: open_start.map_or_else(|| row.try_get("last_seen_at"), Ok)?,
                ended: row.try_get("ended")?,
                withdrawn: row.try_get("withdrawn")?,
            },
            before: Before {
                life: Life {
                    state,
                    shelved_until: known_time(&row, "shelved_until")?,
                    resolved_seen_at: known_time(&row, "resolved_seen_at")?,
                },
                withdrawn: row.try_get("withdrawn")?,
                told,
                shelved_severity,
            },
            open_test,
        })
    })
    .fetch_all(connection)
    .await
}

/// Announcement of an anomaly since it was last opened, and its severity when it was last shelved.
type ShelvedAnnouncement = (Option<Announcement>, Option<Severity>);

/// Announcements of the robot's anomalies that are not settled, by key.
async fn told(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
) -> sqlx::Result<HashMap<i64, ShelvedAnnouncement>> {
    let rows: Vec<(i64, EventKind, Announcement)> = sqlx::query(
        "SELECT anomaly_event.anomaly_id, anomaly_event.what, anomaly_event.severity, anomaly_event.score
         FROM anomaly_event JOIN anomaly USING (anomaly_id)
         WHERE robot_id = $1 AND settled_history_id IS NULL
         ORDER BY anomaly_event_id",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| {
        let what = named(&row, "what", &EventKind::ALL, EventKind::name)?;
        Ok((row.try_get("anomaly_id")?, what, shown(&row)?))
    })
    .fetch_all(executor)
    .await?;
    let mut said: HashMap<i64, ShelvedAnnouncement> = HashMap::new();
    for (anomaly_id, what, now) in rows {
        let (told, shelved) = said.entry(anomaly_id).or_default();
        if matches!(what, EventKind::Opened | EventKind::Reopened) {
            *told = None;
        }
        if what == EventKind::Shelved {
            *shelved = Some(now.severity);
        }
        match told {
            Some(told) => told.and(now),
            None => *told = Some(now),
        }
    }
    Ok(said)
}

fn shown(row: &EngineRow) -> sqlx::Result<Announcement> {
    let score: Option<f64> = row.try_get("score")?;
    Ok(Announcement {
        severity: named(row, "severity", &Severity::ALL, Severity::name)?,
        score: score.map(f64::abs),
    })
}

/// Starts of the robot's complete runs that determine if a found episode continues one of these anomalies: the first
/// runs after each anomaly that has not ended, as many as are counted.
pub(in crate::robot) async fn run_starts(
    connection: &mut EngineConnection,
    robot_id: i64,
    stored: &[StoredAnomaly],
) -> sqlx::Result<Starts> {
    let mut starts = Starts::default();
    for of in stored.iter().filter(|of| !of.episode.ended) {
        for kind in [RunKind::Test, RunKind::Production] {
            let behind = starts_behind(&mut *connection, robot_id, kind, of.episode.to).await?;
            match kind {
                RunKind::Test => starts.tests.extend(behind),
                RunKind::Production => starts.production.extend(behind),
            }
        }
    }
    for of_kind in [&mut starts.tests, &mut starts.production] {
        of_kind.sort_unstable();
        of_kind.dedup();
    }
    Ok(starts)
}

async fn starts_behind(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    to: i64,
) -> sqlx::Result<Vec<i64>> {
    // each kind has a separate index
    let statement = match kind {
        RunKind::Test => {
            "SELECT started_at FROM run
             WHERE robot_id = $1 AND status = 'complete' AND kind = 'test' AND started_at > $2
             ORDER BY started_at LIMIT $3"
        }
        RunKind::Production => {
            "SELECT started_at FROM run
             WHERE robot_id = $1 AND status = 'complete' AND kind = 'production' AND started_at > $2
             ORDER BY started_at LIMIT $3"
        }
    };
    sqlx::query_scalar(statement).bind(robot_id).bind(to).bind(count(RUNS_APART)).fetch_all(executor).await
}

/// Author of a change to an anomaly, and the reason.
#[derive(Debug, Clone, Copy)]
pub(in crate::robot) struct Person<'a> {
    pub(in crate::robot) who: &'a str,
    pub(in crate::robot) why: Option<&'a str>,
}

/// Stores an event of an anomaly with the present state of the anomaly. Without a person, the program is the author.
pub(in crate::robot) async fn record(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    what: EventKind,
    by: Option<Person<'_>>,
) -> sqlx::Result<AnomalyEvent> {
    let (who, why) = (by.map(|person| person.who), by.and_then(|person| person.why));
    write_event(executor, anomaly_id, what, who, why).await
}

/// Like [`record`], for an event that the program causes for a reason.
async fn record_because(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    what: EventKind,
    why: Option<&str>,
) -> sqlx::Result<AnomalyEvent> {
    write_event(executor, anomaly_id, what, None, why).await
}

async fn write_event(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    what: EventKind,
    who: Option<&str>,
    why: Option<&str>,
) -> sqlx::Result<AnomalyEvent> {
    let anomaly_event_id = sqlx::query_scalar(
        "INSERT INTO anomaly_event (anomaly_id, what, severity, score, value, quantity, message, run_id, who, why)
         SELECT anomaly_id, $2, severity, score, value, quantity, message, last_run_id, $3, $4
         FROM anomaly
         WHERE anomaly_id = $1
         RETURNING anomaly_event_id",
    )
    .bind_all((anomaly_id, what.name(), who, why))
    .fetch_one(executor)
    .await?;
    Ok(AnomalyEvent { anomaly_event_id, anomaly_id, what })
}

/// Inserts an anomaly; `open_run_id` is the only test that shows it, if that is incomplete.
pub(in crate::robot) async fn insert_anomaly(
    connection: &mut EngineConnection,
    robot_id: i64,
    anomaly: &Anomaly,
    state: AlarmState,
    open_run_id: Option<i64>,
) -> sqlx::Result<i64> {
    let anomaly_id: i64 = sqlx::query_scalar(
        "INSERT INTO anomaly (robot_id, joint, kind, quantity, severity, first_seen_at, last_seen_at, state, message)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)
         RETURNING anomaly_id",
    )
    .bind_all((robot_id, anomaly.joint.map(joint_number), anomaly.kind.name(), anomaly.quantity.name()))
    .bind_all((anomaly.severity.name(), anomaly.first_seen_at.as_microsecond()))
    .bind_all((anomaly.last_seen_at.as_microsecond(), state.name(), &anomaly.message))
    .fetch_one(&mut *connection)
    .await?;
    update_anomaly(connection, anomaly_id, anomaly, &Life::of(state), open_run_id).await?;
    Ok(anomaly_id)
}

/// Stores everything about an anomaly except its number and joint.
pub(in crate::robot) async fn update_anomaly(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    anomaly: &Anomaly,
    life: &Life,
    open_run_id: Option<i64>,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE anomaly
         SET kind = $1, quantity = $2, severity = $3, score = $4, threshold = $5, value = $6, baseline = $7, peak_value = $8,
             peak_score = $9, first_run_id = $10, first_cycle = $11, last_run_id = $12, first_seen_at = $13, last_seen_at = $14,
             onset_run_id = $15, onset_cycle = $16, onset_at = $17, odds = $18, alternatives = $19, message = $20, ended = $21,
             state = $22, shelved_until = $23, resolved_seen_at = $24, withdrawn = FALSE, open_run_id = $25
         WHERE anomaly_id = $26",
    )
    .bind_all((anomaly.kind.name(), anomaly.quantity.name(), anomaly.severity.name(), finite(anomaly.score)))
    .bind_all((finite(anomaly.threshold), finite(anomaly.value), finite(anomaly.baseline)))
    .bind_all((finite(anomaly.peak_value), finite(anomaly.peak_score), anomaly.first_run_id))
    .bind_all((anomaly.first_cycle, anomaly.last_run_id, anomaly.first_seen_at.as_microsecond()))
    .bind_all((anomaly.last_seen_at.as_microsecond(), anomaly.onset.run_id, anomaly.onset.cycle))
    .bind_all((anomaly.onset.at.as_microsecond(), anomaly.odds.and_then(finite)))
    .bind_all((alternatives(&anomaly.alternatives), &anomaly.message, anomaly.ended, life.state.name()))
    .bind(life.shelved_until.map(Timestamp::as_microsecond))
    .bind_all((life.resolved_seen_at.map(Timestamp::as_microsecond), open_run_id, anomaly_id))
    .run(executor)
    .await
}

/// Rejected causes as a JSON array.
fn alternatives(rejected: &[Alternative]) -> String {
    let one = |of: &Alternative| serde_json::json!({ "cause": of.cause, "odds": finite(of.odds) });
    serde_json::Value::from_iter(rejected.iter().map(one)).to_string()
}

async fn withdraw_anomaly(executor: impl EngineExecutor<'_>, anomaly_id: i64) -> sqlx::Result<()> {
    sqlx::query("UPDATE anomaly SET withdrawn = TRUE WHERE anomaly_id = $1")
        .bind(anomaly_id)
        .run(executor)
        .await
}

async fn replace_health(
    connection: &mut EngineConnection,
    robot_id: i64,
    health: &[JointHealth],
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM joint_health WHERE robot_id = $1")
        .bind(robot_id)
        .execute(&mut *connection)
        .await?;
    if health.is_empty() {
        return Ok(());
    }
    QueryBuilder::<Engine>::new(
        "INSERT INTO joint_health (robot_id, joint, friction_index, friction_quantity, knowledge, reason,
                                  last_result_run_id, trend, warning_by, warning_by_lower, warning_by_upper,
                                  critical_by, critical_by_lower, critical_by_upper) ",
    )
    .push_values(health, |mut row, joint| {
        row.bind_all((robot_id, joint_number(joint.joint), joint.friction_index.and_then(finite)))
            .bind_all((joint.friction_quantity.map(Quantity::name), joint.knowledge.name()))
            .bind_all((joint.reason.as_deref(), joint.last_result_run_id))
            .push_bind(joint.forecast.map(|forecast| forecast.trend.name()));
        let limits = joint.forecast.map(|forecast| [forecast.warning_at, forecast.critical_at]);
        for crossing in limits.unwrap_or_default() {
            row.bind_all((crossing.map(|of| of.by.to_string()), crossing.map(|of| of.lower.to_string())))
                .push_bind(crossing.and_then(|of| of.upper).map(|upper| upper.to_string()));
        }
    })
    .build()
    .run(connection)
    .await
}

/// Stores when the next test is expected. A changed time, as a new test brings, ends the robot's overdue state.
async fn set_expected_by(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    expected_by: Option<Timestamp>,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE robot SET expected_by = $1, overdue = overdue AND expected_by IS NOT DISTINCT FROM $1
         WHERE robot_id = $2",
    )
    .bind_all((expected_by.map(as_text), robot_id))
    .run(executor)
    .await
}

/// A time as the views show it, always with milliseconds, so that the order of texts is the order of times.
pub(crate) fn as_text(time: Timestamp) -> String {
    time.strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string()
}
