//! Results in SQLite. One writer, several readers; every write is one transaction that starts with
//! the write lock, so that waiting for another writer happens once, at its beginning.
//!
//! The views of `migrations/` are what users read; the tables behind them are this module's own.
//! Functions below the facade hold one statement each and take any connection, so that they compose.

mod ledger;
mod results;
mod robot;
mod kept;
#[cfg(test)]
mod tests;
mod views;
mod claim;
mod error;
mod finish;
mod handle;
mod models;
mod open;
mod values;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sqlx::{Sqlite, Transaction};

pub use claim::DaemonClaim;
pub use error::StoreError;
pub use finish::{FinishTransaction, Replaced};
pub use handle::Store;
pub use kept::estimates::{EstimateTransaction, NewEstimate, OtherEstimate};
pub use kept::parameter_sets::{ParameterSet, SourceCycle};
pub use kept::reestimates::{
    CycleView, KeptEstimate, KeptKind, Reestimate, ReestimatedCycle, ReestimatedStatistics,
};
pub use ledger::quarantine::{Dismissal, Fault, FaultState, QuarantineRow};
pub use ledger::resume::{ReadSoFar, StoredPoint};
pub use ledger::runs::{Beginning, Begun, Identity, KnownRun, Owner, RunTotals};
pub use ledger::sources::{EarlierRun, Recording, RunSource, SourceState, UnfinishedSource};
pub use models::{ModelParameter, StoredModel};
pub use results::factors::{FactorsWanted, StoredCycle};
pub use results::production::{ProductionWindow, ReferenceTest};
pub use results::run_analysis::JointDeviation;
pub use results::verification::{CycleState, OfCycle};
pub use robot::anomalies::Reconciled;
pub use robot::conclude::{ConclusionTransaction, StaleRobot};
pub use robot::conclusion_faults::ConclusionFault;
pub use robot::friction::{CycleSpeedFits, FrictionRun, IndexRow, ThermalSourceRow};
pub use robot::health::{OverdueRobot, RunResult};
pub use robot::history::{CycleParameters, CyclePoint, CycleRmsd, RunMeasurements};
pub use views::{AnomalyRow, Counts, FleetHealthRow, HealthStatus, RunRow};

use crate::analysis::{
    CycleAnalysis, Estimator, FrictionPoint, IdentifiedParameter, TorqueRmsd, WarmingContrast,
};
use crate::anomaly::RunSummary;
use crate::robot::{ParameterId, Robot};
use crate::run::{ContentHash, FileId, RunHeader, RunKind};
use results::record::Recorded;

/// Hash by which the database tells descriptions apart: what decides the meaning of base parameters, joint
/// kinds, geometry, gravity, friction columns and couplings. Compare [`StoredModel::description_hash`].
#[must_use]
pub fn description_hash(robot: &Robot) -> [u8; 32] {
    models::description_hash(robot)
}

impl Store {
    /// Opens the database at `path`; makes it, and its folder, if there is none, and brings its
    /// schema up to date.
    ///
    /// # Errors
    /// [`StoreError::NotADatabase`], [`StoreError::Newer`], [`StoreError::NotWritable`] and others;
    /// a file that is refused is left as it is.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        open::open(path, open::BUSY_TIMEOUT).await
    }

    /// Opens the database at `path` to look into it; nothing is made or changed, and writing fails. `None` if
    /// there is none.
    ///
    /// # Errors
    /// As [`Store::open`], and [`StoreError::Older`] for a schema that is not up to date.
    pub async fn open_existing(path: &Path) -> Result<Option<Self>, StoreError> {
        open::open_existing(path).await
    }

    /// Moves the write-ahead log into the database file and closes it, for all clones.
    ///
    /// # Errors
    /// [`StoreError`] of the last checkpoint; what was committed is safe all the same.
    pub async fn close(self) -> Result<(), StoreError> {
        // Readers first: a checkpoint cannot empty the log while they look at it.
        self.probe.close().await;
        self.readers.close().await;
        let checkpoint = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&self.writer).await;
        self.writer.close().await;
        self.checked(checkpoint).map(|_| ())
    }

    /// Makes what was committed so far outlast a loss of power too: a commit alone is written into the log and, for
    /// speed, not synced.
    ///
    /// # Errors
    /// [`StoreError::NotWritable`] if the disk refuses.
    pub async fn sync(&self) -> Result<(), StoreError> {
        open::sync(&self.path).await
    }

    /// What the ledger knows of an export with this content.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn lookup(&self, hash: &ContentHash) -> Result<Option<KnownRun>, StoreError> {
        self.checked(ledger::runs::find_run(&self.readers, hash).await)
    }

    /// Claims the database for one daemon, until the claim is dropped or the process ends.
    ///
    /// # Errors
    /// [`StoreError::Claimed`] while another process holds the claim.
    pub fn claim(&self) -> Result<DaemonClaim, StoreError> {
        claim::claim(&self.path)
    }

    /// What the ledger knows of the export that lay at `path` in this state when it was last taken.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn known_source(&self, path: &str, state: SourceState) -> Result<Option<KnownRun>, StoreError> {
        self.checked(ledger::sources::find(&self.readers, path, state).await)
    }

    /// Writes down that the file at `path`, in this state, holds the export of a run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn remember_source(
        &self,
        path: &str,
        state: SourceState,
        run_id: i64,
    ) -> Result<(), StoreError> {
        self.checked(ledger::sources::remember(&self.writer, path, state, run_id).await)
    }

    /// Runs whose export lay at `path`, in the file of this number under another name, or is of this recording
    /// (robot and start): that of the path first, then the newest.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn earlier_runs(
        &self,
        path: &str,
        file: FileId,
        recording: Option<Recording<'_>>,
    ) -> Result<Vec<EarlierRun>, StoreError> {
        self.checked(ledger::sources::earlier_runs(&self.readers, path, file, recording).await)
    }

    /// Files of runs that are not complete, as they were when the runs were last begun.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn unfinished_sources(&self) -> Result<Vec<UnfinishedSource>, StoreError> {
        self.checked(ledger::sources::unfinished(&self.readers).await)
    }

    /// Ends an unfinished run whose file is gone as quarantined, for `reason`. Its cycles stay, and it goes on if
    /// the file comes back. Returns whether there was such a run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn give_up_run(&self, run_id: i64, reason: &str) -> Result<bool, StoreError> {
        self.checked(ledger::runs::give_up(&self.writer, run_id, reason).await)
    }

    /// Begins the run of the file at `source`, as `beginning` says, and writes down that the file holds it.
    /// The identity must be no other run's, see [`Store::lookup`].
    ///
    /// # Errors
    /// [`StoreError::Refused`] if another run has the identity; others of the database.
    pub async fn begin_source(
        &self,
        header: &RunHeader,
        identity: Identity,
        beginning: Beginning,
        source: SourceState,
    ) -> Result<Begun, StoreError> {
        let mut transaction = self.begin().await?;
        let begun = self.checked(ledger::runs::begin(&mut transaction, header, identity, beginning).await)?;
        let run_id = begun.run.run_id;
        self.checked(
            ledger::sources::remember(&mut *transaction, &header.source_path, source, run_id).await,
        )?;
        self.checked(ledger::sources::set_file(&mut *transaction, run_id, source.file).await)?;
        self.commit(transaction).await?;
        Ok(begun)
    }

    /// Begins a run. A run with this content that was begun before, or is complete, is returned as it
    /// stands; a quarantined one begins afresh, since its export is only read again after a
    /// correction.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn begin_run(&self, header: &RunHeader) -> Result<KnownRun, StoreError> {
        let mut transaction = self.begin().await?;
        let run = self.checked(ledger::runs::begin_run(&mut transaction, header).await)?;
        self.commit(transaction).await?;
        Ok(run)
    }

    /// Stores all rows of a cycle and the run's mark of progress in one transaction. Returns `false`,
    /// and writes nothing, if the run has this cycle already.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] if the run is not streaming.
    pub async fn record_cycle(
        &self,
        run_id: i64,
        analysis: &CycleAnalysis,
        robot: &Robot,
    ) -> Result<bool, StoreError> {
        self.record_cycle_read(run_id, analysis, robot, None).await
    }

    /// As [`Store::record_cycle`], and moves with the mark of progress what the cycles so far were read
    /// from, and where reading goes on after them.
    ///
    /// # Errors
    /// As [`Store::record_cycle`].
    pub async fn record_cycle_read(
        &self,
        run_id: i64,
        analysis: &CycleAnalysis,
        robot: &Robot,
        read: Option<&ReadSoFar>,
    ) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        match self
            .checked(results::record::record_cycle(&mut transaction, run_id, analysis, robot, read).await)?
        {
            Recorded::Stored => self.commit(transaction).await.map(|()| true),
            Recorded::Known => Ok(false),
            Recorded::RunNotOpen => Err(self.run_not_open(run_id)),
        }
    }

    /// Where reading of a run goes on behind cycles that are stored.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn resume_point(&self, run_id: i64) -> Result<Option<StoredPoint>, StoreError> {
        self.checked(ledger::resume::of_run(&self.readers, run_id).await)
    }

    /// Lets a run be read from its start when it is read again.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn forget_resume_point(&self, run_id: i64) -> Result<(), StoreError> {
        self.checked(ledger::resume::forget(&self.writer, run_id).await)
    }

    /// Writes down which sums of standard parameters the base parameters of a description stand for.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a parameter of a joint that the robot does not have.
    pub async fn describe_model(
        &self,
        robot: &Robot,
        groupings: &[(ParameterId, String)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let wanted: Vec<ParameterId> = groupings.iter().map(|(id, _)| *id).collect();
        let model = self.checked(models::robot_model_id(&mut transaction, robot).await)?;
        let keys = self.checked(models::ensure_parameters(&mut transaction, model, robot, &wanted).await)?;
        for (key, grouping) in groupings.iter().filter_map(|(id, text)| Some((keys.get(id)?, text))) {
            self.checked(models::set_grouping(&mut *transaction, *key, grouping).await)?;
        }
        self.commit(transaction).await
    }

    /// Writes down that an export was not understood, why and where. Cycles already stored stay. A
    /// complete run stays complete. Returns the key of the run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn quarantine(&self, header: &RunHeader, fault: &Fault) -> Result<i64, StoreError> {
        let mut transaction = self.begin().await?;
        let run_id = self.checked(ledger::quarantine::quarantine(&mut transaction, header, fault).await)?;
        self.commit(transaction).await?;
        Ok(run_id)
    }

    /// Every fault of every run, those of the newest run first, the latest of a run first.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn faults(&self) -> Result<Vec<QuarantineRow>, StoreError> {
        self.checked(ledger::quarantine::rows(&self.readers).await)
    }

    /// Marks a quarantined run to be read again by the daemon; `false` if it is not quarantined.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn ask_retry(&self, run_id: i64) -> Result<bool, StoreError> {
        self.checked(ledger::quarantine::ask_retry(&self.writer, run_id).await)
    }

    /// Paths at which exports were seen that are marked to be read again.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn paths_to_retry(&self) -> Result<Vec<PathBuf>, StoreError> {
        let paths = self.checked(ledger::quarantine::paths_to_retry(&self.readers).await)?;
        // earlier versions stored paths as they were given
        Ok(paths.into_iter().map(|path| std::path::absolute(&path).unwrap_or_else(|_| path.into())).collect())
    }

    /// What the ledger knows of a run; `None` for an unknown one.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn known_run(&self, run_id: i64) -> Result<Option<KnownRun>, StoreError> {
        match ledger::runs::run_by_key(&self.readers, run_id).await {
            Err(sqlx::Error::RowNotFound) => Ok(None),
            found => self.checked(found).map(Some),
        }
    }

    /// Marks the unfinished run `old` as superseded by `run_id`: its file was written over with the content
    /// of that run. Its rows stay.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn supersede_run(&self, run_id: i64, old: i64) -> Result<(), StoreError> {
        self.checked(ledger::runs::supersede(&self.writer, run_id, old).await)
    }

    /// Takes away the unfinished run `run_id`, because the complete run `other` has its content. What it has
    /// superseded is superseded by that one.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn merge_run(&self, run_id: i64, other: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(ledger::runs::hand_on(&mut *transaction, run_id, other).await)?;
        self.checked(ledger::runs::discard(&mut *transaction, run_id).await)?;
        self.commit(transaction).await
    }

    /// Takes away a run that is not complete, with all its rows. Returns whether there was one.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn discard_run(&self, run_id: i64) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let found = self.checked(ledger::runs::discard(&mut *transaction, run_id).await)?;
        self.commit(transaction).await?;
        Ok(found)
    }

    /// What tells the export of a run; `None` for an unknown run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_source(&self, run_id: i64) -> Result<Option<RunSource>, StoreError> {
        let Some(mut source) = self.checked(ledger::sources::of_run(&self.readers, run_id).await)? else {
            return Ok(None);
        };
        for path in self.checked(ledger::sources::paths_of_run(&self.readers, run_id).await)? {
            let path = PathBuf::from(path);
            if !source.paths.contains(&path) {
                source.paths.push(path);
            }
        }
        Ok(Some(source))
    }

    /// Content that a file name stands for: that of its latest run which is neither quarantined nor superseded
    /// nor growing.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn content_named(&self, source_name: &str) -> Result<Option<ContentHash>, StoreError> {
        self.checked(ledger::sources::content_named(&self.readers, source_name).await)
    }

    /// What the ledger has of each cycle of a run, in order.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn cycle_states(&self, run_id: i64) -> Result<Vec<CycleState>, StoreError> {
        self.checked(results::verification::cycle_states(&self.readers, run_id).await)
    }

    /// RMSD of a run's cycles with their own parameters, by cycle, joint and stage.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn self_rmsd(&self, run_id: i64) -> Result<Vec<OfCycle<TorqueRmsd>>, StoreError> {
        self.checked(results::verification::self_rmsd(&self.readers, run_id).await)
    }

    /// RMSD over the first and over the last third of the warming stages of a run, by cycle and joint.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn warming_contrasts(&self, run_id: i64) -> Result<Vec<OfCycle<WarmingContrast>>, StoreError> {
        self.checked(results::verification::warming_contrasts(&self.readers, run_id).await)
    }

    /// Friction points of a run, in the order of the cycles.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_points(&self, run_id: i64) -> Result<Vec<CyclePoint>, StoreError> {
        self.checked(robot::history::friction_points(&self.readers, run_id).await)
    }

    /// Reads what the stored cycles of a run measured, without holding the writer.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_measurements(&self, run_id: i64) -> Result<RunMeasurements, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(robot::history::run_measurements(&mut connection, run_id).await)
    }

    /// Robots whose history has changed since conclusions were drawn from it, by name.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn stale_robots(&self) -> Result<Vec<StaleRobot>, StoreError> {
        self.checked(robot::conclude::stale_robots(&self.readers).await)
    }

    /// Reads the summaries of a robot's complete runs, ordered by start, then key.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_summaries(&self, robot_id: i64) -> Result<Vec<RunSummary>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(robot::history::run_summaries(&mut connection, robot_id).await)
    }

    /// Reads the friction points of a robot's complete runs at one nominal speed, oldest run first, of a long
    /// history those of the first dozen and the latest two dozen runs; times count from each point's own run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_history(
        &self,
        robot_id: i64,
        speed_fraction: f64,
    ) -> Result<Vec<FrictionPoint>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(robot::friction::friction_history(&mut connection, robot_id, speed_fraction).await)
    }

    /// Reads the friction of a robot's complete runs, oldest first; of a long history the first dozen and the
    /// latest two dozen.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_runs(&self, robot_id: i64) -> Result<Vec<FrictionRun>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(robot::friction::friction_runs(&mut connection, robot_id).await)
    }

    /// Opens the transaction that stores what a robot's history says.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn conclude(&self, robot_id: i64) -> Result<ConclusionTransaction, StoreError> {
        let transaction = self.begin().await?;
        Ok(ConclusionTransaction { transaction, path: Arc::clone(&self.path), robot_id })
    }

    /// Friction indices of the complete runs of a robot, by joint, oldest run first.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_indices(&self, robot: &str) -> Result<Vec<IndexRow>, StoreError> {
        self.checked(robot::friction::indices(&self.readers, robot).await)
    }

    /// What the thermal state of each joint of a robot that has a friction map is taken from, by joint.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn thermal_sources(&self, robot: &str) -> Result<Vec<ThermalSourceRow>, StoreError> {
        self.checked(robot::friction::thermal_sources(&self.readers, robot).await)
    }

    /// Reads which fraction of the rows of each cycle of a run is independent behind its low-pass, by number
    /// of the cycle.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn independent_fractions(&self, run_id: i64) -> Result<HashMap<u32, f64>, StoreError> {
        self.checked(robot::friction::independent_fractions(&self.readers, run_id).await)
    }

    /// Writes down what a run is a recording of.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn set_run_kind(&self, run_id: i64, kind: RunKind) -> Result<(), StoreError> {
        self.checked(ledger::runs::set_kind(&self.writer, run_id, kind).await)
    }

    /// At most `most` complete tests of the robot of run `run_id` whose parameters it may be held against, the best first:
    /// the latest that started no later, and those before it; then the first that started later.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn reference_runs(&self, run_id: i64, most: usize) -> Result<Vec<i64>, StoreError> {
        self.checked(results::production::reference_runs(&self.readers, run_id, most).await)
    }

    /// Complete tests of a robot that production may be held against, oldest first.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn reference_tests(&self, robot_id: i64) -> Result<Vec<ReferenceTest>, StoreError> {
        self.checked(results::production::reference_tests(&self.readers, robot_id).await)
    }

    /// Windows of production of a robot that have factors, by run and number, with the test that they are held
    /// against by `estimator`.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn production_windows(
        &self,
        robot_id: i64,
        estimator: Estimator,
    ) -> Result<Vec<ProductionWindow>, StoreError> {
        self.checked(results::production::windows(&self.readers, robot_id, estimator).await)
    }

    /// The run whose parameters a window of production was held against.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn checked_against(&self, run_id: i64, cycle: u32) -> Result<Option<i64>, StoreError> {
        self.checked(results::production::checked_against(&self.readers, run_id, cycle).await)
    }

    /// Reads the factors of a run's cycles, in the order of the cycles, those without any left out.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn factors_of_run(
        &self,
        run_id: i64,
        wanted: FactorsWanted,
    ) -> Result<Vec<StoredCycle>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(results::factors::of_run(&mut connection, run_id, wanted).await)
    }

    /// Reads the factors of some cycles of a run, given by their numbers in rising order; those without any are left
    /// out. Memory does not grow with the run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn factors_of_cycles(
        &self,
        run_id: i64,
        cycles: &[u32],
    ) -> Result<Vec<StoredCycle>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(results::factors::of_cycles(&mut connection, run_id, cycles).await)
    }

    /// Reads the parameters of one cycle, in no particular order; none for a refused or unknown one.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn cycle_parameters(
        &self,
        run_id: i64,
        cycle: u32,
    ) -> Result<Vec<IdentifiedParameter>, StoreError> {
        self.checked(kept::parameter_sets::of_cycle(&self.readers, run_id, cycle).await)
    }

    /// Keeps parameters under a name. Returns `false`, and writes nothing, if the name is taken.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn save_parameter_set(&self, name: &str, set: &ParameterSet) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let saved = self.checked(kept::parameter_sets::save(&mut transaction, name, set).await)?;
        self.commit(transaction).await?;
        Ok(saved)
    }

    /// Reads the parameters kept under a name.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn parameter_set(&self, name: &str) -> Result<Option<ParameterSet>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(kept::parameter_sets::find(&mut connection, name).await)
    }

    /// Writes how well the parameters of run `reference_run_id`, by `estimator`, fit cycles of run `run_id`, given
    /// by their numbers, in place of what was written of them before. All of it or nothing.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn store_cross_verification(
        &self,
        run_id: i64,
        reference_run_id: i64,
        estimator: Estimator,
        by_cycle: &[(u32, Vec<TorqueRmsd>)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let reference = (reference_run_id, estimator);
        for (cycle, rmsd) in by_cycle {
            let replaced =
                kept::parameter_sets::replace_cross(&mut transaction, run_id, *cycle, reference, rmsd).await;
            self.checked(replaced)?;
        }
        self.commit(transaction).await
    }

    /// Keeps a history identified again under a name, in one transaction; `false`, and nothing is
    /// written, if something of this name is kept.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for parameters that the model does not have.
    pub async fn save_reestimate(&self, name: &str, found: &Reestimate) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let saved = self.checked(kept::reestimates::save(&mut transaction, name, found).await)?;
        self.commit(transaction).await?;
        Ok(saved)
    }

    /// Everything that is kept under a name, by name.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn kept_estimates(&self) -> Result<Vec<KeptEstimate>, StoreError> {
        self.checked(kept::reestimates::kept(&self.readers).await)
    }

    /// Takes away the parameter set or re-estimate of this name; whether there was one.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn delete_estimate(&self, name: &str) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let set = self.checked(kept::reestimates::delete_set(&mut *transaction, name).await)?;
        let reestimate = self.checked(kept::reestimates::delete(&mut *transaction, name).await)?;
        self.commit(transaction).await?;
        Ok(set || reestimate)
    }

    /// Unit and grouping of each parameter of a description.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn model_parameters(
        &self,
        model: &StoredModel,
    ) -> Result<HashMap<ParameterId, ModelParameter>, StoreError> {
        self.checked(models::parameters(&self.readers, model.robot_model_id).await)
    }

    /// Opens the transaction that ends a run. A complete run may be ended again.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] if the run is unknown or quarantined.
    pub async fn finish_run(&self, run_id: i64) -> Result<FinishTransaction, StoreError> {
        let mut transaction = self.begin().await?;
        let robot = self.checked(ledger::runs::robot_of_run(&mut *transaction, run_id).await)?;
        let robot_id = robot.ok_or_else(|| self.run_not_open(run_id))?;
        Ok(FinishTransaction { transaction, path: Arc::clone(&self.path), run_id, robot_id, replaced: None })
    }

    /// All runs, by robot and start.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn runs(&self) -> Result<Vec<RunRow>, StoreError> {
        self.checked(views::runs(&self.readers).await)
    }

    /// Where every joint of every robot with a complete run stands.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn fleet_health(&self) -> Result<Vec<FleetHealthRow>, StoreError> {
        self.checked(views::fleet_health(&self.readers).await)
    }

    /// Anomalies found after the one with key `after` (0 for all), in the order found.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn anomalies_after(&self, after: i64) -> Result<Vec<AnomalyRow>, StoreError> {
        self.checked(views::anomalies_after(&self.readers, after).await)
    }

    /// How much is stored.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        self.checked(views::counts(&self.readers).await)
    }

    /// A transaction that has the write lock. A deferred one that reads first and writes later would
    /// fail at once where this one waits.
    async fn begin(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        self.checked(self.writer.begin_with("BEGIN IMMEDIATE").await)
    }

    async fn commit(&self, transaction: Transaction<'static, Sqlite>) -> Result<(), StoreError> {
        self.checked(transaction.commit().await)
    }

    fn run_not_open(&self, run_id: i64) -> StoreError {
        StoreError::RunNotOpen { path: self.path.to_path_buf(), run_id }
    }

    fn checked<T>(&self, result: Result<T, sqlx::Error>) -> Result<T, StoreError> {
        result.map_err(|error| StoreError::from_sqlx(&self.path, &error))
    }
}
