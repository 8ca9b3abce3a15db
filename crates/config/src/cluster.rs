//! `[cluster]`: several daemons on one database of a server.

use std::path::PathBuf;
use std::time::Duration;

use super::toml::range::Limits;
use super::toml::table::{Table, Value};

/// Longer than a conclusion computes while it holds its transaction, and than a server takes to restart; short compared
/// with a test.
const DEFAULT_LEASE_S: f64 = 60.0;

/// Settings of a daemon among several on one database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClusterSettings {
    /// The name of this daemon, unique on the database; `None` if it is the only one.
    pub host: Option<String>,
    /// Time after the last sign of life of this daemon until the others take over its work.
    pub lease: Duration,
    /// Watched folders that other daemons see under the same path.
    pub shared_folders: Vec<PathBuf>,
}

impl Default for ClusterSettings {
    fn default() -> Self {
        Self { host: None, lease: Duration::from_secs_f64(DEFAULT_LEASE_S), shared_folders: Vec::new() }
    }
}

/// Reads `[cluster]`; `None` after a problem.
pub(super) fn read_cluster(table: Option<&Table<'_>>) -> Option<ClusterSettings> {
    let Some(table) = table else { return Some(ClusterSettings::default()) };
    let host = match table.optional("host") {
        Some(value) => read_host(&value).map(Some),
        None => Some(None),
    };
    let lease = table.number_or("lease_s", &Limits::between(1.0, 3600.0, "s"), DEFAULT_LEASE_S);
    let shared_folders = match table.optional("shared_folders") {
        Some(value) => value.items().and_then(|items| {
            items.iter().map(|item| item.text().map(PathBuf::from)).collect::<Option<Vec<_>>>()
        }),
        None => Some(Vec::new()),
    };
    Some(ClusterSettings {
        host: host?,
        lease: Duration::try_from_secs_f64(lease?).ok()?,
        shared_folders: shared_folders?,
    })
}

fn read_host(value: &Value<'_>) -> Option<String> {
    let name = value.text()?;
    if let Err(problem) = host_name(name) {
        value.refuse(problem, Some("write a short name, such as \"line1\"".into()));
        return None;
    }
    Some(name.to_owned())
}

/// Checks that a name is valid for a host: paths of exports are reported with it, `line1:/data/exports/R01.csv`.
///
/// # Errors
/// The fault.
pub fn host_name(name: &str) -> Result<String, String> {
    let is_allowed = |of: char| of.is_ascii_alphanumeric() || matches!(of, '-' | '_' | '.');
    if name.is_empty() || name.len() > 63 || !name.chars().all(is_allowed) {
        return Err(
            "is not a host name: only letters, digits, \"-\", \"_\" and \".\", at most 63 characters".into(),
        );
    }
    Ok(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_hosts_can_stand_before_a_path() {
        for name in ["line1", "line-1.plant", "A_2"] {
            assert_eq!(host_name(name).as_deref(), Ok(name));
        }
        for name in ["", "line 1", "line:1", "line/1", "größe", &"a".repeat(64)] {
            assert!(host_name(name).is_err(), "{name}");
        }
    }
}
