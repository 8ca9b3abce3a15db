//! Where folders and database lie: on this machine, or on another one.

use std::path::Path;

use super::finding::Finding;
use super::machine::{Machine, is_share};
use armwatch_config::Config;

const CHECK: &str = "shares";

pub(super) fn check(config: &Config, machine: &Machine) -> Vec<Finding> {
    let mut found: Vec<Finding> =
        config.database_file().map(|file| of_database(file, machine)).into_iter().collect();
    for folder in &config.watch.folders {
        if let Some(kind) = machine.file_system(folder).filter(|kind| is_share(kind)) {
            let every = config.watch.scan_interval.as_secs_f64();
            let folder = folder.display();
            found.push(Finding::ok(
                CHECK,
                format!(
                    "{folder} is a network share ({kind}), whose files are found by a look each {every} s"
                ),
            ));
        }
    }
    found
}

fn of_database(file: &Path, machine: &Machine) -> Finding {
    let database = file.display();
    match machine.file_system(file) {
        Some(kind) if is_share(kind) => Finding::problem(
            CHECK,
            format!(
                "the database {database} lies on a network share ({kind}), on which SQLite's log is not safe"
            ),
            "move it to a disk of this machine, and let others read a copy ([snapshot])",
        ),
        Some("tmpfs" | "ramfs") => Finding::warning(
            CHECK,
            format!("the database {database} lies in memory and is gone when the machine stops"),
            "move it to a disk",
        ),
        Some(kind) => Finding::ok(CHECK, format!("the database lies on a disk of this machine ({kind})")),
        None => Finding::warning(
            CHECK,
            format!("the file system of the database {database} is unknown"),
            "see that it is a disk of this machine",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::Level;
    use super::*;

    #[test]
    fn a_database_on_a_share_is_a_problem_and_a_watched_share_is_none() {
        let mut config = Config::shipped().unwrap();
        config.database = "/srv/nas/fleet.db".into();
        config.watch.folders = vec!["/srv/nas/inbox".into()];
        let machine = |kind: &str| Machine { mounts: vec![("/".into(), kind.into())], user: 0 };
        let levels = |kind| check(&config, &machine(kind)).iter().map(|of| of.level).collect::<Vec<_>>();
        assert_eq!(levels("nfs4"), [Level::Problem, Level::Ok]);
        assert_eq!(levels("tmpfs"), [Level::Warning]);
        assert_eq!(levels("ext4"), [Level::Ok]);
    }
}
