//! Databases of earlier versions.

use std::path::Path;
use std::time::Duration;

use sqlx::{AssertSqlSafe, Connection, Executor};

use super::open::plain;
use super::support::*;
use crate::error::StoreError;
use crate::handle::Store;
use crate::schema::latest_schema;

const FIXTURES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/migrations");

/// Creates a database as the version with this schema left it, with rows in almost every table.
pub(crate) fn make_schema(path: &Path, schema: i64) {
    unpack(&format!("{schema:04}"), path);
}

fn unpack(fixture: &str, path: &Path) {
    let packed = std::fs::read(format!("{FIXTURES}/{fixture}.db.zst")).expect("the fixture");
    std::fs::write(path, zstd::decode_all(&packed[..]).expect("unpacked")).expect("a database");
}

/// A change of the schema must not lose data of an earlier version.
#[tokio::test]
async fn a_database_of_an_earlier_version_keeps_its_rows() {
    // with rows in every view, and with recordings stored by programs of that time
    for schema in ["0046", "0050", "0046.recorded", "0050.recorded", "0051.recorded"] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.db");
        unpack(schema, &path);
        let mut before = plain(&path).await;
        let tables: Vec<String> =
            sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")
                .fetch_all(&mut before)
                .await
                .expect("tables");
        // conclusions create the rows of the last ones again
        let gone = [
            "_sqlx_migrations",
            "interval_fill",
            "sqlite_sequence",
            "view_column",
            "run_brief",
            "run_series",
            "friction_plan",
            "run_friction_series",
            "settled_history",
        ];
        let mut counts = Vec::new();
        for table in tables.into_iter().filter(|table| !gone.contains(&&**table)) {
            let count = AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
            let count: i64 = sqlx::query_scalar(count).fetch_one(&mut before).await.expect("a count");
            counts.push((table, count));
        }
        let sequences = "SELECT name, seq FROM sqlite_sequence WHERE seq > 0 ORDER BY name";
        let given: Vec<(String, i64)> =
            sqlx::query_as(sequences).fetch_all(&mut before).await.expect("counters");
        let views: Vec<String> = sqlx::query_scalar(
            "SELECT name FROM sqlite_schema WHERE type = 'view' AND name <> 'view_columns'",
        )
        .fetch_all(&mut before)
        .await
        .expect("views");
        for view in views {
            let count = AssertSqlSafe(format!("SELECT count(*) FROM {view}"));
            let count: i64 = sqlx::query_scalar(count).fetch_one(&mut before).await.expect("a count");
            assert!(count > 0 || schema.ends_with(".recorded"), "{schema}: the fixture has no row in {view}");
            counts.push((view, count));
        }
        before.close().await.expect("closed");
        let cluster = armwatch_config::ClusterSettings::default();
        let old = Store::open_any_schema(&path, &cluster).await.expect("opened").expect("a database");
        let of_old = dump(&old).await;
        old.close().await.expect("closed");
        let store = Store::open(&path).await.expect("a store");
        // views of version 50 have the present columns, except units of anomalies, and the load of friction points, which
        // is unknown for them; the message of a blocked file has another form of its time
        if schema.starts_with("0050") {
            let without = |rows: Vec<String>| -> Vec<String> {
                let changed = ["anomalies:", "anomaly_history:", "blocked_files:"];
                rows.into_iter().filter(|row| !changed.iter().any(|view| row.starts_with(view))).collect()
            };
            let without_load = |row: String| match row.strip_suffix(" NULL NULL") {
                Some(rest) if row.starts_with("friction_points:") => rest.to_owned(),
                _ => row,
            };
            let now: Vec<String> = dump(&store).await.into_iter().map(without_load).collect();
            assert_eq!(without(now), without(of_old), "{schema}");
        }
        for (table, count) in counts {
            let now = AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
            let now: i64 = sqlx::query_scalar(now).fetch_one(&store.readers).await.expect("a count");
            assert_eq!(now, count, "{schema}: {table}");
        }
        let now: Vec<(String, i64)> =
            sqlx::query_as(sequences).fetch_all(&store.readers).await.expect("counters");
        assert_eq!(now, given, "{schema}");
        if !schema.ends_with(".recorded") {
            assert_eq!(store.fleet_health().await.expect("health").len(), 2);
            assert_eq!(store.anomalies_after(0).await.expect("anomalies").len(), 3);
            let width = "SELECT interval_high - value FROM cycle_parameters WHERE degrees_of_freedom = 24.5";
            let width = number(&store, width).await.expect("an interval");
            assert!((width / 0.001 - 2.0617).abs() < 5e-4, "{width}");
        }
        assert_times_are_text_too(&store).await;
        assert_sound(&store).await;
        store.close().await.expect("closed");
        // a second opening finds nothing to do
        let bytes = std::fs::read(&path).expect("the file");
        Store::open(&path).await.expect("a store").close().await.expect("closed");
        assert!(std::fs::read(&path).expect("the file") == bytes, "{schema}: changed again");
    }
}

/// Versions before 51 had one name for values in several units.
#[tokio::test]
async fn anomalies_of_an_earlier_version_get_the_quantity_of_their_values() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    make_schema(&path, 50);
    let mut before = plain(&path).await;
    before
        .execute(
            "INSERT INTO anomaly (anomaly_id, robot_id, kind, quantity, severity, value, baseline, threshold, first_seen_at,
                                  last_seen_at, state, message)
             SELECT column1, robot_id, column2, column3, 'warning', column4, column5, column6, 0, 0, 'resolved', 'old'
             FROM (VALUES (901, 'sensor', 'torque_signal', 11.99, 0.0, 0.0),
                          (902, 'sensor', 'torque_signal', 5.0, 1.0, 1.5),
                          (903, 'sensor', 'torque_signal', 0.92, 1.0, 0.03),
                          (904, 'sensor', 'torque_signal', NULL, NULL, 1.0),
                          (905, 'sensor', 'production_torque_signal', -0.4, 0.0, 0.0),
                          (906, 'sensor', 'production_torque_signal', 1.05, 1.0, 0.03),
                          (907, 'step', 'warm_friction_nm', 1.25, 1.0, 0.05),
                          (908, 'step', 'warm_friction_nm', 15.0, 12.0, 0.05))
             CROSS JOIN (SELECT min(robot_id) AS robot_id FROM robot)",
        )
        .await
        .expect("anomalies");
    before.close().await.expect("closed");
    let store = Store::open(&path).await.expect("a store");
    let rows = store.anomalies_after(900).await.expect("anomalies");
    let found: Vec<_> = rows.iter().map(|row| (row.quantity.name(), row.unit)).collect();
    assert_eq!(
        found,
        [
            ("torque_offset_nm", Some("Nm")),
            ("torque_noise_ratio", Some("1")),
            ("torque_gain_ratio", Some("1")),
            ("torque_signal", None),
            ("production_torque_offset_nm", Some("Nm")),
            ("production_torque_gain_ratio", Some("1")),
            ("friction_jump_ratio", Some("1")),
            ("warm_friction_nm", Some("Nm")),
        ]
    );
    let differing = "SELECT count(*) FROM anomalies WHERE anomaly_id > 900 AND unit IS NOT
                     CASE WHEN quantity LIKE '%~_nm' ESCAPE '~' THEN 'Nm' WHEN quantity <> 'torque_signal' THEN '1' END";
    assert_eq!(number(&store, differing).await, Some(0.0));
}

#[tokio::test]
async fn a_version_that_is_too_old_is_refused_with_a_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    make_schema(&path, 46);
    let mut connection = plain(&path).await;
    connection.execute("DELETE FROM _sqlx_migrations WHERE version > 20").await.expect("an older version");
    connection.close().await.expect("closed");
    let before = std::fs::read(&path).expect("the file");
    let errors = [
        Store::open(&path).await.map(drop).expect_err("a refusal"),
        Store::open_existing(&path).await.map(drop).expect_err("a refusal"),
    ];
    for error in errors {
        assert!(matches!(error, StoreError::TooOld { found: 20, .. }) && error.is_fatal(), "{error:?}");
        assert!(error.to_string().contains("ingest the exports again"), "{error}");
    }
    assert!(std::fs::read(&path).expect("the file") == before, "it was changed");
}

/// A program that is stopped during an upgrade of the schema leaves the database either unchanged or with the new
/// schema, and the next start completes the upgrade.
#[tokio::test]
async fn a_change_of_the_schema_that_is_stopped_changes_nothing() {
    const OLD: i64 = 46;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    make_schema(&path, OLD);
    let mut stopped = 0;
    for milliseconds in [0, 1, 2, 5, 10, 20, 40, 80] {
        let deadline = Duration::from_millis(milliseconds);
        let opened = tokio::time::timeout(deadline, Store::open(&path)).await;
        let mut connection = plain(&path).await;
        let asked = "SELECT count(*) FROM sqlite_schema WHERE name = '_sqlx_migrations'";
        let is_old: bool = sqlx::query_scalar(asked).fetch_one(&mut connection).await.expect("an answer");
        let runs: i64 =
            sqlx::query_scalar("SELECT count(*) FROM run").fetch_one(&mut connection).await.expect("runs");
        connection.close().await.expect("closed");
        assert_eq!(runs, 4);
        assert!(is_old || opened.is_ok() || milliseconds > 0, "{milliseconds} ms");
        stopped += i32::from(is_old);
    }
    assert!(stopped > 0, "never stopped before the end");
    let store = Store::open(&path).await.expect("a store");
    assert_eq!(number(&store, "SELECT version FROM schema_version").await, Some(latest_schema() as f64));
    assert_eq!(store.runs().await.expect("runs").len(), 4);
    assert_sound(&store).await;
}

/// Each time of the views has its text next to it, whichever program wrote the time.
async fn assert_times_are_text_too(store: &Store) {
    let times: Vec<(String, String)> = sqlx::query_as(
        "SELECT tables.name, substr(text.name, 1, length(text.name) - 5)
         FROM sqlite_schema AS tables JOIN pragma_table_info(tables.name) AS text
         WHERE tables.type = 'table' AND text.name LIKE '%~_text' ESCAPE '~'",
    )
    .fetch_all(&store.writer)
    .await
    .expect("columns");
    assert!(times.len() >= 21, "{times:?}");
    for (table, column) in times {
        let other = format!(
            "SELECT count(*) FROM {table}
             WHERE {column}_text IS NOT strftime('%Y-%m-%dT%H:%M:%fZ', {column} / 1000000.0, 'unixepoch')"
        );
        let other: i64 =
            sqlx::query_scalar(AssertSqlSafe(other)).fetch_one(&store.writer).await.expect("a count");
        assert_eq!(other, 0, "{table}.{column}");
    }
}
