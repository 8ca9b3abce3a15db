//! Causes that end a task that reads an export, and do not end the daemon.

use std::time::{Duration, SystemTime};

use super::file_schedule::LookKind;
use super::turn::Class;
use super::*;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_ingest::find::watch::FoundFile;
use armwatch_model::run::FileId;
use armwatch_store::Store;

const NAMES: [&str; 2] = ["A_20260101_0000.csv", "B_20260101_0000.csv"];

fn look(work: &mut RunningDaemon, now: Instant) {
    let found = |(inode, name)| FoundFile {
        path: PathBuf::from(name),
        size: 10,
        modified: SystemTime::UNIX_EPOCH,
        file: FileId { device: 1, inode },
        is_marked: false,
        wait: Duration::ZERO,
    };
    let files: Vec<FoundFile> = (1..).zip(NAMES).map(found).collect();
    let files: Vec<Sighting<'_>> = files.iter().map(|file| (file, LookKind::Now)).collect();
    work.schedule.note(&files, now, |path| path.display().to_string());
}

#[tokio::test]
async fn a_panic_over_one_export_leaves_its_place_and_the_daemon_at_work() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("armwatch.db")).await.unwrap();
    let pipeline = Pipeline::new(Config::shipped().unwrap().into(), store);
    let mut work = RunningDaemon::new(&pipeline, Arc::new(|| None), CancellationToken::new(), HashMap::new());
    let settle = pipeline.config().watch.settle;
    let start = Instant::now();
    look(&mut work, start);
    look(&mut work, start + settle);
    let (due, lane) = work.schedule.next_settled(&HashSet::new(), |_| true, |_| true).unwrap();
    work.exports.admit(&due, &lane, Class::Small, FileAccess::default());
    assert!(work.exports.reads_settled(&lane));
    assert_eq!(Class::ALL.map(|class| work.exports.has_place(class, 1)), [false, true]);

    let panic = tokio::spawn(async { panic!("index 7 of 3") }).await.unwrap_err();
    let way = ReadMode::Settled(lane, Class::Small);
    work.close(Closed { due, way, result: Err(panic.into()) }, &mut |_| ()).unwrap();
    assert!(!work.exports.reads_settled(NAMES[0]));
    assert_eq!(Class::ALL.map(|class| work.exports.has_place(class, 1)), [true, true]);
    let next = |work: &mut RunningDaemon, at: Duration| {
        look(work, start + at);
        let due = work.schedule.next_settled(&HashSet::new(), |_| true, |_| true);
        due.map(|(due, _)| due.path.display().to_string())
    };
    assert_eq!(next(&mut work, settle).as_deref(), Some(NAMES[1]));
    assert_eq!(next(&mut work, settle), None, "it rests");
    assert_eq!(next(&mut work, 2 * settle).as_deref(), Some(NAMES[0]));
}

#[tokio::test]
async fn a_full_disk_ends_the_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("armwatch.db")).await.unwrap();
    let pipeline = Pipeline::new(Config::shipped().unwrap().into(), store);
    let mut work = RunningDaemon::new(&pipeline, Arc::new(|| None), CancellationToken::new(), HashMap::new());
    let full = armwatch_store::StoreError::Full { path: "armwatch.db".into(), detail: "full".into() };
    assert!(work.concluded(("A".into(), Err(full.into())), &mut |_| ()).is_err());
    let busy = armwatch_store::StoreError::Busy { path: "armwatch.db".into(), detail: "locked".into() };
    assert!(work.concluded(("A".into(), Err(busy.into())), &mut |_| ()).is_ok());
    let now = Instant::now();
    assert_eq!(work.stale.next(now, |_| true), None);
    assert_eq!(work.stale.next(now + Duration::from_secs(60), |_| true).as_deref(), Some("A"));
}
