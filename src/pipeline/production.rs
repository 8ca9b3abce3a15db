//! Recordings of ordinary work: windows held against the parameters of the robot's tests.

use std::sync::Arc;

use super::cutting::ReadTotals;
use super::intake::Intake;
use super::stored::{Candidate, Chosen, StoredError, cross_verification, unit_identification};
use super::{Outcome, Pipeline, PipelineError, StoredRun};
use crate::analysis::{CycleAnalysis, JointCheck, ProductionCheck, RmsdPair, RmsdScope, TorqueRmsd};
use crate::config::Layout;
use crate::numerics::analyse::{Method, analyse_cycle};
use crate::numerics::production::{Reference, analyse_window};
use crate::run::{Cycle, RunKind};
use crate::store::{Owner, RunTotals, Store};

/// What is done with each cycle of an export.
#[derive(Debug, Clone)]
pub(super) enum Work {
    /// A test: all of the method, and what is to be said of each cycle.
    Test(Arc<Method>, Option<&'static str>),
    /// Production: held against a test, where there is one.
    Production(Arc<Method>, Option<Arc<Reference>>),
}

impl Work {
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
}

/// What the cycles of an export in `layout` would be analysed with, without a test to hold them against.
pub(super) fn work_alone(layout: &Layout, method: &Arc<Method>) -> Work {
    match layout.stage.run_kind() {
        RunKind::Test => Work::Test(Arc::clone(method), layout.stage.remark()),
        RunKind::Production => Work::Production(Arc::clone(method), None),
    }
}

/// What the cycles of an export that was let in are to be analysed with; writes down what it records.
pub(super) async fn work(
    pipeline: &Pipeline,
    intake: &Intake,
    method: &Arc<Method>,
) -> Result<Work, PipelineError> {
    let (store, kind) = (pipeline.store(), intake.layout.stage.run_kind());
    store.set_run_kind(intake.run_id, kind).await?;
    if kind == RunKind::Test {
        return Ok(work_alone(&intake.layout, method));
    }
    let found = candidate(store, intake.run_id).await?;
    let found = found.filter(|(_, candidate)| candidate.model.describes(&intake.robot));
    let reference = found.map(|(run_id, candidate)| {
        let parameters = candidate.parameters.iter().map(|parameter| (parameter.id, parameter.value));
        Arc::new(Reference { run_id, parameters: parameters.collect() })
    });
    Ok(Work::Production(Arc::clone(method), reference))
}

/// Parameters of the test that a run of production is held against: those of all its cycles together. `None`
/// as long as the robot has no test with parameters.
async fn candidate(store: &Store, run_id: i64) -> Result<Option<(i64, Candidate)>, PipelineError> {
    for test in store.reference_runs(run_id).await? {
        match unit_identification(store, &[Chosen { run_id: test, cycles: None }]).await {
            Ok(set) => {
                let parameters = set.identification.parameters;
                return Ok(Some((test, Candidate { model: set.model, parameters })));
            }
            Err(StoredError::Store(error)) => return Err(error.into()),
            Err(StoredError::Task(error)) => return Err(error.into()),
            // stored by an older program, or a motion too poor: an earlier test may do
            Err(StoredError::Numerics(_) | StoredError::Refused(_)) => {}
        }
    }
    Ok(None)
}

/// Ends a run of production: nothing follows from it for the robot's tests.
///
/// # Errors
/// Those of the store.
pub(super) async fn finish(
    pipeline: &Pipeline,
    intake: &Intake,
    totals: ReadTotals,
    refused: Vec<(u32, String)>,
) -> Result<Outcome, PipelineError> {
    let store = pipeline.store();
    let mut ending = store.finish_run(intake.run_id).await?;
    if let Owner::Other(run_id) = ending.adopt(&totals.content).await? {
        drop(ending);
        store.merge_run(intake.run_id, run_id).await?;
        return Ok(Outcome::AlreadyStored { run_id });
    }
    ending
        .complete(RunTotals {
            rows: usize::try_from(totals.rows).unwrap_or(usize::MAX),
            sample_rate: totals.sample_rate,
            cycles: totals.cycles,
        })
        .await?;
    ending.commit().await?;
    Ok(Outcome::Stored(StoredRun {
        run_id: intake.run_id,
        robot: intake.header.robot.clone(),
        cycles: totals.cycles,
        refused,
        rows: totals.rows,
    }))
}

/// Holds what the robot of test `run_id` recorded in production before it had a test against the tests that
/// there are now, from stored factors: no export is read.
///
/// # Errors
/// Those of the store.
pub(super) async fn check_waiting(store: &Store, run_id: i64) -> Result<(), PipelineError> {
    for waiting in store.unchecked_runs(run_id).await? {
        let Some((reference, candidate)) = candidate(store, waiting).await? else { continue };
        let verified = match cross_verification(store, vec![candidate], &[waiting]).await {
            Ok(verified) => verified,
            Err(StoredError::Store(error)) => return Err(error.into()),
            Err(StoredError::Task(error)) => return Err(error.into()),
            Err(StoredError::Numerics(error)) => {
                tracing::warn!(run_id = waiting, %error, "production is not held against a test");
                continue;
            }
            // another description of the arm: its parameters mean something else
            Err(StoredError::Refused(_)) => continue,
        };
        let checks: Vec<(u32, ProductionCheck)> = verified
            .iter()
            .flat_map(|of| &of.by_cycle)
            .map(|(cycle, rmsd)| (*cycle, check_of(reference, rmsd)))
            .collect();
        store.store_production_checks(waiting, &checks).await?;
    }
    Ok(())
}

/// A check from factors, which know neither the mean nor the largest deviation.
fn check_of(reference_run_id: i64, rmsd: &[TorqueRmsd]) -> ProductionCheck {
    let whole = rmsd.iter().filter(|of| of.scope == RmsdScope::WholeCycle);
    let joint = |of: &TorqueRmsd| JointCheck {
        joint: of.joint,
        rmsd: RmsdPair { all_rows: of.all_rows, moving_rows: of.moving_rows },
        bias: None,
        max: None,
    };
    ProductionCheck { reference_run_id, joints: whole.map(joint).collect() }
}
