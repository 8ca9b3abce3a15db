//! Alarms that no one has answered.

use std::time::Duration;

use jiff::Timestamp;
use sqlx::AssertSqlSafe;

use super::event::SPEAKING;
use crate::error::StoreError;
use crate::handle::Store;

impl Store {
    /// Stores an event `overdue` for every open alarm that has had no event calling for attention for `after` and that
    /// no one has answered. Alarms are anomalies of severity warning or critical. Returns their number.
    pub async fn remind(&self, now: Timestamp, after: Duration) -> Result<u64, StoreError> {
        let since = now.as_microsecond().saturating_sub(i64::try_from(after.as_micros()).unwrap_or(i64::MAX));
        let silent = format!(
            "FROM anomaly
             WHERE state = 'open' AND NOT withdrawn AND severity IN ('warning', 'critical')
                   AND (SELECT max(at) FROM anomaly_event
                        WHERE anomaly_event.anomaly_id = anomaly.anomaly_id AND what IN {SPEAKING}) <= $1"
        );
        let any = format!("SELECT EXISTS (SELECT 1 {silent})");
        let any = sqlx::query_scalar(AssertSqlSafe(any)).bind(since).fetch_one(&self.readers);
        // the writer is only needed if there is something to write
        if !self.checked(any.await)? {
            return Ok(0);
        }
        let statement = format!(
            "INSERT INTO anomaly_event (anomaly_id, at, what, severity, score, value, quantity, message)
             SELECT anomaly_id, $2, 'overdue', severity, score, value, quantity, message {silent}"
        );
        let mut transaction = self.begin().await?;
        let written = sqlx::query(AssertSqlSafe(statement)).bind(since).bind(now.as_microsecond());
        let written = self.checked(written.execute(&mut *transaction).await)?;
        self.commit(transaction).await?;
        Ok(written.rows_affected())
    }
}
