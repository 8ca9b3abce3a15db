//! The queue of a receiver: the next message, the attempt, and its outcome.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use sqlx::{AssertSqlSafe, Row};

use super::alarm::{self, AlarmEvent, COLUMNS};
use super::clock::NOT_AHEAD;
use super::routes::{Held, RouteEntry};
use crate::engine::{Bind, EngineConnection, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::ledger::attempts::{self, Attempt, AttemptKind};
use crate::values::time;

/// Most alarms of one digest: an e-mail of some pages.
const DIGEST_ALARMS: i64 = 200;

/// A message that is due: one alarm, or a digest of several.
#[derive(Debug, Clone, PartialEq)]
pub struct DueMessage {
    /// Rows of `delivery`, in the order of `alarms`.
    pub delivery_ids: Vec<i64>,
    /// Number of the digest.
    pub digest: Option<i64>,
    /// Alarms that it contains.
    pub alarms: Vec<AlarmEvent>,
    /// Attempts so far.
    pub attempts: u32,
}

/// State of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RouteState {
    /// Attempts in a row that did not reach the receiver.
    pub failures: u32,
    /// Time of the next attempt; `None`: now.
    pub retry_at: Option<Timestamp>,
    /// Due time of the next message; `None`: no message waits.
    pub next_due_at: Option<Timestamp>,
    /// Messages sent within the requested time.
    pub sent: u32,
    /// Sending time of the first of these.
    pub first_sent_at: Option<Timestamp>,
}

/// Decision about sending a message now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SendDecision {
    /// Send it; the attempt is stored.
    Begun,
    /// At least one of its alarms no longer waits.
    NotWaiting,
    /// It is given up, because sending it has ended the program three times.
    GivenUp,
    /// It was a digest whose sending has ended the program three times; its alarms are sent one by one.
    TakenApart,
}

/// Reason for giving up a message whose sending ended the program.
const SPENT: &str = "sending it has ended the program three times";

/// Consequence of a failed attempt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Again {
    /// No message is sent on the route before this time: the receiver was not reached.
    Route(Timestamp),
    /// This message is not sent before this time: the receiver has refused it, but may accept others.
    Message(Timestamp),
}

impl Store {
    /// State of a route. Counts the messages sent within `window` before `now`; omits those that a fast clock dated
    /// after `now`.
    pub async fn route_state(
        &self,
        route_id: i64,
        now: Timestamp,
        window: SignedDuration,
    ) -> Result<RouteState, StoreError> {
        let read = sqlx::query(
            "SELECT failures, retry_at,
                    (SELECT min(due_at) FROM delivery
                     WHERE delivery_route_id = $1 AND state = 'pending') AS next_due_at,
                    (SELECT count(DISTINCT coalesce(digest, -delivery_id)) FROM delivery
                     WHERE delivery_route_id = $1 AND state = 'sent' AND sent_at > $2 AND sent_at <= $3) AS sent,
                    (SELECT min(sent_at) FROM delivery
                     WHERE delivery_route_id = $1 AND state = 'sent' AND sent_at > $2 AND sent_at <= $3)
                        AS first_sent_at
             FROM delivery_route WHERE delivery_route_id = $1",
        )
        .bind_all((route_id, (now - window).as_microsecond(), (now + NOT_AHEAD).as_microsecond()))
        .try_map(|row: EngineRow| {
            let moment = |column| match row.try_get::<Option<i64>, _>(column)? {
                Some(_) => time(&row, column).map(Some),
                None => Ok(None),
            };
            Ok(RouteState {
                failures: row.try_get("failures")?,
                retry_at: moment("retry_at")?,
                next_due_at: moment("next_due_at")?,
                sent: row.try_get("sent")?,
                first_sent_at: moment("first_sent_at")?,
            })
        });
        self.checked(read.fetch_one(&self.readers).await)
    }

    /// Next message of a route, if one is due. The events of an anomaly are sent in order; a message that was refused
    /// lets others pass. Events held for a digest or because of a flood become one message. Its number and content are
    /// stored before it is sent, so that another attempt sends the same message.
    ///
    /// # Errors
    /// [`StoreError::LeaseEnded`] if the claim on the route is lost; others of the database.
    pub async fn next_message(
        &self,
        route: RouteEntry,
        now: Timestamp,
    ) -> Result<Option<DueMessage>, StoreError> {
        let mut transaction = self.begin_on(route).await?;
        let next = next_message(&mut transaction, route.route_id, now).await;
        let next = self.checked(next)?;
        self.commit(transaction).await?;
        Ok(next)
    }

    /// Lets everything that is due on a route wait.
    ///
    /// # Errors
    /// Those of [`Store::next_message`].
    pub async fn hold(
        &self,
        route: RouteEntry,
        now: Timestamp,
        until: Timestamp,
        held: Held,
    ) -> Result<u64, StoreError> {
        let mut transaction = self.begin_on(route).await?;
        let statement = sqlx::query(
            "UPDATE delivery SET held = $1, due_at = $2
             WHERE delivery_route_id = $3 AND state = 'pending' AND digest IS NULL AND due_at <= $4",
        )
        .bind_all((held.name(), until.as_microsecond(), route.route_id, now.as_microsecond()));
        let held = self.checked(statement.execute(&mut *transaction).await)?.rows_affected();
        self.commit(transaction).await?;
        Ok(held)
    }

    /// Lets one message wait.
    ///
    /// # Errors
    /// Those of [`Store::next_message`].
    pub async fn hold_message(
        &self,
        route: RouteEntry,
        message: &DueMessage,
        until: Timestamp,
        held: Held,
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin_on(route).await?;
        let statement = sqlx::query(
            "UPDATE delivery SET held = $1, due_at = $2
             WHERE delivery_id IN (SELECT CAST(value AS BIGINT) FROM json_each($3))",
        )
        .bind_all((held.name(), until.as_microsecond(), ids(message)));
        self.checked(statement.execute(&mut *transaction).await)?;
        self.commit(transaction).await
    }

    /// Stores that a message is being sent, before it is sent. A killed process thus remembers that the message may
    /// have arrived, and a message that kills the process is not sent forever.
    ///
    /// # Errors
    /// Those of [`Store::next_message`]; the message must not be sent then.
    pub async fn begin_attempt(
        &self,
        route: RouteEntry,
        message: &DueMessage,
        now: Timestamp,
    ) -> Result<SendDecision, StoreError> {
        let mut transaction = self.begin_on(route).await?;
        let mut is_spent = false;
        for (delivery_id, alarm) in message.delivery_ids.iter().zip(&message.alarms) {
            let begun = sqlx::query(
                "UPDATE delivery
                 SET attempts = attempts + 1, attempted_at = $1, told_kind = $2, told_severity = $3,
                     first_attempted_at = coalesce(first_attempted_at, $4)
                 WHERE delivery_id = $5 AND state = 'pending'",
            )
            .bind_all((now.as_microsecond(), alarm.kind.name(), alarm.severity.name(), now.as_microsecond()))
            .bind(delivery_id);
            if self.checked(begun.execute(&mut *transaction).await)?.rows_affected() == 0 {
                self.checked(transaction.rollback().await)?;
                return Ok(SendDecision::NotWaiting);
            }
            let attempt = attempts::begin_delivery(&mut transaction, *delivery_id).await;
            is_spent |= self.checked(attempt)?.is_spent();
        }
        let sending = match (is_spent, message.digest) {
            (false, _) => SendDecision::Begun,
            (true, None) => SendDecision::GivenUp,
            (true, Some(_)) => SendDecision::TakenApart,
        };
        if is_spent {
            let set_aside = sqlx::query(
                "UPDATE delivery
                 SET state = CASE WHEN digest IS NULL THEN 'failed' ELSE state END, error = $1, digest = NULL, held = NULL
                 WHERE delivery_id IN (SELECT CAST(value AS BIGINT) FROM json_each($2))",
            );
            let set_aside = set_aside.bind(SPENT).bind(ids(message)).execute(&mut *transaction).await;
            self.checked(set_aside)?;
            self.checked(attempts::end_deliveries(&mut *transaction, &ids(message)).await)?;
        }
        self.commit(transaction).await?;
        Ok(sending)
    }

    /// Returns true if the next attempt at a message is the last one, since earlier ones have ended the program.
    pub async fn is_last_attempt(&self, message: &DueMessage) -> Result<bool, StoreError> {
        let mut failed = 0;
        for delivery_id in &message.delivery_ids {
            let of = self.failed_attempts(AttemptKind::Delivery, &delivery_id.to_string()).await?;
            failed = failed.max(of);
        }
        Ok(Attempt { number: failed + 1 }.is_last())
    }

    /// Stores that a message has arrived.
    ///
    /// # Errors
    /// Those of [`Store::next_message`]; the message is sent again then.
    pub async fn mark_sent(
        &self,
        route: RouteEntry,
        message: &DueMessage,
        now: Timestamp,
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin_on(route).await?;
        let sent = sqlx::query(
            "UPDATE delivery SET state = 'sent', sent_at = $1, error = NULL
             WHERE delivery_id IN (SELECT CAST(value AS BIGINT) FROM json_each($2))",
        )
        .bind_all((now.as_microsecond(), ids(message)));
        self.checked(sent.execute(&mut *transaction).await)?;
        self.checked(attempts::end_deliveries(&mut *transaction, &ids(message)).await)?;
        let reached = sqlx::query(
            "UPDATE delivery_route SET failures = 0, retry_at = NULL WHERE delivery_route_id = $1",
        );
        self.checked(reached.bind(route.route_id).execute(&mut *transaction).await)?;
        self.commit(transaction).await
    }

    /// Stores that a message did not arrive. Returns true if it is given up, because its first attempt was at least
    /// `give_up_after` ago.
    ///
    /// # Errors
    /// Those of [`Store::next_message`].
    pub async fn mark_failed(
        &self,
        route: RouteEntry,
        message: &DueMessage,
        error: &str,
        again: Again,
        (now, give_up_after): (Timestamp, Duration),
    ) -> Result<bool, StoreError> {
        let begun_before =
            now.as_microsecond().saturating_sub(i64::try_from(give_up_after.as_micros()).unwrap_or(i64::MAX));
        let mut transaction = self.begin_on(route).await?;
        let due_at = match again {
            Again::Message(at) => Some(at.as_microsecond()),
            Again::Route(_) => None,
        };
        let failed = sqlx::query(
            "UPDATE delivery
             SET error = $1, due_at = coalesce($2, due_at),
                 state = CASE WHEN first_attempted_at <= $3 THEN 'failed' ELSE state END
             WHERE delivery_id IN (SELECT CAST(value AS BIGINT) FROM json_each($4))",
        )
        .bind_all((error, due_at, begun_before, ids(message)));
        self.checked(failed.execute(&mut *transaction).await)?;
        self.checked(attempts::end_deliveries(&mut *transaction, &ids(message)).await)?;
        let after = match again {
            Again::Route(at) => sqlx::query(
                "UPDATE delivery_route SET failures = failures + 1, retry_at = $1 WHERE delivery_route_id = $2",
            )
            .bind(at.as_microsecond()),
            Again::Message(_) => sqlx::query(
                "UPDATE delivery_route SET failures = 0, retry_at = NULL WHERE delivery_route_id = $1",
            ),
        };
        self.checked(after.bind(route.route_id).execute(&mut *transaction).await)?;
        let given_up = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM delivery
                            WHERE delivery_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
                                  AND state = 'failed')",
        )
        .bind(ids(message));
        let given_up: bool = self.checked(given_up.fetch_one(&mut *transaction).await)?;
        self.commit(transaction).await?;
        Ok(given_up)
    }
}

fn ids(message: &DueMessage) -> String {
    serde_json::Value::from_iter(message.delivery_ids.iter().copied()).to_string()
}

async fn next_message(
    connection: &mut EngineConnection,
    route_id: i64,
    now: Timestamp,
) -> sqlx::Result<Option<DueMessage>> {
    compose_digest(&mut *connection, route_id, now).await?;
    let first = sqlx::query(
        "SELECT delivery_id, digest
         FROM delivery
         JOIN anomaly_event USING (anomaly_event_id)
         WHERE delivery_route_id = $1 AND state = 'pending' AND due_at <= $2
               AND (digest IS NOT NULL OR NOT EXISTS (
                   SELECT 1 FROM delivery AS earlier
                   JOIN anomaly_event AS event ON event.anomaly_event_id = earlier.anomaly_event_id
                   WHERE earlier.delivery_route_id = $1 AND earlier.state = 'pending'
                         AND event.anomaly_id = anomaly_event.anomaly_id
                         AND event.anomaly_event_id < anomaly_event.anomaly_event_id))
         ORDER BY attempts, anomaly_event.anomaly_event_id
         LIMIT 1",
    )
    .bind_all((route_id, now.as_microsecond()))
    .fetch_optional(&mut *connection)
    .await?;
    let Some(first) = first else { return Ok(None) };
    let (delivery_id, digest): (i64, Option<i64>) = (first.try_get("delivery_id")?, first.try_get("digest")?);
    let statement = format!(
        "SELECT {COLUMNS}, delivery.delivery_id, delivery.attempts
         FROM delivery
         JOIN anomaly_event USING (anomaly_event_id)
         JOIN anomaly USING (anomaly_id)
         JOIN robot USING (robot_id)
         WHERE delivery.delivery_route_id = $1 AND delivery.state = 'pending'
               AND (delivery.delivery_id = $2 OR delivery.digest = $3)
         ORDER BY anomaly_event_id"
    );
    let rows = sqlx::query(AssertSqlSafe(statement))
        .bind_all((route_id, delivery_id, digest))
        .fetch_all(&mut *connection)
        .await?;
    let mut message = DueMessage { delivery_ids: Vec::new(), digest, alarms: Vec::new(), attempts: 0 };
    for row in &rows {
        if let Some(mut alarm) = alarm::from_row(row)? {
            alarm::complete(&mut *connection, route_id, &mut alarm).await?;
            message.delivery_ids.push(row.try_get("delivery_id")?);
            message.alarms.push(alarm);
            message.attempts = message.attempts.max(row.try_get("attempts")?);
        }
    }
    Ok(Some(message))
}

/// Makes one message of everything that is due, if part of it waited for a digest.
async fn compose_digest(
    connection: &mut EngineConnection,
    route_id: i64,
    now: Timestamp,
) -> sqlx::Result<()> {
    const DUE: &str = "delivery_route_id = $1 AND state = 'pending' AND digest IS NULL AND due_at <= $2";
    let any = format!("SELECT EXISTS (SELECT 1 FROM delivery WHERE {DUE} AND held IN ('digest', 'flood'))");
    let any: bool = sqlx::query_scalar(AssertSqlSafe(any))
        .bind_all((route_id, now.as_microsecond()))
        .fetch_one(&mut *connection)
        .await?;
    if !any {
        return Ok(());
    }
    let chosen = format!(
        "SELECT anomaly_event_id FROM delivery WHERE {DUE} AND attempts = 0 ORDER BY anomaly_event_id LIMIT $3"
    );
    let statement = format!(
        "UPDATE delivery SET digest = (SELECT max(anomaly_event_id) FROM ({chosen}) AS chosen)
         WHERE delivery_route_id = $1 AND anomaly_event_id IN ({chosen})"
    );
    sqlx::query(AssertSqlSafe(statement))
        .bind_all((route_id, now.as_microsecond(), DIGEST_ALARMS))
        .run(connection)
        .await
}
