//! Errors of writing views to files.

use std::path::{Path, PathBuf};

use crate::StoreError;

/// An error of writing views to files. Existing files stay.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The file, or its folder, cannot be written or read.
    #[error("cannot write {}: {detail}; free space there, or name another place", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Message of the system.
        detail: String,
    },
    /// The file is not an export.
    #[error(
        "{} exists and is not an export of the view {view}; name another place, or replace it with --force",
        .path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The view that was to be written.
        view: String,
    },
    /// Another export writes the file.
    #[error("{} is being written by another export; wait until it ends, or name another place", .path.display())]
    Taken {
        /// The file.
        path: PathBuf,
    },
    /// There is no such robot.
    #[error("there is no robot {name}; {known}")]
    NoRobot {
        /// The name.
        name: String,
        /// A sentence on the known robots.
        known: String,
    },
    /// The database contains a value that the description of the column excludes.
    #[error("{view}.{column} holds {value}, which is not a {kind}; please report this")]
    Value {
        /// The view.
        view: String,
        /// The column.
        column: String,
        /// The value.
        value: String,
        /// Expected type.
        kind: &'static str,
    },
    /// A stop was requested.
    #[error("stopped; no file was written")]
    Stopped,
}

impl ExportError {
    /// An error of the system for a file.
    pub(super) fn of_file(path: &Path, error: &dyn std::fmt::Display) -> Self {
        Self::File { path: path.to_path_buf(), detail: error.to_string() }
    }
}
