//! The ledger: one row per export, whatever its outcome.
//!
//! A superseded run has the status `quarantined` and names its successor. Every query that omits quarantined runs
//! therefore omits it too.

use sqlx::Row;

use super::identity::{is_made_otherwise, set_made_with};
use super::robots::robot_id;
use super::{resume, stored_cycles};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::ledger::supersession::{hand_on, set_replaced, supersede};
use crate::values::{count, named, size};
use armwatch_config::UNKNOWN_ROBOT;
use armwatch_model::run::{ContentHash, ContentPrefix, RunHeader, RunKind, RunStatus};

/// State of an export in the ledger.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownRun {
    /// Database key of the run.
    pub run_id: i64,
    /// Status.
    pub status: RunStatus,
    /// Reason for its quarantine.
    pub reason: Option<String>,
    /// Cycles stored so far; reading continues after them.
    pub cycles_stored: u32,
    /// True if a person has asked for a quarantined export to be read again.
    pub retry_asked: bool,
}

/// Identity of a run while it is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Identity {
    /// Hash of its content, which has settled.
    Content(ContentHash),
    /// First bytes of an export that still grows: the source of the stored cycles; none without cycles.
    Growing(ContentPrefix),
}

/// How the run of an export begins, given the earlier content of its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RunStart {
    /// Continues this run, whose stored cycles come from the first bytes of the same content. Cycles that the end of
    /// the file had cut are read again. A quarantined or superseded run begins from its first row. `None`: a new run.
    pub continues: Option<i64>,
    /// Replaces this run, whose file was rewritten.
    pub replaces: Option<i64>,
    /// Everything that determines the cycles of the run, except its bytes. A continued run begins from its first row if
    /// its stored cycles were made with something else. `None`: not compared.
    pub made_with: Option<ContentHash>,
    /// True if a continued run begins from its first row in any case, because a person asked for it.
    pub afresh: bool,
}

/// A run that has begun.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BegunRun {
    /// The run.
    pub run: KnownRun,
    /// True if cycles were deleted because they were made with something else.
    pub afresh: bool,
}

/// The owner of a content's identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// The run itself.
    Ours,
    /// This run, which is complete or set aside, with the same content.
    Other(i64),
}

impl Store {
    /// State of the export with this content; if several robots have one, that of the first.
    pub async fn lookup(&self, hash: &ContentHash) -> Result<Option<KnownRun>, StoreError> {
        Ok(self.runs_of_content(hash).await?.into_iter().next().map(|(run, ..)| run))
    }

    /// Returns true if a run has an export of this size. Only then can a content be that of a known export.
    pub async fn has_run_of_bytes(&self, bytes: u64) -> Result<bool, StoreError> {
        let found = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run WHERE source_bytes = $1)");
        self.checked(found.bind(count(bytes)).fetch_one(&self.readers).await)
    }

    /// Quarantines an unfinished run whose file is gone, for `reason`. Its cycles stay, and reading continues if the
    /// file returns. Returns true if there was such a run.
    pub async fn give_up_run(&self, run_id: i64, reason: &str) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        self.refuse_run_of_another(&mut transaction, run_id).await?;
        let is_given_up = self.checked(give_up(&mut *transaction, run_id, reason).await)?;
        self.commit(transaction).await?;
        Ok(is_given_up)
    }

    /// Begins a run. Returns an unfinished or complete run with this content unchanged. A quarantined one begins from
    /// its first row, since its export is only read again after a correction.
    pub async fn begin_run(&self, header: &RunHeader) -> Result<KnownRun, StoreError> {
        let mut transaction = self.begin().await?;
        let run = self.checked(begin_run(&mut transaction, header).await)?;
        self.commit(transaction).await?;
        Ok(run)
    }

    /// State of a run; `None` if it is unknown.
    pub async fn known_run(&self, run_id: i64) -> Result<Option<KnownRun>, StoreError> {
        match run_by_key(&self.readers, run_id).await {
            Err(sqlx::Error::RowNotFound) => Ok(None),
            found => self.checked(found).map(Some),
        }
    }

    /// Marks the unfinished run `old` as superseded by `run_id`, because its file was overwritten with the content of
    /// that run. Its rows stay. Does nothing if `old` is complete by now.
    pub async fn supersede_run(&self, run_id: i64, old: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        // another daemon may have completed it since
        if !self.checked(is_complete(&mut *transaction, old).await)? {
            self.checked(supersede(&mut *transaction, run_id, old).await)?;
        }
        self.commit(transaction).await
    }

    /// Deletes the unfinished run `run_id`, because the complete run `other` has its content. The runs that it
    /// superseded become superseded by `other`.
    pub async fn merge_run(&self, run_id: i64, other: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(hand_on(&mut *transaction, run_id, other).await)?;
        self.checked(discard(&mut *transaction, run_id).await)?;
        self.commit(transaction).await
    }

    /// Deletes an incomplete run with all its rows. Returns true if there was one.
    pub async fn discard_run(&self, run_id: i64) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let found = self.checked(discard(&mut *transaction, run_id).await)?;
        self.commit(transaction).await?;
        Ok(found)
    }

    /// Sets `identity` as the identity of a run that was read while its file grew, since its content is not read. Does
    /// nothing for other runs.
    pub async fn identify_growing_by(&self, run_id: i64, identity: &ContentHash) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let done = sqlx::query("UPDATE run SET content_hash = $1 WHERE run_id = $2 AND growing")
            .bind_all((&identity.0[..], run_id))
            .execute(&mut *transaction)
            .await;
        self.checked(done)?;
        self.commit(transaction).await
    }

    /// Stores the kind of a run.
    pub async fn set_run_kind(&self, run_id: i64, kind: RunKind) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(set_kind(&mut *transaction, run_id, kind).await)?;
        self.commit(transaction).await
    }
}

pub(crate) fn status(row: &EngineRow, column: &str) -> sqlx::Result<RunStatus> {
    named(row, column, &RunStatus::ALL, RunStatus::name)
}

/// Begins a run, continues an unfinished one, or begins a quarantined one from its first row.
pub(crate) async fn begin_run(
    connection: &mut EngineConnection,
    header: &RunHeader,
) -> sqlx::Result<KnownRun> {
    let known = find_run(&mut *connection, &header.content_hash, &header.robot).await?;
    match known {
        Some(run) if matches!(run.status, RunStatus::Streaming | RunStatus::Complete) => Ok(run),
        Some(run) => afresh(connection, run.run_id, header).await,
        None => insert_new(connection, header).await,
    }
}

/// Begins a run as `beginning` demands, under an identity that no other run has.
pub(crate) async fn begin(
    connection: &mut EngineConnection,
    header: &RunHeader,
    identity: Identity,
    beginning: RunStart,
) -> sqlx::Result<BegunRun> {
    let mut afresh_instead = false;
    let run = match (beginning.continues, &beginning.made_with) {
        (Some(run_id), _) if beginning.afresh => afresh(&mut *connection, run_id, header).await?,
        (Some(run_id), Some(made_with)) if is_made_otherwise(&mut *connection, run_id, made_with).await? => {
            afresh_instead = true;
            afresh(&mut *connection, run_id, header).await?
        }
        (Some(run_id), _) => continues(&mut *connection, run_id, header, identity).await?,
        (None, _) => insert_new(&mut *connection, header).await?,
    };
    let run_id = run.run_id;
    if let Some(made_with) = &beginning.made_with {
        set_made_with(&mut *connection, run_id, made_with).await?;
    }
    if let Some(old) = beginning.replaces {
        replace(&mut *connection, run_id, old).await?;
    }
    match identity {
        Identity::Content(hash) => identify(connection, run_id, &hash, header.source_bytes).await?,
        Identity::Growing(_) if run.cycles_stored == 0 => {
            let nothing = ContentPrefix { bytes: 0, hash: ContentHash(*blake3::hash(b"").as_bytes()) };
            identify_growing(connection, run_id, &nothing).await?;
        }
        Identity::Growing(prefix) => identify_growing(connection, run_id, &prefix).await?,
    }
    Ok(BegunRun { run, afresh: afresh_instead })
}

async fn insert_new(connection: &mut EngineConnection, header: &RunHeader) -> sqlx::Result<KnownRun> {
    let robot_id = robot_id(&mut *connection, &header.robot).await?;
    Ok(begun(insert_run(connection, robot_id, header).await?))
}

/// Begins a run from its first row: the stored results may depend on a layout or robot that has been corrected since.
async fn afresh(
    connection: &mut EngineConnection,
    run_id: i64,
    header: &RunHeader,
) -> sqlx::Result<KnownRun> {
    stored_cycles::delete_all(&mut *connection, run_id).await?;
    resume::forget(&mut *connection, run_id).await?;
    let robot_id = robot_id(&mut *connection, &header.robot).await?;
    reopen_run(connection, run_id, robot_id, header).await?;
    Ok(begun(run_id))
}

/// Continues a run whose content may have become longer.
async fn continues(
    connection: &mut EngineConnection,
    run_id: i64,
    header: &RunHeader,
    identity: Identity,
) -> sqlx::Result<KnownRun> {
    let known = run_by_key(&mut *connection, run_id).await?;
    let is_whole = matches!(identity, Identity::Content(_));
    match known.status {
        RunStatus::Quarantined | RunStatus::Superseded | RunStatus::SetAside => {
            afresh(connection, run_id, header).await
        }
        RunStatus::Streaming
            if is_whole
                && stored_cycles::are_of_first(&mut *connection, run_id, header.source_bytes).await? =>
        {
            Ok(known)
        }
        RunStatus::Streaming => {
            if stored_cycles::delete_cut_by_end(&mut *connection, run_id).await? {
                stored_cycles::count_again(&mut *connection, run_id).await?;
            }
            run_by_key(connection, run_id).await
        }
        RunStatus::Complete => {
            if !stored_cycles::delete_cut_by_end(&mut *connection, run_id).await? {
                stored_cycles::delete_last(&mut *connection, run_id).await?;
            }
            open_again(&mut *connection, run_id).await?;
            stored_cycles::count_again(&mut *connection, run_id).await?;
            run_by_key(connection, run_id).await
        }
    }
}

/// Lets `run_id` supersede `old`: when `run_id` is complete if `old` is complete, at once if the file of `old` changed
/// before its end.
async fn replace(connection: &mut EngineConnection, run_id: i64, old: i64) -> sqlx::Result<()> {
    if run_by_key(&mut *connection, old).await?.status == RunStatus::Complete {
        set_replaced(connection, run_id, old).await
    } else {
        supersede(connection, run_id, old).await
    }
}

/// Gives a run that is ending the identity of its content, unless a complete run has it. An unfinished or superseded
/// run of the same content gives way, since its rows would be the same.
pub(crate) async fn adopt(
    connection: &mut EngineConnection,
    run_id: i64,
    content: &ContentPrefix,
) -> sqlx::Result<Owner> {
    let robot: String =
        sqlx::query_scalar("SELECT robot.name FROM run JOIN robot USING (robot_id) WHERE run_id = $1")
            .bind(run_id)
            .fetch_one(&mut *connection)
            .await?;
    match find_run(&mut *connection, &content.hash, &robot).await? {
        Some(other) if other.run_id == run_id => {}
        Some(other) if matches!(other.status, RunStatus::Complete | RunStatus::SetAside) => {
            return Ok(Owner::Other(other.run_id));
        }
        Some(other) => {
            hand_on(&mut *connection, other.run_id, run_id).await?;
            discard(&mut *connection, other.run_id).await?;
        }
        None => {}
    }
    identify(connection, run_id, &content.hash, content.bytes).await?;
    Ok(Owner::Ours)
}

fn begun(run_id: i64) -> KnownRun {
    KnownRun { run_id, status: RunStatus::Streaming, reason: None, cycles_stored: 0, retry_asked: false }
}

/// The run of a content and a robot, or else the run of the content whose robot is unknown; for an unknown robot, the
/// run of any robot.
pub(crate) async fn find_run(
    executor: impl EngineExecutor<'_>,
    hash: &ContentHash,
    robot: &str,
) -> sqlx::Result<Option<KnownRun>> {
    sqlx::query(
        "SELECT run_id, CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                     THEN 'set_aside' ELSE 'superseded' END AS status, reason,
                cycles_stored, retry_asked_at IS NOT NULL AS retry_asked
         FROM run
         JOIN robot USING (robot_id)
         WHERE content_hash = $1 AND (robot.name IN ($2, $3) OR $2 = $3)
         ORDER BY CASE WHEN robot.name = $2 THEN 0 ELSE 1 END, run_id
         LIMIT 1",
    )
    .bind_all((&hash.0[..], robot, UNKNOWN_ROBOT))
    .try_map(|row| known_run(&row))
    .fetch_optional(executor)
    .await
}

async fn run_by_key(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<KnownRun> {
    sqlx::query(
        "SELECT run_id, CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                     THEN 'set_aside' ELSE 'superseded' END AS status, reason,
                cycles_stored, retry_asked_at IS NOT NULL AS retry_asked
         FROM run
         WHERE run_id = $1",
    )
    .bind(run_id)
    .try_map(|row| known_run(&row))
    .fetch_one(executor)
    .await
}

/// Reads run_id, status, reason, cycles_stored and retry_asked.
pub(crate) fn known_run(row: &EngineRow) -> sqlx::Result<KnownRun> {
    Ok(KnownRun {
        run_id: row.try_get("run_id")?,
        status: status(row, "status")?,
        reason: row.try_get("reason")?,
        cycles_stored: size(row, "cycles_stored")?,
        retry_asked: row.try_get("retry_asked")?,
    })
}

pub(crate) async fn insert_run(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    header: &RunHeader,
) -> sqlx::Result<i64> {
    sqlx::query_scalar(
        "INSERT INTO run (robot_id, model, started_at, source_name, source_path, source_bytes, content_hash, status)
         VALUES ($1, $2, $3, $4, $5, $6, $7, 'streaming')
         RETURNING run_id",
    )
    .bind_all((robot_id, &header.model, header.started_at.as_microsecond(), &header.source_name))
    .bind_all((&header.source_path, count(header.source_bytes), &header.content_hash.0[..]))
    .fetch_one(executor)
    .await
}

/// Opens a run at its first row. Keeps a start that a person has corrected, unless the file has another name.
async fn reopen_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    robot_id: i64,
    header: &RunHeader,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET started_at = CASE WHEN recorded_start IS NULL OR source_name <> $4 OR coalesce(set_aside, '') = 'arrival_order'
                               THEN $3 ELSE started_at END,
             recorded_start_text = CASE WHEN source_name <> $4 OR coalesce(set_aside, '') = 'arrival_order'
                                        THEN NULL ELSE recorded_start_text END,
             recorded_start = CASE WHEN recorded_start IS NULL OR source_name <> $4 OR coalesce(set_aside, '') = 'arrival_order'
                                   THEN NULL ELSE $3 END,
             set_aside = NULL, date_problem = NULL, robot_id = $1, model = $2, source_name = $4, source_path = $5, source_bytes = $6,
             cycles_stored = 0, rows = NULL, rows_skipped = NULL, sample_rate_hz = NULL, cycles_total = NULL, prefix_bytes = NULL,
             prefix_hash = NULL, replaces_run_id = NULL, superseded_by_run_id = NULL, status = 'streaming', reason = NULL,
             reason_line = NULL, reason_column = NULL, retry_asked_at = NULL
         WHERE run_id = $7",
    )
    .bind_all((robot_id, &header.model, header.started_at.as_microsecond(), &header.source_name))
    .bind_all((&header.source_path, count(header.source_bytes), run_id))
    .run(executor)
    .await
}

/// Opens a complete run for further cycles. A trigger deletes the results of the run as a whole.
async fn open_again(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET status = 'streaming', rows = NULL, rows_skipped = NULL, sample_rate_hz = NULL, cycles_total = NULL,
             prefix_bytes = source_bytes, prefix_hash = content_hash
         WHERE run_id = $1",
    )
    .bind(run_id)
    .run(executor)
    .await
}

async fn identify(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    hash: &ContentHash,
    bytes: u64,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET content_hash = $1, source_bytes = $2, growing = FALSE WHERE run_id = $3")
        .bind_all((&hash.0[..], count(bytes), run_id))
        .run(executor)
        .await
}

/// Stores that the export of a run grows. The key becomes a random number that no content has, so that a copy of its
/// earlier content is not assumed to be the same export.
async fn identify_growing(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    prefix: &ContentPrefix,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run SET content_hash = randomblob(32), growing = TRUE, prefix_bytes = $1, prefix_hash = $2
         WHERE run_id = $3",
    )
    .bind_all((count(prefix.bytes), &prefix.hash.0[..], run_id))
    .run(executor)
    .await
}

/// Start of a run that accepts cycles from this session, in microseconds; `None` if it accepts none.
pub(crate) async fn open_run_start(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    session: Option<i64>,
) -> sqlx::Result<Option<i64>> {
    let start = "SELECT started_at FROM run
                 WHERE run_id = $1 AND status = 'streaming' AND host_session_id IS NOT DISTINCT FROM $2";
    sqlx::query_scalar(start).bind(run_id).bind(session).fetch_optional(executor).await
}

/// Robot of a run that is neither quarantined nor read by another session.
pub(crate) async fn robot_of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    session: Option<i64>,
) -> sqlx::Result<Option<i64>> {
    let robot = "SELECT robot_id FROM run
                 WHERE run_id = $1 AND status <> 'quarantined'
                       AND (status <> 'streaming' OR host_session_id IS NOT DISTINCT FROM $2)";
    sqlx::query_scalar(robot).bind(run_id).bind(session).fetch_optional(executor).await
}

/// Ends a run whose file is gone. Its content remains unknown, so the key becomes a random number that no content has.
/// The stored first bytes identify the file if it returns.
async fn give_up(executor: impl EngineExecutor<'_>, run_id: i64, reason: &str) -> sqlx::Result<bool> {
    let done = sqlx::query(
        "UPDATE run
         SET status = 'quarantined', reason = $2, growing = TRUE, content_hash = randomblob(32),
             prefix_bytes = CASE WHEN cycles_stored > 0 THEN coalesce(prefix_bytes, source_bytes) ELSE NULL END,
             prefix_hash = CASE WHEN cycles_stored > 0 THEN coalesce(prefix_hash, content_hash) ELSE NULL END
         WHERE run_id = $1 AND status = 'streaming'",
    )
    .bind_all((run_id, reason))
    .execute(executor)
    .await?;
    Ok(done.rows_affected() > 0)
}

/// True if a run was read to its end.
async fn is_complete(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run WHERE run_id = $1 AND status = 'complete')")
        .bind(run_id)
        .fetch_one(executor)
        .await
}

/// Stores the kind of a run if it differs from the stored one.
async fn set_kind(executor: impl EngineExecutor<'_>, run_id: i64, kind: RunKind) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET kind = $1 WHERE run_id = $2 AND kind <> $1")
        .bind_all((kind.name(), run_id))
        .run(executor)
        .await
}

/// Deletes an incomplete run with its cycles. Returns true if there was one.
async fn discard(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    let done = sqlx::query("DELETE FROM run WHERE run_id = $1 AND status <> 'complete'")
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(done.rows_affected() > 0)
}
