//! Meaning of the public views and their columns: data parsed from `docs/schema.md`, which is compiled in. The view
//! `view_columns` and exported files use it.

use std::sync::LazyLock;

use sqlx::{FromRow, QueryBuilder, Row};

use super::values::ROWS_PER_STATEMENT;
use crate::engine::{Bind, Engine, EnginePool, EngineRow, begin_writing};

/// The only description of views and columns.
const SCHEMA: &str = include_str!("../../../docs/schema.md");

static VIEWS: LazyLock<Vec<PublicView>> = LazyLock::new(|| read(SCHEMA));

/// A public view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PublicView {
    /// Its name in SQL.
    pub name: String,
    /// Meaning of a row.
    pub row_is: String,
    /// Its columns in order.
    pub columns: Vec<ViewColumn>,
}

/// A column of a public view.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ViewColumn {
    /// Its name in SQL.
    pub name: String,
    /// `integer`, `real` or `text`.
    pub kind: String,
    /// Unit of its values: `1` for a dimensionless value, `UTC` for a time, `UTC day` for a day, words if it differs by
    /// row; `None` for counts, numbers of things and texts.
    pub unit: Option<String>,
    /// Condition under which it is NULL; `None` if never.
    pub null_when: Option<String>,
    /// Meaning.
    pub meaning: String,
}

impl ViewColumn {
    /// The column of a row of the table: its type with unit, its meaning with the condition of NULL.
    fn new(name: &str, kind: &str, meaning: &str) -> Self {
        let (kind, unit) = divided(kind, ", ");
        let (meaning, null_when) = divided(meaning, "; NULL ");
        Self { name: name.to_owned(), kind, unit, null_when, meaning }
    }
}

impl FromRow<'_, EngineRow> for ViewColumn {
    fn from_row(row: &EngineRow) -> sqlx::Result<Self> {
        Ok(Self {
            name: row.try_get("column_name")?,
            kind: row.try_get("type")?,
            unit: row.try_get("unit")?,
            null_when: row.try_get("null_when")?,
            meaning: row.try_get("meaning")?,
        })
    }
}

/// The public views, in the order of their descriptions in `docs/schema.md`.
pub fn public_views() -> &'static [PublicView] {
    &VIEWS
}

/// Stores the descriptions in the database if they differ from the stored ones. A program that only reads leaves the
/// stored ones: they belong to the program that wrote last.
pub(super) async fn fill(writer: &EnginePool) -> sqlx::Result<()> {
    let described: Vec<(&str, i64, &ViewColumn)> = public_views()
        .iter()
        .flat_map(|view| (1..).zip(&view.columns).map(|(place, column)| (view.name.as_str(), place, column)))
        .collect();
    let stored: Vec<StoredColumns> = sqlx::query_as(
        "SELECT view_name, position, column_name, type, unit, null_when, meaning FROM view_column
         ORDER BY view_name, position",
    )
    .fetch_all(writer)
    .await?;
    let mut by_name = described.clone();
    by_name.sort_by_key(|(view, position, _)| (*view, *position));
    let is_same = stored.iter().map(|row| (row.view_name.as_str(), row.position, &row.column));
    if is_same.eq(by_name) {
        return Ok(());
    }
    let mut transaction = begin_writing(writer).await?;
    sqlx::query("DELETE FROM view_column").execute(&mut *transaction).await?;
    for rows in described.chunks(ROWS_PER_STATEMENT) {
        let mut insert = QueryBuilder::<Engine>::new(
            "INSERT INTO view_column (view_name, position, column_name, type, unit, null_when, meaning) ",
        );
        insert.push_values(rows, |mut values, (view, position, column)| {
            values
                .bind_all((*view, *position, &column.name, &column.kind, &column.unit, &column.null_when))
                .push_bind(&column.meaning);
        });
        insert.build().execute(&mut *transaction).await?;
    }
    transaction.commit().await
}

struct StoredColumns {
    view_name: String,
    position: i64,
    column: ViewColumn,
}

impl FromRow<'_, EngineRow> for StoredColumns {
    fn from_row(row: &EngineRow) -> sqlx::Result<Self> {
        Ok(Self {
            view_name: row.try_get("view_name")?,
            position: row.try_get("position")?,
            column: ViewColumn::from_row(row)?,
        })
    }
}

/// Reads the sections whose heading is a view in backticks, with a table of its columns: names, type with unit, meaning
/// with the condition of NULL. Names without a type are columns of a table before these sections. The meaning of a row
/// is in the table of all views.
fn read(schema: &str) -> Vec<PublicView> {
    let mut views: Vec<PublicView> = Vec::new();
    let mut common: Vec<ViewColumn> = Vec::new();
    let mut rows_are: Vec<(String, String)> = Vec::new();
    let mut is_view = false;
    for line in schema.lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            let name = heading.strip_prefix('`').and_then(|rest| rest.strip_suffix('`'));
            is_view = name.is_some();
            views.extend(name.map(|name| PublicView {
                name: name.to_owned(),
                row_is: String::new(),
                columns: Vec::new(),
            }));
        }
        let Some(cells) = line.strip_prefix("| `").and_then(|rest| rest.strip_suffix('|')) else { continue };
        let cells: Vec<String> = cells.split('|').map(|cell| plain(cell.trim())).collect();
        match cells.as_slice() {
            [names, kind, meaning] => {
                for name in names.split(", ") {
                    let known = common.iter().find(|of| kind.is_empty() && of.name == name).cloned();
                    let column = known.unwrap_or_else(|| ViewColumn::new(name, kind, meaning));
                    match views.last_mut() {
                        Some(view) if is_view => view.columns.push(column),
                        _ => common.push(column),
                    }
                }
            }
            [name, row_is] if !is_view => rows_are.push((name.clone(), row_is.clone())),
            _ => {}
        }
    }
    for view in &mut views {
        if let Some((_, row_is)) = rows_are.iter().find(|(name, _)| *name == view.name) {
            view.row_is.clone_from(row_is);
        }
    }
    views
}

/// A text before a separator, and the text after it if there is one.
fn divided(text: &str, separator: &str) -> (String, Option<String>) {
    match text.split_once(separator) {
        Some((first, second)) => (first.to_owned(), Some(second.to_owned())),
        None => (text.to_owned(), None),
    }
}

/// A cell of Markdown as plain text: without backticks, and links without their targets.
fn plain(cell: &str) -> String {
    let mut text = cell.replace('`', "");
    while let Some(middle) = text.find("](") {
        let (Some(begin), Some(end)) = (text[..middle].rfind('['), text[middle..].find(')')) else { break };
        text = format!("{}{}{}", &text[..begin], &text[begin + 1..middle], &text[middle + end + 1..]);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handle::Store;

    type Row = (String, String, i64, String);

    #[test]
    fn a_table_of_markdown_becomes_columns() {
        let schema = "\
| view | a row is |\n|---|---|\n| `runs` | an export: see [runs](#runs) |\n\n## Common columns\n\n\
| column | type, unit | meaning |\n|---|---|---|\n| `robot` | text | the robot |\n| `joint` | integer | the joint |\n\n\
## `runs`\n\nWords.\n\n| column | type, unit | meaning |\n|---|---|---|\n\
| `rows` | integer | rows, as `skip_bad` ([layouts.md](layouts.md#bad-rows)) allows; NULL until `complete` |\n\
| `robot`, `joint` | | |\n\
| `first_at`, `last_at` | text, UTC | first and last start [5.1] |\n\n## Size\n\n| `no` | integer | column |\n";
        let views = read(schema);
        assert_eq!(views.len(), 1);
        assert_eq!((views[0].name.as_str(), views[0].row_is.as_str()), ("runs", "an export: see runs"));
        let told: Vec<_> = views[0]
            .columns
            .iter()
            .map(|of| (of.name.as_str(), of.unit.as_deref(), of.null_when.as_deref(), of.meaning.as_str()))
            .collect();
        assert_eq!(
            told,
            [
                ("rows", None, Some("until complete"), "rows, as skip_bad (layouts.md) allows"),
                ("robot", None, None, "the robot"),
                ("joint", None, None, "the joint"),
                ("first_at", Some("UTC"), None, "first and last start [5.1]"),
                ("last_at", Some("UTC"), None, "first and last start [5.1]"),
            ]
        );
    }

    #[tokio::test]
    async fn the_view_has_every_column_of_every_view_in_its_place() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("fleet.db")).await.expect("a store");
        let described: Vec<Row> = sqlx::query_as(
            "SELECT view_name, column_name, position, type FROM view_columns ORDER BY view_name, position",
        )
        .fetch_all(&store.readers)
        .await
        .expect("rows");
        let real: Vec<Row> = sqlx::query_as(
            "SELECT view.name, of.name, of.cid + 1, lower(of.type)
             FROM sqlite_schema AS view JOIN pragma_table_info(view.name) AS of
             WHERE view.type = 'view' ORDER BY view.name, of.cid",
        )
        .fetch_all(&store.readers)
        .await
        .expect("rows");
        let untyped = |rows: &[Row]| -> Vec<(String, String, i64)> {
            rows.iter().map(|row| (row.0.clone(), row.1.clone(), row.2)).collect()
        };
        assert_eq!(untyped(&described), untyped(&real), "docs/schema.md on the left, the views on the right");
        // SQLite knows no type of a computed column, except that of a cast
        for (found, stated) in real.iter().zip(&described) {
            let kind = if found.3 == "int" { "integer" } else { &found.3 };
            assert!(kind.is_empty() || kind == stated.3, "{found:?}, {stated:?}");
        }
        for view in public_views() {
            assert!(!view.row_is.is_empty(), "what is a row of {}?", view.name);
            for column in &view.columns {
                assert!(["integer", "real", "text"].contains(&column.kind.as_str()), "{column:?}");
                assert!(!column.meaning.is_empty(), "{}: {column:?}", view.name);
                assert!(
                    column.kind != "real" || column.unit.is_some(),
                    "{}: {column:?} has no unit",
                    view.name
                );
                assert!(!column.meaning.contains(['`', '|']), "{column:?}");
            }
        }
    }

    #[tokio::test]
    async fn texts_of_another_program_are_replaced_when_the_database_is_opened_to_write() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.db");
        let store = Store::open(&path).await.expect("a store");
        for change in [
            "UPDATE view_column SET meaning = 'as an older program says' WHERE position = 1",
            "DELETE FROM view_column WHERE position = 2",
        ] {
            sqlx::query(change).execute(&store.writer).await.expect("a change");
        }
        store.close().await.expect("closed");
        let older = "SELECT count(*) FROM view_columns WHERE meaning = 'as an older program says'";
        let read = Store::open_existing(&path).await.expect("opened").expect("a database");
        let found: i64 = sqlx::query_scalar(older).fetch_one(&read.readers).await.expect("a number");
        assert!(found > 20, "{found}: reading changes nothing");
        read.close().await.expect("closed");
        let store = Store::open(&path).await.expect("a store");
        let found: i64 = sqlx::query_scalar(older).fetch_one(&store.readers).await.expect("a number");
        let columns: i64 = sqlx::query_scalar("SELECT count(*) FROM view_columns")
            .fetch_one(&store.readers)
            .await
            .expect("a number");
        let described: usize = public_views().iter().map(|view| view.columns.len()).sum();
        assert_eq!((found, columns), (0, i64::try_from(described).expect("few")));
    }
}
