//! Attempts at exports, which the ledger counts before anything is read: an export that crashes the program three times
//! is quarantined, and other exports continue.

use std::path::Path;

use tokio_util::sync::CancellationToken;

use super::{intake, record};
use crate::pipeline::context::{Outcome, Pipeline, PipelineError};
use armwatch_config::UNKNOWN_ROBOT;
use armwatch_ingest::rejection::Rejection;
use armwatch_model::run::RunStatus;
use armwatch_store::{Attempt, AttemptKind, AttemptOn, EarlierRun, SourceState, wait_for_quiet};

impl Pipeline {
    /// Counts an attempt at the file that the ledger calls `name`, before it is read. Waits first until this process is
    /// old enough for a last attempt, or a stop is requested.
    ///
    /// # Errors
    /// Those of the store; the file must not be read then.
    pub(in crate::pipeline) async fn begin_attempt(
        &self,
        name: &str,
        state: Option<SourceState>,
        stop: &CancellationToken,
    ) -> Result<Attempt, PipelineError> {
        let next = Attempt { number: self.store.failed_attempts(AttemptKind::Export, name).await? + 1 };
        if let Some(rest) = wait_for_quiet().filter(|_| next.is_last()) {
            // continue in either case
            let _ = tokio::time::timeout(rest, stop.cancelled()).await;
        }
        let on =
            state.map(|state| AttemptOn { inode: state.file.inode, bytes: state.bytes }).unwrap_or_default();
        Ok(self.store.begin_attempt_at(AttemptKind::Export, name, on).await?)
    }

    /// Returns true if an earlier attempt at a file ended the program.
    pub(in crate::pipeline) async fn is_suspect(&self, name: &str) -> Result<bool, PipelineError> {
        Ok(self.store.failed_attempts(AttemptKind::Export, name).await? > 0)
    }

    /// Notes that an attempt has ended. An attempt that a stop interrupted proves nothing about the file.
    pub(in crate::pipeline) async fn end_attempt(
        &self,
        name: &str,
        outcome: Option<&Outcome>,
    ) -> Result<(), PipelineError> {
        match outcome {
            Some(Outcome::Interrupted) => self.store.break_off_attempt(AttemptKind::Export, name).await?,
            _ => self.store.end_attempt(AttemptKind::Export, name).await?,
        }
        Ok(())
    }

    /// Quarantines a file that crashed the program three times, without opening it. If a run of it had started, that
    /// run keeps its cycles. Otherwise the hash of the path replaces that of the content, as for an unreadable file.
    pub(in crate::pipeline) async fn quarantine_unread(
        &self,
        path: &Path,
        name: &str,
        state: Option<SourceState>,
    ) -> Result<Outcome, PipelineError> {
        intake::forget_unreadable(self, path).await?;
        let by_path = intake::path_identity(&self.store, path);
        let earlier = match state {
            Some(state) => self.store.earlier_runs(name, state.file, None).await?,
            None => Vec::new(),
        };
        let begun = earlier.into_iter().find(|of| of.same_path && of.run.status == RunStatus::Streaming);
        let mut cycles = 0;
        let (mut robot, mut content_hash) = (self.named_robot(path), by_path);
        if let Some(EarlierRun { run, robot: of_run, .. }) = begun {
            self.store.identify_growing_by(run.run_id, &by_path).await?;
            if let Some(source) = self.store.run_source(run.run_id).await? {
                (robot, content_hash, cycles) = (of_run, source.content_hash, run.cycles_stored);
            }
        }
        let (started_at, bytes) = (intake::file_time(path), state.map_or(0, |state| state.bytes));
        let header = intake::header(path, name.to_owned(), &robot, "", started_at, content_hash, bytes);
        let rejection = spent(path);
        let run_id = record::write_down(self, &header, &rejection).await?;
        Ok(Outcome::Quarantined { run_id, rejection, cycles, known: false })
    }

    /// The robot in the name of a file, if the name also gives a start.
    fn named_robot(&self, path: &Path) -> String {
        let named = self.config.recognition.recognise(&intake::file_name(path)).ok();
        let named = named.filter(|named| named.started_at.is_some());
        named.map_or_else(|| UNKNOWN_ROBOT.to_owned(), |named| named.robot)
    }
}

/// Why a file is not read any more.
pub(in crate::pipeline) fn spent(path: &Path) -> Rejection {
    let name = intake::file_name(path);
    Rejection::of_file(
        path,
        "reading this export has ended the program three times",
        format!(
            "the system log has the cause (out of memory, abort, loss of power); `armwatch quarantine retry \
            {name}` reads it again, three times at most; if the file is the cause, report it with this file"
        ),
    )
}
