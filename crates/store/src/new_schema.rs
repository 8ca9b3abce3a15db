//! The schema of a new database, made at once: run one after the other, migrations read the whole schema again for
//! every column that one of them adds to a table.
//!
//! `new_schema.sql` is what all migrations leave of an empty file. It names the migrations that it was made from; where
//! others are compiled in, it is not used.

use sqlx::migrate::Migrator;
use sqlx::{Executor, SqliteConnection};

/// What all migrations leave of an empty file, as statements.
const SCHEMA: &str = include_str!("new_schema.sql");

/// What the first line of [`SCHEMA`] begins with; the migrations that it was made from follow.
const MADE_FROM: &str = "-- made from migrations ";

/// Gives an empty database its tables, and a row for each migration as if it had run. Does nothing where the database
/// has tables, or where [`SCHEMA`] was made from other migrations.
pub(super) async fn make(connection: &mut SqliteConnection, migrator: &Migrator) -> Result<(), sqlx::Error> {
    let made_from = SCHEMA.lines().next().and_then(|line| line.strip_prefix(MADE_FROM));
    if made_from != Some(&*fingerprint(migrator)) {
        return Ok(());
    }
    let tables: i64 =
        sqlx::query_scalar("SELECT count(*) FROM sqlite_schema").fetch_one(&mut *connection).await?;
    if tables > 0 {
        return Ok(());
    }
    connection.execute(sqlx::raw_sql(SCHEMA)).await?;
    for migration in migrator.iter() {
        let row = sqlx::query(
            "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time)
             VALUES (?, ?, TRUE, ?, 0)",
        );
        let row = row.bind(migration.version).bind(&*migration.description).bind(&*migration.checksum);
        row.execute(&mut *connection).await?;
    }
    Ok(())
}

/// A hash of the migrations' texts.
fn fingerprint(migrator: &Migrator) -> String {
    let mut hasher = blake3::Hasher::new();
    for migration in migrator.iter() {
        hasher.update(&migration.version.to_le_bytes()).update(&migration.checksum);
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use sqlx::sqlite::SqliteConnectOptions;
    use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

    use super::*;
    use crate::schema::MIGRATOR;

    /// Where the statements of a new schema are written when [`SCHEMA`] is to be made again.
    const WRITE: &str = "ARMWATCH_WRITE_SCHEMA";

    async fn empty(path: &Path) -> SqliteConnection {
        let options = SqliteConnectOptions::new().filename(path).create_if_missing(true).foreign_keys(true);
        options.connect().await.expect("a connection")
    }

    /// Statements that make what the database holds, apart from the rows of migrations and what is drawn at random.
    async fn statements(connection: &mut SqliteConnection) -> String {
        let application_id: i64 =
            sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await.expect("a number");
        let mut text = format!("PRAGMA application_id = {application_id};\n");
        // in the order in which they were made, in which each finds what it names
        let made: Vec<String> = sqlx::query_scalar(
            "SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL AND name NOT LIKE 'sqlite~_%' ESCAPE '~'
             ORDER BY rowid",
        )
        .fetch_all(&mut *connection)
        .await
        .expect("a schema");
        made.iter().for_each(|sql| text.push_str(&format!("{sql};\n")));
        let tables: Vec<String> =
            sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")
                .fetch_all(&mut *connection)
                .await
                .expect("tables");
        for table in tables.iter().filter(|table| *table != "_sqlx_migrations") {
            if table == "database_identity" {
                text.push_str(
                    "INSERT INTO database_identity (only_one, identity) VALUES (1, lower(hex(randomblob(6))));\n",
                );
                continue;
            }
            let columns: Vec<String> =
                sqlx::query_scalar("SELECT name FROM pragma_table_info(?) ORDER BY cid")
                    .bind(table)
                    .fetch_all(&mut *connection)
                    .await
                    .expect("columns");
            let values: Vec<String> = columns.iter().map(|column| format!("quote({column})")).collect();
            let rows = format!("SELECT {} FROM {table} ORDER BY 1", values.join(" || ', ' || "));
            let rows: Vec<String> =
                sqlx::query_scalar(AssertSqlSafe(rows)).fetch_all(&mut *connection).await.expect("rows");
            for row in rows {
                text.push_str(&format!("INSERT INTO {table} ({}) VALUES ({row});\n", columns.join(", ")));
            }
        }
        text
    }

    type MigrationRow = (i64, String, bool, Vec<u8>);

    async fn migration_rows(connection: &mut SqliteConnection) -> Vec<MigrationRow> {
        let rows = sqlx::query_as(
            "SELECT version, description, success, checksum FROM _sqlx_migrations ORDER BY version",
        );
        rows.fetch_all(connection).await.expect("rows of migrations")
    }

    async fn identity(connection: &mut SqliteConnection) -> String {
        let identity = sqlx::query_scalar("SELECT identity FROM database_identity");
        identity.fetch_one(connection).await.expect("an identity")
    }

    #[tokio::test]
    async fn a_new_database_is_what_all_migrations_make_one_after_the_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut migrated = empty(&folder.path().join("migrated.db")).await;
        MIGRATOR.run(&mut migrated).await.expect("migrations");
        let expected = format!("{MADE_FROM}{}\n{}", fingerprint(&MIGRATOR), statements(&mut migrated).await);
        if let Some(file) = std::env::var_os(WRITE) {
            std::fs::write(file, &expected).expect("written");
            return;
        }
        assert!(
            SCHEMA == expected,
            "a migration was added or changed: run this test with {WRITE}=$PWD/src/store/new_schema.sql, then again"
        );
        let mut made = empty(&folder.path().join("made.db")).await;
        make(&mut made, &MIGRATOR).await.expect("a schema");
        assert_eq!(statements(&mut made).await, statements(&mut migrated).await);
        assert_eq!(migration_rows(&mut made).await, migration_rows(&mut migrated).await);
        assert_eq!(migration_rows(&mut made).await.len(), MIGRATOR.iter().count());
        assert_ne!(identity(&mut made).await, identity(&mut migrated).await);
        // nothing is left to migrate, and nothing is made twice
        MIGRATOR.run(&mut made).await.expect("no migration");
        make(&mut made, &MIGRATOR).await.expect("nothing to make");
        for connection in [made, migrated] {
            connection.close().await.expect("closed");
        }
    }

    #[tokio::test]
    async fn other_migrations_than_those_of_the_file_run_one_after_the_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut connection = empty(&folder.path().join("fleet.db")).await;
        let fewer: Vec<_> = MIGRATOR.iter().take(3).cloned().collect();
        let fewer = Migrator::with_migrations(fewer);
        make(&mut connection, &fewer).await.expect("nothing");
        let tables =
            sqlx::query_scalar("SELECT count(*) FROM sqlite_schema").fetch_one(&mut connection).await;
        assert_eq!(tables.ok(), Some(0_i64));
        connection.close().await.expect("closed");
    }

    /// DuckDB computes views itself, unless they ask for a function or a column that it does not know.
    #[test]
    fn views_hold_nothing_that_duckdb_lacks() {
        assert!(!SCHEMA.contains("GENERATED ALWAYS"), "generated columns are hidden from DuckDB");
        let views: Vec<&str> = SCHEMA
            .split("CREATE VIEW ")
            .skip(1)
            .map(|view| view.split_once(";\n").map_or(view, |(view, _)| view))
            .collect();
        assert!(views.iter().any(|view| view.starts_with("hosts")), "{views:?}");
        for view in views {
            assert!(!view.contains("unixepoch(") && !view.contains("julianday("), "{view}");
        }
    }
}
