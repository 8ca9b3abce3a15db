//! The disks that the daemon writes to: those of the database, of the copy for readers and of uploads.
//!
//! A call to a disk that hangs never returns, and the daemon waits for the database in many places. So a separate
//! thread writes a few bytes to each disk at intervals. If they are not stored in time, the log, `/ready` and the
//! metrics report that, and a stop no longer waits for the disk.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self as threads, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::metrics::{Disk, Metrics};
use armwatch_config::Config;

/// A disk that has not stored a few bytes within this time hangs.
const ANSWERS_WITHIN: Duration = Duration::from_secs(10);

/// Time between two attempts. Each costs a sync of the disk.
const INTERVAL: Duration = Duration::from_secs(20);

/// Interval of checks that an attempt has taken too long.
const LOOK: Duration = Duration::from_millis(500);

/// After a stop, the daemon waits this long for a database whose disk hangs.
const HANGING_AT_STOP: Duration = Duration::from_secs(5);

/// Watches the disks until it is dropped.
#[derive(Debug)]
pub struct Disks {
    silent: watch::Receiver<Vec<Disk>>,
    database: PathBuf,
    task: JoinHandle<()>,
}

impl Drop for Disks {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A disk, and the thread that writes to it.
struct Watched {
    disk: Disk,
    folder: PathBuf,
    /// Start of the running attempt.
    began: Arc<Mutex<Option<Instant>>>,
    /// Requests an attempt at once; dropping it ends the thread.
    wishes: threads::Sender<()>,
    is_silent: bool,
}

impl Disks {
    /// Watches the disks of a configuration. `stop` requests an attempt at once.
    pub fn watch(config: &Config, metrics: Metrics, stop: CancellationToken) -> Self {
        let spool =
            config.serve.as_ref().and_then(|serve| serve.upload.as_ref()).map(|upload| &*upload.spool);
        let places = [
            (Disk::Database, config.database_file().map(around)),
            (Disk::Snapshot, config.snapshot.as_ref().map(|snapshot| around(&snapshot.file))),
            (Disk::Spool, spool.map(Path::to_path_buf)),
        ];
        let watched: Vec<Watched> = places
            .into_iter()
            .filter_map(|(disk, folder)| Watched::begin(disk, folder?))
            .inspect(|of| metrics.disk_answers(of.disk, true))
            .collect();
        let (said, silent) = watch::channel(Vec::new());
        let task = tokio::spawn(look(watched, metrics, said, stop));
        Self { silent, database: config.database_file().map(Path::to_path_buf).unwrap_or_default(), task }
    }

    /// Waits until a disk hangs; for ever if it is not watched.
    async fn until_silent(&self, disk: Disk) {
        let mut silent = self.silent.clone();
        if silent.wait_for(|silent| silent.contains(&disk)).await.is_err() {
            std::future::pending::<()>().await;
        }
    }

    /// Waits for `ended` at a stop, unless a disk hangs.
    pub async fn unless_silent(&self, disk: Disk, ended: impl Future<Output = ()>) {
        tokio::select! {
            () = ended => {}
            () = self.until_silent(disk) => {
                tracing::warn!("not waiting for {}: its disk does not answer", disk.words());
            }
        }
    }

    /// Waits until a stop must no longer wait for the database, because its disk hangs. The returned sentence reports
    /// that.
    pub async fn abandoned(&self, stop: &CancellationToken) -> String {
        stop.cancelled().await;
        self.until_silent(Disk::Database).await;
        tokio::time::sleep(HANGING_AT_STOP).await;
        format!(
            "the disk of the database {} does not answer; ended without it, and the next start continues \
            after the last stored cycle; check the disk",
            self.database.display()
        )
    }
}

impl Watched {
    /// Starts the thread of a disk.
    fn begin(disk: Disk, folder: PathBuf) -> Option<Self> {
        let began = Arc::<Mutex<Option<Instant>>>::default();
        let (wishes, wished) = threads::channel();
        let writing = {
            let (folder, began) = (folder.clone(), Arc::clone(&began));
            move || {
                while !matches!(wished.recv_timeout(INTERVAL), Err(RecvTimeoutError::Disconnected)) {
                    set(&began, Some(Instant::now()));
                    if let Err(error) = sync(&folder) {
                        // the writer of the files reports it
                        tracing::trace!(folder = %folder.display(), %error, "the test write to a watched \
                            disk failed");
                    }
                    set(&began, None);
                }
            }
        };
        match thread::Builder::new().name(format!("disk {}", disk.name())).spawn(writing) {
            Ok(_) => Some(Self { disk, folder, began, wishes, is_silent: false }),
            Err(error) => {
                tracing::error!(%error, "no thread to watch the disk of {}", disk.words());
                None
            }
        }
    }

    /// Notes its state; returns true if it has just stopped or begun to answer.
    fn has_turned(&mut self, now: Instant) -> bool {
        let began = *self.began.lock().unwrap_or_else(PoisonError::into_inner);
        let is_silent = began.is_some_and(|began| now.saturating_duration_since(began) >= ANSWERS_WITHIN);
        std::mem::replace(&mut self.is_silent, is_silent) != is_silent
    }
}

async fn look(
    mut watched: Vec<Watched>,
    metrics: Metrics,
    said: watch::Sender<Vec<Disk>>,
    stop: CancellationToken,
) {
    let mut is_stopping = false;
    loop {
        tokio::select! {
            () = stop.cancelled(), if !is_stopping => {
                is_stopping = true;
                for of in &watched {
                    // a hanging thread does not receive it
                    let _ = of.wishes.send(());
                }
            }
            () = tokio::time::sleep(LOOK) => {}
        }
        let now = Instant::now();
        for of in &mut watched {
            if !of.has_turned(now) {
                continue;
            }
            metrics.disk_answers(of.disk, !of.is_silent);
            let (what, folder) = (of.disk.words(), of.folder.display());
            if of.is_silent {
                tracing::error!(
                    %folder, "the disk of {what} has not answered for {} s; {}, check the disk",
                    ANSWERS_WITHIN.as_secs(), of.disk.consequence()
                );
            } else {
                tracing::info!(%folder, "the disk of {what} answers again");
            }
            said.send_modify(|silent| {
                silent.retain(|disk| *disk != of.disk);
                silent.extend(of.is_silent.then_some(of.disk));
            });
        }
    }
}

fn set(began: &Mutex<Option<Instant>>, at: Option<Instant>) {
    *began.lock().unwrap_or_else(PoisonError::into_inner) = at;
}

fn around(file: &Path) -> PathBuf {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new(".")).to_owned()
}

/// Writes to the disk of a folder and syncs. The file has no name, so that a killed process leaves none behind.
fn sync(folder: &Path) -> io::Result<()> {
    match unnamed_file(folder) {
        Ok(mut file) => file.write_all(b"?").and_then(|()| file.sync_all()),
        // for a file system without such files
        Err(_) => File::open(folder)?.sync_all(),
    }
}

#[cfg(target_os = "linux")]
fn unnamed_file(folder: &Path) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt;
    let flags = i32::try_from(rustix::fs::OFlags::TMPFILE.bits()).map_err(io::Error::other)?;
    OpenOptions::new().write(true).custom_flags(flags).open(folder)
}

#[cfg(not(target_os = "linux"))]
fn unnamed_file(_: &Path) -> io::Result<File> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attempt_leaves_no_file_and_one_that_lasts_turns_the_disk_silent_once() {
        let folder = tempfile::tempdir().unwrap();
        sync(folder.path()).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(sync(&folder.path().join("none")).is_err());

        let mut watched = Watched::begin(Disk::Database, folder.path().to_owned()).unwrap();
        let now = Instant::now();
        assert!(!watched.has_turned(now + 2 * ANSWERS_WITHIN), "no attempt lasts");
        set(&watched.began, Some(now));
        assert!(!watched.has_turned(now + ANSWERS_WITHIN / 2));
        assert!(watched.has_turned(now + ANSWERS_WITHIN) && watched.is_silent);
        assert!(!watched.has_turned(now + 2 * ANSWERS_WITHIN), "it was said");
        set(&watched.began, None);
        assert!(watched.has_turned(now + 3 * ANSWERS_WITHIN) && !watched.is_silent);
    }
}
