use super::*;

const CLIENT: &str = "token of cell 3";

fn spool(folder: &Path) -> Spool {
    let spool = Spool::new(folder, Reserve::new(folder, None, Some(0)), 2 * MOST_PARTIALS);
    spool.prepare().unwrap();
    spool
}

fn claim(spool: &Spool, name: &str, client: &str) -> Claim {
    spool.claim(name, None, client).unwrap().unwrap()
}

/// Adds bytes to an upload.
fn send(spool: &Spool, name: &str, client: &str, bytes: &[u8]) -> Claim {
    let mut claim = claim(spool, name, client);
    claim.begin(false, None).unwrap();
    claim.open(false).unwrap().append(bytes).unwrap();
    claim
}

fn count(spool: &Spool) -> usize {
    spool.partials().unwrap().len()
}

#[test]
fn an_upload_is_gone_on_with_and_renamed_in() {
    let folder = tempfile::tempdir().unwrap();
    let first = spool(&folder.path().join("spool"));
    assert_eq!(first.offset("A.csv", None).unwrap(), None);
    let mut claim = claim(&first, "A.csv", CLIENT);
    assert_eq!(first.claim("A.csv", None, CLIENT).unwrap().unwrap_err(), Busy::Upload, "one at a time");
    assert!(first.claim("B.csv", None, CLIENT).unwrap().is_ok());
    claim.begin(true, Some(11)).unwrap();
    claim.open(true).unwrap().append(b"time,").unwrap();
    drop(claim);
    // after a restart, by another client
    let spool = spool(&folder.path().join("spool"));
    assert_eq!(spool.offset("A.csv", None).unwrap(), Some((5, false)));
    assert_eq!(spool.offset("A.csv", Some(&of_bytes(b"x"))).unwrap(), None, "another content");
    let mut claim = spool.claim("A.csv", None, "").unwrap().unwrap();
    assert_eq!((claim.length().unwrap(), claim.total()), (5, Some(11)));
    claim.begin(false, Some(11)).unwrap();
    claim.open(false).unwrap().append(b"pos_1\n").unwrap();
    assert_eq!(claim.content().unwrap(), (of_bytes(b"time,pos_1\n"), 11));
    spool.put(&claim, "A.csv").unwrap();
    assert_eq!(fs::read(spool.place("A.csv")).unwrap(), b"time,pos_1\n");
    assert_eq!(spool.offset("A.csv", None).unwrap(), Some((11, true)));
    assert_eq!(count(&spool), 0);
}

#[test]
fn the_total_is_that_of_the_first_request_that_says_it() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    let begun = |from_start, total| {
        let mut claim = claim(&spool, "A.csv", CLIENT);
        let before = claim.total();
        claim.begin(from_start, total).unwrap();
        claim.open(from_start).unwrap();
        (before, claim.total(), count(&spool))
    };
    assert_eq!(begun(true, None), (None, None, 1));
    assert_eq!(begun(false, Some(10)), (None, Some(10), 1));
    assert_eq!(begun(false, Some(20)), (Some(10), Some(10), 1));
    assert_eq!(begun(true, Some(30)), (Some(10), Some(30), 1), "begun again");
    // written by a version that used only the key as the name
    fs::write(folder.path().join(PARTIAL).join(key("B.csv", None)), b"12").unwrap();
    let earlier = claim(&spool, "B.csv", CLIENT);
    assert_eq!((earlier.length().unwrap(), earlier.total()), (2, None));
}

#[test]
fn a_client_with_too_many_uploads_loses_its_own_oldest_that_is_idle() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    let set_age = |name: &str, age: u64| {
        let path = spool.partial(&key(name, None)).unwrap().unwrap().path;
        let date = SystemTime::now() - Duration::from_secs(age);
        File::options().write(true).open(path).unwrap().set_modified(date).unwrap();
    };
    drop(send(&spool, "honest.csv", "other", b"1"));
    set_age("honest.csv", 5000);
    for number in 0..MOST_PARTIALS_OF_ONE {
        let name = format!("{number}.csv");
        drop(send(&spool, &name, CLIENT, b"1"));
        set_age(&name, 4000 - number as u64);
    }
    let in_progress = claim(&spool, "0.csv", CLIENT);
    for name in ["x.csv", "y.csv"] {
        drop(send(&spool, name, CLIENT, b"1"));
    }
    let is_there = |name: &str| spool.offset(name, None).unwrap().is_some();
    let gone: Vec<bool> = ["0.csv", "1.csv", "2.csv", "3.csv"].map(|name| !is_there(name)).into();
    assert_eq!(gone, [false, true, true, false], "the oldest but not the one in progress");
    assert!(is_there("honest.csv") && is_there("y.csv"));
    assert_eq!(count(&spool), MOST_PARTIALS_OF_ONE + 1);
    drop(in_progress);
}

#[test]
fn when_there_are_too_many_uploads_the_client_with_most_loses_one() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    for number in 0..MOST_PARTIALS {
        // three clients with their share, and some with one upload each
        let client = if number < 3 * MOST_PARTIALS_OF_ONE { number % 3 } else { number };
        drop(send(&spool, &format!("{number}.csv"), &client.to_string(), b"1"));
    }
    drop(send(&spool, "new.csv", "new", b"1"));
    assert_eq!(count(&spool), MOST_PARTIALS);
    let small = 3 * MOST_PARTIALS_OF_ONE..MOST_PARTIALS;
    assert!(small.into_iter().all(|at| spool.offset(&format!("{at}.csv"), None).unwrap().is_some()));
}

#[test]
fn one_client_leaves_a_turn_to_others() {
    let folder = tempfile::tempdir().unwrap();
    let spool = Spool::new(folder.path(), Reserve::new(folder.path(), None, Some(0)), 1);
    let held = claim(&spool, "A.csv", CLIENT);
    assert_eq!(spool.claim("B.csv", None, CLIENT).unwrap().unwrap_err(), Busy::Client);
    drop(claim(&spool, "B.csv", "other"));
    drop(held);
    drop(claim(&spool, "B.csv", CLIENT));
}

#[test]
fn without_space_idle_uploads_go_and_what_is_written_ends_before_the_reserve() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = spool(folder.path());
    drop(send(&spool, "A.csv", CLIENT, b"1"));
    let active = send(&spool, "B.csv", CLIENT, b"1");
    spool.reserve = Arc::new(Reserve::new(folder.path(), None, Some(1 << 60)));
    let now = SystemTime::now();
    assert!(spool.check().is_err() && count(&spool) == 2, "uploads of the last hour stay");
    let later = now + 2 * STALE_WHEN_SHORT;
    assert!(spool.room_for(1, later).is_err() && count(&spool) == 2, "they would not be enough");
    let full = spool.room_for(0, later).unwrap_err();
    assert_eq!((full.kind(), count(&spool)), (io::ErrorKind::StorageFull, 1));
    drop(active);
    let mut claim = spool.claim("B.csv", None, CLIENT).unwrap().unwrap();
    claim.begin(false, None).unwrap();
    let mut file = claim.open(false).unwrap();
    let written = (0..).find_map(|_| file.append(&[b'1'; 1 << 20]).err()).unwrap();
    assert_eq!(written.kind(), io::ErrorKind::StorageFull);
    assert!(claim.length().unwrap() < 2 * CHECK_INTERVAL_BYTES as u64);
}

#[test]
fn what_nobody_went_on_with_is_given_up_and_what_is_written_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    drop(send(&spool, "A.csv", CLIENT, b""));
    let _active = send(&spool, "B.csv", CLIENT, b"");
    let (date, now) = (SystemTime::now(), Instant::now());
    assert_eq!(spool.remove_stale(date, now).unwrap(), 0);
    assert_eq!(spool.remove_stale(date + 2 * STALE, now + STALE_HERE / 2).unwrap(), 0, "the date jumped");
    assert_eq!(spool.remove_stale(date + 2 * STALE, now + STALE_HERE).unwrap(), 1);
    assert_eq!(spool.offset("B.csv", None).unwrap(), Some((0, false)));
}

#[test]
fn an_upload_that_is_gone_on_with_now_and_then_is_kept_whatever_the_date() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    let (date, now) = (SystemTime::now() + 2 * STALE, Instant::now());
    for day in 0..5 {
        drop(send(&spool, "A.csv", CLIENT, b"1\n"));
        assert_eq!(spool.remove_stale(date, now + day * STALE_HERE).unwrap(), 0, "{day}");
    }
}

#[test]
fn looks_at_the_same_time_do_not_fail_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    let look = || (0..300).try_for_each(|_| spool.probe());
    std::thread::scope(|scope| {
        let looks: Vec<_> = (0..4).map(|_| scope.spawn(look)).collect();
        looks.into_iter().for_each(|look| look.join().unwrap().unwrap());
    });
    assert_eq!(fs::read_dir(folder.path().join(PARTIAL)).unwrap().count(), 0);
}

#[test]
fn a_probe_of_a_killed_process_is_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let spool = spool(folder.path());
    spool.prepare().unwrap();
    let left = folder.path().join(PARTIAL).join("probe-1-0");
    let probe = File::create(&left).unwrap();
    assert_eq!(count(&spool), 0);
    assert!(left.exists(), "it may be in use");
    probe.set_modified(SystemTime::now() - 2 * STALE_WHEN_SHORT).unwrap();
    assert_eq!(count(&spool), 0);
    assert!(!left.exists());
}
