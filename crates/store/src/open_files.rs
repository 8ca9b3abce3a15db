//! Comparison of the files of an open database with the files at its paths.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use armwatch_model::run::FileId;

use super::descriptor::id_of;
use super::error::StoreError;
use super::write_ahead_log;

/// The files that a handle has open, by the paths that they were opened at: the database, its log and the index of the
/// log.
#[derive(Debug)]
pub(super) struct OpenFiles(Vec<(PathBuf, FileId)>);

impl OpenFiles {
    /// The files of the database at `path`, which was `opened` before SQLite opened it and has been written to since.
    ///
    /// # Errors
    /// [`StoreError::Displaced`] if another file has the path by now.
    pub(super) fn at(path: &Path, opened: FileId) -> Result<Self, StoreError> {
        let mut files = vec![(path.to_path_buf(), opened)];
        for beside in [write_ahead_log::path_of(path), write_ahead_log::index_path_of(path)] {
            if let Ok(metadata) = std::fs::metadata(&beside) {
                files.push((beside, id_of(&metadata)));
            }
        }
        let files = Self(files);
        files.check(path).map(|()| files)
    }

    /// Fails if one of the files is gone or another one has its name.
    ///
    /// # Errors
    /// [`StoreError::Displaced`].
    pub(super) fn check(&self, database: &Path) -> Result<(), StoreError> {
        let displaced = self.0.iter().find_map(|(path, opened)| {
            let name = path.display();
            match std::fs::metadata(path) {
                Ok(found) if id_of(&found) != *opened => Some(format!("another file is now at {name}")),
                Ok(_) => None,
                Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                    Some(format!("{name} no longer exists"))
                }
                // an error of the path gives no information about the file
                Err(_) => None,
            }
        });
        displaced.map_or(Ok(()), |detail| Err(StoreError::Displaced { path: database.to_path_buf(), detail }))
    }
}
