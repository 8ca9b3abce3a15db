//! The schema of a database on a server: made at once, in one transaction and by one process at a time, and checked.

use std::path::Path;

use sqlx::{AssertSqlSafe, Connection, Executor, PgConnection};

use crate::error::StoreError;

/// The version of this schema, which counts with the migrations of SQLite's: what one of them changes is changed in the
/// files here too, and comes to a database that is there by a step of [`STEPS`].
pub(super) const VERSION: i64 = 50;

/// How a database with an older version is brought up to date: the version that a step leads to, and its statements.
const STEPS: [(i64, &str); 9] = [
    (42, include_str!("steps/0042_hosts.sql")),
    (43, include_str!("steps/0043_settled_history.sql")),
    (44, include_str!("steps/0044_runs_by_index.sql")),
    (45, include_str!("steps/0045_settled_work.sql")),
    (46, include_str!("steps/0046_open_anomalies_by_index.sql")),
    (47, include_str!("steps/0047_attempts.sql")),
    (48, include_str!("steps/0048_unanswered_folders.sql")),
    (49, include_str!("steps/0049_dates.sql")),
    (50, include_str!("steps/0050_torque_of_joints.sql")),
];

/// Oldest server that the schema works with: earlier ones know no `gen_random_uuid` of their own.
const OLDEST_SERVER: i32 = 130_000;

/// What the schema is made of, in this order.
const PARTS: [&str; 5] = [
    include_str!("functions.sql"),
    include_str!("tables.sql"),
    include_str!("indexes.sql"),
    include_str!("triggers.sql"),
    include_str!("views.sql"),
];

/// Makes the schema where there is none, and brings an older one up to date.
///
/// # Errors
/// [`StoreError::Newer`], [`StoreError::NotADatabase`] for a schema `armwatch` of another program,
/// [`StoreError::Rights`], [`StoreError::ServerTooOld`] and others; the database is as it was then.
pub(super) async fn make(path: &Path, connection: &mut PgConnection) -> Result<(), StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    check_server(path, connection).await?;
    if matches!(found(path, connection).await?, Found::Version(VERSION)) {
        return Ok(());
    }
    let mut transaction = connection.begin().await.map_err(broken)?;
    // others that start now wait, and then find it made
    transaction.execute("SELECT pg_catalog.pg_advisory_xact_lock(1098343522, 2)").await.map_err(broken)?;
    match found(path, &mut transaction).await? {
        Found::Nothing => {
            transaction.execute("CREATE SCHEMA armwatch").await.map_err(broken)?;
            make_all(&mut transaction).await.map_err(broken)?;
        }
        Found::Empty => make_all(&mut transaction).await.map_err(broken)?,
        Found::Version(version) if version < VERSION => {
            tracing::info!(path = %path.display(), "bringing the schema of the database from {version} to {VERSION}");
            for (_, statements) in STEPS.iter().filter(|(to, _)| *to > version) {
                transaction.execute(sqlx::raw_sql(*statements)).await.map_err(broken)?;
            }
            let set = sqlx::query("UPDATE schema_version SET version = $1").bind(VERSION);
            set.execute(&mut *transaction).await.map_err(broken)?;
        }
        Found::Version(_) => {}
    }
    transaction.commit().await.map_err(broken)
}

/// Whether the database has the schema of this program.
///
/// # Errors
/// As [`make`], and [`StoreError::Older`] for a schema that is not up to date.
pub(super) async fn check(path: &Path, connection: &mut PgConnection) -> Result<bool, StoreError> {
    check_server(path, connection).await?;
    match found(path, connection).await? {
        Found::Nothing | Found::Empty => Ok(false),
        Found::Version(VERSION) => Ok(true),
        Found::Version(found) => Err(StoreError::Older { path: path.to_path_buf(), found, known: VERSION }),
    }
}

async fn check_server(path: &Path, connection: &mut PgConnection) -> Result<(), StoreError> {
    let asked = sqlx::query_as(
        "SELECT CAST(current_setting('server_version_num') AS integer), current_setting('server_version'),
                current_setting('server_encoding')",
    );
    let (number, version, encoding): (i32, String, String) =
        asked.fetch_one(connection).await.map_err(|error| StoreError::from_sqlx(path, &error))?;
    if number < OLDEST_SERVER {
        return Err(StoreError::ServerTooOld { path: path.to_path_buf(), version });
    }
    if encoding != "UTF8" {
        let detail = format!("its encoding is {encoding}, not UTF8; make it with `createdb --encoding UTF8`");
        return Err(StoreError::NotADatabase { path: path.to_path_buf(), detail });
    }
    Ok(())
}

/// What of the schema is there.
enum Found {
    /// No schema `armwatch`.
    Nothing,
    /// An empty one, such as an administrator makes for a user who may not make any.
    Empty,
    /// The schema of this program, of this version.
    Version(i64),
}

/// What is there, up to this program's version.
async fn found(path: &Path, connection: &mut PgConnection) -> Result<Found, StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    let asked = sqlx::query_as(
        "SELECT to_regnamespace('armwatch') IS NOT NULL,
                coalesce(has_schema_privilege(to_regnamespace('armwatch'), 'USAGE'), FALSE)",
    );
    let (schema, may_use): (bool, bool) = asked.fetch_one(&mut *connection).await.map_err(broken)?;
    if !schema {
        return Ok(Found::Nothing);
    }
    if !may_use {
        let detail = "permission denied for schema armwatch".into();
        return Err(StoreError::Rights { path: path.to_path_buf(), detail });
    }
    // everything in a schema depends on it; the rights that new tables are to get are nothing in it
    let asked = sqlx::query_as(
        "SELECT to_regclass('armwatch.schema_version') IS NOT NULL,
                EXISTS (SELECT 1 FROM pg_catalog.pg_depend
                        WHERE refclassid = CAST('pg_catalog.pg_namespace' AS regclass)
                              AND refobjid = CAST('armwatch' AS regnamespace)
                              AND classid <> CAST('pg_catalog.pg_default_acl' AS regclass))",
    );
    let (table, anything): (bool, bool) = asked.fetch_one(&mut *connection).await.map_err(broken)?;
    match (table, anything) {
        (true, _) => {}
        (false, false) => return Ok(Found::Empty),
        (false, true) => {
            let detail = "its schema armwatch is of another program".into();
            return Err(StoreError::NotADatabase { path: path.to_path_buf(), detail });
        }
    }
    let asked = sqlx::query_scalar("SELECT version FROM armwatch.schema_version");
    let found: i64 = asked.fetch_one(connection).await.map_err(broken)?;
    if found > VERSION {
        return Err(StoreError::Newer { path: path.to_path_buf(), found, known: VERSION });
    }
    Ok(Found::Version(found))
}

async fn make_all(connection: &mut PgConnection) -> Result<(), sqlx::Error> {
    for part in PARTS {
        connection.execute(sqlx::raw_sql(part)).await?;
    }
    let last = format!(
        "CREATE TABLE schema_version (
             only_one integer PRIMARY KEY CHECK (only_one = 1),
             version bigint NOT NULL
         );
         INSERT INTO schema_version (only_one, version) VALUES (1, {VERSION});
         INSERT INTO database_identity (only_one, identity) VALUES (1, encode(randomblob(6), 'hex'));"
    );
    connection.execute(sqlx::raw_sql(AssertSqlSafe(last))).await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schema::latest_schema;

    /// A migration that is added changes the files of this folder too.
    #[test]
    fn the_version_is_that_of_the_migrations() {
        assert_eq!(VERSION, latest_schema());
    }
}
