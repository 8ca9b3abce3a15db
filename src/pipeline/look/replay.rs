//! Reads one cycle of a stored run again from its export, for data that the database does not contain.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::task::JoinError;

use crate::pipeline::take::cycles::read_cycle;
use crate::pipeline::take::intake::source_state;
use armwatch_config::{Config, Layout};
use armwatch_ingest::bytes::fingerprint::fingerprint;
use armwatch_ingest::rejection::Rejection;
use armwatch_method::NumericsError;
use armwatch_method::identify::carried_torque::subtract_carried;
use armwatch_method::identify::torque_series::{SeriesRows, TorqueSeries, torque_series};
use armwatch_method::signal::filter::filter_signals;
use armwatch_method::signal::restore::restore;
use armwatch_model::robot::{ParameterId, Robot};
use armwatch_model::run::Cycle;
use armwatch_model::text;
use armwatch_store::{CycleState, RunSource, Store, StoreError, description_hash};

/// Why a cycle cannot be read again.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Run or cycle are not stored, or data that they need is unavailable.
    #[error("{0}")]
    Refused(String),
    /// The export is not at its path, or is another one.
    #[error("{0}")]
    Source(String),
    /// The export is no longer understood.
    #[error("{0}")]
    Rejected(#[from] Rejection),
    /// The numbers cannot be computed.
    #[error(transparent)]
    Numerics(#[from] NumericsError),
    /// A task of the program itself panicked.
    #[error("internal error: {0}")]
    Task(#[from] JoinError),
}

/// A stored cycle with everything needed to read it again.
#[derive(Debug, Clone)]
pub struct Replay {
    /// Its run.
    pub run: RunSource,
    /// The ledger's state of it.
    pub cycle: CycleState,
    /// Cut-off of the analysis low-pass, Hz.
    pub cutoff: f64,
    /// The arm.
    pub robot: Arc<Robot>,
    /// Layout of the export.
    layout: Arc<Layout>,
}

/// The export of a run: at `named`, or else at the first known place of the run, or in the first of the configuration's
/// watched folders, that has the run's content. The inner error lists the other files at these places.
///
/// # Errors
/// The end of the task that reads.
pub async fn export_of(
    run: &RunSource,
    config: &Config,
    named: Option<&Path>,
) -> Result<Result<PathBuf, String>, JoinError> {
    let candidates = match named {
        Some(named) => vec![named.to_owned()],
        None => places(run, config),
    };
    let wanted = run.content_hash;
    let found = tokio::task::spawn_blocking(move || {
        let mut seen = Vec::new();
        for path in candidates {
            match fingerprint(&path) {
                Ok((hash, _)) if hash == wanted => return Ok(path),
                Ok((hash, _)) => seen.push(format!("{} has other content ({hash})", text::of_path(&path))),
                Err(error) => seen.push(format!("{}: {error}", text::of_path(&path))),
            }
        }
        Err(seen)
    })
    .await?;
    Ok(found.map_err(|seen| {
        format!(
            "the export of run {} is not available: {}; required is {} with the content {wanted}",
            run.run_id,
            seen.join("; "),
            run.source_name,
        )
    }))
}

/// Possible places of a run's export.
fn places(run: &RunSource, config: &Config) -> Vec<PathBuf> {
    let watched = config.watch.folders.iter().map(|folder| folder.join(text::to_path(&run.source_name)));
    let mut places = run.paths.clone();
    for place in watched.filter(|place| place.exists()) {
        if !places.contains(&place) {
            places.push(place);
        }
    }
    places
}

impl Replay {
    /// Looks up cycle `cycle` of run `run_id`.
    ///
    /// # Errors
    /// [`ReplayError::Refused`] for an unknown run or cycle, a cycle that could not be filtered, and a robot whose
    /// description is gone or has changed.
    pub async fn find(config: &Config, store: &Store, run_id: i64, cycle: u32) -> Result<Self, ReplayError> {
        let run = store.run_source(run_id).await?.ok_or_else(|| {
            ReplayError::Refused(format!(
                "there is no run {run_id}; `SELECT run_id, robot, started_at, status FROM runs` lists the runs"
            ))
        })?;
        let states = store.cycle_states(run_id).await?;
        let state = states.iter().find(|state| state.cycle == cycle);
        let state = state.ok_or_else(|| ReplayError::Refused(no_such_cycle(run_id, cycle, &states)))?;
        let cutoff = state.cutoff.ok_or_else(|| {
            let reason = state.reason.as_deref().unwrap_or("it could not be filtered");
            ReplayError::Refused(format!("cycle {cycle} of run {run_id} has no torques to show: {reason}"))
        })?;
        let entry = config.export_entry(&run.robot, &run.source_name).ok_or_else(|| {
            ReplayError::Refused(format!(
                "no description for robot \"{}\"; add a [[robot]] entry whose name matches to the \
                configuration, or name the configuration that run {run_id} was read with (--config)",
                run.robot
            ))
        })?;
        let (robot, layout) = (Arc::clone(&entry.description), Arc::clone(&entry.layout));
        same_description(&run, &robot)?;
        Ok(Self { cutoff, cycle: state.clone(), run, robot, layout })
    }

    /// The run's export: at `named`, or else at the first known place of the run, or in the first of the
    /// configuration's watched folders, that has the run's content.
    ///
    /// # Errors
    /// [`ReplayError::Source`] if there is none, with the other files at these places.
    pub async fn export(&self, config: &Config, named: Option<&Path>) -> Result<PathBuf, ReplayError> {
        let found = export_of(&self.run, config, named).await?;
        found.map_err(|missing| ReplayError::Source(format!("{missing}: give its place with --source FILE")))
    }

    /// Reads the cycle from `export`, no further than its end, and applies `parameters` to it.
    ///
    /// # Errors
    /// [`ReplayError::Rejected`] if the export is no longer understood, [`ReplayError::Source`] if it changes during
    /// reading or its cycles are cut differently than before, [`ReplayError::Numerics`] for parameters that the robot
    /// does not have.
    pub async fn torque(
        &self,
        export: &Path,
        parameters: Vec<(ParameterId, f64)>,
        rows: SeriesRows,
    ) -> Result<TorqueSeries, ReplayError> {
        let (replay, export) = (self.clone(), export.to_owned());
        tokio::task::spawn_blocking(move || {
            let before = source_state(&export);
            let cycle = replay.read(&export)?;
            if source_state(&export) != before {
                return Err(ReplayError::Source(format!(
                    "{} changed while it was read",
                    text::of_path(&export)
                )));
            }
            let mut samples = Cow::Owned(cycle.samples);
            restore(&replay.robot, &mut samples);
            let mut filtered = filter_signals(&samples, replay.cutoff)?;
            subtract_carried(&replay.robot, &mut samples, &mut filtered);
            Ok(torque_series(&replay.robot, &parameters, &samples, &filtered, rows)?)
        })
        .await?
    }

    /// Reads the cycle from `export`, no further than its end.
    ///
    /// # Errors
    /// Those of [`Replay::torque`] about the export.
    pub fn read(&self, export: &Path) -> Result<Cycle, ReplayError> {
        let CycleState { cycle: wanted, rows, .. } = self.cycle;
        let Some(cycle) = read_cycle(export, &self.layout, &self.robot, wanted)? else {
            return Err(self.cut_otherwise("is no longer found in the export"));
        };
        if cycle.samples.rows() != rows {
            return Err(self.cut_otherwise(&format!("now has {} rows", cycle.samples.rows())));
        }
        Ok(cycle)
    }

    fn cut_otherwise(&self, now: &str) -> ReplayError {
        ReplayError::Source(format!(
            "cycle {} of run {}, stored with {} rows, {now}: the layout \"{}\" or the program has changed since; \
             ingest the export into a new database, or name the configuration of that time (--config)",
            self.cycle.cycle, self.run.run_id, self.cycle.rows, self.layout.name
        ))
    }
}

fn no_such_cycle(run_id: i64, cycle: u32, states: &[CycleState]) -> String {
    match (states.first(), states.last()) {
        (Some(first), Some(last)) => {
            format!("run {run_id} has no cycle {cycle}; it has cycles {} to {}", first.cycle, last.cycle)
        }
        _ => format!("run {run_id} has no cycles: it is quarantined, or none is stored yet"),
    }
}

fn same_description(run: &RunSource, robot: &Robot) -> Result<(), ReplayError> {
    let Some(model) = &run.model else { return Ok(()) };
    if model.description_hash == description_hash(robot) {
        return Ok(());
    }
    Err(ReplayError::Refused(format!(
        "run {} was analysed with another description of {} than the configuration has now ({}): its \
        parameters are not comparable; name the configuration of that time with --config, or ingest the \
        export into a new database",
        run.run_id, model.name, robot.model
    )))
}
