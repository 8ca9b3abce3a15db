//! Names of files that outlast a loss of power.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Syncs a folder and all folders around it on its file system. The names in it then survive a power failure, and so
/// does its own, even if the program has just created the folder and those around it.
///
/// # Errors
/// Those of the file system. The work ends without an error at a folder that this user cannot read: the program has not
/// created it.
pub fn sync_names(folder: &Path) -> io::Result<()> {
    let folder = std::path::absolute(folder)?;
    let device = File::open(&folder)?.metadata()?.dev();
    for around in folder.ancestors() {
        let around = match File::open(around) {
            Err(error) if error.kind() == ErrorKind::PermissionDenied => break,
            opened => opened?,
        };
        if around.metadata()?.dev() != device {
            break;
        }
        around.sync_all()?;
    }
    Ok(())
}
