//! Times that a fast clock has left in the outbox: a message due at such a time would wait until that date.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use sqlx::AssertSqlSafe;

use super::routes::RouteEntry;
use crate::engine::{Bind, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::known_time;

/// Tolerance for clocks that are corrected while they run.
pub(super) const NOT_AHEAD: SignedDuration = SignedDuration::from_mins(1);

/// Longest delay of a message by quiet hours and digests: a day, which has 25 hours when clocks are set back, and one
/// more hour.
const LONGEST_HOLD: SignedDuration = SignedDuration::from_hours(26);

/// Messages on a route that are due later than any delay of their kind allows.
const AHEAD: &str = "delivery_route_id = $1 AND state = 'pending'
                     AND due_at > CASE WHEN held IN ('quiet', 'digest') THEN $3 ELSE $2 END";

impl Store {
    /// Makes messages on a route due now that are due later than any delay allows: the clock was fast when the time was
    /// written. `longest_pause` is the longest delay of an attempt or of a message that exceeds the rate limit; quiet
    /// hours and digests delay by at most a day. Returns the latest such time, including that of a sent message, which
    /// stays unchanged.
    ///
    /// # Errors
    /// [`StoreError::LeaseEnded`] if the claim on the route is lost; others of the database.
    pub async fn mend_moments(
        &self,
        route: RouteEntry,
        (now, longest_pause): (Timestamp, Duration),
    ) -> Result<Option<Timestamp>, StoreError> {
        let pause = SignedDuration::try_from(longest_pause).unwrap_or(SignedDuration::MAX);
        let limit = |wait| microseconds(now, NOT_AHEAD.saturating_add(wait));
        let (paused_until, held_until) = (limit(pause), limit(pause.max(LONGEST_HOLD)));
        let found = format!(
            "SELECT (SELECT max(due_at) FROM delivery WHERE {AHEAD}) AS due_at,
                    (SELECT retry_at FROM delivery_route WHERE delivery_route_id = $1 AND retry_at > $2) AS retry_at,
                    (SELECT max(sent_at) FROM delivery
                     WHERE delivery_route_id = $1 AND state = 'sent' AND sent_at > $4) AS sent_at"
        );
        let found = sqlx::query(AssertSqlSafe(found))
            .bind_all((route.route_id, paused_until, held_until, limit(SignedDuration::ZERO)))
            .try_map(|row: EngineRow| {
                let waits = known_time(&row, "due_at")?.max(known_time(&row, "retry_at")?);
                Ok((waits, known_time(&row, "sent_at")?))
            });
        // the writer is only needed if there is something to write
        let (waits, sent_at) = self.checked(found.fetch_one(&self.readers).await)?;
        if waits.is_some() {
            let mut transaction = self.begin_on(route).await?;
            let due = sqlx::query(AssertSqlSafe(format!("UPDATE delivery SET due_at = $4 WHERE {AHEAD}")))
                .bind_all((route.route_id, paused_until, held_until, now.as_microsecond()));
            self.checked(due.execute(&mut *transaction).await)?;
            let reached = sqlx::query(
                "UPDATE delivery_route SET retry_at = NULL WHERE delivery_route_id = $1 AND retry_at > $2",
            )
            .bind_all((route.route_id, paused_until));
            self.checked(reached.execute(&mut *transaction).await)?;
            self.commit(transaction).await?;
        }
        Ok(waits.max(sent_at))
    }
}

/// The time `wait` after `now`, or the last possible time, in microseconds.
fn microseconds(now: Timestamp, wait: SignedDuration) -> i64 {
    now.checked_add(wait).unwrap_or(Timestamp::MAX).as_microsecond()
}
