//! Upgrade of a database that was created before both engines had one schema text. One transaction creates the new
//! tables, copies the rows column by column and drops the old tables.

use sqlx::Row;

use super::{Schema, names, run};
use crate::engine::{Bind, Dialect, EngineConnection};

/// Prefix of the names of the old tables while their rows are copied.
const BEFORE: &str = "before_";

/// Columns whose value is computed from the old row: table, column, and SQL over the columns of the old table.
const COMPUTED: &[(&str, &str, &str)] = &[
    // old names had values in several units, which baseline and threshold distinguish; a test without result has no
    // value
    (
        "anomaly",
        "quantity",
        "CASE
            WHEN quantity = 'torque_signal' AND value IS NULL THEN 'torque_signal'
            WHEN quantity = 'torque_signal' AND baseline = 0 THEN 'torque_offset_nm'
            WHEN quantity = 'torque_signal' AND threshold >= 1 THEN 'torque_noise_ratio'
            WHEN quantity = 'torque_signal' THEN 'torque_gain_ratio'
            WHEN quantity = 'production_torque_signal' AND baseline = 0 THEN 'production_torque_offset_nm'
            WHEN quantity = 'production_torque_signal' THEN 'production_torque_gain_ratio'
            WHEN kind = 'step' AND baseline = 1 AND quantity IN ('warm_friction_nm', 'excitation_friction_nm')
                THEN 'friction_jump_ratio'
            WHEN quantity = 'warm friction, Nm' THEN 'warm_friction_nm'
            ELSE quantity
        END",
    ),
    ("anomaly", "settled_history_id", "NULL"),
];

/// Tables whose rows are not copied, because conclusions compute them again.
const REMADE: [&str; 3] = ["friction_plan", "run_friction_series", "settled_history"];

/// Statements that run after the copy if the old version is below a number.
const AFTERWARDS: &[(i64, &str)] = &[
    // version 49 began to judge dates, including those of older runs
    (
        49,
        "UPDATE robot SET history = history + 1
         WHERE robot_id IN (SELECT run.robot_id FROM run WHERE run.status = 'complete')",
    ),
];

/// A table of the database.
struct OldTable {
    name: String,
    columns: Vec<String>,
}

/// Replaces the tables of version `found` by those of `schema`, with their rows, and creates indexes, triggers and
/// views.
///
/// # Errors
/// Those of the database, and [`sqlx::Error::Protocol`] if a table has fewer rows than before.
pub(super) async fn rebuild(
    schema: &Schema,
    connection: &mut EngineConnection,
    found: i64,
) -> sqlx::Result<()> {
    let engine = schema.engine;
    let granted = grants(engine, connection).await?;
    schema.drop_derived(connection).await?;
    let old = tables(engine, connection).await?;
    let counters = put_away(engine, connection, &old).await?;
    schema.make_tables(connection).await?;
    let new = tables(engine, connection).await?;
    // the schema lists a table after the tables that it refers to
    let is_copied = |name: &str| name != "schema_version" && !REMADE.contains(&name);
    for statement in schema.tables.iter().filter(|of| is_copied(&of.name)) {
        let table = |of: &[OldTable], name: &str| of.iter().position(|table| table.name == name);
        if let (Some(before), Some(after)) = (table(&old, &statement.name), table(&new, &statement.name)) {
            copy(connection, &old[before], &new[after]).await?;
        }
    }
    set_counters(engine, connection, counters).await?;
    for (before, statement) in AFTERWARDS {
        if found < *before {
            run(connection, statement).await?;
        }
    }
    match engine {
        // children first, so that no reference has to be followed
        Dialect::Sqlite => {
            let order = |name: &str| schema.tables.iter().position(|statement| statement.name == name);
            let mut names: Vec<&str> = old.iter().map(|table| table.name.as_str()).collect();
            names.sort_by_key(|name| std::cmp::Reverse(order(name)));
            for name in names {
                run(connection, &format!("DROP TABLE {BEFORE}{name}")).await?;
            }
        }
        Dialect::Postgres => {
            let names: Vec<String> = old.iter().map(|table| format!("{BEFORE}{}", table.name)).collect();
            run(connection, &format!("DROP TABLE {}", names.join(", "))).await?;
        }
    }
    schema.make_derived(connection).await?;
    grant(connection, &granted).await
}

async fn copy(connection: &mut EngineConnection, old: &OldTable, new: &OldTable) -> sqlx::Result<()> {
    let name = &new.name;
    let (mut columns, mut values) = (Vec::new(), Vec::new());
    for column in &new.columns {
        let computed = COMPUTED.iter().find(|(table, of, _)| table == name && of == column);
        match computed {
            Some((_, _, value)) => values.push((*value).to_owned()),
            None if old.columns.contains(column) => values.push(format!("\"{column}\"")),
            None => continue,
        }
        columns.push(format!("\"{column}\""));
    }
    if columns.is_empty() {
        return Ok(());
    }
    let (columns, values) = (columns.join(", "), values.join(", "));
    run(connection, &format!("INSERT INTO {name} ({columns}) SELECT {values} FROM {BEFORE}{name}")).await?;
    let counts = format!("SELECT (SELECT count(*) FROM {BEFORE}{name}), (SELECT count(*) FROM {name})");
    let row = sqlx::query(sqlx::AssertSqlSafe(counts)).fetch_one(connection).await?;
    let (before, after): (i64, i64) = (row.try_get(0)?, row.try_get(1)?);
    if before != after {
        return Err(sqlx::Error::Protocol(format!(
            "table {name} has {after} of {before} rows in the new schema"
        )));
    }
    Ok(())
}

/// Tables of the database with their writable columns.
async fn tables(engine: Dialect, connection: &mut EngineConnection) -> sqlx::Result<Vec<OldTable>> {
    let rows = sqlx::query(match engine {
        Dialect::Sqlite => {
            "SELECT tables.name, columns.name FROM sqlite_schema AS tables JOIN pragma_table_info(tables.name) AS columns
             WHERE tables.type = 'table' AND tables.name NOT LIKE 'sqlite~_%' ESCAPE '~'
                   AND tables.name NOT LIKE 'before~_%' ESCAPE '~'
             ORDER BY tables.name, columns.cid"
        }
        Dialect::Postgres => {
            "SELECT CAST(tables.relname AS text), CAST(columns.attname AS text)
             FROM pg_class AS tables JOIN pg_attribute AS columns ON columns.attrelid = tables.oid
             WHERE tables.relnamespace = CAST('armwatch' AS regnamespace) AND tables.relkind = 'r'
                   AND columns.attnum > 0 AND NOT columns.attisdropped AND columns.attgenerated = ''
                   AND tables.relname NOT LIKE 'before~_%' ESCAPE '~'
             ORDER BY tables.relname, columns.attnum"
        }
    });
    let mut found: Vec<OldTable> = Vec::new();
    for row in rows.fetch_all(connection).await? {
        let (table, column): (String, String) = (row.try_get(0)?, row.try_get(1)?);
        match found.last_mut().filter(|last| last.name == table) {
            Some(last) => last.columns.push(column),
            None => found.push(OldTable { name: table, columns: vec![column] }),
        }
    }
    Ok(found)
}

/// A table with an identity column, that column, and the last key that it assigned, if any.
type Counter = (String, String, Option<i64>);

/// Renames the tables. On a server, also drops their constraints, indexes and sequences, whose names the new tables
/// need.
async fn put_away(
    engine: Dialect,
    connection: &mut EngineConnection,
    tables: &[OldTable],
) -> sqlx::Result<Vec<Counter>> {
    let mut counters = Vec::new();
    if engine == Dialect::Postgres {
        for index in names(engine, connection, "index").await? {
            run(connection, &format!("DROP INDEX \"{index}\"")).await?;
        }
        let constraints = sqlx::query(
            "SELECT CAST(tables.relname AS text), CAST(conname AS text)
             FROM pg_constraint JOIN pg_class AS tables ON tables.oid = conrelid
             WHERE connamespace = CAST('armwatch' AS regnamespace) AND contype IN ('f', 'p', 'u', 'c')
             ORDER BY contype <> 'f', conname",
        );
        for row in constraints.fetch_all(&mut *connection).await? {
            let (table, constraint): (String, String) = (row.try_get(0)?, row.try_get(1)?);
            run(connection, &format!("ALTER TABLE {table} DROP CONSTRAINT \"{constraint}\"")).await?;
        }
        let keys = sqlx::query(
            "SELECT CAST(tables.relname AS text), CAST(columns.attname AS text)
             FROM pg_class AS tables JOIN pg_attribute AS columns ON columns.attrelid = tables.oid
             WHERE tables.relnamespace = CAST('armwatch' AS regnamespace) AND columns.attidentity <> ''
             ORDER BY tables.relname",
        );
        for row in keys.fetch_all(&mut *connection).await? {
            let (table, column): (String, String) = (row.try_get(0)?, row.try_get(1)?);
            let last = sqlx::query_scalar(
                "SELECT last_value FROM pg_sequences
                 WHERE CAST(format('%I.%I', schemaname, sequencename) AS text) = pg_get_serial_sequence($1, $2)",
            );
            let last: Option<Option<i64>> =
                last.bind(&table).bind(&column).fetch_optional(&mut *connection).await?;
            run(connection, &format!("ALTER TABLE {table} ALTER COLUMN {column} DROP IDENTITY")).await?;
            counters.push((table, column, last.flatten()));
        }
    }
    for OldTable { name, .. } in tables {
        run(connection, &format!("ALTER TABLE {name} RENAME TO {BEFORE}{name}")).await?;
    }
    Ok(counters)
}

/// Continues the counters of keys, so that the key of a deleted row is not assigned again.
async fn set_counters(
    engine: Dialect,
    connection: &mut EngineConnection,
    counters: Vec<Counter>,
) -> sqlx::Result<()> {
    if engine == Dialect::Sqlite {
        // SQLite has renamed the counters together with the tables
        let renamed = format!(
            "DELETE FROM sqlite_sequence WHERE '{BEFORE}' || name IN (SELECT name FROM sqlite_sequence);
             INSERT INTO sqlite_sequence (name, seq)
             SELECT substr(name, {}), seq FROM sqlite_sequence WHERE name LIKE 'before~_%' ESCAPE '~'",
            BEFORE.len() + 1
        );
        return run(connection, &renamed).await;
    }
    for (table, column, last) in counters {
        let sequence: Option<Option<String>> = sqlx::query_scalar(
            "SELECT pg_get_serial_sequence($1, $2)
             WHERE EXISTS (SELECT 1 FROM pg_attribute WHERE attrelid = to_regclass($1) AND attname = $2)",
        )
        .bind_all((&table, &column))
        .fetch_optional(&mut *connection)
        .await?;
        if let (Some(Some(sequence)), Some(last)) = (sequence, last) {
            sqlx::query("SELECT setval(CAST($1 AS regclass), $2)")
                .bind_all((sequence, last))
                .execute(&mut *connection)
                .await?;
        }
    }
    Ok(())
}

/// The rights of other users on tables and views of a server, as statements that grant them.
pub(super) async fn grants(engine: Dialect, connection: &mut EngineConnection) -> sqlx::Result<Vec<String>> {
    if engine == Dialect::Sqlite {
        return Ok(Vec::new());
    }
    let rows = sqlx::query(
        "SELECT CAST(tables.relname AS text),
                format('GRANT %s ON %I TO %s', of.privilege_type, tables.relname,
                       CASE of.grantee WHEN 0 THEN 'PUBLIC' ELSE CAST(CAST(of.grantee AS regrole) AS text) END)
         FROM pg_class AS tables CROSS JOIN aclexplode(tables.relacl) AS of
         WHERE tables.relnamespace = CAST('armwatch' AS regnamespace) AND tables.relkind IN ('r', 'v')
               AND of.grantee <> tables.relowner
         ORDER BY 1, 2",
    );
    rows.fetch_all(connection).await?.iter().map(|row| row.try_get(1)).collect()
}

/// Runs the statements of [`grants`] whose table or view still exists.
pub(super) async fn grant(connection: &mut EngineConnection, granted: &[String]) -> sqlx::Result<()> {
    for statement in granted {
        let table =
            statement.split(" ON ").nth(1).and_then(|rest| rest.split(" TO ").next()).unwrap_or_default();
        let is_there: bool = sqlx::query_scalar("SELECT to_regclass('armwatch.' || $1) IS NOT NULL")
            .bind(table)
            .fetch_one(&mut *connection)
            .await?;
        if is_there {
            run(connection, statement).await?;
        }
    }
    Ok(())
}
