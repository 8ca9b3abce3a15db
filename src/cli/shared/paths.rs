//! Files that are named on the command line.

use std::fs::Metadata;
use std::io::ErrorKind;
use std::path::Path;

use crate::cli::context::CliError;

/// What the system says of a file or folder that was named; every command says alike that there is none.
pub(in crate::cli) fn metadata(path: &Path) -> Result<Metadata, CliError> {
    std::fs::metadata(path).map_err(|error| {
        let shown = path.display();
        CliError::Usage(match error.kind() {
            ErrorKind::NotFound => format!("{shown}: there is no such file or folder; check the name"),
            ErrorKind::PermissionDenied => {
                format!("{shown}: may not be looked at by this user; ask for permission to read it")
            }
            _ => format!("{shown}: {error}"),
        })
    })
}
