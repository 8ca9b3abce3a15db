//! The schema of a database on a server: created and upgraded in one transaction and by one process at a time, and
//! checked.

use std::path::Path;

use sqlx::Connection;

use crate::engine::{Dialect, EngineConnection};
use crate::error::StoreError;
use crate::schema::on_file::refuse_too_old;
use crate::schema::{Schema, latest_schema};

/// Oldest server that the schema works with: earlier ones have no built-in `gen_random_uuid`.
const OLDEST_SERVER: i32 = 130_000;

/// Creates the schema if there is none, and upgrades an older one.
///
/// # Errors
/// [`StoreError::Newer`], [`StoreError::TooOld`], [`StoreError::NotADatabase`] for a schema `armwatch` of another
/// program, [`StoreError::Rights`], [`StoreError::ServerTooOld`] and others; the database is unchanged then.
pub(super) async fn make(path: &Path, connection: &mut EngineConnection) -> Result<(), StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    check_server(path, connection).await?;
    let schema = Schema::of(Dialect::Postgres);
    let there = found(path, connection).await?;
    if schema.is_applied(connection, there.version()).await.map_err(broken)? {
        return Ok(());
    }
    let mut transaction = connection.begin().await.map_err(broken)?;
    // other programs that start now wait, and then find the schema
    let locked = sqlx::query("SELECT pg_catalog.pg_advisory_xact_lock(1098343522, 2)");
    locked.execute(&mut *transaction).await.map_err(broken)?;
    let there = found(path, &mut transaction).await?;
    if schema.is_applied(&mut transaction, there.version()).await.map_err(broken)? {
        return Ok(());
    }
    if matches!(there, SchemaState::Nothing) {
        sqlx::query("CREATE SCHEMA armwatch").execute(&mut *transaction).await.map_err(broken)?;
    }
    if let Some(version) = there.version().filter(|version| *version != latest_schema()) {
        refuse_too_old(path, version)?;
        let known = latest_schema();
        tracing::info!(path = %path.display(), "upgrading the schema of the database from {version} to {known}");
    }
    schema.apply(&mut transaction, there.version()).await.map_err(broken)?;
    transaction.commit().await.map_err(broken)
}

/// Returns true if the database has the schema of this program.
///
/// # Errors
/// Those of [`make`], and [`StoreError::Older`] for an outdated schema.
pub(super) async fn check(path: &Path, connection: &mut EngineConnection) -> Result<bool, StoreError> {
    check_server(path, connection).await?;
    match found(path, connection).await? {
        SchemaState::Nothing | SchemaState::Empty => Ok(false),
        SchemaState::Version(found) if found == latest_schema() => Ok(true),
        SchemaState::Version(found) => {
            refuse_too_old(path, found)?;
            Err(StoreError::Older { path: path.to_path_buf(), found, known: latest_schema() })
        }
    }
}

async fn check_server(path: &Path, connection: &mut EngineConnection) -> Result<(), StoreError> {
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
        let detail =
            format!("its encoding is {encoding}, not UTF8; create it with `createdb --encoding UTF8`");
        return Err(StoreError::NotADatabase { path: path.to_path_buf(), detail });
    }
    Ok(())
}

/// State of the schema.
enum SchemaState {
    /// No schema `armwatch`.
    Nothing,
    /// An empty one, such as an administrator creates for a user without the right to create schemas.
    Empty,
    /// The schema of this program, of this version.
    Version(i64),
}

impl SchemaState {
    fn version(&self) -> Option<i64> {
        match self {
            Self::Version(version) => Some(*version),
            Self::Nothing | Self::Empty => None,
        }
    }
}

/// The present state; fails for a version that is newer than this program's.
async fn found(path: &Path, connection: &mut EngineConnection) -> Result<SchemaState, StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    let asked = sqlx::query_as(
        "SELECT to_regnamespace('armwatch') IS NOT NULL,
                coalesce(has_schema_privilege(to_regnamespace('armwatch'), 'USAGE'), FALSE)",
    );
    let (schema, may_use): (bool, bool) = asked.fetch_one(&mut *connection).await.map_err(broken)?;
    if !schema {
        return Ok(SchemaState::Nothing);
    }
    if !may_use {
        let detail = "permission denied for schema armwatch".into();
        return Err(StoreError::Rights { path: path.to_path_buf(), detail });
    }
    // all objects of a schema depend on it, but the default rights of new tables are no objects in it
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
        (false, false) => return Ok(SchemaState::Empty),
        (false, true) => {
            let detail = "its schema armwatch is of another program".into();
            return Err(StoreError::NotADatabase { path: path.to_path_buf(), detail });
        }
    }
    let asked = sqlx::query_scalar("SELECT version FROM armwatch.schema_version");
    let found: i64 = asked.fetch_one(connection).await.map_err(broken)?;
    let known = latest_schema();
    if found > known {
        return Err(StoreError::Newer { path: path.to_path_buf(), found, known });
    }
    Ok(SchemaState::Version(found))
}
