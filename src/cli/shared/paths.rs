//! Files that are named on the command line, with remedies if one cannot be read or written.

use std::fs::Metadata;
use std::io::{Error, ErrorKind};
use std::path::Path;

use crate::cli::context::CliError;

/// Metadata of a named file or folder; all commands report a missing one with the same words.
pub(in crate::cli) fn metadata(path: &Path) -> Result<Metadata, CliError> {
    std::fs::metadata(path).map_err(|error| {
        let shown = path.display();
        CliError::Usage(match error.kind() {
            ErrorKind::NotFound => format!("{shown}: there is no such file or folder; check the name"),
            ErrorKind::PermissionDenied => {
                format!("{shown}: this user may not read it; ask for permission to read it")
            }
            _ => format!("{shown}: {error}"),
        })
    })
}

/// Why an existing file could not be read, and the remedy.
pub(in crate::cli) fn not_read(path: &Path, error: &Error) -> CliError {
    let remedy = match error.kind() {
        ErrorKind::PermissionDenied => "ask for permission to read it",
        _ => "check the disk or the share",
    };
    CliError::Io(format!("cannot read {}: {error}; {remedy}", path.display()))
}

/// Why a file or folder could not be written, and the remedy.
pub(in crate::cli) fn not_written(path: &Path, error: &Error) -> CliError {
    let remedy = match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            "free space there, or name a place on another disk"
        }
        ErrorKind::FileTooLarge => "name a place on a disk that allows larger files",
        ErrorKind::PermissionDenied => {
            "name a folder that this user may write to, or ask for permission to write there"
        }
        ErrorKind::ReadOnlyFilesystem => "name a place on a disk that is not read-only",
        ErrorKind::NotFound => "name a place in an existing folder",
        ErrorKind::NotADirectory | ErrorKind::AlreadyExists => {
            "there is a file instead of a folder; name another folder"
        }
        ErrorKind::IsADirectory => "this is a folder; name a file",
        _ => "check the disk, or name another place",
    };
    CliError::Io(format!("cannot write {}: {error}; {remedy}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::context::EXIT_IO;

    #[test]
    fn what_helps_depends_on_what_the_system_says() {
        // error numbers of Linux and other systems
        for (number, remedy) in [
            (28, "free space there"),
            (13, "ask for permission to write there"),
            (30, "not read-only"),
            (2, "an existing folder"),
            (20, "there is a file instead of a folder"),
            (21, "this is a folder; name a file"),
            (5, "check the disk"),
        ] {
            let error = not_written(Path::new("a/r.html"), &Error::from_raw_os_error(number));
            let said = error.to_string();
            assert!(said.starts_with("cannot write a/r.html: ") && said.contains(remedy), "{said}");
            assert_eq!(error.exit_code(), EXIT_IO);
        }
        let said = not_read(Path::new("a.csv"), &Error::from_raw_os_error(13)).to_string();
        assert!(said.starts_with("cannot read a.csv: ") && said.contains("permission to read"), "{said}");
    }
}
