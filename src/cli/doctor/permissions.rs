//! Checks that the user may read and write the files of the daemon.

use std::path::Path;

use rustix::fs::{Access, access};

use super::finding::DoctorFinding;
use super::machine::{Machine, nearest};
use armwatch_config::Config;
use armwatch_store::lock_file_of;

const CHECK: &str = "permissions";

pub(super) fn check(config: &Config, machine: &Machine) -> Vec<DoctorFinding> {
    let mut found = Vec::new();
    if let Some(database) = config.database_file() {
        let beside =
            database.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        found.extend(written(beside, "the folder of the database"));
        if database.exists() {
            found.extend(written(database, "the database"));
            found.extend(lock_file(&lock_file_of(database)));
        }
    }
    for folder in &config.watch.folders {
        // a missing folder is reported with the configuration
        if folder.exists() && access(folder, Access::READ_OK | Access::EXEC_OK).is_err() {
            let said = format!("the watched folder {} is not readable", folder.display());
            found.push(DoctorFinding::problem(CHECK, said, "let the user of the service read it"));
        }
        if config.watch.archive.is_some() && folder.exists() {
            found.extend(written(folder, "the watched folder of archived exports"));
        }
    }
    let others = [
        ("the archive", config.watch.archive.as_deref()),
        (
            "the spool of uploads",
            config.serve.as_ref().and_then(|serve| Some(serve.upload.as_ref()?.spool.as_path())),
        ),
        ("the folder of the copy for readers", config.snapshot.as_ref().and_then(|of| of.file.parent())),
    ];
    found.extend(others.into_iter().filter_map(|(what, path)| written(path?, what)));
    if found.is_empty() {
        found.push(DoctorFinding::ok(CHECK, "all required reads and writes are permitted"));
    }
    if machine.user == 0 {
        found.push(DoctorFinding::warning(
            CHECK,
            "the check runs as root, who has more permissions than the user of the service",
            "run it as that user: `sudo -u armwatch armwatch doctor`",
        ));
    }
    found
}

/// A problem that prevents the daemon from opening its lock file, such as a first start as root.
fn lock_file(lock: &Path) -> Option<DoctorFinding> {
    let error = access(lock, Access::WRITE_OK).err().filter(|_| lock.exists())?;
    let said =
        format!("the lock file {} is not writable ({error}); the daemon does not start", lock.display());
    let remedy = "give it to the user of the service with `chown`, or delete it while no daemon runs";
    Some(DoctorFinding::problem(CHECK, said, remedy))
}

/// A problem that prevents writing to a path; a missing one would be created in the nearest existing folder above it.
fn written(path: &Path, what: &str) -> Option<DoctorFinding> {
    let place = nearest(path);
    let error = access(&place, Access::WRITE_OK).err()?;
    let said = format!("{what}, {}, is not writable ({error})", place.display());
    let remedy = "let the user of the service write there; under systemd, ReadWritePaths= must name it";
    Some(DoctorFinding::problem(CHECK, said, remedy))
}
