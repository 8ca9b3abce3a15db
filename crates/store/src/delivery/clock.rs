//! Moments that a clock which was ahead has left in the outbox: what waits for one would be silent until that date.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use sqlx::AssertSqlSafe;

use super::routes::RouteEntry;
use crate::engine::EngineRow;
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::known_time;

/// What lies no further ahead is due to clocks that are set right while they run.
pub(super) const NOT_AHEAD: SignedDuration = SignedDuration::from_mins(1);

/// The longest that quiet hours and digests hold a message: a day, which has 25 hours where clocks are set back, and an
/// hour more.
const LONGEST_HOLD: SignedDuration = SignedDuration::from_hours(26);

/// What waits on a route for a moment that no wait of its kind reaches.
const AHEAD: &str = "delivery_route_id = $1 AND state = 'pending'
                     AND due_at > CASE WHEN held IN ('quiet', 'digest') THEN $3 ELSE $2 END";

impl Store {
    /// Makes due now what waits on a route for a moment further ahead than anything is made to wait: the clock was ahead
    /// when the moment was written. `longest_pause` is the longest for which an attempt or a message that is one of too
    /// many is put off; quiet hours and digests are at most a day. Gives the furthest moment found, be it that of a
    /// message sent then, which stays as it is.
    ///
    /// # Errors
    /// [`StoreError::LeaseEnded`] where the claim on the route is lost, and others of the database.
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
            .bind(route.route_id)
            .bind(paused_until)
            .bind(held_until)
            .bind(limit(SignedDuration::ZERO))
            .try_map(|row: EngineRow| {
                let waits = known_time(&row, "due_at")?.max(known_time(&row, "retry_at")?);
                Ok((waits, known_time(&row, "sent_at")?))
            });
        // the writer is asked for only where there is something to write
        let (waits, sent_at) = self.checked(found.fetch_one(&self.readers).await)?;
        if waits.is_some() {
            let mut transaction = self.begin_on(route).await?;
            let due = sqlx::query(AssertSqlSafe(format!("UPDATE delivery SET due_at = $4 WHERE {AHEAD}")))
                .bind(route.route_id)
                .bind(paused_until)
                .bind(held_until)
                .bind(now.as_microsecond());
            self.checked(due.execute(&mut *transaction).await)?;
            let reached = sqlx::query(
                "UPDATE delivery_route SET retry_at = NULL WHERE delivery_route_id = $1 AND retry_at > $2",
            )
            .bind(route.route_id)
            .bind(paused_until);
            self.checked(reached.execute(&mut *transaction).await)?;
            self.commit(transaction).await?;
        }
        Ok(waits.max(sent_at))
    }
}

/// A moment so long after another one, or the last that there is.
fn microseconds(now: Timestamp, wait: SignedDuration) -> i64 {
    now.checked_add(wait).unwrap_or(Timestamp::MAX).as_microsecond()
}
