//! Copies of a database beside it.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, SystemTime};

use sqlx::ConnectOptions;
use sqlx::sqlite::SqliteConnectOptions;

use super::support::*;

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
    let (_folder, store) = fresh().await;
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
    let (_folder, store) = fresh().await;
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
    let left = ["copy.db", "copy.db.8-1790.partial", "copy.db.notes.partial", "other.db.7-1789.partial"];
    assert_eq!(files(folder.path()), left);
}
