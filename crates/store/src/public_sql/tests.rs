use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::*;

const LIMITS_OF_TEST: SqlLimits = SqlLimits { rows: 100, bytes: 1 << 20, time: Duration::from_secs(60) };

async fn database() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("a.db")).await.unwrap();
    (folder, store)
}

fn ask(store: &Store, statement: &str) -> Result<Vec<Vec<Value>>, SqlError> {
    store.ask_within(statement, &[], LIMITS_OF_TEST, &Arc::default()).map(|answer| answer.table.rows)
}

#[tokio::test]
async fn every_public_view_is_read_in_every_way() {
    let (_folder, store) = database().await;
    let views = store.views().await.unwrap();
    assert!(views.len() > 20, "{views:?}");
    for (view, _) in views {
        for statement in [
            format!("SELECT * FROM {view}"),
            format!("SELECT count(*) FROM main.\"{view}\" AS x"),
            format!("WITH mine AS (SELECT * FROM {view}) SELECT count(*) FROM mine"),
            format!("SELECT 1 WHERE EXISTS (SELECT 1 FROM {})", view.to_uppercase()),
        ] {
            ask(&store, &statement).unwrap_or_else(|error| panic!("{statement}: {error}"));
        }
    }
    for more in [
        "VALUES (1)",
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 5) SELECT sum(i) FROM n",
        "SELECT value FROM json_each('[1, 2]')",
        "SELECT name FROM sqlite_schema WHERE type = 'view'",
    ] {
        ask(&store, more).unwrap_or_else(|error| panic!("{more}: {error}"));
    }
}

#[tokio::test]
async fn nothing_is_changed_and_nothing_but_views_is_read() {
    let (folder, store) = database().await;
    let copy = folder.path().join("copy.db");
    let copy = copy.display();
    for statement in [
        "DELETE FROM run".to_owned(),
        "INSERT INTO robot (name) VALUES ('x')".into(),
        "WITH a AS (SELECT 1) DELETE FROM run".into(),
        "WITH a AS (SELECT 1) INSERT INTO robot (name) SELECT 'x' FROM a".into(),
        "CREATE TABLE x (y)".into(),
        "CREATE TEMP VIEW x AS SELECT * FROM run".into(),
        "DROP VIEW runs".into(),
        format!("ATTACH '{copy}' AS x"),
        format!("VACUUM INTO '{copy}'"),
        "PRAGMA query_only = 0".into(),
        "PRAGMA table_info(run)".into(),
        "BEGIN".into(),
        "EXPLAIN SELECT * FROM runs".into(),
        "SELECT * FROM run".into(),
        "SELECT count(run_id) FROM run".into(),
        "SELECT 1 FROM runs WHERE EXISTS (SELECT 1 FROM main.run AS x WHERE x.run_id = runs.run_id)".into(),
        "SELECT count(*) FROM pragma_table_info('run')".into(),
        "SELECT (SELECT max(run_id) FROM \"run\") FROM runs".into(),
        "SELECT * FROM (SELECT * FROM run) AS runs".into(),
        "SELECT * FROM runs JOIN cycle".into(),
        "SELECT * FROM schema_version".into(),
        "SELECT * FROM pragma_table_info('run')".into(),
        "SELECT * FROM pragma_database_list".into(),
        "SELECT load_extension('x')".into(),
        "WITH mine AS (SELECT * FROM run) SELECT * FROM mine".into(),
        // SQLite asks as if the view read the table
        "WITH runs AS (SELECT * FROM run) SELECT * FROM runs".into(),
        "WITH [Judged] AS (SELECT * FROM run) SELECT * FROM judged".into(),
        "WITH run AS (SELECT 1) SELECT count(*) FROM main.run".into(),
        "SELECT 1; DELETE FROM run".into(),
        "SELECT 1; SELECT * FROM run".into(),
        String::new(),
    ] {
        let answer = ask(&store, &statement);
        let refused = matches!(answer, Err(SqlError::Forbidden(_) | SqlError::Statement { .. }));
        assert!(refused, "{statement}: {answer:?}");
    }
    assert_eq!(
        std::fs::read_dir(folder.path())
            .unwrap()
            .filter(|e| e.as_ref().unwrap().file_name() == "copy.db")
            .count(),
        0
    );
    assert!(ask(&store, "SELECT 1; -- and no more").is_ok());
}

#[tokio::test]
async fn what_is_wrong_is_said_with_its_place() {
    let (_folder, store) = database().await;
    let said = |statement: &str| ask(&store, statement).unwrap_err().to_string();
    assert_eq!(said("SELECT run_id,\n  'é', robo FROM runs"), "line 2, column 8: no such column: robo");
    assert_eq!(said("SELECT *\nFORM runs"), "line 2, column 1: near \"FORM\": syntax error");
    assert!(said("SELECT * FROM run").starts_with("run is not public"), "{}", said("SELECT * FROM run"));
    assert!(said("SELECT 1; SELECT 2").contains("several statements"));
    assert!(said("SELECT ?1").contains("1 parameters"));
    let bound = store.ask_within(
        "SELECT ?1, ?2, ?3, ?4",
        &[json!(1), json!(0.5), json!("x"), json!(null)],
        LIMITS_OF_TEST,
        &Arc::default(),
    );
    assert_eq!(bound.unwrap().table.rows, [[json!(1), json!(0.5), json!("x"), Value::Null]]);
}

#[tokio::test]
async fn an_answer_has_its_limits() {
    const ENDLESS: &str = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT ";
    let (_folder, store) = database().await;
    let cut = store.ask_within(&format!("{ENDLESS} i FROM n"), &[], LIMITS_OF_TEST, &Arc::default()).unwrap();
    assert_eq!((cut.table.rows.len(), cut.truncated), (100, true));
    let long = format!("{ENDLESS} printf('%.*c', 100000, 'x') FROM n");
    assert!(matches!(ask(&store, &long), Err(SqlError::TooLarge(_))));
    assert!(matches!(ask(&store, "SELECT zeroblob(1000000000)"), Err(SqlError::Statement { .. })));

    // without the handler, neither would ever end
    let begun = Instant::now();
    let short = SqlLimits { time: Duration::from_millis(200), ..LIMITS_OF_TEST };
    let slow = store.ask_within(&format!("{ENDLESS} count(*) FROM n"), &[], short, &Arc::default());
    assert!(matches!(slow, Err(SqlError::TooSlow(_))), "{slow:?}");
    assert!(begun.elapsed() >= Duration::from_millis(200));
    let gone = Arc::new(AtomicBool::new(true));
    let abandoned = store.ask_within(&format!("{ENDLESS} count(*) FROM n"), &[], LIMITS_OF_TEST, &gone);
    assert!(matches!(abandoned, Err(SqlError::TooSlow(_))), "{abandoned:?}");
    // each name doubles the text that SQLite must prepare
    let names: Vec<String> =
        (1..40).map(|i| format!("a{i} AS (SELECT x.c FROM a{0} AS x, a{0} AS y)", i - 1)).collect();
    let doubled = format!("WITH a0 AS (SELECT 1 AS c), {} SELECT * FROM a39", names.join(", "));
    assert!(matches!(ask(&store, &doubled), Err(SqlError::Forbidden(_))));
}

/// No function may work on long values for longer than a statement may take, because nothing can stop it during that
/// time.
#[tokio::test]
async fn functions_of_long_values_are_bounded_and_give_what_sqlite_gives() {
    let (_folder, store) = database().await;
    let begun = Instant::now();
    for long in [
        "instr(printf('%.*c', 900000, 'a'), printf('%.*c', 450000, 'a') || 'b')",
        "replace(printf('%.*c', 900000, 'a'), printf('%.*c', 450000, 'a') || 'b', 'c')",
        "trim(printf('%.*c', 900000, 'b'), printf('%.*c', 900000, 'a') || 'b')",
        "ltrim(printf('%.*c', 900000, 'b'), printf('%.*c', 900000, 'a') || 'b')",
        "rtrim(printf('%.*c', 900000, 'b'), printf('%.*c', 900000, 'a') || 'b')",
        "printf('%.*c', 900000, 'a') LIKE '%' || printf('%.*c', 800, 'a') || 'b'",
        "printf('%.*c', 900000, 'a') GLOB '*' || printf('%.*c', 800, 'a') || 'b'",
    ] {
        let refused = ask(&store, &format!("SELECT {long}"));
        assert!(matches!(refused, Err(SqlError::Statement { .. })), "{long}: {refused:?}");
    }
    assert!(begun.elapsed() < LIMITS_OF_TEST.time, "{:?}", begun.elapsed());
    // each of them alone has worked for minutes; arguments of ordinary length give the usual results
    let usual = "SELECT instr('äöü', 'ü'), instr(x'00ff', x'ff'), instr(12.5, '.'), instr(NULL, 'a'), replace('a-b', '-', '+'),
                        replace('abc', '', 'x'), trim('xxaxx', 'x'), ltrim('xa', 'x'), rtrim(1.50, '0'), trim(' a '),
                        typeof(replace(1, '1', '2'))";
    let expected = [
        json!(3),
        json!(2),
        json!(3),
        Value::Null,
        json!("a+b"),
        json!("abc"),
        json!("a"),
        json!("a"),
        json!("1.5"),
        json!("a"),
        json!("text"),
    ];
    assert_eq!(ask(&store, usual).unwrap(), [expected]);
}
