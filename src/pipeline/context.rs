//! What everything in the pipeline works with and answers: the pipeline itself, outcomes, progress and errors.

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

/// What the stages of the pipeline share.
#[derive(Debug, Clone)]
pub struct Pipeline {
    pub(super) config: Arc<Config>,
    pub(super) store: Store,
    /// Structure analyses, made when the first export of a description arrives. Few, and told apart by all that
    /// the description says: a wall-mounted arm may bear the name of one that stands.
    pub(super) methods: Arc<Mutex<Vec<Arc<Method>>>>,
    /// Places for analyses, of growing and of settled exports.
    pub(super) places: [Arc<Semaphore>; 2],
    /// Held while conclusions are drawn.
    pub(super) concluding: Arc<tokio::sync::Mutex<()>>,
    /// Runs whose exports are being read.
    pub(super) open: OpenRuns,
    /// Memory of their cycles.
    pub(super) memory: CycleMemory,
    /// What robots' complete tests say of those that are being written.
    pub(super) usual: UsualByRobot,
    /// Figures of the work.
    pub(super) metrics: Metrics,
    /// How files are opened.
    pub(super) access: FileAccess,
}

/// What the complete tests of a robot say of the one that is being written.
#[derive(Debug)]
pub(super) struct RobotBaseline {
    /// The test that is being written.
    pub(super) run_id: i64,
    /// How often the robot's history had changed.
    pub(super) history: i64,
    pub(super) settings: DetectSettings,
    /// Ordinals of the epochs of the joints that the test belongs to.
    pub(super) epochs: Vec<u32>,
    pub(super) tests: UsualTests,
    /// Those whose first cycles the arm is compared with, with what their cycles measured.
    pub(super) first: Vec<(RunSummary, RunMeasurements)>,
}

/// By the key of the robot.
pub(super) type UsualByRobot = Arc<Mutex<HashMap<i64, Arc<RobotBaseline>>>>;

pub(super) type OpenRuns = Arc<Mutex<HashSet<i64>>>;

/// Keeps a run among those being read until it is dropped.
#[derive(Debug)]
pub(super) struct OpenRun(pub(super) OpenRuns, pub(super) i64);

impl OpenRun {
    /// Lets other daemons read the run, where there are several. One that is dropped keeps it from them until the session of
    /// this program ends.
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

/// What became of an export.
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
        /// Whether this was known of its content, which was not read again.
        known: bool,
    },
    /// A stop was asked for; what is stored stays, the rest is read when the program starts again.
    Interrupted,
    /// The file changed or vanished while it was read; it is looked at again later.
    Changed,
    /// The system refuses to read the file, which says nothing of its content; it is looked at again later.
    Unreadable {
        /// What the system says.
        rejection: Rejection,
    },
    /// The same content is being read under another name, or another daemon reads the file; it is looked at again later.
    InWork {
        /// The run that it becomes, where this is known.
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
    /// Cycles without parameters in words, such as `cycles 1 to 8`, with their reason: what is wrong with a channel is
    /// mostly wrong in every cycle.
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
    /// The run that holds the export, where its fate is decided.
    #[must_use]
    pub fn run_id(&self) -> Option<i64> {
        match self {
            Self::Stored(run) => Some(run.run_id),
            Self::AlreadyStored { run_id } | Self::Quarantined { run_id, .. } => Some(*run_id),
            Self::Interrupted | Self::Changed | Self::Unreadable { .. } | Self::InWork { .. } => None,
        }
    }
}

/// How far an export has come, for progress bars.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// The export is let in: its run has its number.
    Begun,
    /// All that is written of a growing export so far is read.
    CaughtUp,
    /// Bytes of the file read so far.
    Read(u64),
    /// A cycle is stored.
    Cycle(u32),
    /// A test that is still being written has one more stored cycle; its run.
    Grown(i64),
}

/// Why the pipeline cannot go on. A bad export is never one of these.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A task of the program itself panicked.
    #[error("internal error: {0}")]
    Task(#[from] JoinError),
}

/// Whether an export whose fate is decided is read again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Retry {
    /// A person asked for it: configuration may have changed.
    Quarantined,
    /// Only when its content changes.
    Never,
    /// A person asked for it: a complete one is read again too, from its start, as the run that it is.
    Complete,
}

/// A cycle under analysis.
#[derive(Debug)]
pub(super) struct InAnalysis {
    /// What it will say, and its memory.
    pub(super) analysis: JoinHandle<(CycleAnalysis, HeldCycle)>,
    /// What it and the cycles before it were read from.
    pub(super) read: ReadSoFar,
    /// When the row that ended it was written, where that is known.
    pub(super) written: Option<SystemTime>,
}
