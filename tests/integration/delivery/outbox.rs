//! Events of anomalies, written into a daemon's database in the way of conclusions: by another process, in a
//! transaction.

use std::path::Path;
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, Connection, Executor};
use tokio::runtime::Runtime;

use crate::support::Workshop;

/// A connection that writes.
pub struct Outbox {
    runtime: Runtime,
    connection: SqliteConnection,
}

impl Outbox {
    /// Opens a workshop's database, creates it if it is missing, and adds the robots `R01` and `R02`.
    pub fn new(workshop: &Workshop) -> Self {
        workshop.stdout(&["ingest", "inbox"], 0);
        let mut outbox = Self::open(&workshop.path("armwatch.db"));
        outbox.write("INSERT INTO robot (name) VALUES ('R01'), ('R02')");
        outbox
    }

    fn open(database: &Path) -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let options = SqliteConnectOptions::new()
            .filename(database)
            .foreign_keys(true)
            .busy_timeout(Duration::from_secs(30));
        let connection = runtime.block_on(SqliteConnection::connect_with(&options)).expect("the database");
        Self { runtime, connection }
    }

    pub fn write(&mut self, sql: &str) {
        let script = format!("BEGIN IMMEDIATE; {sql}; COMMIT");
        let run = self.connection.execute(AssertSqlSafe(script));
        self.runtime.block_on(run).unwrap_or_else(|error| panic!("{sql}: {error}"));
    }

    fn number(&mut self, sql: &str) -> i64 {
        let read = sqlx::query_scalar(AssertSqlSafe(sql)).fetch_one(&mut self.connection);
        self.runtime.block_on(read).unwrap_or_else(|error| panic!("{sql}: {error}"))
    }

    /// Adds an open anomaly with its event; returns its number.
    pub fn open_anomaly(&mut self, robot: &str, joint: u32, severity: &str) -> i64 {
        self.write(&format!(
            "INSERT INTO anomaly (robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
                                  peak_value, peak_score, first_seen_at, last_seen_at, onset_at, odds, state, message)
             SELECT robot_id, {joint}, 'drift', 'friction_index', '{severity}', 0.2, 0.05, 1.2, 1.0, 1.3, 0.3,
                    1767600000000000, 1767700000000000, 1767500000000000, 900.0, 'open', 'friction rose by 20 %'
             FROM robot WHERE name = '{robot}';
             INSERT INTO anomaly_event (anomaly_id, what, severity, score, value, message)
             SELECT anomaly_id, 'opened', severity, score, value, message FROM anomaly
             ORDER BY anomaly_id DESC LIMIT 1"
        ));
        self.number("SELECT max(anomaly_id) FROM anomaly")
    }

    /// Adds another event of an anomaly, with its present severity; returns the number of the event.
    pub fn event(&mut self, anomaly_id: i64, what: &str, severity: &str) -> i64 {
        let state = if ["ended", "resolved"].contains(&what) { "resolved" } else { "open" };
        self.write(&format!(
            "UPDATE anomaly SET severity = '{severity}', state = '{state}' WHERE anomaly_id = {anomaly_id};
             INSERT INTO anomaly_event (anomaly_id, what, severity, score, value, message)
             SELECT anomaly_id, '{what}', severity, score, value, message FROM anomaly
             WHERE anomaly_id = {anomaly_id}"
        ));
        self.number("SELECT max(anomaly_event_id) FROM anomaly_event")
    }

    pub fn identity(&mut self) -> String {
        let read =
            sqlx::query_scalar("SELECT identity FROM database_identity").fetch_one(&mut self.connection);
        self.runtime.block_on(read).expect("an identity")
    }
}
