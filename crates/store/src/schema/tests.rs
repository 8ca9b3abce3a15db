//! An upgraded database has the schema of a new one.

use sqlx::Connection;

use super::*;
use crate::engine::{EnginePool, begin_writing, dialect};
use crate::handle::Store;
use crate::tests::support::{fresh, number, text};
use crate::tests::upgrade::make_schema;

/// Columns and references of the tables of a file, and the statements of everything else.
async fn definitions(store: &Store) -> Vec<String> {
    sqlx::query_scalar(
        "SELECT t.name || '.' || c.name || ' ' || c.type || ' ' || c.\"notnull\" || c.pk || ifnull(c.dflt_value, '')
         FROM sqlite_schema AS t JOIN pragma_table_info(t.name) AS c WHERE t.type = 'table'
         UNION ALL
         SELECT t.name || ' ' || f.\"from\" || ' ' || f.\"table\" || f.on_delete
         FROM sqlite_schema AS t JOIN pragma_foreign_key_list(t.name) AS f WHERE t.type = 'table'
         UNION ALL
         SELECT sql FROM sqlite_schema WHERE type <> 'table' AND sql IS NOT NULL
         ORDER BY 1",
    )
    .fetch_all(&store.readers)
    .await
    .expect("definitions")
}

#[tokio::test]
async fn a_file_that_was_brought_up_to_date_has_the_schema_of_a_new_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let new = Store::open(&folder.path().join("new.db")).await.expect("a store");
    let expected = definitions(&new).await;
    assert!(expected.len() > 600, "{}", expected.len());
    for schema in [46, 50] {
        let path = folder.path().join(format!("{schema}.db"));
        make_schema(&path, schema);
        let store = Store::open(&path).await.expect("brought up to date");
        assert_eq!(definitions(&store).await, expected, "{schema}");
    }
}

/// The files of `migrations/` lead from the tables of version 52 to those of a new database.
#[tokio::test]
async fn every_change_of_a_table_is_a_migration_too() {
    let packed = include_bytes!("../../../../tests/fixtures/migrations/0052.tables.sql.zst");
    let squashed = String::from_utf8(zstd::decode_all(&packed[..]).expect("unpacked")).expect("text");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let mut connection =
        EngineConnection::Sqlite(sqlx::ConnectOptions::connect(&options).await.expect("a connection"));
    let old = Schema::from_texts(Dialect::Sqlite, &squashed, "", &[]);
    old.apply(&mut connection, None).await.expect("the schema");
    connection.close().await.expect("closed");
    let new = Store::open(&folder.path().join("new.db")).await.expect("a store");
    let upgraded = Store::open(&path).await.expect("a store");
    assert_eq!(
        definitions(&upgraded).await,
        definitions(&new).await,
        "migrations/ lacks a change of tables.sql"
    );
}

/// The schema of a new database of a later version, which has changed a table and added a view.
fn later(engine: Dialect) -> Schema {
    let tables = TABLES.replace("    peers_compared INTEGER NOT NULL DEFAULT 0\n", "    peers_compared INTEGER NOT NULL DEFAULT 0,\n    spare INTEGER NOT NULL DEFAULT 1 CHECK (spare IN (0, 1))\n");
    let view = "CREATE VIEW spare_robots AS\nSELECT robot.name AS robot FROM robot WHERE robot.spare;\n";
    let changes: [(i64, &'static str); 1] = [(
        9001,
        "-- Arms that stand by.\nALTER TABLE robot ADD COLUMN spare INTEGER NOT NULL DEFAULT 1 CHECK (spare IN (0, 1));\n\
         UPDATE robot SET spare = FALSE WHERE name = 'R01';\n",
    )];
    let derived =
        [&DERIVED.concat().replace("CREATE INDEX run_by_name", "CREATE INDEX run_by_its_name"), view]
            .concat();
    Schema::from_texts(engine, &tables, &derived, &changes)
}

async fn apply(pool: &EnginePool, schema: &Schema, found: Option<i64>) {
    let mut transaction = begin_writing(pool).await.expect("a transaction");
    schema.apply(&mut transaction, found).await.expect("the schema");
    assert!(schema.is_applied(&mut transaction, Some(9001)).await.expect("an answer"));
    transaction.commit().await.expect("a commit");
}

/// Runs on both engines, see [`fresh`].
#[tokio::test]
async fn a_change_is_written_once_and_leads_to_the_schema_of_a_new_database() {
    let (_folder, store) = fresh().await;
    for name in ["R00", "R01"] {
        sqlx::query("INSERT INTO robot (name) VALUES ($1)")
            .bind(name)
            .execute(&store.writer)
            .await
            .expect("a robot");
    }
    let schema = later(dialect(&store.writer));
    apply(&store.writer, &schema, Some(latest_schema())).await;
    assert_eq!(text(&store, "SELECT robot FROM spare_robots").await.as_deref(), Some("R00"));
    assert_eq!(number(&store, "SELECT version + 0.0 FROM schema_version").await, Some(9001.0));
    let indexes =
        names(dialect(&store.writer), &mut store.writer.acquire().await.expect("a turn"), "index").await;
    let indexes = indexes.expect("indexes");
    assert!(
        indexes.contains(&"run_by_its_name".into()) && !indexes.contains(&"run_by_name".into()),
        "{indexes:?}"
    );
    if dialect(&store.writer) == Dialect::Postgres {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("new.db");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let mut connection =
        EngineConnection::Sqlite(sqlx::ConnectOptions::connect(&options).await.expect("a connection"));
    schema.apply(&mut connection, None).await.expect("the schema");
    let same = "SELECT type, name FROM sqlite_schema ORDER BY type, name";
    let of_new: Vec<(String, String)> = sqlx::query_as(same).fetch_all(&mut connection).await.expect("names");
    let of_changed: Vec<(String, String)> =
        sqlx::query_as(same).fetch_all(&store.readers).await.expect("names");
    assert_eq!(of_changed, of_new);
    let columns = "SELECT name, type, \"notnull\", dflt_value FROM pragma_table_info('robot')";
    type Column = (String, String, i64, Option<String>);
    let of_new: Vec<Column> = sqlx::query_as(columns).fetch_all(&mut connection).await.expect("columns");
    let of_changed: Vec<Column> = sqlx::query_as(columns).fetch_all(&store.readers).await.expect("columns");
    assert_eq!(of_changed, of_new);
    connection.close().await.expect("closed");
}

/// Without a new version a changed view is created again, and tables stay.
#[tokio::test]
async fn a_view_of_another_text_is_made_again() {
    let (folder, store) = fresh().await;
    for change in ["DROP VIEW temperatures", "UPDATE schema_version SET derived = 'other'"] {
        sqlx::query(change).execute(&store.writer).await.expect("a change");
    }
    let path = folder.path().join("fleet.db");
    let again = match dialect(&store.writer) {
        Dialect::Sqlite => Store::open(&path).await.expect("a store"),
        Dialect::Postgres => return,
    };
    assert_eq!(number(&again, "SELECT count(*) FROM temperatures").await, Some(0.0));
}

/// DuckDB computes views itself, unless they use a function or a column that it does not know.
#[test]
fn views_hold_nothing_that_duckdb_lacks() {
    let schema = Schema::of(Dialect::Sqlite);
    assert!(schema.tables.iter().all(|table| !table.sql.contains("GENERATED ALWAYS")), "hidden from DuckDB");
    let views: Vec<&Statement> =
        schema.derived.iter().filter(|of| of.sql.starts_with("CREATE VIEW ")).collect();
    assert!(views.iter().any(|view| view.name == "hosts"));
    for view in views {
        let code = view.sql.lines().filter(|line| !line.trim_start().starts_with("--"));
        for line in code {
            assert!(!line.contains("unixepoch(") && !line.contains("julianday("), "{line}");
        }
    }
}
