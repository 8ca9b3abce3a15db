//! Implausible starts, starts that a person has corrected, and runs that are set aside.
//!
//! A run that is set aside takes no part in conclusions. It is its own successor, with the status of a superseded one.
//! It keeps its rows, and every query that omits superseded runs omits it.

use jiff::Timestamp;
use sqlx::Row;

use super::settled;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::ledger::attempts::{self, AttemptKind};
use crate::ledger::identity::move_start;
use crate::values::{known_time, named, time, time_in_views};
use armwatch_model::run::arrival::{Arrival, ImplausibleDate};
use armwatch_model::run::{RunKind, RunStatus};

/// Values of the column `set_aside`.
const PERSON: &str = "person";
const MISDATED: &str = "implausible_date";
const BY_ARRIVAL: &str = "arrival_order";

/// A run as its start is judged: complete, or set aside for its start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DatedRun {
    /// Database key.
    pub run_id: i64,
    /// Test or production.
    pub kind: RunKind,
    /// File name of the export.
    pub source_name: String,
    /// Path of the export in the ledger.
    pub source_path: String,
    /// Start of the recording, as recorded or as a person has corrected it.
    pub started_at: Timestamp,
    /// Time of its first reading.
    pub arrived_at: Timestamp,
    /// Modification time of its file.
    pub file_time: Option<Timestamp>,
    /// True if a person has corrected or confirmed the start.
    pub is_confirmed: bool,
    /// Reason why its start is implausible, as stored.
    pub problem: Option<String>,
    /// Place in the history.
    pub place: DatedPlace,
}

/// Place of a run in the history of its robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DatedPlace {
    /// At its start.
    Start,
    /// At this time, in the order of arrival. It can open alarms, and takes no part in earlier ones.
    Arrival(Timestamp),
    /// Nowhere: it is set aside.
    LeftOut,
}

impl DatedRun {
    /// The run as part of the sequence of arrivals.
    pub fn arrival(&self) -> Arrival<'_> {
        Arrival {
            started_at: self.started_at,
            arrived_at: self.arrived_at,
            file_time: self.file_time,
            folder: self.source_path.rsplit_once('/').map_or("", |(folder, _)| folder),
            is_confirmed: self.is_confirmed,
        }
    }
}

/// A decision of a person about one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RunDecision {
    /// Its start is this.
    StartedAt(Timestamp),
    /// It began when it was first read.
    StartedAtArrival,
    /// Its start is right.
    Confirm,
    /// Its start is the recorded one, and is judged again.
    StartAsRecorded,
    /// It is set aside, by this person.
    SetAside(String),
    /// It takes part in conclusions again.
    TakeBack,
}

/// Reason why a decision was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotDecided {
    /// There is no such run.
    NoRun,
    /// Decisions are only possible for runs that were read completely; this one was not.
    Status(RunStatus),
    /// There is nothing to undo.
    NothingToUndo,
}

/// A run after a decision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DecidedRun {
    /// The robot.
    pub robot: String,
    /// File name of the export.
    pub source_name: String,
    /// Start of the recording from now on.
    pub started_at: Timestamp,
    /// Start as recorded, if a person has corrected or confirmed it.
    pub recorded_start: Option<Timestamp>,
}

impl Store {
    /// Runs of the robot of this name whose starts are judged, in the order of their arrival.
    pub async fn dated_runs(&self, robot: &str) -> Result<Vec<DatedRun>, StoreError> {
        self.checked(dated_runs(&self.readers, robot).await)
    }

    /// Stores the judgement on the starts of these runs, and gives them their places in the history.
    pub async fn mark_dates(
        &self,
        found: &[(i64, Option<ImplausibleDate>, DatedPlace)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let marked = mark_dates(&mut transaction, found).await;
        self.checked(marked)?;
        self.commit(transaction).await
    }

    /// Applies a decision about a run, which makes the conclusions of its robot stale.
    pub async fn decide_about_run(
        &self,
        run_id: i64,
        decision: &RunDecision,
    ) -> Result<Result<DecidedRun, NotDecided>, StoreError> {
        let mut transaction = self.begin().await?;
        let decided = decide(&mut transaction, run_id, decision).await;
        let decided = self.checked(decided)?;
        if decided.is_ok() {
            self.commit(transaction).await?;
        }
        Ok(decided)
    }
}

async fn dated_runs(executor: impl EngineExecutor<'_>, robot: &str) -> sqlx::Result<Vec<DatedRun>> {
    sqlx::query(
        "SELECT run.run_id, run.kind, run.source_name, run.source_path, run.started_at, run.recorded_start,
                run.ingested_at, run.date_problem, run.set_aside,
                (SELECT max(source_file.modified) FROM source_file
                 WHERE source_file.run_id = run.run_id AND source_file.path = run.source_path) AS file_time
         FROM run
         WHERE run.robot_id = (SELECT robot.robot_id FROM robot WHERE robot.name = $1)
               AND (run.status = 'complete' OR run.set_aside = 'implausible_date')
         ORDER BY run.run_id",
    )
    .bind(robot)
    .try_map(|row: EngineRow| {
        let (started_at, recorded) = (time(&row, "started_at")?, known_time(&row, "recorded_start")?);
        let set_aside: Option<String> = row.try_get("set_aside")?;
        let place = match set_aside.as_deref() {
            None => DatedPlace::Start,
            Some(BY_ARRIVAL) => DatedPlace::Arrival(started_at),
            Some(_) => DatedPlace::LeftOut,
        };
        let is_by_arrival = matches!(place, DatedPlace::Arrival(_));
        Ok(DatedRun {
            run_id: row.try_get("run_id")?,
            kind: named(&row, "kind", &[RunKind::Test, RunKind::Production], RunKind::name)?,
            source_name: row.try_get("source_name")?,
            source_path: row.try_get("source_path")?,
            started_at: recorded.filter(|_| is_by_arrival).unwrap_or(started_at),
            arrived_at: time(&row, "ingested_at")?,
            file_time: known_time(&row, "file_time")?,
            is_confirmed: recorded.is_some() && !is_by_arrival,
            problem: row.try_get("date_problem")?,
            place,
        })
    })
    .fetch_all(executor)
    .await
}

async fn mark_dates(
    connection: &mut EngineConnection,
    found: &[(i64, Option<ImplausibleDate>, DatedPlace)],
) -> sqlx::Result<()> {
    for (run_id, date, place) in found {
        let problem = date.map(|date| date.to_string());
        let reason = problem.as_deref().unwrap_or("its start is being corrected");
        if let Some(RunDate { run, set_aside, .. }) = standing(&mut *connection, *run_id).await?
            && set_aside.as_deref() == Some(BY_ARRIVAL)
        {
            leave(&mut *connection, *run_id, MISDATED, reason).await?;
            place_start(&mut *connection, *run_id, run.started_at, None).await?;
        }
        match place {
            DatedPlace::Start => come_back(&mut *connection, *run_id, MISDATED, None).await?,
            DatedPlace::LeftOut => leave(&mut *connection, *run_id, MISDATED, reason).await?,
            DatedPlace::Arrival(at) => {
                leave(&mut *connection, *run_id, MISDATED, reason).await?;
                if let Some(RunDate { run, .. }) = standing(&mut *connection, *run_id).await? {
                    place_start(&mut *connection, *run_id, *at, Some(run.started_at)).await?;
                }
                come_back(&mut *connection, *run_id, MISDATED, Some(BY_ARRIVAL)).await?;
            }
        }
        sqlx::query("UPDATE run SET date_problem = $2 WHERE run_id = $1")
            .bind_all((run_id, &problem))
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

/// Sets aside a run that was read completely.
async fn leave(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    set_aside: &str,
    reason: &str,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run SET status = 'quarantined', reason = $3, superseded_by_run_id = run_id, set_aside = $2
         WHERE run_id = $1 AND (status = 'complete' OR set_aside IS NOT NULL)",
    )
    .bind_all((run_id, set_aside, reason))
    .run(executor)
    .await
}

/// Lets a run take part again that is set aside for this, marked as `now`.
async fn come_back(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    set_aside: &str,
    now: Option<&str>,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run SET status = 'complete', reason = NULL, superseded_by_run_id = NULL, set_aside = $3
         WHERE run_id = $1 AND set_aside = $2",
    )
    .bind_all((run_id, set_aside, now))
    .run(executor)
    .await
}

/// A run before a decision. The start is the recorded one if the run has its place by arrival.
struct RunDate {
    run: DecidedRun,
    status: RunStatus,
    set_aside: Option<String>,
    arrived_at: Timestamp,
}

async fn standing(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Option<RunDate>> {
    sqlx::query(
        "SELECT robot.name AS robot, run.source_name, run.started_at, run.recorded_start, run.set_aside, run.ingested_at,
                CASE WHEN run.superseded_by_run_id IS NULL THEN run.status
                     WHEN run.superseded_by_run_id = run.run_id THEN 'set_aside' ELSE 'superseded' END AS status
         FROM run JOIN robot USING (robot_id)
         WHERE run.run_id = $1",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let set_aside: Option<String> = row.try_get("set_aside")?;
        let started_at = time(&row, "started_at")?;
        let recorded = known_time(&row, "recorded_start")?;
        let (started_at, recorded_start) = match (recorded, set_aside.as_deref()) {
            (Some(recorded), Some(BY_ARRIVAL)) => (recorded, None),
            _ => (started_at, recorded),
        };
        Ok(RunDate {
            run: DecidedRun {
                robot: row.try_get("robot")?,
                source_name: row.try_get("source_name")?,
                started_at,
                recorded_start,
            },
            status: named(&row, "status", &RunStatus::ALL, RunStatus::name)?,
            set_aside,
            arrived_at: time(&row, "ingested_at")?,
        })
    })
    .fetch_optional(executor)
    .await
}

async fn decide(
    connection: &mut EngineConnection,
    run_id: i64,
    decision: &RunDecision,
) -> sqlx::Result<Result<DecidedRun, NotDecided>> {
    let Some(RunDate { mut run, status, set_aside, arrived_at }) = standing(&mut *connection, run_id).await?
    else {
        return Ok(Err(NotDecided::NoRun));
    };
    if !matches!(status, RunStatus::Complete | RunStatus::SetAside) {
        return Ok(Err(NotDecided::Status(status)));
    }
    let started_at = run.started_at;
    match decision {
        RunDecision::StartedAt(_) | RunDecision::StartedAtArrival | RunDecision::Confirm => {
            run.recorded_start = Some(run.recorded_start.unwrap_or(run.started_at));
            run.started_at = match decision {
                RunDecision::StartedAt(at) => *at,
                RunDecision::StartedAtArrival => arrived_at,
                _ => run.started_at,
            };
            correct_start(&mut *connection, run_id, &run, set_aside.as_deref()).await?;
        }
        RunDecision::StartAsRecorded => {
            let Some(recorded) = run.recorded_start else { return Ok(Err(NotDecided::NothingToUndo)) };
            (run.started_at, run.recorded_start) = (recorded, None);
            correct_start(&mut *connection, run_id, &run, set_aside.as_deref()).await?;
        }
        RunDecision::SetAside(who) => {
            if set_aside.as_deref() == Some(BY_ARRIVAL) {
                correct_start(&mut *connection, run_id, &run, None).await?;
            }
            leave(&mut *connection, run_id, PERSON, &format!("set aside by {who}")).await?;
        }
        RunDecision::TakeBack if set_aside.as_deref() == Some(PERSON) => {
            come_back(&mut *connection, run_id, PERSON, None).await?;
        }
        RunDecision::TakeBack => return Ok(Err(NotDecided::NothingToUndo)),
    }
    settled::reopen(&mut *connection, &run.robot, started_at.min(run.started_at)).await?;
    // runs that were set aside before have changed no history, but their robot needs a new conclusion
    let stale = "UPDATE robot SET history = history + 1 WHERE name = $1";
    sqlx::query(stale).bind(&run.robot).execute(&mut *connection).await?;
    // the history has changed, so a conclusion that ended the program may be tried again
    attempts::end(&mut *connection, AttemptKind::Conclusion, &run.robot).await?;
    Ok(Ok(run))
}

/// Gives a run the start of `run`. It leaves the history and returns, so that everything that depends on its place is
/// computed again.
async fn correct_start(
    connection: &mut EngineConnection,
    run_id: i64,
    run: &DecidedRun,
    set_aside: Option<&str>,
) -> sqlx::Result<()> {
    let by_person = set_aside == Some(PERSON);
    if !by_person {
        leave(&mut *connection, run_id, MISDATED, "its start is being corrected").await?;
    }
    place_start(&mut *connection, run_id, run.started_at, run.recorded_start).await?;
    sqlx::query("UPDATE run SET date_problem = NULL WHERE run_id = $1")
        .bind(run_id)
        .execute(&mut *connection)
        .await?;
    if !by_person {
        come_back(&mut *connection, run_id, MISDATED, None).await?;
    }
    Ok(())
}

/// Moves the start of a run. `recorded` is the recorded start if the new one is another.
async fn place_start(
    connection: &mut EngineConnection,
    run_id: i64,
    start: Timestamp,
    recorded: Option<Timestamp>,
) -> sqlx::Result<()> {
    move_start(&mut *connection, run_id, start).await?;
    sqlx::query("UPDATE run SET recorded_start = $2, recorded_start_text = $3 WHERE run_id = $1")
        .bind_all((run_id, recorded.map(Timestamp::as_microsecond), recorded.map(time_in_views)))
        .run(&mut *connection)
        .await
}
