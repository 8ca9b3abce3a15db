//! `armwatch export`: contents of the files, replaced files, and the state after a failed export.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Cursor;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use jiff::Timestamp;
use jiff::civil::Date;
use polars_core::prelude::{AnyValue, ArrowDataType, ArrowField, ArrowTimeUnit, Series};
use polars_parquet::read::{
    BasicDecompressor, FileMetadata, PageReader, column_iter_to_arrays, infer_schema, read_metadata,
};

use crate::canon;
use crate::small::{self, export};
use crate::support::{Workshop, end_of, query, text, wait_until};

/// A database of robot A with two tests in January and robot B with one, created once for all tests.
static STORED: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let workshop = small::workshop();
    for (robot, day) in [("A", 5), ("A", 6), ("B", 5)] {
        workshop.add(&export(robot, day, day));
    }
    fs::write(workshop.inbox("Bad_20260101_0000.csv"), "").expect("an empty export");
    workshop.stdout(&["ingest", "inbox"], 1);
    workshop
        .stdout(&["maintenance", "A", "--what", "greased, \"all\" joints\nby hand", "--at", "2026-01-06"], 0);
    fs::read(workshop.path("armwatch.db")).expect("the database")
});

fn stored() -> Workshop {
    let workshop = small::workshop();
    fs::write(workshop.path("armwatch.db"), &*STORED).expect("a copy");
    workshop
}

/// Views of a database, each with types and units of its columns.
fn views(database: &Path) -> BTreeMap<String, Vec<[String; 2]>> {
    let rows = query(database, "SELECT view_name, type, unit FROM view_columns ORDER BY view_name, position");
    let mut views: BTreeMap<String, Vec<[String; 2]>> = BTreeMap::new();
    for row in rows {
        let [view, kind, unit] =
            row.split('|').map(str::to_owned).collect::<Vec<_>>().try_into().expect("cells");
        views.entry(view).or_default().push([kind, unit]);
    }
    views
}

/// Rows of a view in the form of SQL results, sorted.
fn in_sql(database: &Path, view: &str) -> Vec<String> {
    sorted(query(database, &format!("SELECT * FROM \"{view}\"")))
}

fn sorted(mut rows: Vec<String>) -> Vec<String> {
    rows.sort();
    rows
}

/// Names of the files in a folder, including hidden ones.
fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").file_name());
    sorted(entries.map(|name| name.to_string_lossy().into_owned()).collect())
}

#[test]
fn csv_has_every_value_of_every_view() {
    let workshop = stored();
    let told = workshop.stdout(&["export", "--csv", "out/all"], 0);
    let database = workshop.path("armwatch.db");
    let views = views(&database);
    assert!(views.len() > 30 && views.keys().eq(canon_views(&database).iter()), "{:?}", views.keys());
    let mut with_rows = 0;
    for (view, columns) in &views {
        let mut reader =
            csv::Reader::from_path(workshop.path(&format!("out/all/{view}.csv"))).expect("a file");
        let names = query(&database, &format!("SELECT name FROM pragma_table_info('{view}') ORDER BY cid"));
        assert!(reader.headers().expect("a header").iter().eq(names.iter()), "{view}");
        let shown = |cell: &str, kind: &str| match kind {
            // numbers have another text here
            "real" if !cell.is_empty() => cell.parse::<f64>().expect("a number").to_string(),
            _ => cell.to_owned(),
        };
        let row = |record: csv::StringRecord| -> String {
            record
                .iter()
                .zip(columns)
                .map(|(cell, [kind, _])| shown(cell, kind))
                .collect::<Vec<_>>()
                .join("|")
        };
        let rows: Vec<String> = reader.records().map(|record| row(record.expect("a row"))).collect();
        assert!(told.contains(&format!("out/all/{view}.csv ")), "{told}");
        with_rows += usize::from(!rows.is_empty());
        assert_eq!(sorted(rows), in_sql(&database, view), "{view}");
    }
    assert!(with_rows >= 15, "{with_rows} views have rows");
    // the declared nullability is correct
    let never = "SELECT view_name, group_concat('count(\"' || column_name || '\")', ', ') FROM view_columns
                 WHERE nullable = 0 GROUP BY view_name";
    for row in query(&database, never) {
        let (view, values) = row.split_once('|').expect("two cells");
        let counts = query(&database, &format!("SELECT count(*), {values} FROM \"{view}\"")).remove(0);
        let counts: Vec<&str> = counts.split('|').collect();
        assert!(counts.iter().all(|count| *count == counts[0]), "{view} has NULL: {counts:?} of {values}");
    }
    assert_eq!(files(&workshop.path("out/all")).len(), views.len(), "nothing else is left there");
}

/// Views including `deliveries`, which comparisons of databases omit.
fn canon_views(database: &Path) -> Vec<String> {
    let mut views = canon::views(database);
    views.push("deliveries".into());
    sorted(views)
}

#[test]
fn parquet_has_every_value_with_its_type_and_says_what_it_means() {
    let workshop = stored();
    workshop.stdout(&["export", "--parquet", "out"], 0);
    let database = workshop.path("armwatch.db");
    for (view, columns) in views(&database) {
        let file = Parquet::read(&workshop.path(&format!("out/{view}.parquet")));
        let pairs = file.metadata.key_value_metadata().as_ref().expect("metadata");
        let told = |key: &str| pairs.iter().find(|pair| pair.key == key).and_then(|pair| pair.value.clone());
        assert_eq!(told("armwatch.view").as_deref(), Some(view.as_str()));
        assert_eq!(told("armwatch.version").as_deref(), Some(env!("CARGO_PKG_VERSION")));
        let described = query(
            &database,
            &format!(
                "SELECT column_name, unit, meaning FROM view_columns WHERE view_name = '{view}' ORDER BY position"
            ),
        );
        let fields = infer_schema(&file.metadata).expect("a schema");
        let told = fields.iter_values().map(|field| {
            let metadata = field.metadata.as_ref().expect("metadata");
            let of = |key: &str| metadata.get(key).map_or("", |text| text.as_str());
            format!("{}|{}|{}", field.name, of("unit"), of("description"))
        });
        assert_eq!(told.collect::<Vec<_>>(), described, "{view}");

        let values: Vec<(&ArrowField, Series)> = fields
            .iter_values()
            .enumerate()
            .map(|(number, field)| (field, file.values(number, field)))
            .collect();
        let row = |number: usize| {
            let cells = values
                .iter()
                .zip(&columns)
                .map(|((field, values), of)| shown(&field.dtype, &values.get(number).expect("a value"), of));
            cells.collect::<Vec<_>>().join("|")
        };
        let rows = (0..file.metadata.num_rows).map(row).collect();
        assert_eq!(sorted(rows), in_sql(&database, &view), "{view}");
    }
}

/// A Parquet file.
struct Parquet {
    metadata: FileMetadata,
    bytes: Vec<u8>,
}

impl Parquet {
    fn read(path: &Path) -> Self {
        let bytes = fs::read(path).expect("a file");
        Self { metadata: read_metadata(&mut Cursor::new(&bytes)).expect("Parquet"), bytes }
    }

    /// Values of a column; times and days as numbers, since polars is built without them.
    fn values(&self, number: usize, field: &ArrowField) -> Series {
        let kind = match &field.dtype {
            ArrowDataType::Timestamp(..) => ArrowDataType::Int64,
            ArrowDataType::Date32 => ArrowDataType::Int32,
            other => other.clone(),
        };
        let field = ArrowField::new(field.name.clone(), kind, true);
        let groups = self.metadata.row_groups.iter();
        let arrays = groups.flat_map(|group| {
            let column = &group.parquet_columns()[number];
            let range = column.byte_range();
            let bytes = self.bytes[range.start as usize..range.end as usize].to_vec();
            let pages = PageReader::new(Cursor::new(bytes.into()), column, Vec::new(), usize::MAX);
            let pages = vec![BasicDecompressor::new(pages, Vec::new())];
            let kinds = vec![&column.descriptor().descriptor.primitive_type];
            column_iter_to_arrays(pages, kinds, field.clone(), None).expect("values").0
        });
        let arrays: Vec<_> = arrays.collect();
        match arrays.is_empty() {
            true => Series::default(),
            false => Series::try_from((&field, arrays)).expect("a column"),
        }
    }
}

/// A value in the form that [`query`] shows; panics if it has another type.
fn shown(kind: &ArrowDataType, value: &AnyValue<'_>, [of, unit]: &[String; 2]) -> String {
    match (of.as_str(), unit.as_str(), kind, value) {
        (_, _, _, AnyValue::Null) => String::new(),
        ("integer", _, ArrowDataType::Int64, AnyValue::Int64(number)) => number.to_string(),
        ("real", _, ArrowDataType::Float64, AnyValue::Float64(number)) => number.to_string(),
        (
            "text",
            "UTC",
            ArrowDataType::Timestamp(ArrowTimeUnit::Millisecond, Some(zone)),
            AnyValue::Int64(time),
        ) => {
            assert_eq!(zone.as_str(), "UTC");
            format!("{:.3}", Timestamp::from_millisecond(*time).expect("a time"))
        }
        ("text", "UTC day", ArrowDataType::Date32, AnyValue::Int32(days)) => {
            (Date::constant(1970, 1, 1) + jiff::Span::new().days(i64::from(*days))).to_string()
        }
        ("text", "", _, AnyValue::String(text)) => (*text).to_owned(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn robots_and_times_choose_rows() {
    let workshop = stored();
    let rows = |arguments: &[&str]| -> BTreeMap<String, u64> {
        let told = workshop.stdout(&[&["export", "--json", "--force"], arguments].concat(), 0);
        let objects = told.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"));
        objects
            .map(|of| {
                (of["view"].as_str().expect("a name").to_owned(), of["rows"].as_u64().expect("a number"))
            })
            .collect()
    };
    let number = |sql: &str| u64::try_from(workshop.number(sql)).expect("a count");
    let of_a = rows(&["--csv", "a", "--robot", "A"]);
    for view in ["runs", "cycle_parameters", "fleet_health", "maintenance_log"] {
        assert_eq!(of_a[view], number(&format!("SELECT count(*) FROM {view} WHERE robot = 'A'")), "{view}");
        assert!(of_a[view] > 0, "{view}");
    }
    let both = rows(&["--csv", "ab", "--robot", "A", "--robot", "B"]);
    assert_eq!(both["cycles"], number("SELECT count(*) FROM cycles WHERE robot IN ('A', 'B')"));

    // a test belongs to one side of a moment with all its rows, also if the moment is within it
    let parts =
        [&["--until", "2026-01-06"][..], &["--since", "2026-01-06", "--until", "2026-01-07T00:00:00Z"]];
    let [before, after] = parts.map(|times| rows(&[&["--parquet", "part"], times].concat()));
    for view in ["runs", "cycles", "cycle_rmsd", "friction_points", "maintenance_log"] {
        assert_eq!(before[view] + after[view], number(&format!("SELECT count(*) FROM {view}")), "{view}");
    }
    assert_eq!((before["maintenance_log"], after["maintenance_log"]), (0, 1));
    assert_eq!(after["runs"], number("SELECT count(*) FROM runs WHERE started_at >= '2026-01-06'"));
    assert_eq!(before["view_columns"], number("SELECT count(*) FROM view_columns"), "columns have no time");
}

/// Files below a folder, as relative paths.
fn all_files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for name in files(folder) {
        let path = folder.join(&name);
        match path.is_dir() {
            true => found.extend(all_files(&path).into_iter().map(|file| format!("{name}/{file}"))),
            false => found.push(name),
        }
    }
    found
}

#[test]
fn by_month_every_row_is_in_one_file_and_what_has_not_changed_is_left_alone() {
    let workshop = stored();
    let database = workshop.path("armwatch.db");
    let by_month = |options: &[&str]| -> BTreeMap<String, serde_json::Value> {
        let told = workshop.stdout(&[&["export", "--json", "--by-month"], options].concat(), 0);
        let objects = told.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"));
        objects.map(|of| (of["view"].as_str().expect("a name").to_owned(), of)).collect()
    };
    let first = by_month(&["--csv", "out"]);
    let out = workshop.path("out");
    for (view, columns) in views(&database) {
        let Some(robot) = first[&view]["parts"].as_object().map(|_| ()).and_then(|()| {
            let names =
                query(&database, &format!("SELECT name FROM pragma_table_info('{view}') ORDER BY cid"));
            names.iter().position(|name| name == "robot")
        }) else {
            assert!(out.join(format!("{view}.csv")).exists(), "{view}");
            continue;
        };
        let mut rows = Vec::new();
        let there = if out.join(&view).exists() { all_files(&out.join(&view)) } else { Vec::new() };
        for file in &there {
            let [of, month, name] = file.split('/').collect::<Vec<_>>().try_into().expect("two folders");
            let of = of.strip_prefix("robot=").expect("a robot").replace("__HIVE_DEFAULT_PARTITION__", "");
            assert!(["month=2026-01", "month=__HIVE_DEFAULT_PARTITION__"].contains(&month), "{file}");
            assert_eq!(name, format!("{view}.csv"));
            let mut reader = csv::Reader::from_path(out.join(&view).join(file)).expect("a file");
            for record in reader.records() {
                let record = record.expect("a row");
                let mut cells: Vec<String> = record.iter().map(str::to_owned).collect();
                cells.insert(robot, of.clone());
                for (cell, [kind, _]) in cells.iter_mut().zip(&columns) {
                    if kind == "real" && !cell.is_empty() {
                        *cell = cell.parse::<f64>().expect("a number").to_string();
                    }
                }
                rows.push(cells.join("|"));
            }
        }
        assert_eq!(sorted(rows), in_sql(&database, &view), "{view}");
    }
    let tests = ["robot=A/month=2026-01/cycles.csv", "robot=B/month=2026-01/cycles.csv"];
    assert_eq!(all_files(&out.join("cycles")), tests);

    // Parquet, again, and with one more test: only the changed month is written
    let parts = |of: &BTreeMap<String, serde_json::Value>, view: &str| {
        ["written", "unchanged", "removed"].map(|count| of[view]["parts"][count].as_u64().expect("a count"))
    };
    assert_eq!(parts(&by_month(&["--parquet", "months"]), "cycles"), [2, 0, 0]);
    assert_eq!(parts(&by_month(&["--parquet", "months"]), "cycles"), [0, 2, 0]);
    let later = export("A", 7, 7);
    workshop.add(&later);
    workshop.stdout(&["ingest", &format!("inbox/{}", later.name)], 0);
    assert_eq!(parts(&by_month(&["--parquet", "months"]), "cycles"), [1, 1, 0]);
    let file =
        |robot: &str, month: &str| workshop.path(&format!("months/cycles/robot={robot}/month={month}"));
    let counted = Parquet::read(&file("A", "2026-01").join("cycles.parquet")).metadata.num_rows;
    assert_eq!(counted as i64, workshop.number("SELECT count(*) FROM cycles WHERE robot = 'A'"));

    // a file without remaining rows is deleted, within the selected months and robots
    for robot in ["A", "B"] {
        fs::create_dir(file(robot, "2025-12")).expect("a folder");
        let from = file(robot, "2026-01").join("cycles.parquet");
        fs::copy(from, file(robot, "2025-12").join("cycles.parquet")).expect("a copy");
    }
    // a date in the middle of the month selects the whole month
    let since = ["cycles", "--parquet", "months", "--since", "2026-01-06"];
    assert_eq!(parts(&by_month(&since), "cycles"), [0, 2, 0]);
    assert_eq!(parts(&by_month(&["cycles", "--parquet", "months", "--robot", "B"]), "cycles"), [0, 1, 1]);
    assert_eq!(parts(&by_month(&["--parquet", "months"]), "cycles"), [0, 2, 1]);
    // a foreign file is not deleted
    let foreign = file("A", "2025-12").join("cycles.parquet");
    fs::write(&foreign, "notes").expect("a file");
    let refused = workshop.run(&["export", "--by-month", "--parquet", "months"]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    assert_eq!(fs::read_to_string(&foreign).expect("it is there"), "notes");
}

#[test]
fn an_empty_database_gives_files_without_rows() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop.stdout(&["export", "--csv", "out"], 0);
    workshop.stdout(&["export", "--parquet", "out"], 0);
    let header = fs::read_to_string(workshop.path("out/fleet_health.csv")).expect("a file");
    assert!(header.starts_with("robot,joint,") && header.lines().count() == 1, "{header}");
    let metadata = Parquet::read(&workshop.path("out/fleet_health.parquet")).metadata;
    assert_eq!((metadata.num_rows, metadata.schema().fields().len()), (0, header.split(',').count()));
}

#[test]
fn what_cannot_be_meant_is_said_before_anything_is_written() {
    let workshop = stored();
    let cases: [(&[&str], i32, &str); 9] = [
        (&["friction_indexes", "--csv", "out"], 2, "'friction_index'"),
        (&["--csv", "out", "--robot", "C"], 2, "there is no robot C; there are A, B"),
        (&["runs"], 2, "--csv <DIR>|--parquet <DIR>|--output <FILE>"),
        (&["runs", "--csv", "out", "--parquet", "out"], 2, "cannot be used with"),
        (&["runs", "-o", "out/runs.xlsx"], 2, "must end with .csv or .parquet"),
        (&["runs", "cycles", "-o", "out/runs.csv"], 2, "accepts one view"),
        (&["--csv", "out", "--since", "2026-02-01", "--until", "2026-01-01"], 2, "is not after"),
        (&["--csv", "out", "--since", "last week"], 2, "2026-03-01"),
        (&["--csv", "out", "--db", "typo.db"], 74, "there is no database typo.db"),
    ];
    for (arguments, code, words) in cases {
        let said = workshop.stderr(&[&["export"], arguments].concat(), code);
        assert!(said.contains(words), "{arguments:?}: {said}");
        assert!(!workshop.path("out").exists() && !workshop.path("typo.db").exists(), "{arguments:?}");
    }
}

#[test]
fn only_exports_of_the_same_view_are_replaced() {
    let workshop = stored();
    fs::create_dir(workshop.path("out")).expect("a folder");
    let notes = workshop.path("out/runs.csv");
    fs::write(&notes, "run_id,robot,what I think of it\n").expect("a file of somebody");
    for arguments in [&["export", "--csv", "out"][..], &["export", "runs", "-o", "out/runs.csv"]] {
        let said = workshop.stderr(arguments, 2);
        assert!(said.contains("out/runs.csv exists and is not an export of the view runs"), "{said}");
        assert_eq!(files(&workshop.path("out")), ["runs.csv"], "nothing else is written");
    }
    assert!(fs::read_to_string(&notes).expect("the file").contains("what I think"));
    workshop.stdout(&["export", "runs", "-o", "out/runs.csv", "--force"], 0);
    let export = fs::read(&notes).expect("the file");
    workshop.stdout(&["export", "runs", "--csv", "out"], 0);
    assert_eq!(fs::read(&notes).expect("the file"), export, "the same rows are the same bytes");

    workshop.stdout(&["export", "runs", "-o", "out/of_a.parquet", "--robot", "A"], 0);
    workshop.stdout(&["export", "runs", "-o", "out/of_a.parquet"], 0);
    let refused = workshop.run(&["export", "cycles", "-o", "out/of_a.parquet"]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    // a copy for readers has the content of the database
    workshop.stdout(&["snapshot", "copy.db"], 0);
    workshop.stdout(&["export", "--csv", "of_copy", "--db", "copy.db"], 0);
    assert_eq!(fs::read(workshop.path("of_copy/runs.csv")).expect("the file"), export);
}

#[test]
fn what_cannot_be_written_is_named() {
    let workshop = stored();
    fs::write(workshop.path("taken"), "a file").expect("a file");
    // a full device, like a full disk
    for name in ["full.csv", "full.parquet"] {
        symlink("/dev/full", workshop.path(name)).expect("a link");
    }
    fs::create_dir_all(workshop.path("there/runs.csv")).expect("a folder");
    let cases: [(&[&str], &str); 4] = [
        (&["--csv", "taken/out"], "taken/out/runs.csv: Not a directory"),
        (&["cycle_parameters", "-o", "full.csv"], "full.csv: No space left on device"),
        (&["cycle_parameters", "-o", "full.parquet"], "full.parquet: No space left on device"),
        (&["--csv", "there"], "there/runs.csv: it is a folder"),
    ];
    for (arguments, words) in cases {
        let said = workshop.stderr(&[&["export"], arguments].concat(), 74);
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
    assert_eq!(files(&workshop.path("there")), ["runs.csv"]);
}

/// Creates a pipe; an export blocks on it until it has a reader.
fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo runs");
    assert!(made.success());
}

#[test]
fn a_killed_export_leaves_no_half_file() {
    let workshop = stored();
    let out = workshop.path("out");
    workshop.stdout(&["export", "--parquet", "out", "--robot", "A"], 0);
    let earlier = fs::read(out.join("cycles.parquet")).expect("a file");
    // the last view waits for a reader
    fs::remove_file(out.join("view_columns.parquet")).expect("removed");
    pipe(&out.join("view_columns.parquet"));
    let mut command = workshop.command(&["export", "--parquet", "out"]);
    let mut half = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    let last = out.join(".reestimated_statistics.parquet.partial");
    let whole = |path: &Path| {
        let file = File::open(path).ok();
        file.is_some_and(|mut file| read_metadata(&mut file).is_ok())
    };
    wait_until(|| whole(&last) || half.try_wait().expect("a child").is_some(), || "no half export".into());
    let other = workshop.stderr(&["export", "runs", "--parquet", "out"], 74);
    assert!(other.contains("out/runs.parquet is being written by another export"));
    half.kill().expect("killed");
    half.wait().expect("an end");

    let is_partial = |name: &String| name.starts_with('.');
    assert!(files(&out).iter().filter(|name| is_partial(name)).count() > 20, "{:?}", files(&out));
    assert!(fs::read(out.join("cycles.parquet")).expect("a file") == earlier, "the earlier file stays");
    fs::remove_file(out.join("view_columns.parquet")).expect("removed");
    workshop.stdout(&["export", "--parquet", "out"], 0);
    assert!(!files(&out).iter().any(is_partial), "{:?}", files(&out));
    assert!(fs::read(out.join("cycles.parquet")).expect("a file") != earlier);
}

#[test]
fn all_files_are_of_one_moment() {
    let workshop = stored();
    let out = workshop.path("out");
    fs::create_dir(&out).expect("a folder");
    pipe(&out.join("cycles.csv"));
    let before = workshop.number("SELECT count(*) FROM cycle_parameters");
    let mut command = workshop.command(&["export", "--csv", "out"]);
    let mut running = command.stdout(Stdio::null()).spawn().expect("it starts");
    wait_until(
        || out.join(".runs.csv.partial").exists() || running.try_wait().expect("a child").is_some(),
        || "the export does not begin".into(),
    );
    let later = export("A", 7, 7);
    workshop.add(&later);
    workshop.stdout(&["ingest", &format!("inbox/{}", later.name)], 0);
    let reader = std::thread::spawn({
        let pipe = out.join("cycles.csv");
        move || fs::read_to_string(pipe)
    });
    // the reader would wait forever for a failed export
    assert_eq!(end_of(&mut running, || "the export does not end".into()), Some(0));
    wait_until(|| reader.is_finished(), || "the export did not write into the pipe".into());
    let cycles = reader.join().expect("no panic").expect("what comes through the pipe");
    let rows =
        |name: &str| csv::Reader::from_path(out.join(name)).expect("a file").into_records().count() as i64;
    assert!(!cycles.contains("2026-01-07"), "{cycles}");
    assert_eq!(rows("cycle_parameters.csv"), before);
    assert!(workshop.number("SELECT count(*) FROM cycle_parameters") > before, "the test is stored");
}

#[test]
fn the_schema_is_told_without_a_database() {
    let workshop = Workshop::new();
    let views = workshop.stdout(&["sql", "--schema"], 0);
    assert!(views.lines().any(|line| line.starts_with("fleet_health  ")), "{views}");
    let index = workshop.stdout(&["sql", "--schema", "friction_index"], 0);
    assert!(
        index.starts_with("friction_index: a row is ") && index.contains("friction_index_std_error"),
        "{index}"
    );
    assert!(index.lines().all(|line| line.chars().count() <= 110), "{index}");
    let unknown = workshop.stderr(&["sql", "--schema", "friction_indices"], 2);
    assert!(unknown.contains("'friction_index'"), "{unknown}");
    assert!(!workshop.path("armwatch.db").exists());

    workshop.stdout(&["ingest", "inbox"], 0);
    let told = workshop.stdout(&["sql", "--schema", "cycles", "--csv"], 0);
    let stored = "SELECT * FROM view_columns WHERE view_name = 'cycles' ORDER BY position";
    assert_eq!(told, workshop.stdout(&["sql", stored, "--csv"], 0));
}
