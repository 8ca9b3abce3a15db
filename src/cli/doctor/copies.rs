//! Checks that the copy for readers exists and is new enough.

use std::time::{Duration, SystemTime};

use super::finding::DoctorFinding;
use super::machine::Machine;
use armwatch_config::Config;

const CHECK: &str = "copies";

/// Older than this, and than the database, a copy is stale.
const STALE: Duration = Duration::from_secs(24 * 3600);

pub(super) fn check(config: &Config, _machine: &Machine) -> Vec<DoctorFinding> {
    let backup = DoctorFinding::ok(
        CHECK,
        "`armwatch backup` writes backups to a place of your choice; they are not checked",
    );
    let Some(snapshot) = &config.snapshot else { return vec![backup] };
    let written = |path: &std::path::Path| std::fs::metadata(path).and_then(|of| of.modified()).ok();
    let age = written(&snapshot.file).and_then(|at| SystemTime::now().duration_since(at).ok());
    let is_behind = written(&snapshot.file) < written(&config.database);
    vec![judged(&snapshot.file.display().to_string(), age, is_behind), backup]
}

fn judged(file: &str, age: Option<Duration>, is_behind: bool) -> DoctorFinding {
    let Some(age) = age else {
        return DoctorFinding::warning(
            CHECK,
            format!("the copy for readers, {file}, does not exist"),
            "start the daemon, or `armwatch snapshot FILE`; the log of the daemon has the reason if it \
            cannot be written",
        );
    };
    let said = format!("the copy for readers, {file}, is {:.1} hours old", age.as_secs_f64() / 3600.0);
    match is_behind && age > STALE {
        true => DoctorFinding::warning(CHECK, said, "check that the daemon runs and may write there"),
        false => DoctorFinding::ok(CHECK, said),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn a_copy_that_is_behind_for_long_is_told() {
        let hours = |hours: u64| Some(Duration::from_secs(3600 * hours));
        let level = |age, is_behind| judged("/srv/fleet.db", age, is_behind).level;
        assert_eq!(level(None, false), CheckLevel::Warning);
        assert_eq!(level(hours(1), true), CheckLevel::Ok);
        assert_eq!(level(hours(48), false), CheckLevel::Ok);
        assert_eq!(level(hours(48), true), CheckLevel::Warning);
    }
}
