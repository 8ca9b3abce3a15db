//! Routes, and the selection of events for each of them.

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, Row};

use super::alarm::{self, AlarmEvent, COLUMNS};
use super::event::{SPEAKING, TOLD};
use crate::engine::{Bind, EngineConnection, EngineTransaction, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::alarms::alarm_state::EventKind;

/// Most events handled in one transaction: a fleet's backlog must not hold the writer for long.
const EVENTS_AT_ONCE: i64 = 200;

armwatch_model::named_enum! {
    /// Reason why a message is not sent at once.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Held {
        /// Quiet hours.
        Quiet = "quiet",
        /// The route sends all messages of a day as one.
        Digest = "digest",
        /// Too many messages within an hour.
        Flood = "flood",
    }
}

/// Fate of an event on a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventFate {
    /// The receiver gets it, not before a given time.
    Send {
        /// The time.
        due_at: Timestamp,
        /// Reason for the delay.
        held: Option<Held>,
    },
    /// The route selects it, but a person has silenced it.
    Suppress,
    /// The route does not select it.
    Nothing,
}

/// A route in the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RouteEntry {
    /// Its key.
    pub route_id: i64,
    /// True if it is new, so that it began with the open anomalies.
    pub is_new: bool,
    /// Session whose claim on the route every write needs; `None` for a database in a file, which has one daemon.
    pub(super) session: Option<i64>,
}

impl Store {
    /// Enters a route of the configuration. A new one begins with the open alarms that `judge` selects, each by its
    /// latest event. Earlier events are not sent.
    pub async fn enter_route(
        &self,
        name: &str,
        now: Timestamp,
        judge: impl Fn(&AlarmEvent) -> EventFate,
    ) -> Result<RouteEntry, StoreError> {
        let mut transaction = self.begin().await?;
        let entered = enter_route(&mut transaction, name, now, judge).await;
        let entered = self.checked(entered)?;
        self.commit(transaction).await?;
        Ok(entered)
    }

    /// The route, bound to the claim that this program has just obtained. Writes with this entry fail once the claim is
    /// lost, even under a new session of this program.
    pub fn claimed(&self, route: RouteEntry) -> RouteEntry {
        RouteEntry { session: self.session(), ..route }
    }

    /// A transaction that has the write lock, on a route whose claim is valid. The claim stays valid until the
    /// transaction ends, because ending a session needs the lock.
    ///
    /// # Errors
    /// [`StoreError::LeaseEnded`] if the claim is lost; others of the database.
    pub(super) async fn begin_on(&self, route: RouteEntry) -> Result<EngineTransaction, StoreError> {
        let mut transaction = self.begin().await?;
        let Some(session) = route.session else { return Ok(transaction) };
        let claimed = sqlx::query_scalar(
            "SELECT EXISTS (
                 SELECT 1 FROM claim
                 JOIN delivery_route ON delivery_route.name = claim.subject
                 WHERE claim.kind = 'route' AND delivery_route_id = $1 AND host_session_id = $2)",
        )
        .bind_all((route.route_id, session));
        let is_claimed: bool = self.checked(claimed.fetch_one(&mut *transaction).await)?;
        if is_claimed {
            Ok(transaction)
        } else {
            Err(StoreError::LeaseEnded { path: self.path.to_path_buf() })
        }
    }

    /// Ends the routes whose names are not given: events that they have not sent are suppressed.
    pub async fn retire_routes(&self, names: &[&str]) -> Result<u64, StoreError> {
        let mut transaction = self.begin().await?;
        let retired = self.checked(retire_routes(&mut transaction, names).await)?;
        self.commit(transaction).await?;
        Ok(retired)
    }

    /// Handles the events that a route has not seen, as `judge` decides, and marks them as seen in the same
    /// transaction. An event that closes an alarm is sent only if the alarm was. Returns true if there was one.
    ///
    /// # Errors
    /// [`StoreError`] of the database; no event is handled then.
    pub async fn hand_on(
        &self,
        route_id: i64,
        now: Timestamp,
        judge: impl Fn(&AlarmEvent) -> EventFate,
    ) -> Result<bool, StoreError> {
        let unseen = sqlx::query_scalar(
            "SELECT EXISTS (
                 SELECT 1 FROM anomaly_event WHERE anomaly_event_id > (
                     SELECT seen_event_id FROM delivery_route WHERE delivery_route_id = $1))",
        );
        // the writer is only needed if there is something to write
        if !self.checked(unseen.bind(route_id).fetch_one(&self.readers).await)? {
            return Ok(false);
        }
        let mut transaction = self.begin().await?;
        let done = hand_on(&mut transaction, route_id, now, judge).await;
        self.checked(done)?;
        self.commit(transaction).await?;
        Ok(true)
    }
}

async fn enter_route(
    connection: &mut EngineConnection,
    name: &str,
    now: Timestamp,
    judge: impl Fn(&AlarmEvent) -> EventFate,
) -> sqlx::Result<RouteEntry> {
    let known = sqlx::query("SELECT delivery_route_id, retired FROM delivery_route WHERE name = $1")
        .bind(name)
        .fetch_optional(&mut *connection)
        .await?;
    if let Some(row) = &known
        && !row.try_get::<bool, _>("retired")?
    {
        return Ok(RouteEntry { route_id: row.try_get("delivery_route_id")?, is_new: false, session: None });
    }
    let route_id = sqlx::query_scalar(
        "INSERT INTO delivery_route (name, seen_event_id)
         VALUES ($1, (SELECT coalesce(max(anomaly_event_id), 0) FROM anomaly_event))
         ON CONFLICT (name) DO UPDATE
         SET seen_event_id = excluded.seen_event_id, retired = FALSE, failures = 0, retry_at = NULL
         RETURNING delivery_route_id",
    )
    .bind(name)
    .fetch_one(&mut *connection)
    .await?;
    for event in alarm::open_alarms(&mut *connection).await? {
        settle(&mut *connection, route_id, now, &event, judge(&event)).await?;
    }
    Ok(RouteEntry { route_id, is_new: true, session: None })
}

async fn retire_routes(connection: &mut EngineConnection, names: &[&str]) -> sqlx::Result<u64> {
    let names = serde_json::Value::from_iter(names.iter().copied()).to_string();
    let gone = "name NOT IN (SELECT value FROM json_each($1)) AND NOT retired";
    let statement = format!(
        "UPDATE delivery SET state = 'suppressed', error = 'the route is not in the configuration any more'
         WHERE state = 'pending'
               AND delivery_route_id IN (SELECT delivery_route_id FROM delivery_route WHERE {gone})"
    );
    let spared = sqlx::query(AssertSqlSafe(statement)).bind(&names).execute(&mut *connection).await?;
    let statement = format!("UPDATE delivery_route SET retired = TRUE WHERE {gone}");
    sqlx::query(AssertSqlSafe(statement)).bind(&names).execute(connection).await?;
    Ok(spared.rows_affected())
}

async fn hand_on(
    connection: &mut EngineConnection,
    route_id: i64,
    now: Timestamp,
    judge: impl Fn(&AlarmEvent) -> EventFate,
) -> sqlx::Result<()> {
    // events that are never announced count as seen too
    let last: i64 = sqlx::query_scalar(
        "SELECT coalesce(max(anomaly_event_id), 0) FROM (
             SELECT anomaly_event_id FROM anomaly_event
             WHERE anomaly_event_id > (SELECT seen_event_id FROM delivery_route WHERE delivery_route_id = $1)
             ORDER BY anomaly_event_id LIMIT $2) AS next",
    )
    .bind_all((route_id, EVENTS_AT_ONCE))
    .fetch_one(&mut *connection)
    .await?;
    let statement = format!(
        "SELECT {COLUMNS}
         FROM anomaly_event
         JOIN anomaly USING (anomaly_id)
         JOIN robot USING (robot_id)
         WHERE anomaly_event_id > (SELECT seen_event_id FROM delivery_route WHERE delivery_route_id = $1)
               AND anomaly_event_id <= $2 AND what IN {TOLD}
         ORDER BY anomaly_event_id"
    );
    let events = sqlx::query(AssertSqlSafe(statement))
        .bind_all((route_id, last))
        .try_map(|row| alarm::from_row(&row))
        .fetch_all(&mut *connection)
        .await?;
    for event in events.iter().flatten() {
        settle(&mut *connection, route_id, now, event, judge(event)).await?;
    }
    sqlx::query(
        "UPDATE delivery_route SET seen_event_id = max(seen_event_id, $1) WHERE delivery_route_id = $2",
    )
    .bind_all((last, route_id))
    .run(connection)
    .await
}

/// Stores the fate of one event on one route.
async fn settle(
    connection: &mut EngineConnection,
    route_id: i64,
    now: Timestamp,
    event: &AlarmEvent,
    fate: EventFate,
) -> sqlx::Result<()> {
    if event.what.closes() {
        spare_untold(&mut *connection, route_id, event).await?;
        if !is_told(&mut *connection, route_id, event).await? {
            return Ok(());
        }
    }
    let (state, due_at, held, error) = match fate {
        EventFate::Nothing => return Ok(()),
        EventFate::Suppress => {
            ("suppressed", now, None, Some("the alarm is shelved, in maintenance or false"))
        }
        EventFate::Send { due_at, held } => ("pending", due_at, held, None),
    };
    // a route that returns gets the events that were suppressed
    sqlx::query(
        "INSERT INTO delivery (delivery_route_id, anomaly_event_id, state, held, created_at, due_at, error)
         VALUES ($1, $2, $3, $4, $5, $6, $7)
         ON CONFLICT (delivery_route_id, anomaly_event_id) DO UPDATE
         SET state = excluded.state, held = excluded.held, due_at = excluded.due_at, error = excluded.error,
             digest = NULL
         WHERE delivery.state = 'suppressed'",
    )
    .bind_all((route_id, event.event_id, state, held.map(Held::name), now.as_microsecond()))
    .bind_all((due_at.as_microsecond(), error))
    .run(connection)
    .await
}

/// Suppresses the waiting messages about an anomaly that was withdrawn or marked as a false alarm before they were
/// sent.
async fn spare_untold(
    connection: &mut EngineConnection,
    route_id: i64,
    event: &AlarmEvent,
) -> sqlx::Result<()> {
    if !matches!(event.what, EventKind::Withdrawn | EventKind::FalseAlarm) {
        return Ok(());
    }
    sqlx::query(
        "UPDATE delivery SET state = 'suppressed', error = 'taken back before it was sent: ' || $1
         WHERE delivery_route_id = $2 AND state = 'pending' AND attempts = 0 AND digest IS NULL
               AND anomaly_event_id IN (
                   SELECT anomaly_event_id FROM anomaly_event WHERE anomaly_id = $3 AND anomaly_event_id < $4)",
    )
    .bind_all((event.what.name(), route_id, event.anomaly_id, event.event_id))
    .run(connection)
    .await
}

/// True if the route's latest event of the anomaly, sent or waiting, calls for attention.
async fn is_told(connection: &mut EngineConnection, route_id: i64, event: &AlarmEvent) -> sqlx::Result<bool> {
    let statement = format!(
        "SELECT coalesce((
             SELECT earlier.what IN {SPEAKING}
             FROM delivery
             JOIN anomaly_event AS earlier USING (anomaly_event_id)
             WHERE delivery.delivery_route_id = $1 AND delivery.state <> 'suppressed' AND earlier.anomaly_id = $2
                   AND earlier.anomaly_event_id < $3
             ORDER BY earlier.anomaly_event_id DESC
             LIMIT 1
         ), FALSE)"
    );
    sqlx::query_scalar(AssertSqlSafe(statement))
        .bind_all((route_id, event.anomaly_id, event.event_id))
        .fetch_one(connection)
        .await
}
