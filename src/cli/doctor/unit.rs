//! Checks the systemd unit: installation, and write access to the configured paths.

use std::path::{Path, PathBuf};

use super::finding::DoctorFinding;
use super::machine::Machine;
use armwatch_config::Config;

const CHECK: &str = "unit";

/// Paths of units, the one in force first.
const PLACES: [&str; 4] =
    ["/etc/systemd/system", "/run/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system"];

pub(super) fn check(config: &Config, _machine: &Machine) -> Vec<DoctorFinding> {
    let unit =
        PLACES.iter().map(|place| Path::new(place).join("armwatch.service")).find(|unit| unit.exists());
    let Some(unit) = unit else {
        return vec![DoctorFinding::ok(CHECK, "no systemd unit armwatch.service is installed")];
    };
    let text = with_drop_ins(&unit);
    let mut found = judged(&unit.display().to_string(), &text, &written(config));
    if config.serve.is_some() && values(&text, "RestrictAddressFamilies").any(|of| !of.contains("AF_INET")) {
        found.push(DoctorFinding::problem(
            CHECK,
            format!("{} allows no network, but the configuration has [serve]", unit.display()),
            "add AF_INET AF_INET6 to RestrictAddressFamilies=",
        ));
    }
    found
}

/// The unit and its drop-ins, in systemd's order of reading.
fn with_drop_ins(unit: &Path) -> String {
    let mut text = std::fs::read_to_string(unit).unwrap_or_default();
    let mut added: Vec<PathBuf> = PLACES
        .iter()
        .filter_map(|place| std::fs::read_dir(Path::new(place).join("armwatch.service.d")).ok())
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|ending| ending == "conf"))
        .collect();
    added.sort_by_key(|path| path.file_name().map(ToOwned::to_owned));
    for path in added {
        text.push('\n');
        text.push_str(&std::fs::read_to_string(path).unwrap_or_default());
    }
    text
}

/// Absolute paths that the daemon writes to.
fn written(config: &Config) -> Vec<PathBuf> {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut paths: Vec<PathBuf> = config.database_file().map(absolute).into_iter().collect();
    if let Some(archive) = &config.watch.archive {
        paths.push(absolute(archive));
        paths.extend(config.watch.folders.iter().map(|folder| absolute(folder)));
    }
    paths.extend(config.snapshot.iter().map(|of| absolute(&of.file)));
    let upload = config.serve.as_ref().and_then(|serve| serve.upload.as_ref());
    paths.extend(upload.map(|upload| absolute(&upload.spool)));
    paths
}

fn values<'t>(text: &'t str, key: &'t str) -> impl Iterator<Item = &'t str> {
    text.lines().filter_map(move |line| line.trim().strip_prefix(key)?.trim_start().strip_prefix('='))
}

/// Checks that a unit permits writing to these paths.
fn judged(unit: &str, text: &str, written: &[PathBuf]) -> Vec<DoctorFinding> {
    if values(text, "ProtectSystem").last().is_none_or(|value| value.trim() != "strict") {
        return vec![DoctorFinding::ok(CHECK, format!("{unit} leaves the file system writable"))];
    }
    let mut allowed: Vec<PathBuf> = Vec::new();
    for value in values(text, "ReadWritePaths") {
        if value.trim().is_empty() {
            allowed.clear();
        }
        // a minus sign permits its absence, a plus sign makes it relative to the unit's root
        allowed.extend(value.split_whitespace().map(|path| path.trim_start_matches(['-', '+']).into()));
    }
    for value in values(text, "StateDirectory") {
        allowed.extend(value.split_whitespace().map(|name| Path::new("/var/lib").join(name)));
    }
    let closed = written.iter().filter(|path| !allowed.iter().any(|place| path.starts_with(place)));
    let found: Vec<DoctorFinding> = closed
        .map(|path| {
            let path = path.display();
            let remedy =
                "run `systemctl edit armwatch` and add [Service] and ReadWritePaths= with its folder";
            DoctorFinding::problem(
                CHECK,
                format!("{unit} keeps {path} read-only, which the daemon writes to"),
                remedy,
            )
        })
        .collect();
    match found.is_empty() {
        true => vec![DoctorFinding::ok(CHECK, format!("{unit} lets the daemon write to all its places"))],
        false => found,
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn a_strict_unit_must_name_what_is_written() {
        let strict = "[Service]\nStateDirectory=armwatch\nProtectSystem=strict\nReadWritePaths=-/srv/archive /srv/in\n";
        let levels = |text: &str, paths: &[&str]| {
            let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
            judged("unit", text, &paths).iter().map(|of| of.level).collect::<Vec<_>>()
        };
        assert_eq!(
            levels(strict, &["/var/lib/armwatch/armwatch.db", "/srv/archive", "/srv/in/a"]),
            [CheckLevel::Ok]
        );
        assert_eq!(levels(strict, &["/srv/armwatch.db", "/srv/inbox"]), [CheckLevel::Problem; 2]);
        assert_eq!(levels(&format!("{strict}ReadWritePaths=\n"), &["/srv/in"]), [CheckLevel::Problem]);
        assert_eq!(levels("[Service]\nProtectSystem=full\n", &["/srv/in"]), [CheckLevel::Ok]);
    }
}
