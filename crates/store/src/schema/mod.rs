//! The schema: one text in `migrations/` for both engines, and the creation or upgrade of a database with it.
//!
//! Indexes, triggers and views contain no data. They are created again whenever their text has changed. A change of a
//! table is a file `migrations/NNNN_description.sql`, whose number is the new version.

mod dialect;
pub(crate) mod on_file;
mod rebuild;
mod units;
#[cfg(test)]
pub(crate) mod tests;

use sqlx::{AssertSqlSafe, Executor, Row};

use self::dialect::Statement;
use crate::engine::{Bind, Dialect, EngineConnection, Run};

/// Version of the first schema that both engines share; the files of `migrations/` change it.
const SQUASHED: i64 = 52;

/// Oldest version that can be upgraded.
pub(crate) const OLDEST: i64 = 46;

/// Changes of tables since [`SQUASHED`]: the files of `migrations/`, by version.
const CHANGES: &[(i64, &str)] = &include!(concat!(env!("OUT_DIR"), "/migrations.rs"));

/// Tables of a new database.
const TABLES: &str = include_str!("../../../../migrations/schema/tables.sql");

/// Indexes, triggers and views of those tables.
const DERIVED: [&str; 3] = [
    include_str!("../../../../migrations/schema/indexes.sql"),
    include_str!("../../../../migrations/schema/triggers.sql"),
    include_str!("../../../../migrations/schema/views.sql"),
];

/// Functions of SQLite that PostgreSQL lacks.
const SERVER_FUNCTIONS: &str = include_str!("../server/functions.sql");

/// Latest version of the schema.
pub(crate) fn latest_schema() -> i64 {
    CHANGES.last().map_or(SQUASHED, |(version, _)| *version)
}

/// The schema in the SQL of one engine.
pub(crate) struct Schema {
    engine: Dialect,
    tables: Vec<Statement>,
    derived: Vec<Statement>,
    changes: Vec<(i64, Vec<Statement>)>,
}

impl Schema {
    /// The schema of this program.
    pub(crate) fn of(engine: Dialect) -> Self {
        Self::from_texts(engine, TABLES, &DERIVED.concat(), CHANGES)
    }

    fn from_texts(engine: Dialect, tables: &str, derived: &str, changes: &[(i64, &str)]) -> Self {
        let mut derived = dialect::statements(&units::with_units(derived), engine);
        let tables = dialect::statements(tables, engine);
        derived.extend(tables.iter().flat_map(dialect::times_as_text));
        let changes = changes.iter().map(|(version, text)| (*version, dialect::statements(text, engine)));
        Self { engine, tables, derived, changes: changes.collect() }
    }

    fn version(&self) -> i64 {
        self.changes.last().map_or(SQUASHED, |(version, _)| *version)
    }

    /// A hash of the statements that create indexes, triggers, views and functions.
    fn fingerprint(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        for statement in &self.derived {
            hasher.update(statement.sql.as_bytes());
        }
        if self.engine == Dialect::Postgres {
            hasher.update(SERVER_FUNCTIONS.as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Creates the schema in a database without tables, or upgrades that of version `found`. The connection is in a
    /// transaction of its caller.
    ///
    /// # Errors
    /// Those of the database. The caller has refused other versions than [`OLDEST`] to [`latest_schema`].
    pub(crate) async fn apply(
        &self,
        connection: &mut EngineConnection,
        found: Option<i64>,
    ) -> sqlx::Result<()> {
        if self.engine == Dialect::Postgres {
            // the server sends a notice for each trigger that it drops with its function, and the driver logs it
            run(connection, "SET LOCAL client_min_messages = warning").await?;
        }
        match found {
            None => self.make(connection).await?,
            Some(version) if version < SQUASHED => rebuild::rebuild(self, connection, version).await?,
            Some(version) => {
                let missing = self.changes.iter().filter(|(change, _)| *change > version);
                for statement in missing.flat_map(|(_, statements)| statements) {
                    run(connection, &statement.sql).await?;
                }
                let granted = rebuild::grants(self.engine, connection).await?;
                self.drop_derived(connection).await?;
                self.make_functions(connection).await?;
                self.make_derived(connection).await?;
                rebuild::grant(connection, &granted).await?;
            }
        }
        run(connection, "DELETE FROM schema_version").await?;
        sqlx::query("INSERT INTO schema_version (only_one, version, derived) VALUES (1, $1, $2)")
            .bind_all((self.version(), self.fingerprint()))
            .run(connection)
            .await
    }

    /// Returns true if a database of version `found` needs no change.
    pub(crate) async fn is_applied(
        &self,
        connection: &mut EngineConnection,
        found: Option<i64>,
    ) -> sqlx::Result<bool> {
        if found != Some(self.version()) {
            return Ok(false);
        }
        let derived: Option<String> =
            sqlx::query_scalar("SELECT derived FROM schema_version").fetch_optional(connection).await?;
        Ok(derived == Some(self.fingerprint()))
    }

    async fn make(&self, connection: &mut EngineConnection) -> sqlx::Result<()> {
        self.make_tables(connection).await?;
        self.make_derived(connection).await?;
        let identity = match self.engine {
            Dialect::Sqlite => "lower(hex(randomblob(6)))",
            Dialect::Postgres => "encode(randomblob(6), 'hex')",
        };
        let row = format!("INSERT INTO database_identity (only_one, identity) VALUES (1, {identity})");
        run(connection, &row).await
    }

    /// Creates the functions that a server lacks, or marks a file as one of this program.
    async fn make_functions(&self, connection: &mut EngineConnection) -> sqlx::Result<()> {
        match self.engine {
            Dialect::Sqlite => {
                let id = crate::verified_copy::APPLICATION_ID;
                run(connection, &format!("PRAGMA application_id = {id}")).await
            }
            Dialect::Postgres => run(connection, SERVER_FUNCTIONS).await,
        }
    }

    async fn make_tables(&self, connection: &mut EngineConnection) -> sqlx::Result<()> {
        self.make_functions(connection).await?;
        for statement in &self.tables {
            run(connection, &statement.sql).await?;
        }
        Ok(())
    }

    /// Creates triggers and views, and the missing indexes.
    async fn make_derived(&self, connection: &mut EngineConnection) -> sqlx::Result<()> {
        let there = names(self.engine, connection, "index").await?;
        for statement in self.derived.iter().filter(|of| !there.contains(&of.name)) {
            run(connection, &statement.sql).await?;
        }
        Ok(())
    }

    /// Drops triggers and views, and the indexes that the schema no longer has.
    async fn drop_derived(&self, connection: &mut EngineConnection) -> sqlx::Result<()> {
        let quoted = |names: Vec<String>| names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>();
        let views = quoted(names(self.engine, connection, "view").await?);
        let triggers = quoted(names(self.engine, connection, "trigger").await?);
        let mut indexes = names(self.engine, connection, "index").await?;
        indexes.retain(|name| self.derived.iter().all(|statement| statement.name != *name));
        let mut statements: Vec<String> = match self.engine {
            Dialect::Sqlite => {
                let views = views.iter().map(|view| format!("DROP VIEW {view}"));
                views.chain(triggers.iter().map(|trigger| format!("DROP TRIGGER {trigger}"))).collect()
            }
            // views that use each other are dropped together; a dependent view of another user stops the change with
            // its name
            Dialect::Postgres => {
                let views = (!views.is_empty()).then(|| format!("DROP VIEW {}", views.join(", ")));
                let functions = triggers.iter().map(|trigger| format!("DROP FUNCTION {trigger}() CASCADE"));
                views.into_iter().chain(functions).collect()
            }
        };
        statements.extend(quoted(indexes).iter().map(|index| format!("DROP INDEX {index}")));
        for statement in statements {
            run(connection, &statement).await?;
        }
        Ok(())
    }
}

/// Names of the views, triggers or indexes of a database, except those that belong to a constraint. A trigger of
/// PostgreSQL has the name of its function.
async fn names(engine: Dialect, connection: &mut EngineConnection, kind: &str) -> sqlx::Result<Vec<String>> {
    let statement = match (engine, kind) {
        (Dialect::Sqlite, _) => {
            "SELECT name FROM sqlite_schema WHERE type = $1 AND sql IS NOT NULL ORDER BY name"
        }
        (Dialect::Postgres, "view") => {
            "SELECT CAST(relname AS text) FROM pg_class
             WHERE relnamespace = CAST('armwatch' AS regnamespace) AND relkind = 'v' AND $1 = 'view' ORDER BY relname"
        }
        (Dialect::Postgres, "trigger") => {
            "SELECT CAST(proname AS text) FROM pg_proc
             WHERE pronamespace = CAST('armwatch' AS regnamespace) AND prorettype = CAST('trigger' AS regtype)
                   AND $1 = 'trigger'
             ORDER BY proname"
        }
        (Dialect::Postgres, _) => {
            "SELECT CAST(relname AS text) FROM pg_class
             WHERE relnamespace = CAST('armwatch' AS regnamespace) AND relkind = 'i' AND $1 = 'index'
                   AND NOT EXISTS (SELECT 1 FROM pg_constraint WHERE conindid = pg_class.oid)
             ORDER BY relname"
        }
    };
    let rows = sqlx::query(statement).bind(kind).fetch_all(connection).await?;
    rows.iter().map(|row| row.try_get(0)).collect()
}

/// Runs one or more statements of the program itself.
async fn run(connection: &mut EngineConnection, sql: &str) -> sqlx::Result<()> {
    connection.execute(sqlx::raw_sql(AssertSqlSafe(sql.to_owned()))).await.map(|_| ())
}
