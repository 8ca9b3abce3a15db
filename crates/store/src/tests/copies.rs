//! Copies of a database next to it.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, SystemTime};

use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

use super::support::*;
use crate::error::StoreError;
use crate::handle::Store;

fn files(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        names.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

async fn is_whole(copy: &Path) -> bool {
    let options = SqliteConnectOptions::new().filename(copy).read_only(true);
    let mut copy = options.connect().await.expect("a database");
    let found: String =
        sqlx::query_scalar("PRAGMA integrity_check").fetch_one(&mut copy).await.expect("a check");
    let runs: i64 =
        sqlx::query_scalar("SELECT count(*) FROM run").fetch_one(&mut copy).await.expect("a count");
    found == "ok" && runs == 40
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn copies_to_one_file_at_once_are_each_whole() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 40, cycles: 4, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let folder = tempfile::tempdir().expect("a folder");
    let [backup, snapshot] = ["backup.db", "snapshot.db"].map(|name| folder.path().join(name));
    let mut tasks = Vec::new();
    for _ in 0..6 {
        let (of_backup, target) = (store.clone(), backup.clone());
        tasks.push(tokio::spawn(async move { of_backup.backup(&target).await.map(|done| done.bytes) }));
        let (of_snapshot, target) = (store.clone(), snapshot.clone());
        tasks.push(tokio::spawn(async move { of_snapshot.snapshot(&target).await }));
    }
    for task in tasks {
        assert!(task.await.expect("no panic").expect("a copy") > 0);
        for copy in [&backup, &snapshot] {
            assert!(!copy.exists() || is_whole(copy).await, "{}", copy.display());
        }
    }
    assert_eq!(files(folder.path()), ["backup.db", "snapshot.db"]);
}

#[tokio::test]
async fn what_a_writer_that_ended_has_left_goes_after_a_day() {
    let (_folder, store) = fresh_file().await;
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join("copy.db");
    let two_days_ago = SystemTime::now() - Duration::from_secs(2 * 86_400);
    for name in
        ["copy.db.7-1789.partial", "copy.db.partial", "other.db.7-1789.partial", "copy.db.notes.partial"]
    {
        let file = File::create(folder.path().join(name)).expect("a file");
        file.set_modified(two_days_ago).expect("a time");
    }
    File::create(folder.path().join("copy.db.8-1790.partial")).expect("a file that is being written");
    store.backup(&target).await.expect("a copy");
    assert_eq!(files(folder.path()), ["copy.db", "copy.db.8-1790.partial", "copy.db.notes.partial"]);
}

/// A damaged page is found at any place, and the earlier backup stays.
#[tokio::test]
async fn a_backup_of_a_damaged_database_is_refused() {
    const PAGE: usize = 4096;
    let (source, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 40, cycles: 4, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let folder = tempfile::tempdir().expect("a folder");
    let target = folder.path().join("backup.db");
    store.backup(&target).await.expect("a backup");
    let good = std::fs::read(&target).expect("the backup");
    store.close().await.expect("closed");
    let sound = std::fs::read(source.path().join("fleet.db")).expect("the database");
    let pages = sound.len() / PAGE;
    assert!(pages > 100, "{pages}");
    for place in 0..24 {
        let page = 3 + place * (pages - 3) / 24;
        let mut bytes = sound.clone();
        bytes[page * PAGE..(page + 1) * PAGE].fill(0xff);
        let database = folder.path().join(format!("{page}.db"));
        std::fs::write(&database, bytes).expect("the damaged database");
        let opened = Store::open_any_schema(&database, &armwatch_config::ClusterSettings::default()).await;
        let error = match opened {
            Ok(store) => store.expect("a database").backup(&target).await.expect_err("a refusal"),
            Err(error) => error,
        };
        assert!(matches!(error, StoreError::Corrupt { .. }), "page {page}: {error:?}");
        assert!(std::fs::read(&target).expect("the backup") == good, "page {page}");
    }
}

/// The copy has the content of the database at one moment, despite concurrent writes.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_beside_a_writer_is_compared_with_the_moment_of_its_making() {
    let (folder, store) = fresh_file().await;
    let writer = store.clone();
    let writing = tokio::spawn(async move {
        for number in 0.. {
            if writer.begin_run(&header(&format!("R{number}"), 0)).await.is_err() {
                break;
            }
        }
    });
    for _ in 0..5 {
        store.backup(&folder.path().join("backup.db")).await.expect("a backup");
    }
    writing.abort();
}

/// A database of an earlier version is copied without a change, and copied once more before its schema is changed.
#[tokio::test]
async fn a_database_of_an_earlier_schema_is_copied_as_it_is() {
    const OLD: i64 = 46;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    super::upgrade::make_schema(&path, OLD);
    let before = std::fs::read(&path).expect("the database");
    let cluster = armwatch_config::ClusterSettings::default();
    let any = Store::open_any_schema(&path, &cluster).await.expect("opened").expect("a database");
    let backup = folder.path().join("backup.db");
    let done = any.backup(&backup).await.expect("a backup");
    assert!(done.rows.iter().any(|(table, rows)| table == "run" && *rows == 4), "{done:?}");
    any.close().await.expect("closed");
    assert!(std::fs::read(&path).expect("the database") == before, "it was changed");
    assert!(matches!(Store::open_existing(&backup).await, Err(StoreError::Older { found: OLD, .. })));

    // an earlier upgrade left a copy, and a user left a file that looks like one
    std::fs::copy(&backup, folder.path().join("fleet.db.schema-45")).expect("a copy");
    std::fs::write(folder.path().join("fleet.db.schema-44"), "notes").expect("a file");
    let store = Store::open(&path).await.expect("brought up to date");
    assert_eq!(store.runs().await.expect("runs").len(), 4);
    let copy = folder.path().join("fleet.db.schema-46");
    assert!(matches!(Store::open_existing(&copy).await, Err(StoreError::Older { found: OLD, .. })));
    store.close().await.expect("closed");
    assert_eq!(files(folder.path()), ["backup.db", "fleet.db", "fleet.db.schema-44", "fleet.db.schema-46"]);
}

/// A damaged database is not changed by a new version.
#[tokio::test]
async fn the_schema_of_a_damaged_database_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    super::upgrade::make_schema(&path, 46);
    let asked = async |question: &'static str| -> i64 {
        let mut connection = SqliteConnectOptions::new().filename(&path).connect().await.expect("opened");
        sqlx::query_scalar(question).fetch_one(&mut connection).await.expect("a number")
    };
    let page = asked("SELECT rootpage FROM sqlite_schema WHERE name = 'cycle'").await;
    let begin = 4096 * (usize::try_from(page).expect("a page") - 1);
    let mut bytes = std::fs::read(&path).expect("the database");
    bytes[begin..begin + 4096].fill(0xff);
    std::fs::write(&path, &bytes).expect("the damaged database");
    let error = Store::open(&path).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Corrupt { .. }), "{error:?}");
    assert_eq!(asked("SELECT max(version) FROM _sqlx_migrations").await, 46);
}
