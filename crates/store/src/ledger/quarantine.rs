//! Exports that could not be read: their faults, the times, and who asked for another attempt.
//!
//! A content has one row in the ledger, so a run that is read again keeps its number. The faults of all attempts are
//! stored with it. The state of a fault is derived from the run and not stored.

use std::path::PathBuf;

use jiff::Timestamp;
use serde::{Serialize, Serializer};
use sqlx::Row;

use super::robots::robot_id;
use super::runs::{find_run, insert_run};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{count, in_views, known_in_views, named, size, time_text};
use armwatch_model::run::{RunHeader, RunStatus};

/// The fault of an export.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ExportFault {
    /// Place, fault and remedy in one sentence, without the file.
    pub reason: String,
    /// The fault alone; if there is a value, it follows after "value is ".
    pub problem: String,
    /// Line in the decompressed file, from 1.
    pub line: Option<u64>,
    /// Column in the header.
    pub column: Option<String>,
    /// First byte of the cell, or else of the line, in the decompressed file, from 0.
    pub byte: Option<u64>,
    /// Content of that place.
    pub value: Option<String>,
    /// Remedy.
    pub remedy: String,
}

/// A row of the view `quarantine`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct QuarantineRow {
    /// Database key of the run.
    pub run_id: i64,
    /// The individual robot; `unknown` if the file name does not contain it.
    pub robot: String,
    /// File name of the export.
    pub source_name: String,
    /// First known path.
    #[serde(rename = "file")]
    pub source_path: String,
    /// State of the fault.
    pub state: FaultState,
    /// The fault alone.
    pub problem: String,
    /// Line in the decompressed file, from 1.
    pub line: Option<u64>,
    /// Column in the header.
    pub column: Option<String>,
    /// First byte of the cell, or else of the line, in the decompressed file, from 0.
    pub byte: Option<u64>,
    /// Content of that place.
    pub value: Option<String>,
    /// Remedy.
    pub remedy: String,
    /// Complete cycles before the fault, which were stored.
    pub cycles_stored: u32,
    /// Attempts that found exactly this fault.
    pub tries: u32,
    /// Time of the first of them.
    #[serde(serialize_with = "in_views")]
    pub first_at: Timestamp,
    /// Time of the last of them.
    #[serde(serialize_with = "in_views")]
    pub last_at: Timestamp,
    /// Time of a person's request for another attempt, if that was not made yet.
    #[serde(serialize_with = "known_in_views")]
    pub retry_asked_at: Option<Timestamp>,
    /// Run that supersedes this one.
    pub superseded_by_run_id: Option<i64>,
    /// Dismissal by a person.
    #[serde(flatten, serialize_with = "dismissal_columns")]
    pub dismissal: Option<Dismissal>,
}

/// A person's statement that nothing is to be done about a fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dismissal {
    /// Time.
    pub at: Timestamp,
    /// Person.
    pub by: String,
    /// Reason.
    pub reason: String,
}

/// The columns of the view `quarantine` that are NULL without a dismissal.
fn dismissal_columns<S: Serializer>(of: &Option<Dismissal>, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct DismissalColumns<'a> {
        #[serde(serialize_with = "known_in_views")]
        dismissed_at: Option<Timestamp>,
        dismissed_by: Option<&'a str>,
        dismissal_reason: Option<&'a str>,
    }
    let of = of.as_ref();
    DismissalColumns {
        dismissed_at: of.map(|of| of.at),
        dismissed_by: of.map(|of| of.by.as_str()),
        dismissal_reason: of.map(|of| of.reason.as_str()),
    }
    .serialize(serializer)
}

armwatch_model::named_enum! {
    /// State of a fault.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum FaultState {
        /// Someone has to act.
        Open = "open",
        /// A person has stated that nothing is to be done.
        Dismissed = "dismissed",
        /// A later attempt found another fault.
        Earlier = "earlier",
        /// The export is being read again.
        Reading = "reading",
        /// A later attempt read the export successfully.
        Stored = "stored",
        /// A corrected export supersedes it.
        Superseded = "superseded",
    }
}

armwatch_model::serialize_by_name!(FaultState);

impl Store {
    /// Stores that an export could not be read, with the reason and place. Stored cycles stay, and a complete run stays
    /// complete. Returns the key of the run.
    pub async fn quarantine(&self, header: &RunHeader, fault: &ExportFault) -> Result<i64, StoreError> {
        let mut transaction = self.begin().await?;
        if let Some(run) =
            self.checked(find_run(&mut *transaction, &header.content_hash, &header.robot).await)?
        {
            self.refuse_run_of_another(&mut transaction, run.run_id).await?;
        }
        let run_id = self.checked(quarantine(&mut transaction, header, fault).await)?;
        self.commit(transaction).await?;
        Ok(run_id)
    }

    /// Every fault of every run; newest run first, then latest fault first.
    pub async fn faults(&self) -> Result<Vec<QuarantineRow>, StoreError> {
        self.checked(rows(&self.readers).await)
    }

    /// Marks a quarantined run to be read again by the daemon; `false` if it is not quarantined.
    pub async fn ask_retry(&self, run_id: i64) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let is_asked = self.checked(ask_retry(&mut *transaction, run_id).await)?;
        self.commit(transaction).await?;
        Ok(is_asked)
    }

    /// Paths of exports that are marked to be read again.
    pub async fn paths_to_retry(&self) -> Result<Vec<PathBuf>, StoreError> {
        let paths = self.checked(paths_to_retry(&self.readers).await)?;
        let here = paths.iter().filter_map(|path| self.local_path(path));
        // earlier versions stored paths as they were given
        Ok(here.map(|path| std::path::absolute(&path).unwrap_or(path)).collect())
    }
}

/// Stores that an export could not be read. Stored cycles stay, and a complete run stays complete.
pub(crate) async fn quarantine(
    connection: &mut EngineConnection,
    header: &RunHeader,
    fault: &ExportFault,
) -> sqlx::Result<i64> {
    let run_id = match find_run(&mut *connection, &header.content_hash, &header.robot).await? {
        Some(run) if matches!(run.status, RunStatus::Complete | RunStatus::Superseded) => {
            return Ok(run.run_id);
        }
        Some(run) => run.run_id,
        None => {
            let robot_id = robot_id(&mut *connection, &header.robot).await?;
            insert_run(&mut *connection, robot_id, header).await?
        }
    };
    rename_robot(&mut *connection, run_id, &header.robot).await?;
    mark(&mut *connection, run_id, fault).await?;
    if !count_again(&mut *connection, run_id, fault).await? {
        insert(connection, run_id, fault).await?;
    }
    Ok(run_id)
}

/// Moves a run without cycles to another robot, because its file name turned out to contain none. Deletes a robot that
/// has no more runs.
async fn rename_robot(connection: &mut EngineConnection, run_id: i64, robot: &str) -> sqlx::Result<()> {
    let before: Option<i64> = sqlx::query_scalar(
        "SELECT robot_id FROM run JOIN robot USING (robot_id)
         WHERE run_id = $1 AND cycles_stored = 0 AND robot.name <> $2",
    )
    .bind_all((run_id, robot))
    .fetch_optional(&mut *connection)
    .await?;
    let Some(before) = before else { return Ok(()) };
    let robot_id = robot_id(&mut *connection, robot).await?;
    sqlx::query("UPDATE run SET robot_id = $1 WHERE run_id = $2")
        .bind_all((robot_id, run_id))
        .execute(&mut *connection)
        .await?;
    sqlx::query(
        "DELETE FROM robot
         WHERE robot_id = $1 AND NOT EXISTS (SELECT 1 FROM run WHERE run.robot_id = $1)",
    )
    .bind(before)
    .run(connection)
    .await
}

async fn mark(executor: impl EngineExecutor<'_>, run_id: i64, fault: &ExportFault) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET status = 'quarantined', reason = $1, reason_line = $2, reason_column = $3, retry_asked_at = NULL
         WHERE run_id = $4",
    )
    .bind_all((&fault.reason, fault.line.map(count), &fault.column, run_id))
    .run(executor)
    .await
}

/// Counts another attempt with the same fault as the one before; `false` if the fault is another one.
async fn count_again(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    fault: &ExportFault,
) -> sqlx::Result<bool> {
    let done = sqlx::query(
        "UPDATE fault
         SET tries = tries + 1, last_at = CAST(unixepoch('subsec') * 1000000 AS BIGINT),
             cycles_stored = (SELECT run.cycles_stored FROM run WHERE run.run_id = fault.run_id)
         WHERE fault_id = (SELECT max(latest.fault_id) FROM fault AS latest WHERE latest.run_id = $1)
           AND problem = $2 AND line IS NOT DISTINCT FROM $3 AND column_name IS NOT DISTINCT FROM $4
           AND byte IS NOT DISTINCT FROM $5 AND value IS NOT DISTINCT FROM $6",
    )
    .bind_all((run_id, &fault.problem, fault.line.map(count), &fault.column, fault.byte.map(count)))
    .bind(&fault.value)
    .execute(executor)
    .await?;
    Ok(done.rows_affected() > 0)
}

async fn insert(executor: impl EngineExecutor<'_>, run_id: i64, fault: &ExportFault) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO fault (run_id, problem, line, column_name, byte, value, remedy, cycles_stored)
         SELECT run_id, $1, $2, $3, $4, $5, $6, cycles_stored FROM run WHERE run_id = $7",
    )
    .bind_all((&fault.problem, fault.line.map(count), &fault.column, fault.byte.map(count), &fault.value))
    .bind_all((&fault.remedy, run_id))
    .run(executor)
    .await
}

/// Every fault of every run; newest run first, then latest fault first.
pub(crate) async fn rows(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<QuarantineRow>> {
    sqlx::query(
        "SELECT run_id, robot, source_name, source_path, state, problem, line, column_name, byte, value, remedy,
                cycles_stored, tries, first_at, last_at, retry_asked_at, superseded_by_run_id,
                dismissed_at, dismissed_by, dismissal_reason
         FROM quarantine
         ORDER BY run_id DESC, last_at DESC, fault_id DESC",
    )
    .try_map(|row: EngineRow| {
        let asked: Option<&str> = row.try_get("retry_asked_at")?;
        Ok(QuarantineRow {
            run_id: row.try_get("run_id")?,
            robot: row.try_get("robot")?,
            source_name: row.try_get("source_name")?,
            source_path: row.try_get("source_path")?,
            state: named(&row, "state", &FaultState::ALL, FaultState::name)?,
            problem: row.try_get("problem")?,
            line: row.try_get("line")?,
            column: row.try_get("column_name")?,
            byte: row.try_get("byte")?,
            value: row.try_get("value")?,
            remedy: row.try_get("remedy")?,
            cycles_stored: size(&row, "cycles_stored")?,
            tries: size(&row, "tries")?,
            first_at: time_text(&row, "first_at")?,
            last_at: time_text(&row, "last_at")?,
            retry_asked_at: asked.map(|_| time_text(&row, "retry_asked_at")).transpose()?,
            superseded_by_run_id: row.try_get("superseded_by_run_id")?,
            dismissal: dismissal(&row)?,
        })
    })
    .fetch_all(executor)
    .await
}

fn dismissal(row: &EngineRow) -> sqlx::Result<Option<Dismissal>> {
    let at: Option<&str> = row.try_get("dismissed_at")?;
    at.map(|_| {
        Ok(Dismissal {
            at: time_text(row, "dismissed_at")?,
            by: row.try_get("dismissed_by")?,
            reason: row.try_get("dismissal_reason")?,
        })
    })
    .transpose()
}

impl Store {
    /// Dismisses the latest fault of a quarantined run. `false` if the run is not quarantined, or its fault is already
    /// dismissed.
    pub async fn dismiss(&self, run_id: i64, by: &str, reason: &str) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let done = sqlx::query(
            "INSERT INTO dismissal (fault_id, dismissed_by, reason)
             SELECT fault_id, $2, $3 FROM quarantine WHERE run_id = $1 AND state = 'open'",
        )
        .bind_all((run_id, by, reason))
        .execute(&mut *transaction)
        .await;
        let is_put_aside = self.checked(done)?.rows_affected() > 0;
        self.commit(transaction).await?;
        Ok(is_put_aside)
    }

    /// Withdraws the dismissal of a run's fault; the dismissal stays on record.
    pub async fn withdraw_dismissal(&self, run_id: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let done = sqlx::query(
            "UPDATE dismissal SET withdrawn_at = CAST(unixepoch('subsec') * 1000000 AS BIGINT)
             WHERE withdrawn_at IS NULL AND fault_id IN (SELECT fault_id FROM fault WHERE run_id = $1)",
        )
        .bind(run_id)
        .execute(&mut *transaction)
        .await;
        self.checked(done)?;
        self.commit(transaction).await
    }
}

/// Marks a quarantined run to be read again; `false` if it is not quarantined.
pub(crate) async fn ask_retry(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    let done = sqlx::query(
        "UPDATE run
         SET retry_asked_at = CAST(unixepoch('subsec') * 1000000 AS BIGINT)
         WHERE run_id = $1 AND status = 'quarantined' AND superseded_by_run_id IS NULL",
    )
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(done.rows_affected() > 0)
}

/// Paths of exports that are marked to be read again.
pub(crate) async fn paths_to_retry(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<String>> {
    sqlx::query_scalar(
        "SELECT source_path FROM run WHERE retry_asked_at IS NOT NULL
         UNION
         SELECT source_file.path FROM run JOIN source_file USING (run_id) WHERE retry_asked_at IS NOT NULL",
    )
    .fetch_all(executor)
    .await
}

/// Lets `run_id`, which is complete, supersede quarantined runs of the same recording: those with the same robot, start
/// and file name. Their content was corrected.
pub(crate) async fn supersede_faulty(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET reason = 'superseded by run ' || complete.run_id || ': the export was corrected', reason_line = NULL,
             reason_column = NULL, superseded_by_run_id = complete.run_id, retry_asked_at = NULL
         FROM run AS complete
         WHERE complete.run_id = $1 AND run.run_id <> complete.run_id AND run.status = 'quarantined'
           AND run.superseded_by_run_id IS NULL AND run.robot_id = complete.robot_id
           AND run.started_at = complete.started_at AND run.source_name = complete.source_name",
    )
    .bind(run_id)
    .run(executor)
    .await
}
