//! Shared types of the pipeline: the pipeline itself, outcomes, progress and errors.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use tokio::sync::Semaphore;
use tokio::task::{JoinError, JoinHandle};

use super::cycle_memory::{CycleMemory, HeldCycle};
use crate::metrics::Metrics;
use armwatch_config::Config;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_ingest::rejection::Rejection;
use armwatch_method::analyse::Method;
use armwatch_method::detect::runs::open_run::UsualTests;
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::measurements::RunMeasurements;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_store::{ClaimKind, ReadSoFar, Store, StoreError};

/// Growing exports and settled ones do not wait for each other's analyses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lane {
    /// Exports that grow.
    Live,
    /// Exports that have settled.
    Backlog,
}

/// State that the stages of the pipeline share.
#[derive(Debug, Clone)]
pub struct Pipeline {
    pub(super) config: Arc<Config>,
    pub(super) store: Store,
    /// Structure analyses, made when the first export of a description arrives. They are few, and are identified by the
    /// whole description: a wall-mounted arm may have the same name as a standing one.
    pub(super) methods: Arc<Mutex<Vec<Arc<Method>>>>,
    /// Permits for analyses, of growing and of settled exports.
    pub(super) places: [Arc<Semaphore>; 2],
    /// Held while conclusions are drawn.
    pub(super) concluding: Arc<tokio::sync::Mutex<()>>,
    /// Runs whose exports are being read.
    pub(super) open: OpenRuns,
    /// Memory of their cycles.
    pub(super) memory: CycleMemory,
    /// Results of robots' complete tests, for comparison with tests that are still being written.
    pub(super) usual: UsualByRobot,
    /// Metrics of the work.
    pub(super) metrics: Metrics,
    /// How files are opened.
    pub(super) access: FileAccess,
}

/// Results of a robot's complete tests, for comparison with the test that is being written.
#[derive(Debug)]
pub(super) struct RobotBaseline {
    /// The test that is being written.
    pub(super) run_id: i64,
    /// Change count of the robot's history.
    pub(super) history: i64,
    pub(super) settings: DetectSettings,
    /// Ordinals of the epochs of the joints that the test belongs to.
    pub(super) epochs: Vec<u32>,
    pub(super) tests: UsualTests,
    /// Baseline runs of the arm, with the measurements of their cycles.
    pub(super) first: Vec<(RunSummary, RunMeasurements)>,
}

/// By the key of the robot.
pub(super) type UsualByRobot = Arc<Mutex<HashMap<i64, Arc<RobotBaseline>>>>;

pub(super) type OpenRuns = Arc<Mutex<HashSet<i64>>>;

/// Marks a run as being read until it is dropped.
#[derive(Debug)]
pub(super) struct OpenRun(pub(super) OpenRuns, pub(super) i64);

impl OpenRun {
    /// Releases the run for other daemons, if there are several. If it is dropped instead, other daemons cannot read
    /// the run until this program's session ends.
    pub(super) async fn close(self, store: &Store) {
        let run_id = self.1.to_string();
        store.release_work(&[(ClaimKind::Run, &run_id)]).await;
    }
}

impl Drop for OpenRun {
    fn drop(&mut self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.1);
    }
}

/// The result of processing an export.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// Every cycle is stored.
    Stored(StoredRun),
    /// The same content was stored before.
    AlreadyStored {
        /// The run that holds it.
        run_id: i64,
    },
    /// The export was not understood; row and reason are stored, the file is untouched.
    Quarantined {
        /// The quarantined run.
        run_id: i64,
        /// Why, where, and what to do.
        rejection: Rejection,
        /// Whole cycles before the fault, which are stored.
        cycles: u32,
        /// True if this was already known of its content, which was not read again.
        known: bool,
    },
    /// A stop was requested. Stored cycles stay; the rest is read when the program starts again.
    Interrupted,
    /// The file changed or vanished during reading; it is processed again later.
    Changed,
    /// The system refuses to read the file, which does not depend on its content; it is tried again later.
    Unreadable {
        /// The system's error.
        rejection: Rejection,
    },
    /// The same content is being read under another name, or another daemon reads the file; it is processed again
    /// later.
    InWork {
        /// The run that it becomes, if known.
        run_id: Option<i64>,
    },
}

/// A run that was stored.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredRun {
    /// Its key.
    pub run_id: i64,
    /// The robot.
    pub robot: String,
    /// Cycles of the run.
    pub cycles: u32,
    /// Cycles without parameters, each with its reason.
    pub refused: Vec<(u32, String)>,
    /// Rows of the export.
    pub rows: u64,
}

impl StoredRun {
    /// Cycles without parameters in words, such as `cycles 1 to 8`, with their reason. They are grouped, because a
    /// faulty channel mostly affects every cycle.
    pub fn refusals(&self) -> impl Iterator<Item = (String, &str)> {
        self.refused.chunk_by(|a, b| a.1 == b.1 && a.0 + 1 == b.0).map(|alike| {
            let (first, reason) = &alike[0];
            let last = alike[alike.len() - 1].0;
            let cycles =
                if last == *first { format!("cycle {first}") } else { format!("cycles {first} to {last}") };
            (cycles, reason.as_str())
        })
    }
}

impl Outcome {
    /// The run that contains the export, if its treatment is final.
    pub fn run_id(&self) -> Option<i64> {
        match self {
            Self::Stored(run) => Some(run.run_id),
            Self::AlreadyStored { run_id } | Self::Quarantined { run_id, .. } => Some(*run_id),
            Self::Interrupted | Self::Changed | Self::Unreadable { .. } | Self::InWork { .. } => None,
        }
    }
}

/// Receives the progress of an export; several tasks call it.
pub trait OnProgress: Fn(Progress) + Send + Sync + Clone + 'static {}

impl<T: Fn(Progress) + Send + Sync + Clone + 'static> OnProgress for T {}

/// Progress of an export, for progress bars.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// The export is admitted: its run has its number.
    Begun,
    /// All rows written so far of a growing export are read.
    CaughtUp,
    /// Bytes of the file read so far.
    Read(u64),
    /// A cycle is stored.
    Cycle(u32),
    /// A test that is still being written has one more stored cycle; its run.
    Grown(i64),
}

/// Why the pipeline cannot continue. A bad export is never one of these.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A task of the program itself panicked.
    #[error("internal error: {0}")]
    Task(#[from] JoinError),
}

/// Selects which decided exports are read again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Retry {
    /// Quarantined ones, on a person's request: the configuration may have changed.
    Quarantined,
    /// None, until their content changes.
    Never,
    /// Complete ones too, on a person's request; they are read from the start, and keep their run.
    Complete,
}

/// A cycle under analysis.
#[derive(Debug)]
pub(super) struct InAnalysis {
    /// Its result, and its memory.
    pub(super) analysis: JoinHandle<(CycleAnalysis, HeldCycle)>,
    /// The bytes that it and the cycles before it were read from.
    pub(super) read: ReadSoFar,
    /// When the row that ended it was written, if known.
    pub(super) written: Option<SystemTime>,
}
