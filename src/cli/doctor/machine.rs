//! Properties of the system that several checks need.

use std::path::{Path, PathBuf};

/// The machine and the user.
#[derive(Debug, Clone, Default)]
pub(super) struct Machine {
    /// Mount points with the types of their file systems, as in `/proc/self/mountinfo`.
    pub(super) mounts: Vec<(PathBuf, String)>,
    /// Number of the user.
    pub(super) user: u32,
}

impl Machine {
    /// This machine.
    pub(super) fn here() -> Self {
        let mounts = std::fs::read_to_string("/proc/self/mountinfo").unwrap_or_default();
        Self { mounts: mounts.lines().filter_map(mount).collect(), user: rustix::process::geteuid().as_raw() }
    }

    /// The type of a path's file system; if the path does not exist, that of the nearest existing folder above it.
    pub(super) fn file_system(&self, path: &Path) -> Option<&str> {
        let path = std::fs::canonicalize(nearest(path)).ok()?;
        let above = self.mounts.iter().filter(|(point, _)| path.starts_with(point));
        // if several have the same mount point, the last covers the others
        let nearest = above.max_by_key(|(point, _)| point.components().count())?;
        Some(&nearest.1)
    }
}

/// Mount point and type in a line of mountinfo: `36 35 98:0 / /mnt rw shared:1 - ext4 /dev/sda1 rw`.
fn mount(line: &str) -> Option<(PathBuf, String)> {
    let (before, after) = line.split_once(" - ")?;
    let point = before.split(' ').nth(4)?.replace("\\040", " ");
    Some((point.into(), after.split(' ').next()?.to_owned()))
}

/// The path, or the nearest existing folder above it.
pub(super) fn nearest(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    path.ancestors().find(|place| place.exists()).unwrap_or(Path::new("/")).to_owned()
}

/// Returns true if a file system is on another machine.
pub(super) fn is_share(file_system: &str) -> bool {
    let shares = [
        "nfs",
        "nfs4",
        "cifs",
        "smb3",
        "smbfs",
        "9p",
        "afs",
        "ceph",
        "glusterfs",
        "fuse.sshfs",
        "fuse.glusterfs",
    ];
    shares.contains(&file_system)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_mountinfo_is_read() {
        let line = "36 35 98:0 /mnt1 /mnt/with\\040space rw,noatime master:1 shared:2 - cifs //nas/x rw,errors=continue";
        assert_eq!(mount(line), Some(("/mnt/with space".into(), "cifs".into())));
        assert_eq!(mount(""), None);
        let machine =
            Machine { mounts: vec![("/".into(), "ext4".into()), ("/proc".into(), "proc".into())], user: 0 };
        assert_eq!(machine.file_system(Path::new("/proc/self/nothing")), Some("proc"));
        assert_eq!(machine.file_system(Path::new("/nowhere/at/all")), Some("ext4"));
        assert!(is_share("cifs") && !is_share("ext4"));
    }
}
