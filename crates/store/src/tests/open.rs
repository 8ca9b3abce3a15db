//! Opening, refusing, waiting and failing.

use std::path::Path;
use std::time::Duration;

use sqlx::{ConnectOptions, Connection, Executor, SqliteConnection, sqlite::SqliteConnectOptions};

use super::support::*;
use crate::error::StoreError;
use crate::handle::Store;
use crate::open::open;
use crate::verified_copy::APPLICATION_ID;
use armwatch_testing::er3a;

pub(super) async fn plain(path: &Path) -> SqliteConnection {
    SqliteConnectOptions::new().filename(path).create_if_missing(true).connect().await.expect("a connection")
}

#[tokio::test]
async fn sqlite_has_the_fix_for_resets_of_the_log() {
    let (_folder, store) = fresh_file().await;
    let version = text(&store, "SELECT sqlite_version()").await.expect("a version");
    let numbers: Vec<u32> = version.split('.').map(|n| n.parse().expect("a number")).collect();
    assert!(numbers >= vec![3, 51, 3], "{version}");
}

#[tokio::test]
async fn folders_are_made_and_connections_behave_as_stated() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a/b/fleet.db");
    let store = Store::open(&path).await.expect("a store");
    assert_eq!(text(&store, "PRAGMA journal_mode").await.as_deref(), Some("wal"));
    for (pragma, expected) in [
        ("PRAGMA foreign_keys", 1),
        ("PRAGMA synchronous", 1),
        ("PRAGMA busy_timeout", 10_000),
        ("PRAGMA application_id", APPLICATION_ID),
    ] {
        let found: i64 = sqlx::query_scalar(pragma).fetch_one(&store.writer).await.expect("a value");
        assert_eq!(found, expected, "{pragma}");
    }
    let write = sqlx::query("INSERT INTO robot (name) VALUES ('x')").execute(&store.readers).await;
    assert!(write.is_err(), "a reader wrote");
    store.close().await.expect("closed");
    assert!(path.exists() && !path.with_extension("db-wal").exists());
}

#[tokio::test]
async fn the_database_answers_while_all_readers_are_busy_and_not_once_it_is_closed() {
    let (_folder, store) = fresh_file().await;
    let mut busy = Vec::new();
    while let Some(reader) = store.readers.try_acquire() {
        busy.push(reader);
    }
    for _ in busy.len()..4 {
        busy.push(store.readers.acquire().await.expect("a reader"));
    }
    tokio::time::timeout(Duration::from_secs(1), store.probe()).await.expect("at once").expect("an answer");
    drop(busy);
    store.clone().close().await.expect("closed");
    assert!(store.probe().await.is_err());
}

#[tokio::test]
async fn a_database_opened_again_holds_what_was_committed() {
    let (folder, store) = fresh_file().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let before = dump(&store).await;
    store.close().await.expect("closed");
    let store = Store::open(&folder.path().join("fleet.db")).await.expect("the same store");
    assert_eq!(dump(&store).await, before);
    assert!(store.record_cycle(run_id, &cycle(3), &er3a()).await.expect("a cycle"));
}

/// After a disk failure inside a transaction, SQLite has ended the transaction, but the driver counts it as open.
#[tokio::test]
async fn a_transaction_that_sqlite_ended_by_itself_does_not_block_the_next() {
    let (_folder, store) = fresh_file().await;
    let mut lost = store.begin().await.expect("a transaction");
    sqlx::raw_sql("ROLLBACK").execute(&mut *lost).await.expect("ended");
    drop(lost);
    streaming_run(&store, "R00", 0, 1).await;
    assert_eq!(number(&store, "SELECT count(*) + 0.0 FROM cycles").await, Some(1.0));
}

#[tokio::test]
async fn an_empty_file_becomes_a_database() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("empty.db");
    std::fs::write(&path, b"").expect("a file");
    let store = Store::open(&path).await.expect("a store");
    assert_eq!(store.counts().await.expect("counts"), crate::views::StoredCounts::default());
}

#[tokio::test]
async fn a_newer_schema_is_refused() {
    let (folder, store) = fresh_file().await;
    let later = sqlx::query("UPDATE schema_version SET version = 9001").execute(&store.writer).await;
    later.expect("a later version");
    store.close().await.expect("closed");
    let error = Store::open(&folder.path().join("fleet.db")).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Newer { found: 9001, .. }) && error.is_fatal(), "{error}");
    assert!(error.to_string().contains("use the newer program"), "{error}");
}

#[tokio::test]
async fn a_file_of_anything_else_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    // Multiplying by an odd number and taking the high byte: bytes without a pattern.
    let noise: Vec<u8> = (1..=9000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for (name, bytes) in [("noise.db", noise), ("export.csv", b"time,pos_1\n0,1\n".repeat(400))] {
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).expect("a file");
        let error = Store::open(&path).await.expect_err("a refusal");
        assert!(matches!(error, StoreError::NotADatabase { .. }) && error.is_fatal(), "{error}");
        assert!(
            error.to_string().contains(name) && error.to_string().contains("name another file"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).expect("the file"), bytes);
    }
}

#[tokio::test]
async fn the_database_of_another_program_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bookmarks.db");
    let mut other = plain(&path).await;
    other.execute("CREATE TABLE bookmark (url TEXT)").await.expect("a table");
    other.close().await.expect("closed");
    let bytes = std::fs::read(&path).expect("the file");
    let error = Store::open(&path).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::NotADatabase { .. }), "{error}");
    assert_eq!(std::fs::read(&path).expect("the file"), bytes);
}

#[tokio::test]
async fn a_damaged_database_is_said_to_be_damaged() {
    let (folder, store) = fresh_file().await;
    streaming_run(&store, "R00", 0, 2).await;
    store.close().await.expect("closed");
    let path = folder.path().join("fleet.db");
    let mut bytes = std::fs::read(&path).expect("the file");
    // The first page, with the header and the schema's root, stays.
    bytes[4096..].fill(0xA5);
    std::fs::write(&path, bytes).expect("the damaged file");
    let error = Store::open(&path).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Corrupt { .. }) && error.is_fatal(), "{error}");
}

#[tokio::test]
async fn places_that_cannot_hold_a_database_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("file");
    std::fs::write(&file, b"x").expect("a file");
    let mut places = vec![file.join("fleet.db")];
    if cfg!(target_os = "linux") {
        // Not even a privileged user may create a file there.
        places.push("/proc/fleet.db".into());
    }
    for place in places {
        let error = Store::open(&place).await.expect_err("a refusal");
        assert!(matches!(error, StoreError::NotWritable { .. }) && error.is_fatal(), "{error:?}");
        assert!(error.to_string().contains(&place.display().to_string()), "{error}");
    }
}

#[tokio::test]
async fn a_folder_is_told_from_a_database() {
    let folder = tempfile::tempdir().expect("a folder");
    let to_write = Store::open(folder.path()).await.expect_err("a refusal");
    let to_read = Store::open_existing(folder.path()).await.expect_err("a refusal");
    for error in [to_write, to_read] {
        assert!(matches!(error, StoreError::Folder { .. }) && error.is_fatal(), "{error:?}");
        let file = folder.path().join("armwatch.db");
        assert!(error.to_string().contains(&format!("such as {}", file.display())), "{error}");
    }
}

#[tokio::test]
async fn a_database_that_may_not_be_written_says_so() {
    let (_folder, store) = fresh_file().await;
    sqlx::query("PRAGMA query_only = ON").execute(&store.writer).await.expect("a setting");
    let error = store.begin_run(&header("R00", 0)).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::NotWritable { .. }), "{error}");
}

#[tokio::test]
async fn a_full_disk_is_fatal_and_loses_nothing_that_was_committed() {
    let (folder, store) = fresh_file().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let before = dump(&store).await;
    // SQLite returns "full" both for the disk and for this limit, which it reduces to the present size.
    sqlx::query("PRAGMA max_page_count = 1").execute(&store.writer).await.expect("a limit");
    let mut error = None;
    for number in 2..10 {
        error = store.record_cycle(run_id, &cycle(number), &er3a()).await.err();
        if error.is_some() {
            break;
        }
    }
    let error = error.expect("the limit is reached");
    assert!(matches!(error, StoreError::Full { .. }) && error.is_fatal(), "{error}");
    assert!(error.to_string().contains("free space"), "{error}");
    let store = Store::open(&folder.path().join("fleet.db")).await.expect("the store");
    let after = dump(&store).await;
    assert!(before.iter().filter(|row| !row.starts_with("runs:")).all(|row| after.contains(row)));
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_second_writer_waits_for_the_first() {
    let (folder, first) = fresh_file().await;
    let second = Store::open(&folder.path().join("fleet.db")).await.expect("a second store");
    let run_id = streaming_run(&first, "R00", 0, 1).await;
    let mut end = first.finish_run(run_id).await.expect("the lock");
    end.complete(totals(1)).await.expect("completion");
    let mut waiting = tokio::spawn(async move { second.begin_run(&header("R01", 0)).await });
    let early = tokio::time::timeout(Duration::from_millis(200), &mut waiting).await;
    assert!(early.is_err(), "the second writer did not wait: {early:?}");
    end.commit().await.expect("a commit");
    waiting.await.expect("no panic").expect("a run");
    assert_eq!(first.runs().await.expect("runs").len(), 2);
}

#[tokio::test]
async fn a_lock_that_stays_is_busy_and_not_fatal() {
    let (folder, first) = fresh_file().await;
    let run_id = streaming_run(&first, "R00", 0, 1).await;
    let second =
        open(&folder.path().join("fleet.db"), Duration::from_millis(50)).await.expect("a second store");
    let end = first.finish_run(run_id).await.expect("the lock");
    let error = second.begin_run(&header("R01", 0)).await.expect_err("locked out");
    assert!(matches!(error, StoreError::Busy { .. }) && !error.is_fatal(), "{error}");
    assert!(second.lookup(&header("R00", 0).content_hash).await.expect("readers do not wait").is_some());
    drop(end);
    second.begin_run(&header("R01", 0)).await.expect("the lock is free");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn programs_that_start_together_on_a_new_file_all_come_up() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    let starts: Vec<_> = (0..4)
        .map(|_| {
            let path = path.clone();
            tokio::spawn(async move { Store::open(&path).await })
        })
        .collect();
    for start in starts {
        start.await.expect("no panic").expect("a store");
    }
}

/// Changes to the files of an open database, and the resulting errors.
#[tokio::test]
async fn nothing_is_stored_once_the_open_file_is_not_at_its_path() {
    type Change = fn(&Path);
    let beside = |end: &str| format!("fleet.db{end}");
    let ways: [(&str, Change); 7] = [
        ("deleted", |data| std::fs::remove_file(data.join("fleet.db")).unwrap()),
        ("replaced", |data| std::fs::rename(data.join("other.db"), data.join("fleet.db")).unwrap()),
        ("folder renamed", |data| {
            std::fs::rename(std::fs::canonicalize(data).unwrap(), data.with_file_name("gone")).unwrap();
        }),
        ("link elsewhere", |data| {
            std::fs::remove_file(data).unwrap();
            std::os::unix::fs::symlink(data.with_file_name("elsewhere"), data).unwrap();
        }),
        ("log deleted", |data| std::fs::remove_file(data.join("fleet.db-wal")).unwrap()),
        ("log replaced", |data| {
            std::fs::copy(data.join("fleet.db-wal"), data.join("new")).unwrap();
            std::fs::rename(data.join("new"), data.join("fleet.db-wal")).unwrap();
        }),
        ("index deleted", |data| std::fs::remove_file(data.join("fleet.db-shm")).unwrap()),
    ];
    for (way, change) in ways {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::create_dir(&real).unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let store = Store::open(&link.join("fleet.db")).await.unwrap();
        streaming_run(&store, "R00", 0, 1).await;
        store.sync().await.unwrap();
        for end in ["", "-wal", "-shm"] {
            assert!(real.join(beside(end)).exists(), "{way}: {end}");
        }
        std::fs::create_dir(folder.path().join("elsewhere")).unwrap();
        for other in [real.join("other.db"), folder.path().join("elsewhere/fleet.db")] {
            Store::open(&other).await.unwrap().close().await.unwrap();
        }
        change(&link);
        let displaced = |error: StoreError| {
            let said = error.to_string();
            assert!(matches!(error, StoreError::Displaced { .. }) && error.is_fatal(), "{way}: {said}");
            assert!(said.contains("nothing more is stored") && said.contains("start again"), "{way}: {said}");
        };
        displaced(store.begin_run(&header("R01", 0)).await.unwrap_err());
        // sync fails, so that exports to be deleted after a sync stay
        let synced = store.sync().await.unwrap_err();
        assert!(
            matches!(synced, StoreError::Displaced { .. } | StoreError::NotWritable { .. }),
            "{way}: {synced}"
        );
        displaced(store.probe().await.unwrap_err());
        displaced(store.check_files().unwrap_err());
        displaced(store.backup(&folder.path().join("backup.db")).await.unwrap_err());
        displaced(store.snapshot(&folder.path().join("snapshot.db")).await.unwrap_err());
        displaced(store.close().await.unwrap_err());
    }
}

/// A log next to a database that has replaced its own.
#[tokio::test]
async fn a_log_that_belongs_to_another_database_is_named_and_a_database_keeps_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet.db");
    let at = |name: &str| folder.path().join(name);
    let copy = |from: &str, to: &str| std::fs::copy(at(from), at(to)).map(drop).unwrap();
    let store = Store::open(&path).await.unwrap();
    streaming_run(&store, "R00", 0, 1).await;
    store.backup(&at("backup.db")).await.unwrap();
    store.close().await.unwrap();
    copy("fleet.db", "earlier.db");
    for robot in ["R01", "R02"] {
        let store = Store::open(&path).await.unwrap();
        streaming_run(&store, robot, 0, 1).await;
        store.close().await.unwrap();
    }
    let store = Store::open(&path).await.unwrap();
    streaming_run(&store, "R03", 0, 1).await;
    // as a kill leaves them
    copy("fleet.db", "killed.db");
    copy("fleet.db-wal", "killed.db-wal");
    for restored in ["backup", "earlier"] {
        copy(&format!("{restored}.db"), &format!("{restored}-2.db"));
        copy("fleet.db-wal", &format!("{restored}-2.db-wal"));
        let database = at(&format!("{restored}-2.db"));
        let bytes = std::fs::read(&database).unwrap();
        let errors = [
            Store::open(&database).await.map(drop).unwrap_err(),
            Store::open_existing(&database).await.map(drop).unwrap_err(),
        ];
        for error in errors {
            let said = error.to_string();
            assert!(matches!(error, StoreError::ForeignLog { .. }), "{restored}: {said}");
            let named = format!("{restored}-2.db-wal belongs to another database");
            assert!(said.contains(&named) && said.contains("delete it"), "{said}");
        }
        assert!(std::fs::read(&database).unwrap() == bytes, "{restored}: it was changed");
        // as the message advises
        std::fs::remove_file(at(&format!("{restored}-2.db-wal"))).unwrap();
        assert_sound(&Store::open(&database).await.unwrap()).await;
    }
    let killed = Store::open(&at("killed.db")).await.unwrap();
    assert_eq!(killed.runs().await.unwrap().len(), 4);
    assert_sound(&killed).await;
    // two handles in use, with commits between
    let second = Store::open(&path).await.unwrap();
    streaming_run(&second, "R04", 0, 1).await;
    streaming_run(&store, "R05", 0, 1).await;
    assert_eq!(Store::open_existing(&path).await.unwrap().unwrap().runs().await.unwrap().len(), 6);
}

/// A log that is cut at any place still belongs to its database.
#[tokio::test]
async fn a_torn_log_is_not_taken_for_that_of_another_database() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let store = Store::open(&at("fleet.db")).await.unwrap();
    for run in 0..3 {
        streaming_run(&store, &format!("R{run}"), 0, 1).await;
    }
    let log = std::fs::read(at("fleet.db-wal")).unwrap();
    for (number, length) in (0..=log.len()).step_by(log.len() / 12).enumerate() {
        let name = format!("torn-{number}.db");
        std::fs::copy(at("fleet.db"), at(&name)).unwrap();
        let mut torn = log.clone();
        torn[length..].fill(0);
        std::fs::write(at(&format!("{name}-wal")), torn).unwrap();
        let opened = Store::open(&at(&name)).await;
        assert!(!matches!(opened, Err(StoreError::ForeignLog { .. })), "{length} of {}", log.len());
    }
}

mod claims {
    use std::fs::{File, Permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt};

    use nix::fcntl::{FcntlArg, fcntl};
    use nix::libc;

    use super::*;
    use crate::claim::{DaemonState, lock_file_of};

    /// One lock, whatever name the file has.
    #[tokio::test]
    async fn a_database_has_one_daemon_under_all_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.db");
        let store = Store::open(&path).await.unwrap();
        let lock = lock_file_of(&path);
        // as an earlier version created it
        std::fs::write(&lock, "1\n").unwrap();
        std::fs::set_permissions(&lock, Permissions::from_mode(0o644)).unwrap();
        assert!(!store.has_daemon().await.unwrap());
        let claim = store.claim().await.unwrap();
        assert_eq!(std::fs::metadata(&lock).unwrap().mode() & 0o777, 0o600);
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        std::os::unix::fs::symlink(&path, folder.path().join("sub/link.db")).unwrap();
        for name in ["fleet.db", "sub/link.db", "sub/../fleet.db"] {
            let claimed = crate::claim::claim(&folder.path().join(name));
            assert!(matches!(claimed, Err(StoreError::Claimed { .. })), "{name}: {claimed:?}");
        }
        assert!(store.has_daemon().await.unwrap());
        assert_eq!(store.daemon().await.unwrap(), DaemonState::AtWork);
        let since = std::time::SystemTime::now() - std::time::Duration::from_secs(600);
        File::options().write(true).open(&lock).unwrap().set_modified(since).unwrap();
        let silent = DaemonState::SilentSince(since.try_into().unwrap());
        assert_eq!(store.daemon().await.unwrap(), silent);
        claim.beat();
        assert_eq!(store.daemon().await.unwrap(), DaemonState::AtWork);
        drop(claim);
        assert_eq!(store.daemon().await.unwrap(), DaemonState::Absent);
        assert!(!store.has_daemon().await.unwrap());
        store.claim().await.unwrap();
    }

    /// A user who may only read the database can lock a byte of it for reading, and the daemon still starts.
    #[tokio::test]
    async fn a_reader_cannot_keep_a_daemon_from_its_database() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.db");
        let store = Store::open(&path).await.unwrap();
        let reader = File::open(&path).unwrap();
        let whole = libc::flock {
            l_type: i16::try_from(libc::F_RDLCK).unwrap(),
            l_whence: i16::try_from(libc::SEEK_SET).unwrap(),
            l_start: (1 << 30) + 512,
            l_len: 0,
            l_pid: 0,
        };
        fcntl(&reader, FcntlArg::F_OFD_SETLK(&whole)).unwrap();
        reader.lock().unwrap();
        assert!(!store.has_daemon().await.unwrap());
        store.claim().await.unwrap();
    }

    #[tokio::test]
    async fn a_lock_file_that_cannot_be_opened_is_named_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.db");
        let store = Store::open(&path).await.unwrap();
        // a link must not lead a daemon of root elsewhere
        std::fs::write(folder.path().join("passwd"), "of the system").unwrap();
        std::os::unix::fs::symlink(folder.path().join("passwd"), lock_file_of(&path)).unwrap();
        let error = store.claim().await.unwrap_err();
        let said = error.to_string();
        assert!(matches!(error, StoreError::LockFile { .. }) && error.is_fatal(), "{said}");
        assert!(said.contains("fleet.db.daemon") && said.contains("chown"), "{said}");
        assert_eq!(std::fs::read_to_string(folder.path().join("passwd")).unwrap(), "of the system");
    }
}
