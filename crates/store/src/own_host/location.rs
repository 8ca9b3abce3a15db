//! Paths of files in a cluster of several hosts: `line1:/data/exports/R01.csv` for a file that only this host sees, the
//! path alone for a file in a shared folder.

use std::path::{Path, PathBuf};

use armwatch_config::ClusterSettings;
use armwatch_model::run::FileId;
use armwatch_model::text;

/// Settings of a cluster that determine the places of files.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClusterLocation {
    host: Option<String>,
    shared: Vec<PathBuf>,
}

impl ClusterLocation {
    pub(crate) fn of(settings: &ClusterSettings) -> Self {
        let shared = settings.shared_folders.iter();
        let shared = shared.map(|folder| std::path::absolute(folder).unwrap_or_else(|_| folder.clone()));
        Self { host: settings.host.clone(), shared: shared.collect() }
    }

    /// The name of the host; empty without one.
    pub(crate) fn host(&self) -> &str {
        self.host.as_deref().unwrap_or_default()
    }

    pub(crate) fn is_shared(&self, path: &Path) -> bool {
        self.host.is_some() && self.shared.iter().any(|folder| path.starts_with(folder))
    }

    /// A path as in the ledger.
    pub(crate) fn located(&self, path: String) -> String {
        match &self.host {
            Some(host) if !self.is_shared(Path::new(&path)) => format!("{host}:{path}"),
            _ => path,
        }
    }

    /// The file on this host for a path of the ledger; `None` for a file of another host.
    pub(crate) fn local_path(&self, located: &str) -> Option<PathBuf> {
        match (located.split_once(":/"), &self.host) {
            (Some((host, path)), Some(own)) if host == own => Some(Path::new("/").join(text::to_path(path))),
            (Some((host, _)), _) if !host.is_empty() && !host.contains('/') => None,
            _ => Some(text::to_path(located)),
        }
    }

    /// The number of a file, made distinct by the host: two hosts may give the same number to two files.
    pub(crate) fn file(&self, file: FileId) -> FileId {
        let Some(host) = &self.host else { return file };
        let hash = blake3::hash(host.as_bytes());
        let mut first = [0; 8];
        first.copy_from_slice(&hash.as_bytes()[..8]);
        FileId { device: file.device ^ u64::from_le_bytes(first), ..file }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(host: Option<&str>) -> ClusterLocation {
        ClusterLocation { host: host.map(str::to_owned), shared: vec!["/mnt/share".into()] }
    }

    #[test]
    fn a_path_says_its_host_unless_it_is_shared() {
        let line1 = place(Some("line1"));
        assert_eq!(line1.located("/data/a.csv".into()), "line1:/data/a.csv");
        assert_eq!(line1.located("/mnt/share/a.csv".into()), "/mnt/share/a.csv");
        assert_eq!(line1.located("/mnt/shares/a.csv".into()), "line1:/mnt/shares/a.csv");
        assert_eq!(place(None).located("/mnt/share/a.csv".into()), "/mnt/share/a.csv");
        assert!(!place(None).is_shared(Path::new("/mnt/share/a.csv")));
    }

    #[test]
    fn a_path_of_another_host_is_no_file_here() {
        let line1 = place(Some("line1"));
        for (located, here) in [
            ("line1:/data/a.csv", Some("/data/a.csv")),
            ("line2:/data/a.csv", None),
            ("/mnt/share/a.csv", Some("/mnt/share/a.csv")),
            ("/odd:/name.csv", Some("/odd:/name.csv")),
            ("given/as/it:/was.csv", Some("given/as/it:/was.csv")),
        ] {
            assert_eq!(line1.local_path(located), here.map(PathBuf::from), "{located}");
        }
        assert_eq!(place(None).local_path("line1:/data/a.csv"), None);
    }

    #[test]
    fn files_of_two_hosts_with_one_number_are_two() {
        let file = FileId { device: 2049, inode: 77 };
        assert_eq!(place(None).file(file), file);
        assert_ne!(place(Some("line1")).file(file), place(Some("line2")).file(file));
    }
}
