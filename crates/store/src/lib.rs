//! Results in SQLite, or on a PostgreSQL server. There is one writer and several readers. Every write is one
//! transaction that starts with the write lock, so it waits for another writer only once, at its beginning.
//!
//! Users read the views of `migrations/`; the tables behind them are private to this crate. Functions below the facade
//! contain one statement each and accept any connection, so that they compose.

pub mod export;
mod engine;
mod ledger;
mod results;
mod robot;
mod kept;
mod delivery;
#[cfg(test)]
mod tests;
mod views;
mod claim;
mod descriptor;
mod error;
mod finish;
mod handle;
mod hosts;
mod inode_lock;
mod own_host;
mod models;
mod monitoring;
mod soundness;
mod synthetic;
mod write_ahead_log;
mod schema;
mod server;
mod open;
mod open_files;
mod small_blocks;
mod table;
mod public_sql;
mod question;
mod retention;
mod partial;
mod snapshot;
mod backup;
mod verified_copy;
mod lists;
mod values;
mod view_columns;
mod view_reader;

pub use claim::{DaemonClaim, DaemonState, lock_file_of};
pub use delivery::alarm::AlarmEvent;
pub use delivery::queue::{Again, DueMessage, RouteState, SendDecision};
pub use delivery::routes::{EventFate, Held, RouteEntry};
pub use error::StoreError;
pub use finish::{FinishTransaction, Replaced};
pub use handle::Store;
pub use hosts::HostSession;
pub use hosts::folders::UnansweredFolder;
pub use hosts::kinds::{ClaimKind, SessionKind};
pub use hosts::list::{HostRow, HostState};
pub use kept::estimates::{EstimateTransaction, NewEstimate, OtherEstimate};
pub use kept::parameter_sets::{ParameterSet, SourceCycle};
pub use kept::reestimates::{
    CycleView, KeptEstimate, KeptKind, Reestimate, ReestimatedCycle, ReestimatedStatistics,
};
pub use ledger::attempts::{Attempt, AttemptKind, AttemptOn, QUIET_START, wait_for_quiet};
pub use ledger::blocked::{BlockReason, BlockedFile};
pub use ledger::quarantine::{Dismissal, ExportFault, FaultState, QuarantineRow};
pub use ledger::resume::{ReadSoFar, StoredPoint};
pub use ledger::run_progress::RunTotals;
pub use ledger::runs::{BegunRun, Identity, KnownRun, Owner, RunStart};
pub use ledger::sources::{EarlierRun, RecordingName, RunSource, SourceState, UnfinishedSource};
pub use lists::ListFilter;
pub use models::{ModelParameter, StoredModel, description_hash};
pub use monitoring::{AnomalyCount, DatabaseSize, RouteCounts};
pub use public_sql::{SqlAnswer, SqlError, SqlLimits};
pub use question::{QuestionAnswer, QuestionError, SqlQuestion};
pub use results::factors::{FactorsWanted, StoredCycle};
pub use results::joined_factors::{JoinedFactors, WindowsToJoin};
pub use results::production::{ProductionWindow, ReferenceTest};
pub use results::run_analysis::JointDeviation;
pub use results::verification::{CycleState, FactorsGone, OfCycle};
pub use retention::{DueRun, FreeSpace, KeptSince, MOST_REFERENCES};
pub use robot::alarms::alarm_life::{AlarmAction, AnomalyHistoryRow, NotDone, SeriesRun};
pub use robot::alarms::alarm_state::{AlarmState, EventKind};
pub use robot::alarms::anomalies::{AnomalyEvent, Reconciled};
pub use robot::alarms::health::{OverdueRobot, RunResult};
pub use robot::conclude::{ConclusionTransaction, StaleRobot};
pub use robot::conclusion_faults::ConclusionFault;
pub use robot::dates::{DatedPlace, DatedRun, DecidedRun, NotDecided, RunDecision};
pub use robot::figures::friction_series::{FrictionSeries, TestPoints};
pub use robot::indices::baseline_plan::known::{KnownMap, KnownPlan};
pub use robot::indices::baseline_plan::{FrictionPlan, PlannedMap, PlannedTest, plan};
pub use robot::indices::baselines::{
    BaselineChange, BaselineRow, FrictionConclusion, FrictionTest, FrictionTests, IndexBasis, NewBaseline,
    NewIndices, ReplacedBaseline, StoredBaseline,
};
pub use robot::indices::friction::{CycleSpeedFits, IndexRow, ThermalSourceRow};
pub use robot::maintenance::{DescriptionKey, MaintenanceRow, NewMaintenance, NotEntered};
pub use robot::summaries::TestWindow;
pub use robot::unfinished_run::OpenTest;
pub use robot::windows::NewWindow;
pub use synthetic::{SYNTHETIC_FILE_BYTES, SyntheticSize};
pub use table::{AskError, ResultTable, ViewRows};
pub use values::time_in_views;
pub use verified_copy::Backup;
pub use view_columns::{PublicView, ViewColumn, public_views};
pub use view_reader::{RowFilter, ViewReader};
pub use views::{AnomalyRow, FleetHealthRow, HealthStatus, RunRow, StoredCounts};
