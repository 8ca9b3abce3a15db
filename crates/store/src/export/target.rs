//! Output file of a view. It has another name until it is complete, so a reader sees either the earlier file or the new
//! one.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::ExportError;

/// A file that is being written.
#[derive(Debug)]
pub(super) struct Target {
    path: PathBuf,
    file: File,
    /// Its name until it is complete; `None` for a path that is no regular file, such as a pipe, which is written
    /// directly.
    partial: Option<PathBuf>,
}

impl Target {
    /// Creates the folder if needed, and the file under its temporary name. The caller has already checked that `path`
    /// may be replaced.
    pub(super) fn open(path: &Path) -> Result<Self, ExportError> {
        let failed = |error: std::io::Error| ExportError::of_file(path, &error);
        if std::fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            let file = OpenOptions::new().write(true).open(path).map_err(failed)?;
            return Ok(Self { path: path.to_path_buf(), file, partial: None });
        }
        let folder = folder_of(path);
        std::fs::create_dir_all(folder).map_err(failed)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let partial = folder.join(format!(".{name}.partial"));
        loop {
            // the remains of a killed export are overwritten
            let file =
                OpenOptions::new().create(true).truncate(false).write(true).open(&partial).map_err(failed)?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => return Err(ExportError::Taken { path: path.to_path_buf() }),
                locked => locked.map_err(|error| failed(error.into()))?,
            }
            // another export may have finished, and renamed the file, before it was locked here
            if is_at(&file, &partial) {
                file.set_len(0).map_err(failed)?;
                return Ok(Self { path: path.to_path_buf(), file, partial: Some(partial) });
            }
        }
    }

    /// A handle for writing.
    pub(super) fn file(&self) -> Result<File, ExportError> {
        self.file.try_clone().map_err(|error| ExportError::of_file(&self.path, &error))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Syncs the written data to the disk, and returns its size in bytes.
    pub(super) fn sync(&self) -> Result<u64, ExportError> {
        let failed = |error: std::io::Error| ExportError::of_file(&self.path, &error);
        if self.partial.is_some() {
            self.file.sync_all().map_err(failed)?;
        }
        Ok(self.file.metadata().map_err(failed)?.len())
    }

    /// True if the written data equals the present content of the path.
    pub(super) fn is_as_before(&self) -> Result<bool, ExportError> {
        let failed = |error: std::io::Error| ExportError::of_file(&self.path, &error);
        let (Some(partial), Some(before)) = (&self.partial, existing(&self.path)?) else { return Ok(false) };
        let now = File::open(partial).map_err(failed)?;
        let length = |file: &File| file.metadata().map(|of| of.len());
        if length(&now).map_err(failed)? != length(&before).map_err(failed)? {
            return Ok(false);
        }
        let (mut now, mut before) = (BufReader::new(now), BufReader::new(before));
        loop {
            let [a, b] = [now.fill_buf().map_err(failed)?, before.fill_buf().map_err(failed)?];
            let common = a.len().min(b.len());
            if a[..common] != b[..common] {
                return Ok(false);
            }
            if common == 0 {
                return Ok(true);
            }
            now.consume(common);
            before.consume(common);
        }
    }

    /// Gives the file its final name.
    pub(super) fn place(mut self) -> Result<(), ExportError> {
        let Some(partial) = self.partial.take() else { return Ok(()) };
        let placed = std::fs::rename(&partial, &self.path)
            .and_then(|()| File::open(folder_of(&self.path))?.sync_all());
        if placed.is_err() {
            self.partial = Some(partial);
        }
        placed.map_err(|error| ExportError::of_file(&self.path, &error))
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        if let Some(partial) = &self.partial {
            // an incomplete file is useless
            let _ = std::fs::remove_file(partial);
        }
    }
}

/// True if there is no file at `path`, if it begins with `begin`, or if it is no regular file, such as a pipe.
pub(super) fn begins_with(path: &Path, begin: &[u8]) -> Result<bool, ExportError> {
    let failed = |error: std::io::Error| ExportError::of_file(path, &error);
    let Some(file) = existing(path)? else { return Ok(true) };
    let mut found = Vec::new();
    file.take(begin.len() as u64).read_to_end(&mut found).map_err(failed)?;
    Ok(found == begin)
}

/// The file at `path`, opened for reading; `None` if there is none, and for anything else than a regular file, such as
/// a pipe.
pub(super) fn existing(path: &Path) -> Result<Option<File>, ExportError> {
    let failed = |error: std::io::Error| ExportError::of_file(path, &error);
    let there = match std::fs::metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        there => there.map_err(failed)?,
    };
    if there.is_dir() {
        return Err(ExportError::of_file(path, &"it is a folder"));
    }
    if !there.is_file() {
        return Ok(None);
    }
    File::open(path).map(Some).map_err(failed)
}

fn is_at(file: &File, path: &Path) -> bool {
    let one = |of: std::fs::Metadata| (of.dev(), of.ino());
    let there = std::fs::metadata(path).map(one).ok();
    there.is_some() && file.metadata().map(one).ok() == there
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}
