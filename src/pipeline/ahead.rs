//! Reads and analyses settled exports before the ledger has decided on them. This keeps the processors busy while an
//! export is hashed and while the results of earlier exports are stored.
//!
//! The values of the rows depend only on the export's bytes and the configuration, so nothing is decided here. The
//! ledger is queried when it is the export's turn; the early result is used only if a reading at that time would give
//! the same, and is dropped otherwise. A command does not hash a large export first if no stored export has as many
//! bytes: its run is identified by the bytes read so far, like that of a growing export, until it is read completely.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use tokio::sync::mpsc;
use tokio_util::sync::{CancellationToken, DropGuard};
use tokio_util::task::AbortOnDropHandle;

use super::context::{Lane, OnProgress, Outcome, Pipeline, PipelineError, Progress, Retry};
use super::cycle_memory::RecordingTurn;
use super::production;
use super::streaming::{Streaming, cycles_in_analysis};
use super::take::admitted::AdmittedExport;
use super::take::cutting::ReadEnd;
use super::take::decide::Decision;
use super::take::intake::Recognised;
use super::take::{decide, intake, new_robot, record, resume};
use armwatch_config::{Config, FleetEntry};
use armwatch_ingest::bytes::fingerprint;
use armwatch_method::analyse::Method;
use armwatch_method::buffers::Buffers;
use armwatch_model::robot::Robot;
use armwatch_model::run::{ContentHash, RunKind, RunStatus};
use armwatch_store::{EarlierRun, Identity, SourceState, StoreError};

/// When an export that is read ahead is hashed.
#[derive(Debug, Clone, Copy)]
struct Hashing {
    /// Hash an export up to this many bytes before reading it: that takes milliseconds, and avoids reading a copy of a
    /// stored one.
    first_up_to: u64,
    /// Hash a larger export only during reading, if no run has as many bytes. Otherwise its turn hashes it too.
    once: bool,
}

/// Hashing for the daemon: a client that has sent an export may look it up by its hash, even during reading.
const BY_CONTENT: Hashing = Hashing { first_up_to: 16 << 20, once: false };

/// Hashing for a command.
const ONCE: Hashing = Hashing { once: true, ..BY_CONTENT };

/// An export that is read ahead. Dropping it stops the reading.
#[derive(Debug)]
pub struct ReadAhead {
    /// State of the file before it was read.
    state: SourceState,
    /// Its content, if it was hashed before reading.
    hashed: Option<(ContentHash, u64)>,
    /// True if it may be used without that.
    unhashed: bool,
    /// Hash of everything except its bytes that determines its cycles.
    made_with: ContentHash,
    pub(super) method: Arc<Method>,
    pub(super) streaming: Streaming<ReadEnd>,
    /// Bytes read so far.
    pub(super) bytes: Arc<AtomicU64>,
    /// Hash of all its bytes, once they are read.
    whole: Arc<OnceLock<ContentHash>>,
    has_read: CancellationToken,
    pub(super) turn: RecordingTurn,
    pub(super) stop: DropGuard,
}

impl ReadAhead {
    /// Returns true if a reading of the admitted export would give this, as far as is known. Another content appears as
    /// a file that changed during reading.
    pub(super) fn is_of(&self, admitted: &AdmittedExport) -> bool {
        let content = self.whole.get().is_none_or(|whole| *whole == admitted.header.content_hash);
        let from_start = admitted.cycles_stored == 0 && admitted.resume.is_none();
        content && from_start && self.made_with == admitted.made_with
    }

    /// The content and its number of bytes, if the file was hashed before reading and has not changed since.
    pub(super) fn hashed(&self, path: &Path) -> Option<(ContentHash, u64)> {
        self.hashed.filter(|_| intake::source_state(path) == Some(self.state))
    }

    /// Cancelled once the last row is read: the next export may then be read ahead, without more memory.
    pub fn has_read(&self) -> CancellationToken {
        self.has_read.clone()
    }
}

/// Exports in their order; the next ones are read ahead.
#[derive(Debug)]
pub struct ExportsAhead {
    begun: mpsc::Receiver<Result<Option<ReadAhead>, PipelineError>>,
    _beginning: AbortOnDropHandle<()>,
}

impl ExportsAhead {
    /// The next export, if it is read ahead.
    pub async fn next(&mut self) -> Result<Option<ReadAhead>, PipelineError> {
        self.begun.recv().await.unwrap_or(Ok(None))
    }
}

impl Pipeline {
    /// Starts to read `exports` ahead, in their order. Each starts once all rows of the one before are read. At most
    /// `cycles_in_analysis` exports are read ahead of the requested one.
    pub fn read_all_ahead(
        &self,
        exports: &[PathBuf],
        retry: Retry,
        stop: &CancellationToken,
    ) -> ExportsAhead {
        let (to_turn, begun) = mpsc::channel(cycles_in_analysis());
        let (pipeline, exports, stop) = (self.clone(), exports.to_vec(), stop.clone());
        let beginning = tokio::spawn(async move {
            for export in exports {
                let Ok(turn) = to_turn.reserve().await else { return };
                let ahead = match pipeline.store.is_shared(&export) {
                    // it is claimed in its turn, so that two daemons do not read it until then
                    true => Ok(None),
                    false => pipeline.read_ahead_hashing(&export, retry, &stop, ONCE).await,
                };
                let has_read = ahead.as_ref().ok().and_then(Option::as_ref).map(ReadAhead::has_read);
                turn.send(ahead);
                if let Some(has_read) = has_read {
                    has_read.cancelled().await;
                }
            }
        });
        ExportsAhead { begun, _beginning: AbortOnDropHandle::new(beginning) }
    }

    /// Starts to read an export before its turn. Returns `None` if there is nothing to read, or if only its turn can
    /// decide: its treatment is final, a run continues with it, its name gives no robot, or it is not a test.
    pub async fn read_ahead(
        &self,
        path: &Path,
        retry: Retry,
        stop: &CancellationToken,
    ) -> Result<Option<ReadAhead>, PipelineError> {
        self.read_ahead_hashing(path, retry, stop, BY_CONTENT).await
    }

    /// Like [`read_ahead`](Self::read_ahead), but hashes as `hashing` requires.
    async fn read_ahead_hashing(
        &self,
        path: &Path,
        retry: Retry,
        stop: &CancellationToken,
        hashing: Hashing,
    ) -> Result<Option<ReadAhead>, PipelineError> {
        let Some(state) = intake::source_state(path) else { return Ok(None) };
        let name = intake::ledger_path(&self.store, path);
        let known = self.store.known_source(&name, state).await?;
        if known.is_some_and(|known| decide::is_decided(&known, retry)) {
            return Ok(None);
        }
        // a command reads several exports ahead; an export that crashed the program is read in its turn, alone
        if hashing.once {
            if self.is_suspect(&name).await? {
                return Ok(None);
            }
            self.begin_attempt(&name, Some(state), stop).await?;
        }
        let hashed = match state.bytes <= hashing.first_up_to {
            true => match self.new_content_of(path, retry).await? {
                None => return Ok(None),
                content => content,
            },
            false => None,
        };
        let earlier = self.store.earlier_runs(&name, state.file, None).await?;
        // a growing file, or one that was cut and has lost its header
        let goes_on = |of: &EarlierRun| of.run.status == RunStatus::Streaming && of.run.cycles_stored > 0;
        if earlier.iter().any(|of| goes_on(of) || of.same_file) {
            return Ok(None);
        }
        let Ok(recognised) = intake::recognise(self.config(), path, intake::file_time(path)) else {
            return Ok(None);
        };
        let FleetEntry { description, layout, .. } = recognised.entry;
        if layout.stage.kind().run_kind() != RunKind::Test {
            return Ok(None);
        }
        let Some(method) = self.method_of(description).await? else { return Ok(None) };
        let Config { limits, analysis, .. } = self.config();
        let made_with = resume::settings_hash(layout, description, limits, analysis);
        let no_hash = fingerprint::nothing().hash;
        let header = intake::header(
            path,
            name,
            &recognised.robot,
            &description.model,
            recognised.started_at,
            no_hash,
            0,
        );
        let turn = RecordingTurn::default();
        let export = AdmittedExport {
            path: path.to_path_buf(),
            run_id: 0,
            header,
            robot: Arc::clone(description),
            layout: Arc::clone(layout),
            named_start: recognised.named_start,
            cycles_stored: 0,
            resume: None,
            made_with,
            limits: *limits,
            memory: self.memory.clone(),
            header_before: None,
            turn: turn.clone(),
        };
        let (stop, has_read) = (stop.child_token(), CancellationToken::new());
        let buffers = Buffers::going_round();
        let (bytes, whole) = (Arc::<AtomicU64>::default(), Arc::<OnceLock<ContentHash>>::default());
        let reading = {
            let (stop, has_read) = (stop.clone(), has_read.clone().drop_guard());
            let (bytes, whole) = (Arc::clone(&bytes), Arc::clone(&whole));
            let buffers = buffers.clone();
            move |cycles| {
                let read = |so_far| bytes.store(so_far, Ordering::Relaxed);
                let end = intake::read_before_its_turn(&export, &cycles, &stop, read, &whole, buffers);
                drop(has_read);
                end
            }
        };
        let work = production::work_alone(layout, &method);
        let places = Arc::clone(&self.places[Lane::Backlog as usize]);
        let access = self.access.clone();
        let reading = move |cycles| access.during(|| reading(cycles));
        let streaming = Streaming::start(work, places, self.metrics.clone(), buffers, reading);
        let stop = stop.drop_guard();
        let unhashed = hashing.once && hashed.is_none();
        Ok(Some(ReadAhead {
            state,
            hashed,
            unhashed,
            made_with,
            method,
            streaming,
            bytes,
            whole,
            has_read,
            turn,
            stop,
        }))
    }

    /// Takes an export that is read ahead without hashing it first. This requires that no run has as many bytes, so
    /// that none has its content, and that no run continues with it. Returns `Err` if that is uncertain or something is
    /// unusual: the export must then be taken the normal way, which reports the problem.
    pub(super) async fn take_unhashed(
        &self,
        path: &Path,
        ahead: ReadAhead,
        retry: Retry,
        progress: impl OnProgress,
    ) -> Result<Result<Outcome, Option<ReadAhead>>, PipelineError> {
        let state = ahead.state;
        let is_as_read = || intake::source_state(path) == Some(state);
        if !ahead.unhashed || !is_as_read() || self.store.has_run_of_bytes(state.bytes).await? {
            return Ok(Err(Some(ahead)));
        }
        let Ok(recognised) = intake::recognise(self.config(), path, intake::file_time(path)) else {
            return Ok(Err(Some(ahead)));
        };
        let facts = intake::facts(self, path, None, state, Some(&recognised), retry).await?;
        let start = match facts.map(|facts| decide::decide(&facts)) {
            Ok(Decision::Read(start)) if start.continues.is_none() => start,
            _ => return Ok(Err(Some(ahead))),
        };
        if new_robot::question(self, path, &recognised).await?.is_some() {
            return Ok(Err(Some(ahead)));
        }
        intake::forget_unreadable(self, path).await?;
        // placeholder until the content is read completely
        let no_hash = ContentHash([0; 32]);
        let Recognised { entry, robot, started_at, .. } = &recognised;
        let header = intake::header(
            path,
            intake::ledger_path(&self.store, path),
            robot,
            &entry.description.model,
            *started_at,
            no_hash,
            state.bytes,
        );
        let identity = Identity::Growing(start.read);
        let export = intake::begin(self, path, &recognised, header, identity, start, state).await?;
        let open = self.open(export.run_id);
        let taken = self.take_begun(&export, (ahead, state), progress).await;
        open.close(&self.store).await;
        taken
    }

    /// Takes an export that is read ahead and whose run has started; returns `Err` like
    /// [`take_unhashed`](Self::take_unhashed).
    async fn take_begun(
        &self,
        export: &AdmittedExport,
        (ahead, state): (ReadAhead, SourceState),
        progress: impl OnProgress,
    ) -> Result<Result<Outcome, Option<ReadAhead>>, PipelineError> {
        let is_as_read = || intake::source_state(&export.path) == Some(state);
        progress(Progress::Begun);
        if export.made_with != ahead.made_with {
            return Ok(Err(Some(ahead)));
        }
        let Ok(method) = self.method(export, Some(Arc::clone(&ahead.method))).await? else {
            return Ok(Err(None));
        };
        let done = match self.record_ahead(export, &method, ahead, progress).await {
            Ok((ReadEnd::Complete(totals), refused))
                if is_as_read() && totals.content.bytes == state.bytes =>
            {
                let written_at = Some(export.header.started_at);
                record::finish(self, export, &method, totals, refused, written_at).await
            }
            Ok((ReadEnd::Interrupted, _)) => Ok(Outcome::Interrupted),
            // reading the file again finds the position of the fault
            Ok((ReadEnd::Rejected(_), _)) => return Ok(Err(None)),
            // its stored cycles are compared with the file when it is processed again
            Ok((ReadEnd::Complete(_) | ReadEnd::Changed, _)) => {
                self.store.forget_resume_point(export.run_id).await?;
                Ok(Outcome::Changed)
            }
            Err(error) => Err(error),
        };
        match done {
            Err(PipelineError::Store(StoreError::Refused { .. }) | PipelineError::Task(_)) => Ok(Err(None)),
            done => Ok(Ok(done?)),
        }
    }

    /// The content of a file and its number of bytes. Returns `None` if it is stored or being read under any name, so
    /// that it is not read again. Also returns `None` if it is unreadable; its turn reports that.
    async fn new_content_of(
        &self,
        path: &Path,
        retry: Retry,
    ) -> Result<Option<(ContentHash, u64)>, PipelineError> {
        let owned = path.to_path_buf();
        let hashed = self.with_files(move || fingerprint::fingerprint(&owned)).await?;
        let Ok((content, bytes)) = hashed else { return Ok(None) };
        let known = self.store.lookup(&content).await?;
        let is_new =
            known.is_none_or(|known| !decide::is_decided(&known, retry) && !self.is_open(known.run_id));
        Ok(is_new.then_some((content, bytes)))
    }

    /// The structure analysis of a robot. Returns `None` if there is none; the turn of its export reports that.
    async fn method_of(&self, robot: &Arc<Robot>) -> Result<Option<Arc<Method>>, PipelineError> {
        if let Some(method) = self.known_method(robot) {
            return Ok(Some(method));
        }
        let (robot, settings) = (Robot::clone(robot), self.config.analysis);
        let made = tokio::task::spawn_blocking(move || Method::new(robot, settings)).await?;
        Ok(made.ok().map(Arc::new))
    }
}

#[cfg(test)]
mod tests {
    use sqlx::ConnectOptions;
    use sqlx::sqlite::SqliteConnectOptions;

    use super::*;
    use crate::pipeline::context::Outcome;
    use armwatch_config::Config;
    use armwatch_model::analysis::IdentifiedParameter;
    use armwatch_simulate::{SimulationSettings, simulate_run};
    use armwatch_store::Store;
    use armwatch_testing::er3a;

    /// Exports of two tests of a robot, one of them twice, and a file that is not an export; in the order of their
    /// turn.
    fn exports(folder: &Path) -> Vec<PathBuf> {
        let first_start = "2026-01-05T08:47:00Z".parse().expect("a time");
        let settings =
            SimulationSettings { cycles: 2, warming_s: 2.0, first_start, ..SimulationSettings::default() };
        let mut exports: Vec<PathBuf> = (0..2)
            .map(|run| simulate_run(&er3a(), &settings, run, folder, &mut |_| ()).expect("an export").export)
            .collect();
        let copy = folder.join("copy").join(exports[0].file_name().expect("a name"));
        std::fs::create_dir(folder.join("copy")).expect("a folder");
        std::fs::copy(&exports[0], &copy).expect("copied");
        let other = folder.join("R00_20260109_0800_5s_cycle1.csv");
        std::fs::write(&other, "time,pos_1\n0,nothing\n").expect("written");
        exports.extend([copy, other]);
        exports
    }

    async fn pipeline(folder: &Path) -> Pipeline {
        let config = Config::shipped().expect("shipped settings");
        let store = Store::open(&folder.join("fleet.db")).await.expect("a store");
        Pipeline::new(Arc::new(config), store)
    }

    async fn parameters(pipeline: &Pipeline, run_id: i64) -> Vec<Vec<IdentifiedParameter>> {
        let mut cycles = Vec::new();
        for cycle in 1..=2 {
            cycles.push(pipeline.store().cycle_parameters(run_id, cycle).await.expect("parameters"));
        }
        cycles
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn exports_that_are_read_ahead_come_to_what_they_come_to_in_their_turn() {
        let folders = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
        let exports = exports(folders[2].path());
        let (early, late) = (pipeline(folders[0].path()).await, pipeline(folders[1].path()).await);
        let stop = CancellationToken::new();
        let mut ahead = early.read_all_ahead(&exports, Retry::Never, &stop);
        for (place, export) in exports.iter().enumerate() {
            let begun = ahead.next().await.expect("a store");
            // the ledger may already know the first export when its copy is due to be read ahead
            assert!(begun.is_some() || place == 2, "{}", export.display());
            let found = early.process_ahead(export, begun, Retry::Never, &stop, |_| ()).await;
            let expected = late.process_ahead(export, None, Retry::Never, &stop, |_| ()).await;
            let (found, expected) = (found.expect("an outcome"), expected.expect("an outcome"));
            assert_eq!(found, expected);
            match place {
                0 | 1 => assert!(matches!(found, Outcome::Stored(_)), "{found:?}"),
                2 => assert!(matches!(found, Outcome::AlreadyStored { run_id: 1 }), "{found:?}"),
                _ => assert!(matches!(found, Outcome::Quarantined { .. }), "{found:?}"),
            }
        }
        for run_id in [1, 2] {
            let expected = parameters(&late, run_id).await;
            assert!(expected.iter().all(|cycle| cycle.len() > 40));
            assert_eq!(parameters(&early, run_id).await, expected);
        }
        // now the ledger contains them
        let mut ahead = early.read_all_ahead(&exports, Retry::Never, &stop);
        for export in &exports {
            let begun = ahead.next().await.expect("a store");
            assert!(begun.is_none(), "{}", export.display());
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn exports_that_are_not_hashed_first_come_to_what_they_come_to_in_their_turn() {
        let folders = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
        let mut exports = exports(folders[2].path());
        // an export with a fault in its second cycle
        let faulty = folders[2].path().join("R00_20260110_0800_5s_cycle2.csv");
        let text = std::fs::read_to_string(&exports[0]).expect("an export");
        let (whole, rest) = text.split_at(text.len() / 4 * 3);
        std::fs::write(&faulty, format!("{whole}\nnothing\n{rest}")).expect("written");
        exports.push(faulty);
        let (early, late) = (pipeline(folders[0].path()).await, pipeline(folders[1].path()).await);
        let stop = CancellationToken::new();
        for (place, export) in exports.iter().enumerate() {
            let hashing = Hashing { first_up_to: 0, ..ONCE };
            let ahead = early.read_ahead_hashing(export, Retry::Never, &stop, hashing).await;
            let ahead = ahead.expect("a store");
            let ahead = ahead.expect("a test");
            let unhashed = early.take_unhashed(export, ahead, Retry::Never, |_| ()).await.expect("a store");
            // a copy has the length of a stored export; a faulty export is read again
            assert_eq!(unhashed.is_ok(), place < 2, "{}", export.display());
            let found = match unhashed {
                Ok(found) => found,
                Err(ahead) => {
                    early.process_ahead(export, ahead, Retry::Never, &stop, |_| ()).await.expect("an outcome")
                }
            };
            let expected = late.process_ahead(export, None, Retry::Never, &stop, |_| ()).await;
            assert_eq!(found, expected.expect("an outcome"));
        }
        for run_id in [1, 2] {
            assert_eq!(parameters(&early, run_id).await, parameters(&late, run_id).await);
        }
        for folder in &folders[..2] {
            let options = SqliteConnectOptions::new().filename(folder.path().join("fleet.db"));
            let mut connection = options.read_only(true).connect().await.expect("a database");
            let runs: (i64, i64) = sqlx::query_as("SELECT count(*), sum(growing) FROM run")
                .fetch_one(&mut connection)
                .await
                .expect("counts");
            assert_eq!(runs, (4, 0));
        }
        // a stored run has its content
        for export in &exports {
            let again = early.process_ahead(export, None, Retry::Never, &stop, |_| ()).await;
            let again = again.expect("an outcome");
            let known = matches!(&again, Outcome::AlreadyStored { .. })
                || matches!(&again, Outcome::Quarantined { known: true, .. });
            assert!(known, "{again:?}");
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_export_that_changes_before_its_turn_is_read_as_it_is_then() {
        let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let exports = exports(folders[1].path());
        let pipeline = pipeline(folders[0].path()).await;
        let stop = CancellationToken::new();
        let begun = pipeline.read_ahead(&exports[0], Retry::Never, &stop).await.expect("a store");
        begun.as_ref().expect("a test").has_read().cancelled().await;
        std::fs::copy(&exports[1], &exports[0]).expect("written over");
        let outcome = pipeline.process_ahead(&exports[0], begun, Retry::Never, &stop, |_| ()).await;
        assert!(matches!(outcome, Ok(Outcome::Stored(_))), "{outcome:?}");
        let again = pipeline.process_ahead(&exports[1], None, Retry::Never, &stop, |_| ()).await;
        assert!(matches!(again, Ok(Outcome::AlreadyStored { run_id: 1 })), "{again:?}");
    }
}
