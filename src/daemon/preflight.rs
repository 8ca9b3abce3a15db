//! Problems of this machine that prevent the daemon from working with a configuration. The text of the configuration
//! does not show them. `run` and `config check` perform the same checks.

use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use crate::alert::trial;
use crate::serve;
use armwatch_config::{Config, ConfigProblem, WatchSettings};

/// Longest wait for a path that may be on a file server.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Message for a path that does not answer.
pub const NO_ANSWER: &str = "does not answer";

/// Permission of a group and of others to read.
const OTHERS_READ: u32 = 0o044;

/// The result of the checks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Preflight {
    /// The daemon does not start with these.
    pub refusals: Vec<ConfigProblem>,
    /// Watched folders that do not exist or do not answer. They may appear later, such as a mount; the daemon warns of
    /// each when it scans.
    pub missing: Vec<ConfigProblem>,
    /// Oddities that lose no data.
    pub remarks: Vec<ConfigProblem>,
}

/// Checks the machine for everything that `config` names: database, folders and token.
pub fn preflight(config: &Config) -> Preflight {
    let mut found = Preflight::default();
    if config.database.is_dir() {
        let hint = format!("name a file, such as {}", config.database.join("armwatch.db").display());
        found.refusals.push(problem("database", &config.database, "is a folder", &hint));
    }
    if let (None, Some(snapshot)) = (config.database_file(), &config.snapshot) {
        let hint = "remove [snapshot]; readers query the server, as a user with read access only";
        found.refusals.push(problem(
            "snapshot.file",
            &snapshot.file,
            "is for a database file, but the database is on a server",
            hint,
        ));
    }
    descriptions(config, &mut found);
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
            && answered(is_no_folder(&upload.spool)) == Some(true)
        {
            let hint = "name a folder; it is created if missing";
            found.refusals.push(problem("serve.upload.spool", &upload.spool, "is not a folder", hint));
        }
    }
    secrets(config, &mut found);
    found
}

/// Secrets that others than the owner of their file may read.
fn secrets(config: &Config, found: &mut Preflight) {
    for path in config.secret_files() {
        let owned = path.to_owned();
        let mode = answered(move || std::fs::metadata(&owned).map(|file| file.permissions().mode()));
        let Some(Ok(mode)) = mode else { continue };
        // systemd grants access for one user by a list, which appears as that of a group
        let is_handed_over =
            std::env::var_os("CREDENTIALS_DIRECTORY").is_some_and(|folder| path.starts_with(folder));
        if mode & OTHERS_READ != 0 && !is_handed_over {
            let who = if mode & 0o004 != 0 { "every user of this computer" } else { "its group" };
            let hint =
                format!("run `chmod 600 {}`; the file must belong to the user of the daemon", path.display());
            found.remarks.push(problem("secret", path, &format!("is readable by {who}"), &hint));
        }
    }
}

/// Parts of the robots' descriptions that are read differently than written.
fn descriptions(config: &Config, found: &mut Preflight) {
    for entry in &config.fleet {
        for remark in &entry.description.remarks {
            let remark = ConfigProblem {
                key: "description".into(),
                problem: format!("of {}: {remark}", entry.description.model),
                ..empty()
            };
            if !found.remarks.contains(&remark) {
                found.remarks.push(remark);
            }
        }
    }
}

/// Settings of `[cluster]` without effect.
fn cluster(config: &Config, found: &mut Preflight) {
    let settings = &config.cluster;
    let mut remark = |key: &str, problem: &str, hint: &str| {
        let [key, problem, hint] = [key, problem, hint].map(str::to_owned);
        found.remarks.push(ConfigProblem { key, problem, hint: Some(hint), ..empty() });
    };
    if settings.host.is_some() && config.database_file().is_some() {
        let problem = "has no effect: a database file has only one daemon";
        remark(
            "cluster.host",
            problem,
            "several daemons can share a database on a PostgreSQL server, see \
            docs/operations.md",
        );
    }
    if settings.host.is_none() && !settings.shared_folders.is_empty() {
        let problem = "has no effect without a name for this daemon";
        remark("cluster.shared_folders", problem, "set host, or start with `armwatch run --host NAME`");
    }
}

fn folders(watch: &WatchSettings, found: &mut Preflight) {
    let asked: Vec<_> = watch.folders.iter().map(|path| ask(real_path(path))).collect();
    let until = Instant::now() + ANSWERS_WITHIN;
    let answers: Vec<Option<Option<PathBuf>>> = asked.iter().map(|asked| answer(asked, until)).collect();
    let real: Vec<Option<&PathBuf>> = answers.iter().map(|of| of.as_ref()?.as_ref()).collect();
    for (number, (folder, place)) in watch.folders.iter().zip(&real).enumerate() {
        let key = format!("watch.folders[{}]", number + 1);
        let Some(place) = place else {
            let (what, hint) = match answers[number] {
                Some(_) if folder.is_relative() && answered(is_absent(folder)) == Some(true) => continue,
                Some(_) => (
                    "does not exist or is not readable",
                    "create it, mount it, or correct the path; it is watched as soon as it exists",
                ),
                None => (NO_ANSWER, "check its disk or file server; it is watched as soon as it answers"),
            };
            found.missing.push(problem(&key, folder, what, hint));
            continue;
        };
        if place.parent().is_none() {
            let hint = "name the folder of the exports";
            found.refusals.push(problem(&key, folder, "is the whole file system", hint));
        }
        let others = watch.folders.iter().zip(&real).enumerate().filter(|(other, _)| *other != number);
        let around = others.filter_map(|(other, (name, outer))| Some((other, name, (*outer)?)));
        // if a folder has two names, the second is reported
        let mut around = around
            .filter(|(other, _, outer)| place.starts_with(outer) && (outer != place || *other < number));
        if let Some((_, outer, _)) = around.next() {
            let sentence = format!(
                "is inside the watched folder {}, which is searched with its subfolders",
                outer.display()
            );
            found.remarks.push(problem(&key, folder, &sentence, "remove one of them"));
        }
    }
}

/// Creates the relative watched folders that do not exist, and returns them. An absolute one may be on a disk that is not
/// mounted yet. The server creates the spool of uploads.
pub fn create_folders(config: &Config) -> Vec<PathBuf> {
    let spool = config.serve.as_ref().and_then(|serve| serve.upload.as_ref()).map(|upload| &upload.spool);
    let is_created = |folder: &&PathBuf| folder.is_relative() && Some(*folder) != spool;
    let relative: Vec<_> = config.watch.folders.iter().filter(is_created).collect();
    let asked: Vec<_> = relative.iter().map(|folder| ask(created(folder))).collect();
    let until = Instant::now() + ANSWERS_WITHIN;
    let new = relative.into_iter().zip(&asked).filter(|(_, asked)| answer(asked, until) == Some(true));
    new.map(|(folder, _)| folder.clone()).collect()
}

/// Watched folders whose disk or file server does not answer.
pub fn unanswered(watch: &WatchSettings) -> Vec<PathBuf> {
    let asked: Vec<_> = watch.folders.iter().map(|path| ask(listed(path))).collect();
    let until = Instant::now() + ANSWERS_WITHIN;
    let silent = watch.folders.iter().zip(&asked).filter(|(_, asked)| answer(asked, until).is_none());
    silent.map(|(folder, _)| folder.clone()).collect()
}

fn real_path(path: &Path) -> impl FnOnce() -> Option<PathBuf> + Send + use<> {
    let path = path.to_owned();
    move || std::fs::canonicalize(path).ok()
}

/// Checks that nothing is at the path, not even a link.
fn is_absent(path: &Path) -> impl FnOnce() -> bool + Send + use<> {
    let path = path.to_owned();
    move || std::fs::symlink_metadata(path).is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

/// Creates a folder if nothing is at its path.
fn created(path: &Path) -> impl FnOnce() -> bool + Send + use<> {
    let (is_absent, path) = (is_absent(path), path.to_owned());
    move || is_absent() && std::fs::create_dir_all(path).is_ok()
}

/// Checks if the path exists and is not a folder.
fn is_no_folder(path: &Path) -> impl FnOnce() -> bool + Send + use<> {
    let path = path.to_owned();
    move || path.exists() && !path.is_dir()
}

/// Reads the first entry of a folder.
fn listed(path: &Path) -> impl FnOnce() -> bool + Send + use<> {
    let path = path.to_owned();
    move || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some())
}

/// Runs work that may never end on a separate thread.
fn ask<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> mpsc::Receiver<T> {
    let (sender, receiver) = mpsc::channel();
    // without a thread there is no answer
    let _ = thread::Builder::new().name("preflight".into()).spawn(move || sender.send(work()));
    receiver
}

/// The answer, if it arrives in time.
fn answer<T>(asked: &mpsc::Receiver<T>, until: Instant) -> Option<T> {
    asked.recv_timeout(until.saturating_duration_since(Instant::now())).ok()
}

fn answered<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    answer(&ask(work), Instant::now() + ANSWERS_WITHIN)
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

    #[test]
    fn secrets_that_others_may_read_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, mode) in [("own", 0o600), ("group", 0o640), ("all", 0o644)] {
            std::fs::write(path(name), "0123456789abcdef0123456789abcdef").unwrap();
            std::fs::set_permissions(path(name), std::fs::Permissions::from_mode(mode)).unwrap();
        }
        let mut config = Config::shipped().unwrap();
        let token = |name: &str| armwatch_config::TokenSettings {
            name: name.into(),
            file: path(name),
            scopes: vec![armwatch_config::Scope::Read],
        };
        config.clients.tokens = ["own", "group", "all", "none"].map(token).into();
        let mut found = Preflight::default();
        secrets(&config, &mut found);
        let said: Vec<String> = found.remarks.iter().map(ToString::to_string).collect();
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(said[0].contains("is readable by its group") && said[0].contains("chmod 600"), "{said:?}");
        assert!(said[1].contains("is readable by every user"), "{said:?}");
        assert!(!said.concat().contains("0123456789"));
    }

    #[test]
    fn a_place_that_does_not_answer_is_waited_for_in_vain_only_so_long() {
        let (release, hangs) = mpsc::channel::<()>();
        let asked = ask(move || hangs.recv().is_err());
        assert_eq!(answer(&asked, Instant::now() + Duration::from_millis(10)), None);
        drop(release);
        assert_eq!(answer(&asked, Instant::now() + Duration::from_secs(60)), Some(true));
    }
}
