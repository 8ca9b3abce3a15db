//! Files as they were last seen.

use std::collections::HashMap;
use std::path::PathBuf;

use jiff::Timestamp;
use sqlx::Row;

use super::attempts::AttemptKind;
use super::runs::{BegunRun, Identity, KnownRun, RunStart, known_run};
use super::{attempts, blocked, runs};
use crate::engine::{Bind, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models::StoredModel;
use crate::values::{count, named, size, time};
use armwatch_model::run::{ContentHash, ContentPrefix, FileId, RunHeader, RunKind};

/// A file as the file system describes it; its content is not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceState {
    /// Size, bytes.
    pub bytes: u64,
    /// Time of the last modification.
    pub modified: Timestamp,
    /// Number of the file in its file system.
    pub file: FileId,
}

/// A run whose export was at a path, or in the file that is there now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EarlierRun {
    /// The run.
    pub run: KnownRun,
    /// Its robot.
    pub robot: String,
    /// Start of its recording.
    pub started_at: Timestamp,
    /// File name of its export.
    pub source_name: String,
    /// Its kind, once a cycle is stored.
    pub kind: RunKind,
    /// The first bytes of the content, the source of its stored results.
    pub read: ContentPrefix,
    /// True if it was at the path.
    pub same_path: bool,
    /// True if it was in the file.
    pub same_file: bool,
}

/// Recording of a file, as its name states it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordingName<'n> {
    /// The individual robot.
    pub robot: &'n str,
    /// Start.
    pub started_at: Timestamp,
    /// The name itself.
    pub source_name: &'n str,
}

/// File of an incomplete run, as it was when the run was last begun.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnfinishedSource {
    /// The run.
    pub run_id: i64,
    /// Path of the file.
    pub path: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// Time of its last modification, to the microsecond.
    pub modified: Timestamp,
    /// True if it was read while it grew, false if it had settled.
    pub growing: bool,
}

/// Latest runs of a file number that are compared with a file. A file that an archive removes leaves its number to the
/// next file, so a number may have any count of runs.
const MOST_OF_NUMBER: i64 = 4;

/// Runs of possibly the same recording that are compared with a file: first those that were not refused, then those of
/// the same name, then the latest. One recording has few runs. A folder of broken files with one start may have
/// thousands, and each would be compared with all others.
const MOST_OF_RECORDING: i64 = 16;

/// Everything that identifies the export of a run, and the description that its rows were analysed with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunSource {
    /// Database key of the run.
    pub run_id: i64,
    /// The individual robot.
    pub robot: String,
    /// File name of the export when it was read.
    pub source_name: String,
    /// Paths of the export: first the oldest one, then the later ones, latest first.
    pub paths: Vec<PathBuf>,
    /// Identity of its content.
    pub content_hash: ContentHash,
    /// Description that it was analysed with; `None` until a cycle is stored.
    pub model: Option<StoredModel>,
}

impl Store {
    /// Begins the run of the file at `source`, as `beginning` demands, and stores that the file holds it. No other run
    /// may have the identity, see [`Store::lookup`].
    ///
    /// # Errors
    /// [`StoreError::Refused`] if another run has the identity; others of the database.
    pub async fn begin_source(
        &self,
        header: &RunHeader,
        identity: Identity,
        beginning: RunStart,
        source: SourceState,
    ) -> Result<BegunRun, StoreError> {
        let mut transaction = self.begin().await?;
        let begun = self.checked(runs::begin(&mut transaction, header, identity, beginning).await)?;
        let run_id = begun.run.run_id;
        self.checked(remember(&mut *transaction, &header.source_path, source, run_id).await)?;
        self.checked(set_file(&mut *transaction, run_id, self.numbered(source.file), self.session()).await)?;
        self.claim_run(&mut transaction, run_id).await?;
        self.commit(transaction).await?;
        Ok(begun)
    }

    /// State of the export that was at `path` in this state when it was last read.
    pub async fn known_source(&self, path: &str, state: SourceState) -> Result<Option<KnownRun>, StoreError> {
        self.checked(find(&self.readers, path, state).await)
    }

    /// State of the exports that were at `paths` when they were last read, by path: size in bytes, time of the last
    /// modification in microseconds UTC, and run. Unknown paths are omitted.
    pub async fn known_sources(
        &self,
        paths: &[String],
    ) -> Result<HashMap<String, (u64, i64, KnownRun)>, StoreError> {
        self.checked(find_all(&self.readers, paths).await)
    }

    /// Stores that the file at `path`, in this state, holds the export of a run. This ends the attempt at it.
    pub async fn remember_source(
        &self,
        path: &str,
        state: SourceState,
        run_id: i64,
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(remember(&mut *transaction, path, state, run_id).await)?;
        self.checked(attempts::end(&mut *transaction, AttemptKind::Export, path).await)?;
        self.checked(blocked::forget(&mut *transaction, path).await)?;
        self.commit(transaction).await
    }

    /// Runs whose export was at `path`, was in the file of this number under another name, or is of this recording
    /// (robot and start): first that of the path, then the newest.
    pub async fn earlier_runs(
        &self,
        path: &str,
        file: FileId,
        recording: Option<RecordingName<'_>>,
    ) -> Result<Vec<EarlierRun>, StoreError> {
        self.checked(earlier_runs(&self.readers, path, self.numbered(file), recording).await)
    }

    /// Files of incomplete runs, as they were when the runs were last begun. Omits those of other hosts and those that
    /// other programs read.
    pub async fn unfinished_sources(&self) -> Result<Vec<UnfinishedSource>, StoreError> {
        let mut found = self.checked(unfinished(&self.readers).await)?;
        let of_others = self.runs_of_others().await?;
        found.retain_mut(|source| {
            let Some(path) = source.path.to_str().and_then(|located| self.local_path(located)) else {
                return false;
            };
            source.path = from_root(path);
            !of_others.contains(&source.run_id)
        });
        Ok(found)
    }

    /// Identity of the export of a run; `None` if the run is unknown.
    pub async fn run_source(&self, run_id: i64) -> Result<Option<RunSource>, StoreError> {
        let Some(mut source) = self.checked(of_run(&self.readers, run_id).await)? else {
            return Ok(None);
        };
        for path in self.checked(paths_of_run(&self.readers, run_id).await)? {
            let path = PathBuf::from(path);
            if !source.paths.contains(&path) {
                source.paths.push(path);
            }
        }
        // a file of another host keeps the name of that host, since it is no file here
        for path in &mut source.paths {
            if let Some(here) = path.to_str().and_then(|located| self.local_path(located)) {
                *path = here;
            }
        }
        Ok(Some(source))
    }

    /// Content with this file name: that of the latest run with this name that is neither quarantined, superseded nor
    /// growing.
    pub async fn content_named(&self, source_name: &str) -> Result<Option<ContentHash>, StoreError> {
        self.checked(content_named(&self.readers, source_name).await)
    }
}

pub(crate) async fn find(
    executor: impl EngineExecutor<'_>,
    path: &str,
    state: SourceState,
) -> sqlx::Result<Option<KnownRun>> {
    sqlx::query(
        "SELECT run.run_id, CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                     THEN 'set_aside' ELSE 'superseded' END AS status, run.reason,
                run.cycles_stored, retry_asked_at IS NOT NULL AS retry_asked
         FROM source_file JOIN run USING (run_id)
         WHERE source_file.path = $1 AND source_file.bytes = $2 AND source_file.modified = $3",
    )
    .bind_all((path, count(state.bytes), state.modified.as_microsecond()))
    .try_map(|row| known_run(&row))
    .fetch_optional(executor)
    .await
}

/// Run last read at each of `paths`.
async fn find_all(
    executor: impl EngineExecutor<'_>,
    paths: &[String],
) -> sqlx::Result<HashMap<String, (u64, i64, KnownRun)>> {
    let asked = serde_json::Value::from(paths.to_vec()).to_string();
    let rows = sqlx::query(
        "SELECT source_file.path, source_file.bytes, source_file.modified, run.run_id,
                CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                     THEN 'set_aside' ELSE 'superseded' END AS status, run.reason,
                run.cycles_stored,
                retry_asked_at IS NOT NULL AS retry_asked
         FROM json_each($1) AS asked
         CROSS JOIN source_file
         JOIN run USING (run_id)
         WHERE source_file.path = asked.value",
    )
    .bind(asked)
    .try_map(|row: EngineRow| {
        Ok((row.try_get("path")?, (size(&row, "bytes")?, row.try_get("modified")?, known_run(&row)?)))
    })
    .fetch_all(executor)
    .await?;
    Ok(rows.into_iter().collect())
}

/// Largest difference between two time zones, in microseconds. A start that was read with the wrong time zone is within
/// it.
const ZONES_APART: i64 = 26 * 3_600_000_000;

/// Runs whose export was at `path` or in the file of this number, or may be of this recording. Such runs have the same
/// robot and start, or the same robot and name if the start was read in another time zone. First that of the path, then
/// the newest.
pub(crate) async fn earlier_runs(
    executor: impl EngineExecutor<'_>,
    path: &str,
    file: FileId,
    recording: Option<RecordingName<'_>>,
) -> sqlx::Result<Vec<EarlierRun>> {
    sqlx::query(
        "WITH earlier AS (
             SELECT run_id FROM source_file WHERE path = $1
             UNION
             SELECT run_id FROM (SELECT run_id FROM run WHERE inode = $2 AND device = $3
                                 ORDER BY run_id DESC LIMIT $4) AS of_number
             UNION
             SELECT run_id FROM (SELECT run_id FROM robot JOIN run USING (robot_id)
                                 WHERE robot.name = $5 AND status IN ('streaming', 'complete', 'quarantined')
                                   AND started_at BETWEEN $6 - $8 AND $6 + $8
                                   AND (started_at = $6 OR source_name = $7)
                                 ORDER BY status = 'quarantined', source_name = $7 DESC, run_id DESC
                                 LIMIT $9) AS of_recording
         )
         SELECT run_id, CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                     THEN 'set_aside' ELSE 'superseded' END AS status, reason,
                cycles_stored, retry_asked_at IS NOT NULL AS retry_asked, robot.name AS robot, started_at, source_name, kind,
                EXISTS (SELECT 1 FROM source_file WHERE path = $1 AND source_file.run_id = run.run_id) AS same_path,
                coalesce(inode = $2 AND device = $3, FALSE) AS same_file,
                CASE WHEN status = 'streaming' OR growing THEN coalesce(prefix_bytes, source_bytes)
                     ELSE source_bytes END AS bytes,
                CASE WHEN status = 'streaming' OR growing THEN coalesce(prefix_hash, content_hash)
                     ELSE content_hash END AS hash
         FROM earlier
         JOIN run USING (run_id)
         JOIN robot USING (robot_id)
         ORDER BY same_path DESC, run_id DESC",
    )
    .bind_all((path, file.inode.cast_signed(), file.device.cast_signed(), MOST_OF_NUMBER))
    .bind_all((recording.map(|of| of.robot), recording.map(|of| of.started_at.as_microsecond())))
    .bind_all((recording.map(|of| of.source_name), ZONES_APART, MOST_OF_RECORDING))
    .try_map(|row: EngineRow| {
        let hash: Vec<u8> = row.try_get("hash")?;
        let hash = hash.try_into().map_err(|_| sqlx::Error::Decode("a hash of another length".into()))?;
        Ok(EarlierRun {
            run: known_run(&row)?,
            robot: row.try_get("robot")?,
            started_at: time(&row, "started_at")?,
            source_name: row.try_get("source_name")?,
            kind: named(&row, "kind", &[RunKind::Test, RunKind::Production], RunKind::name)?,
            read: ContentPrefix { bytes: size(&row, "bytes")?, hash: ContentHash(hash) },
            same_path: row.try_get("same_path")?,
            same_file: row.try_get("same_file")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Files of incomplete runs.
pub(crate) async fn unfinished(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<UnfinishedSource>> {
    sqlx::query(
        "SELECT run.run_id, path, bytes, modified, growing
         FROM run JOIN source_file USING (run_id)
         WHERE status = 'streaming'
         ORDER BY run.run_id, path",
    )
    .try_map(|row: EngineRow| {
        Ok(UnfinishedSource {
            run_id: row.try_get("run_id")?,
            path: row.try_get::<String, _>("path")?.into(),
            bytes: size(&row, "bytes")?,
            modified: time(&row, "modified")?,
            growing: row.try_get("growing")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Absolute path. Earlier versions stored paths as they were given, mostly by a daemon that is still started in the
/// same folder.
fn from_root(path: PathBuf) -> PathBuf {
    std::path::absolute(&path).unwrap_or(path)
}

pub(crate) async fn remember(
    executor: impl EngineExecutor<'_>,
    path: &str,
    state: SourceState,
    run_id: i64,
) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO source_file (path, bytes, modified, run_id) VALUES ($1, $2, $3, $4)
         ON CONFLICT (path) DO UPDATE
         SET bytes = excluded.bytes, modified = excluded.modified, run_id = excluded.run_id",
    )
    .bind_all((path, count(state.bytes), state.modified.as_microsecond(), run_id))
    .run(executor)
    .await
}

/// Stores the file that a run is read from, and the session that reads it.
async fn set_file(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    file: FileId,
    session: Option<i64>,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET device = $1, inode = $2, host_session_id = $4 WHERE run_id = $3")
        .bind_all((file.device.cast_signed(), file.inode.cast_signed(), run_id, session))
        .run(executor)
        .await
}

/// Run `run_id` with the first of its paths.
pub(crate) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Option<RunSource>> {
    sqlx::query(
        "SELECT run.run_id, robot.name AS robot, source_name, source_path, content_hash,
                run.robot_model_id, robot_model.name AS model, description_hash
         FROM run
         JOIN robot USING (robot_id)
         LEFT JOIN robot_model USING (robot_model_id)
         WHERE run.run_id = $1",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let hash: Vec<u8> = row.try_get("content_hash")?;
        let hash = hash.try_into().map_err(|_| sqlx::Error::Decode("a content hash of odd length".into()))?;
        let path: String = row.try_get("source_path")?;
        let model = match row.try_get::<Option<i64>, _>("robot_model_id")? {
            Some(robot_model_id) => Some(StoredModel {
                robot_model_id,
                name: row.try_get("model")?,
                description_hash: row.try_get("description_hash")?,
            }),
            None => None,
        };
        Ok(RunSource {
            run_id: row.try_get("run_id")?,
            robot: row.try_get("robot")?,
            source_name: row.try_get("source_name")?,
            paths: vec![path.into()],
            content_hash: ContentHash(hash),
            model,
        })
    })
    .fetch_optional(executor)
    .await
}

/// Known paths of a run's export, latest modification first.
async fn paths_of_run(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Vec<String>> {
    sqlx::query_scalar("SELECT path FROM source_file WHERE run_id = $1 ORDER BY modified DESC, path")
        .bind(run_id)
        .fetch_all(executor)
        .await
}

/// Content of the latest run whose export had this file name and that is neither quarantined, superseded nor
/// growing.
pub(crate) async fn content_named(
    executor: impl EngineExecutor<'_>,
    source_name: &str,
) -> sqlx::Result<Option<ContentHash>> {
    let hash: Option<Vec<u8>> = sqlx::query_scalar(
        "SELECT content_hash FROM run
         WHERE source_name = $1 AND status <> 'quarantined' AND NOT growing
         ORDER BY run_id DESC
         LIMIT 1",
    )
    .bind(source_name)
    .fetch_optional(executor)
    .await?;
    let whole =
        |hash: Vec<u8>| hash.try_into().map_err(|_| sqlx::Error::Decode("a hash of another length".into()));
    hash.map(whole).transpose().map(|hash| hash.map(ContentHash))
}
