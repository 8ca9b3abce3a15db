//! Production logs: windows are compared with the parameters of the robot's tests.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use super::context::{Pipeline, PipelineError};
use super::stored::chosen_cycles::{ParameterCandidate, RunCycles, StoredError, unit_identification};
use super::take::admitted::AdmittedExport;
use armwatch_config::Layout;
use armwatch_method::analyse::{Method, analyse_cycle, analyse_cycle_in};
use armwatch_method::buffers::Buffers;
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::production::reference::{Reference, last_link_shares};
use armwatch_method::production::window::{analyse_window, check_window};
use armwatch_method::spare_threads::SpareThreads;
use armwatch_model::analysis::{CycleAnalysis, Estimator, ProductionCheck};
use armwatch_model::run::{Cycle, RunKind};
use armwatch_store::{MOST_REFERENCES, ProductionWindow, ReferenceTest, Store, StoredCycle};

/// Windows whose factors are in memory at once: 50 kB each for a six-joint arm, 3 MB in total.
const WINDOWS_AT_ONCE: usize = 64;

/// The analysis of each cycle of an export.
#[derive(Debug, Clone)]
pub(super) enum CycleWork {
    /// A test: the full method, and a remark for each cycle.
    Test(Arc<Method>, Option<&'static str>),
    /// Production: comparison with a test, if there is one.
    Production(Arc<Method>, Option<Arc<Reference>>),
}

impl CycleWork {
    /// Analyses one cycle.
    pub(super) fn analyse(&self, cycle: &Cycle) -> CycleAnalysis {
        match self {
            Self::Test(method, remark) => {
                let mut analysis = analyse_cycle(method, cycle);
                analysis.remarks.extend(remark.map(str::to_owned));
                analysis
            }
            Self::Production(method, reference) => analyse_window(method, cycle, reference.as_deref()),
        }
    }

    /// Like [`analyse`](Self::analyse), for a cycle whose memory is reused through `buffers`, on several threads while
    /// some are `spare`.
    pub(super) fn analyse_in(&self, cycle: Cycle, buffers: &Buffers, spare: &SpareThreads) -> CycleAnalysis {
        match self {
            Self::Test(method, remark) => {
                let mut analysis = analyse_cycle_in(method, cycle, buffers, spare);
                analysis.remarks.extend(remark.map(str::to_owned));
                analysis
            }
            Self::Production(..) => self.analyse(&cycle),
        }
    }
}

/// The analysis of cycles of an export in `layout`, without a test to compare them with.
pub(super) fn work_alone(layout: &Layout, method: &Arc<Method>) -> CycleWork {
    match layout.stage.kind().run_kind() {
        RunKind::Test => CycleWork::Test(Arc::clone(method), layout.stage.kind().remark()),
        RunKind::Production => CycleWork::Production(Arc::clone(method), None),
    }
}

/// The analysis of cycles of an admitted export. Stores which kind of recording the export is.
pub(super) async fn work(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
    method: &Arc<Method>,
) -> Result<CycleWork, PipelineError> {
    let (store, kind) = (pipeline.store(), intake.layout.stage.kind().run_kind());
    store.set_run_kind(intake.run_id, kind).await?;
    if kind == RunKind::Test {
        return Ok(work_alone(&intake.layout, method));
    }
    // a preliminary result for a log that is still written; conclusions make the final one
    let estimator = pipeline.config().analysis.estimator.of_factors();
    for test in store.reference_runs(intake.run_id, MOST_REFERENCES).await? {
        if let Some(found) = candidate(store, test, estimator).await?
            && found.model.describes(&intake.robot)
        {
            let reference = as_reference(store, test, estimator, &found).await?;
            return Ok(CycleWork::Production(Arc::clone(method), Some(reference)));
        }
    }
    Ok(CycleWork::Production(Arc::clone(method), None))
}

/// Parameters of a test, from all its cycles together; `None` if they are not available.
async fn reference(
    store: &Store,
    run_id: i64,
    estimator: Estimator,
) -> Result<Option<Arc<Reference>>, PipelineError> {
    match candidate(store, run_id, estimator).await? {
        Some(found) => Ok(Some(as_reference(store, run_id, estimator, &found).await?)),
        None => Ok(None),
    }
}

async fn as_reference(
    store: &Store,
    run_id: i64,
    estimator: Estimator,
    candidate: &ParameterCandidate,
) -> Result<Arc<Reference>, PipelineError> {
    let parameters: Vec<_> =
        candidate.parameters.iter().map(|parameter| (parameter.id, parameter.value)).collect();
    let groupings = store.model_groupings(&candidate.model).await?;
    let terms = parameters.iter().filter_map(|(id, _)| Some((*id, &groupings.get(id)?[..])));
    let last_link = last_link_shares(terms);
    Ok(Arc::new(Reference { run_id, estimator, parameters, last_link }))
}

async fn candidate(
    store: &Store,
    run_id: i64,
    estimator: Estimator,
) -> Result<Option<ParameterCandidate>, PipelineError> {
    match unit_identification(store, &[RunCycles::all(run_id)], estimator).await {
        Ok(set) => {
            Ok(Some(ParameterCandidate { model: set.model, parameters: set.identification.parameters }))
        }
        Err(StoredError::Store(error)) => Err(error.into()),
        Err(StoredError::Task(error)) => Err(error.into()),
        // stored by an older program, or the motion is too poor: another test may work
        Err(StoredError::Numerics(_) | StoredError::Refused(_) | StoredError::PassedOver(_)) => Ok(None),
    }
}

/// Checks of a run's windows that replace the stored ones.
pub(super) type NewChecks = (i64, Vec<(u32, ProductionCheck)>);

/// Compares windows of a robot's production with the tests of its whole history, if the stored comparison is outdated.
/// It uses stored factors and reads no export.
///
/// A window belongs to the last test that started no later, or else to the first test; a test without parameters of the
/// window's description is skipped. A check is computed again if it was stored by an estimator other than the
/// configured one or its counterpart on factors.
pub(super) async fn settle(
    store: &Store,
    robot_id: i64,
    estimator: Estimator,
) -> Result<Vec<NewChecks>, PipelineError> {
    let estimator = estimator.of_factors();
    let windows = store.production_windows(robot_id, estimator).await?;
    let Some(from) = windows.iter().map(|window| window.started_at).min() else { return Ok(Vec::new()) };
    let models: BTreeSet<i64> = windows.iter().map(|window| window.robot_model_id).collect();
    let models = Vec::from_iter(models);
    let tests = store.reference_tests(robot_id, from, &models, MOST_REFERENCES).await?;
    let mut candidates: HashMap<i64, Option<Arc<Reference>>> = HashMap::new();
    let mut due: BTreeMap<i64, BTreeMap<u32, Arc<Reference>>> = BTreeMap::new();
    for window in windows {
        for test in nearest(&tests, &window).take(MOST_REFERENCES) {
            if window.settled_against == Some(test.run_id) {
                break;
            }
            let candidate = match candidates.entry(test.run_id) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(reference(store, test.run_id, estimator).await?),
            };
            if let Some(reference) = candidate {
                due.entry(window.run_id).or_default().insert(window.cycle, Arc::clone(reference));
                break;
            }
        }
    }
    let mut settled = Vec::with_capacity(due.len());
    for (run_id, windows) in due {
        settled.push((run_id, checks(store, run_id, windows).await?));
    }
    Ok(settled)
}

/// Tests of the window's description, the best first. `tests` are in the order of their start.
fn nearest<'a>(
    tests: &'a [ReferenceTest],
    window: &ProductionWindow,
) -> impl Iterator<Item = &'a ReferenceTest> {
    let (before, after) = tests.split_at(tests.partition_point(|test| test.started_at <= window.started_at));
    let model = window.robot_model_id;
    before.iter().rev().chain(after).filter(move |test| test.robot_model_id == model)
}

/// Checks of windows, given by their numbers, each with its test for comparison.
async fn checks(
    store: &Store,
    run_id: i64,
    windows: BTreeMap<u32, Arc<Reference>>,
) -> Result<Vec<(u32, ProductionCheck)>, PipelineError> {
    let (mut checks, windows) = (Vec::with_capacity(windows.len()), Vec::from_iter(windows));
    for some in windows.chunks(WINDOWS_AT_ONCE) {
        let numbers: Vec<u32> = some.iter().map(|(number, _)| *number).collect();
        let cycles = store.factors_of_cycles(run_id, &numbers).await?;
        let references: HashMap<u32, Arc<Reference>> = some.iter().cloned().collect();
        let made = tokio::task::spawn_blocking(move || {
            let check = |cycle: &StoredCycle| {
                let columns = FactorColumns::of_stored(&cycle.factors.columns);
                let reference = references.get(&cycle.cycle)?;
                let checked =
                    unpack(&cycle.factors).and_then(|factors| check_window(&columns, &factors, reference));
                match checked {
                    Ok(check) => Some((cycle.cycle, check)),
                    Err(error) => {
                        tracing::warn!(run_id, window = cycle.cycle, %error, "not compared with a test");
                        None
                    }
                }
            };
            cycles.iter().filter_map(check).collect::<Vec<_>>()
        });
        checks.extend(made.await?);
    }
    Ok(checks)
}
