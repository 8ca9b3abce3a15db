//! What would keep the daemon from working with a configuration on this machine, which its text does not show. `run`
//! and `config check` ask the same.

use std::path::{Path, PathBuf};

use crate::alert::trial;
use crate::serve;
use armwatch_config::{Config, ConfigProblem, WatchSettings};

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Preflight {
    /// The daemon does not start with these.
    pub refusals: Vec<ConfigProblem>,
    /// Watched folders that are not there. They may come, such as a mount; the daemon warns of each when it looks.
    pub missing: Vec<ConfigProblem>,
    /// Odd, and nothing is lost.
    pub remarks: Vec<ConfigProblem>,
}

/// Looks at the machine for what `config` names: database, folders and token.
#[must_use]
pub fn preflight(config: &Config) -> Preflight {
    let mut found = Preflight::default();
    if config.database.is_dir() {
        let hint = format!("name a file, such as {}", config.database.join("armwatch.db").display());
        found.refusals.push(problem("database", &config.database, "is a folder", &hint));
    }
    if let (None, Some(snapshot)) = (config.database_file(), &config.snapshot) {
        let hint = "take [snapshot] away; readers ask the server, as a user who may only read";
        found.refusals.push(problem(
            "snapshot.file",
            &snapshot.file,
            "is a copy of a database file, and the database is on a server",
            hint,
        ));
    }
    cluster(config, &mut found);
    folders(&config.watch, &mut found);
    for (route, unusable) in trial::problems(&config.alerts) {
        let key = format!("alerts.route {route}");
        found.refusals.push(ConfigProblem { key, problem: unusable.to_string(), ..empty() });
    }
    if let Some(settings) = &config.serve {
        if let Err(error) = serve::check_access(settings, &config.clients) {
            found.refusals.push(ConfigProblem { problem: error.to_string(), ..empty() });
        }
        if let Some(upload) = &settings.upload
            && upload.spool.exists()
            && !upload.spool.is_dir()
        {
            let hint = "name a folder; it is made if it is not there";
            found.refusals.push(problem("serve.upload.spool", &upload.spool, "is no folder", hint));
        }
    }
    found
}

/// What of `[cluster]` has no effect.
fn cluster(config: &Config, found: &mut Preflight) {
    let settings = &config.cluster;
    let mut remark = |key: &str, problem: &str, hint: &str| {
        let [key, problem, hint] = [key, problem, hint].map(str::to_owned);
        found.remarks.push(ConfigProblem { key, problem, hint: Some(hint), ..empty() });
    };
    if settings.host.is_some() && config.database_file().is_some() {
        let problem = "has no effect: a database in a file has one daemon";
        remark("cluster.host", problem, "several share one on a PostgreSQL server, see docs/fleet.md");
    }
    if settings.host.is_none() && !settings.shared_folders.is_empty() {
        let problem = "has no effect without a name of this daemon";
        remark("cluster.shared_folders", problem, "set host, or start with `armwatch run --host NAME`");
    }
}

fn folders(watch: &WatchSettings, found: &mut Preflight) {
    let real: Vec<Option<PathBuf>> =
        watch.folders.iter().map(|path| std::fs::canonicalize(path).ok()).collect();
    for (number, (folder, place)) in watch.folders.iter().zip(&real).enumerate() {
        let key = format!("watch.folders[{}]", number + 1);
        let Some(place) = place else {
            let hint = "make it, mount it, or correct the path; it is watched once it is there";
            found.missing.push(problem(&key, folder, "is not there, or may not be looked into", hint));
            continue;
        };
        if place.parent().is_none() {
            let hint = "name the folder that exports appear in";
            found.refusals.push(problem(&key, folder, "is the whole file system", hint));
        }
        let others = watch.folders.iter().zip(&real).enumerate().filter(|(other, _)| *other != number);
        let around = others.filter_map(|(other, (name, outer))| Some((other, name, outer.as_ref()?)));
        // of the same folder by two names, the second is named
        let mut around = around
            .filter(|(other, _, outer)| place.starts_with(outer) && (*outer != place || *other < number));
        if let Some((_, outer, _)) = around.next() {
            let sentence = format!(
                "lies in the watched folder {}, which is searched with its subfolders",
                outer.display()
            );
            found.remarks.push(problem(&key, folder, &sentence, "leave one of them out"));
        }
    }
}

fn problem(key: &str, value: &Path, problem: &str, hint: &str) -> ConfigProblem {
    ConfigProblem {
        key: key.to_owned(),
        value: Some(format!("\"{}\"", value.display())),
        problem: problem.to_owned(),
        hint: Some(hint.to_owned()),
        ..empty()
    }
}

fn empty() -> ConfigProblem {
    ConfigProblem {
        file: "configuration".into(),
        line: None,
        column: None,
        key: String::new(),
        value: None,
        problem: String::new(),
        hint: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(problems: &[ConfigProblem]) -> Vec<&str> {
        problems.iter().map(|problem| problem.key.as_str()).collect()
    }

    #[test]
    fn folders_are_looked_at_as_the_machine_has_them() {
        let folder = tempfile::tempdir().unwrap();
        let (inbox, inner) = (folder.path().join("inbox"), folder.path().join("inbox/left"));
        std::fs::create_dir_all(&inner).unwrap();
        std::os::unix::fs::symlink(&inbox, folder.path().join("link")).unwrap();
        let mut config = Config::shipped().unwrap();
        config.database = folder.path().to_path_buf();
        config.watch.folders =
            vec![inbox, inner, folder.path().join("link"), folder.path().join("none"), "/".into()];
        let found = preflight(&config);
        assert_eq!(keys(&found.refusals), ["database", "watch.folders[5]"], "{found:?}");
        assert_eq!(keys(&found.missing), ["watch.folders[4]"]);
        assert_eq!(keys(&found.remarks), ["watch.folders[1]", "watch.folders[2]", "watch.folders[3]"]);
        config.database = folder.path().join("armwatch.db");
        config.watch.folders.truncate(1);
        assert_eq!(preflight(&config), Preflight::default());
    }
}
