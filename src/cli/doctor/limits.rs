//! Limits of the system: open files, and watched folders.

use std::path::Path;

use rustix::process::{Resource, getrlimit};

use super::finding::DoctorFinding;
use super::machine::Machine;
use armwatch_config::Config;

const CHECK: &str = "limits";

/// Open files of the daemon besides exports: 320 connections of clients, connections of the database, log.
const OTHER_FILES: u64 = 384;

/// Most folders that are counted: walking a tree of millions takes minutes.
const MOST_COUNTED: u64 = 100_000;

pub(super) fn check(config: &Config, _machine: &Machine) -> Vec<DoctorFinding> {
    let exports = config.watch.live_files + 2 * config.limits.backlog_files;
    let needed = OTHER_FILES + exports as u64;
    let folders = config.watch.folders.iter().map(|folder| counted(folder, MOST_COUNTED)).sum();
    vec![
        open_files(getrlimit(Resource::Nofile).current, needed),
        watches(folders, number("max_user_watches")),
    ]
}

fn open_files(limit: Option<u64>, needed: u64) -> DoctorFinding {
    match limit {
        Some(limit) if limit < needed => DoctorFinding::problem(
            CHECK,
            format!("{limit} files may be open, but the daemon needs up to {needed}"),
            "raise LimitNOFILE= of the unit, or `ulimit -n`",
        ),
        Some(limit) => {
            DoctorFinding::ok(CHECK, format!("{limit} files may be open; the daemon needs up to {needed}"))
        }
        None => DoctorFinding::ok(CHECK, "any number of files may be open"),
    }
}

fn watches(folders: u64, limit: Option<u64>) -> DoctorFinding {
    match limit {
        Some(limit) if limit < 2 * folders => DoctorFinding::warning(
            CHECK,
            format!(
                "{folders} watched folders and subfolders of at most {limit} watches of this user \
                (inotify): files in the other folders are found only by the next scan"
            ),
            "raise fs.inotify.max_user_watches with sysctl",
        ),
        Some(limit) => {
            DoctorFinding::ok(CHECK, format!("{folders} watched folders and subfolders of {limit} watches"))
        }
        None => DoctorFinding::ok(CHECK, "no file events on this system; folders are scanned"),
    }
}

fn number(name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/sys/fs/inotify/{name}")).ok()?;
    text.trim().parse().ok()
}

/// Number of a folder and its subfolders, at most `most`; links are not followed.
fn counted(folder: &Path, most: u64) -> u64 {
    let (mut count, mut waiting) = (0, vec![folder.to_owned()]);
    while let Some(folder) = waiting.pop() {
        if count == most {
            break;
        }
        count += 1;
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let inner = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
        waiting.extend(inner.map(|entry| entry.path()));
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn limits_are_compared_with_what_is_needed() {
        assert_eq!(open_files(Some(1024), 300).level, CheckLevel::Ok);
        assert_eq!(open_files(Some(256), 300).level, CheckLevel::Problem);
        assert_eq!(watches(10, Some(8192)).level, CheckLevel::Ok);
        assert_eq!(watches(5000, Some(8192)).level, CheckLevel::Warning);
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("a/b")).unwrap();
        std::fs::create_dir_all(folder.path().join("c")).unwrap();
        std::fs::write(folder.path().join("file"), "").unwrap();
        assert_eq!(counted(folder.path(), MOST_COUNTED), 4);
        assert_eq!(counted(folder.path(), 2), 2);
    }
}
