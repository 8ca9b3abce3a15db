//! Space for the database, and for all other files of the daemon.

use std::path::Path;

use super::finding::DoctorFinding;
use super::machine::{Machine, nearest};
use armwatch_config::Config;

const CHECK: &str = "disk";

/// A share of free space below this is small.
const LITTLE: f64 = 0.10;

/// Free space that the daemon needs, bytes; with less, it stops within days: a write-ahead log after a burst takes some
/// hundred megabytes.
const NEEDED_BYTES: u64 = 1 << 30;

pub(super) fn check(config: &Config, _machine: &Machine) -> Vec<DoctorFinding> {
    let mut found: Vec<DoctorFinding> =
        config.database_file().map(|file| of(file, "the database")).into_iter().collect();
    let written = [
        ("the archive", config.watch.archive.as_deref()),
        (
            "the spool of uploads",
            config.serve.as_ref().and_then(|serve| Some(serve.upload.as_ref()?.spool.as_path())),
        ),
        ("the copy for readers", config.snapshot.as_ref().map(|snapshot| snapshot.file.as_path())),
    ];
    found.extend(written.into_iter().filter_map(|(what, path)| Some(of(path?, what))));
    found
}

fn of(path: &Path, what: &str) -> DoctorFinding {
    let place = nearest(path);
    let room = match rustix::fs::statvfs(&place) {
        Ok(room) => room,
        Err(error) => {
            return DoctorFinding::warning(
                CHECK,
                format!("space for {what} is unknown ({error})"),
                "check that it is mounted",
            );
        }
    };
    let (free, size) = (room.f_bavail * room.f_frsize, room.f_blocks * room.f_frsize);
    judged(what, &place, (free, size), (room.f_favail, room.f_files))
}

/// Checks `room`, free and total bytes, and `inodes`, free and total; some file systems report no inodes.
fn judged(what: &str, place: &Path, room: (u64, u64), inodes: (u64, u64)) -> DoctorFinding {
    let share = |(free, all): (u64, u64)| if all == 0 { 1.0 } else { free as f64 / all as f64 };
    let place = place.display();
    let said = format!(
        "{:.1} GB ({:.0} %) free for {what}, and {:.0} % of the inodes, on the disk of {place}",
        room.0 as f64 / 1e9,
        100.0 * share(room),
        100.0 * share(inodes)
    );
    let remedy = "free space, or make it larger; docs/operations.md, Retention";
    if room.0 < NEEDED_BYTES || share(inodes) < 0.01 {
        DoctorFinding::problem(CHECK, said, remedy)
    } else if share(room) < LITTLE || share(inodes) < LITTLE {
        DoctorFinding::warning(CHECK, said, remedy)
    } else {
        DoctorFinding::ok(CHECK, said)
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn little_room_and_few_inodes_are_told() {
        const GB: u64 = 1 << 30;
        let level = |room, inodes| judged("the database", Path::new("/"), room, inodes).level;
        assert_eq!(level((50 * GB, 100 * GB), (900, 1000)), CheckLevel::Ok);
        assert_eq!(level((5 * GB, 100 * GB), (900, 1000)), CheckLevel::Warning);
        assert_eq!(level((50 * GB, 100 * GB), (50, 1000)), CheckLevel::Warning);
        assert_eq!(level((GB - 1, GB), (900, 1000)), CheckLevel::Problem);
        assert_eq!(level((50 * GB, 100 * GB), (0, 1000)), CheckLevel::Problem);
        assert_eq!(level((50 * GB, 100 * GB), (0, 0)), CheckLevel::Ok, "btrfs counts no inodes");
        assert!(of(Path::new("/nowhere/at/all"), "x").said.contains("on the disk of /"));
    }
}
