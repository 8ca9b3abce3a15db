//! Location of folders and database, on this machine or another one; places that scans of the folders skip.

use std::path::Path;

use super::finding::DoctorFinding;
use super::machine::{Machine, is_share};
use crate::daemon::preflight::NO_ANSWER;
use armwatch_config::Config;
use armwatch_ingest::find::watch;

const CHECK: &str = "shares";

const FOLDERS: &str = "folders";

/// Most places of a folder that are reported individually.
const MOST_TOLD: usize = 20;

pub(super) fn check(config: &Config, machine: &Machine) -> Vec<DoctorFinding> {
    let mut found: Vec<DoctorFinding> =
        config.database_file().map(|file| of_database(file, machine)).into_iter().collect();
    for folder in &config.watch.folders {
        if let Some(kind) = machine.file_system(folder).filter(|kind| is_share(kind)) {
            let every = config.watch.scan_interval.as_secs_f64();
            let folder = folder.display();
            found.push(DoctorFinding::ok(
                CHECK,
                format!("{folder} is a network share ({kind}); a scan every {every} s finds its files"),
            ));
        }
    }
    found.extend(config.watch.folders.iter().flat_map(|folder| left_out(folder, config.watch.follow_links)));
    found
}

/// A watched folder that does not answer.
pub(super) fn silent(folder: &Path) -> DoctorFinding {
    DoctorFinding::problem(
        FOLDERS,
        format!("the watched folder {} {NO_ANSWER}; its exports are not read", folder.display()),
        "check its disk or file server",
    )
}

/// Places in a watched folder that scans skip.
fn left_out(folder: &Path, follow_links: bool) -> Vec<DoctorFinding> {
    let skipped = watch::scan(&[folder.to_owned()], follow_links).skipped;
    let told =
        skipped.iter().take(MOST_TOLD).map(|of| DoctorFinding::warning(FOLDERS, of.reason(), of.remedy()));
    let mut found: Vec<DoctorFinding> = told.collect();
    if skipped.len() > MOST_TOLD {
        let more = format!("{} more places in {} are skipped", skipped.len() - MOST_TOLD, folder.display());
        found.push(DoctorFinding::warning(FOLDERS, more, "the log of the daemon lists them"));
    } else if skipped.is_empty() {
        found.push(DoctorFinding::ok(FOLDERS, format!("no place in {} is skipped", folder.display())));
    }
    found
}

fn of_database(file: &Path, machine: &Machine) -> DoctorFinding {
    let database = file.display();
    match machine.file_system(file) {
        Some(kind) if is_share(kind) => DoctorFinding::problem(
            CHECK,
            format!(
                "the database {database} is on a network share ({kind}), which is unsafe for the log of SQLite"
            ),
            "move it to a local disk, and let others read a copy ([snapshot])",
        ),
        Some("tmpfs" | "ramfs") => DoctorFinding::warning(
            CHECK,
            format!("the database {database} is in memory and is lost when the computer stops"),
            "move it to a disk",
        ),
        Some(kind) => DoctorFinding::ok(CHECK, format!("the database is on a local disk ({kind})")),
        None => DoctorFinding::warning(
            CHECK,
            format!("the file system of the database {database} is unknown"),
            "check that it is a local disk",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn a_database_on_a_share_is_a_problem_and_a_watched_share_is_none() {
        let mut config = Config::shipped().unwrap();
        config.database = "/srv/nas/fleet.db".into();
        config.watch.folders = vec!["/srv/nas/inbox".into()];
        let machine = |kind: &str| Machine { mounts: vec![("/".into(), kind.into())], user: 0 };
        let levels = |kind| {
            check(&config, &machine(kind))
                .iter()
                .filter(|of| of.check == CHECK)
                .map(|of| of.level)
                .collect::<Vec<_>>()
        };
        assert_eq!(levels("nfs4"), [CheckLevel::Problem, CheckLevel::Ok]);
        assert_eq!(levels("tmpfs"), [CheckLevel::Warning]);
        assert_eq!(levels("ext4"), [CheckLevel::Ok]);
    }

    #[test]
    fn what_is_left_out_of_a_folder_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let inbox = folder.path().join("inbox");
        std::fs::create_dir(&inbox).unwrap();
        assert_eq!(left_out(&inbox, false)[0].level, CheckLevel::Ok);
        std::os::unix::fs::symlink("/etc/hostname", inbox.join("R01.csv")).unwrap();
        let found = &left_out(&inbox, false)[0];
        assert_eq!(found.level, CheckLevel::Warning);
        assert!(found.said.contains("R01.csv is a link to a place outside"), "{found:?}");
        assert_eq!(left_out(&inbox, true)[0].level, CheckLevel::Ok);
    }
}
