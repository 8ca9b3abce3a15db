//! Data for monitoring besides the views: counts with few labels, and sizes.

use std::sync::Arc;

use jiff::Timestamp;
use sqlx::Row;

use super::error::StoreError;
use super::handle::Store;
use super::values::{named, size, time};
use crate::engine::{Dialect, EngineExecutor, EngineRow, catalog};
use armwatch_model::anomaly::Severity;

/// Counts of the deliveries of a route.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RouteCounts {
    /// Name of the route in the configuration.
    pub route: String,
    /// Messages that wait, including those for the end of quiet hours or for a digest.
    pub pending: u64,
    /// Messages that the receiver has accepted.
    pub sent: u64,
    /// Messages that are given up.
    pub failed: u64,
    /// Messages that were suppressed.
    pub suppressed: u64,
    /// Attempts in a row that did not reach the receiver.
    pub failures: u64,
    /// Time since which the oldest waiting message could have been sent.
    pub oldest_due_at: Option<Timestamp>,
}

/// Sizes of the files of a database, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatabaseSize {
    /// The database.
    pub database: u64,
    /// Its write-ahead log; 0 if there is none.
    pub log: u64,
}

/// Anomalies of one severity in one state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AnomalyCount {
    /// Severity: how soon a person should look.
    pub severity: Severity,
    /// `open`, `acknowledged`, `shelved` or `maintenance`.
    pub state: String,
    /// Number of anomalies.
    pub anomalies: u64,
}

/// Counts anomalies that are not settled. The states are listed, so that settled ones are not read: index
/// `anomaly_by_state`.
pub(super) const UNSETTLED_COUNTS: &str = "SELECT severity, state, count(*) AS anomalies
     FROM anomaly
     WHERE state IN ('open', 'acknowledged', 'shelved', 'maintenance') AND NOT withdrawn
     GROUP BY severity, state
     ORDER BY severity, state";

impl Store {
    /// Returns true if an export of this file name is stored completely.
    pub async fn is_complete(&self, source_name: &str) -> Result<bool, StoreError> {
        self.checked(is_complete(&self.readers, source_name).await)
    }

    /// Number of quarantined exports of each robot that need attention, by robot; the robot is `unknown` if the name of
    /// an export does not contain it.
    pub async fn quarantined_by_robot(&self) -> Result<Vec<(String, u64)>, StoreError> {
        self.checked(quarantined_by_robot(&self.readers).await)
    }

    /// Numbers of anomalies that are not settled, by severity and state; zeros are omitted.
    pub async fn unsettled_counts(&self) -> Result<Vec<AnomalyCount>, StoreError> {
        self.checked(unsettled_counts(&self.readers).await)
    }

    /// Counts of deliveries of each route of the configuration, by name.
    pub async fn deliveries_by_route(&self) -> Result<Vec<RouteCounts>, StoreError> {
        self.checked(deliveries_by_route(&self.readers).await)
    }

    /// Sizes of the files of the database; `None` if the system does not report them.
    pub async fn size(&self) -> Option<DatabaseSize> {
        if self.dialect() == Dialect::Postgres {
            let database = catalog::bytes_on_server(&self.readers).await.ok()?;
            return Some(DatabaseSize { database: database.try_into().ok()?, log: 0 });
        }
        let path = Arc::clone(&self.path);
        let sizes = tokio::task::spawn_blocking(move || {
            let database = std::fs::metadata(&path).ok()?.len();
            let mut log = path.as_os_str().to_owned();
            log.push("-wal");
            // a missing log is empty
            let log = std::fs::metadata(&log).map_or(0, |metadata| metadata.len());
            Some(DatabaseSize { database, log })
        });
        sizes.await.ok().flatten()
    }
}

async fn is_complete(executor: impl EngineExecutor<'_>, source_name: &str) -> sqlx::Result<bool> {
    sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run WHERE source_name = $1 AND status = 'complete')")
        .bind(source_name)
        .fetch_one(executor)
        .await
}

async fn quarantined_by_robot(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<(String, u64)>> {
    sqlx::query(
        "SELECT robot, count(DISTINCT run_id) AS exports FROM quarantine WHERE state = 'open' GROUP BY robot \
         ORDER BY robot",
    )
    .try_map(|row: EngineRow| Ok((row.try_get("robot")?, size(&row, "exports")?)))
    .fetch_all(executor)
    .await
}

async fn unsettled_counts(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<AnomalyCount>> {
    sqlx::query(UNSETTLED_COUNTS)
        .try_map(|row: EngineRow| {
            Ok(AnomalyCount {
                severity: named(&row, "severity", &Severity::ALL, Severity::name)?,
                state: row.try_get("state")?,
                anomalies: size(&row, "anomalies")?,
            })
        })
        .fetch_all(executor)
        .await
}

async fn deliveries_by_route(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<RouteCounts>> {
    sqlx::query(
        "SELECT r.name AS route, r.failures,
                count(*) FILTER (WHERE d.state = 'pending') AS pending,
                count(*) FILTER (WHERE d.state = 'sent') AS sent,
                count(*) FILTER (WHERE d.state = 'failed') AS failed,
                count(*) FILTER (WHERE d.state = 'suppressed') AS suppressed,
                min(d.due_at) FILTER (WHERE d.state = 'pending') AS oldest_due_at
         FROM delivery_route AS r
         LEFT JOIN delivery AS d ON d.delivery_route_id = r.delivery_route_id
         WHERE NOT r.retired
         GROUP BY r.delivery_route_id
         ORDER BY r.name",
    )
    .try_map(|row: EngineRow| {
        Ok(RouteCounts {
            route: row.try_get("route")?,
            pending: size(&row, "pending")?,
            sent: size(&row, "sent")?,
            failed: size(&row, "failed")?,
            suppressed: size(&row, "suppressed")?,
            failures: size(&row, "failures")?,
            oldest_due_at: match row.try_get::<Option<i64>, _>("oldest_due_at")? {
                Some(_) => Some(time(&row, "oldest_due_at")?),
                None => None,
            },
        })
    })
    .fetch_all(executor)
    .await
}
