//! The daemons that work on the database, for display.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::Row;

use crate::engine::EngineRow;
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::in_views;

armwatch_model::named_enum! {
    /// State of the daemon of a host.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum HostState {
        /// Its lease has not ended.
        AtWork = "at_work",
        /// Its lease has ended, but its session is not ended yet.
        Silent = "silent",
        /// It was stopped or restarted, or others have claimed its work.
        Ended = "ended",
    }
}

armwatch_model::serialize_by_name!(HostState);

/// The latest session of the daemon of a host: a row of the view `hosts`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct HostRow {
    /// Its name; empty for a daemon without one.
    pub host: String,
    /// State of the daemon.
    pub state: HostState,
    /// Reason for its end: `stopped`, `restarted` or `lease_ended`.
    pub end_reason: Option<String>,
    /// Time of its last sign of life.
    #[serde(serialize_with = "in_views")]
    pub seen_at: Timestamp,
}

impl HostRow {
    /// True if its daemon is gone without having been stopped.
    pub fn is_lost(&self) -> bool {
        self.state == HostState::Silent || self.end_reason.as_deref() == Some("lease_ended")
    }
}

impl Store {
    /// The daemons that have worked on a database of a server, by name; empty for a file.
    pub async fn hosts(&self) -> Result<Vec<HostRow>, StoreError> {
        let rows = sqlx::query("SELECT host, state, end_reason, seen_at FROM hosts ORDER BY host");
        let rows = rows.try_map(|row: EngineRow| {
            let (state, seen_at): (String, String) = (row.try_get("state")?, row.try_get("seen_at")?);
            let decode = |what: String| sqlx::Error::Decode(what.into());
            let known = HostState::ALL.into_iter().find(|known| known.name() == state);
            Ok(HostRow {
                host: row.try_get("host")?,
                state: known.ok_or_else(|| decode(format!("state {state} of a host")))?,
                end_reason: row.try_get("end_reason")?,
                seen_at: seen_at.parse().map_err(|error: jiff::Error| decode(error.to_string()))?,
            })
        });
        self.checked(rows.fetch_all(&self.readers).await)
    }
}
