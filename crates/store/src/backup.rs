//! A backup of the whole database, made while programs work with it.

use std::path::Path;

use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::verified_copy::{Backup, is_ours, is_same_file, not_written, write_beside};
use super::write_ahead_log;

impl Store {
    /// Writes a copy of the whole database at one moment to `target`, replacing an earlier one. The pages of the
    /// database are checked first. The copy is written next to its target, verified (integrity, references, a hash of
    /// all values of every table) and renamed, so an earlier copy stays until the new one is verified.
    ///
    /// # Errors
    /// [`StoreError::NotABackup`] if `target` is something else, or a database that is in use;
    /// [`StoreError::NoFactorsInSnapshot`] for a snapshot; [`StoreError::Corrupt`] if the database or the copy is
    /// damaged; [`StoreError`] of the database or of the copy.
    pub async fn backup(&self, target: &Path) -> Result<Backup, StoreError> {
        if self.dialect() == Dialect::Postgres {
            let (file, address) = (target.display(), self.path.display());
            let instead =
                format!("write it with `pg_dump --schema armwatch --format custom --file {file} {address}`");
            return Err(self.on_server("a backup", instead));
        }
        self.check_files()?;
        self.refuse_snapshot("a backup of it would not be whole")?;
        self.refuse_target(target)?;
        write_beside(&self.path, target).await
    }

    fn refuse_target(&self, target: &Path) -> Result<(), StoreError> {
        let refused =
            |detail: &str| StoreError::NotABackup { path: target.to_owned(), detail: detail.into() };
        if is_same_file(target, &self.path) {
            return Err(refused("it is the database itself"));
        }
        match is_ours(target) {
            Ok(None) => Ok(()),
            Ok(Some(true)) if write_ahead_log::path_of(target).exists() => {
                Err(refused("it is a database that is in use"))
            }
            Ok(Some(true)) => Ok(()),
            Ok(Some(false)) => Err(refused("it is not an armwatch database")),
            Err(error) => Err(not_written(target, error)),
        }
    }
}
