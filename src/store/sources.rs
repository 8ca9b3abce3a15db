//! Files as they were last seen.

use jiff::Timestamp;
use sqlx::Row;
use sqlx::sqlite::{SqliteExecutor, SqliteRow};

use super::ledger::{KnownRun, known_run};
use super::values::{count, size, time};
use crate::run::{ContentHash, ContentPrefix, FileId};

/// A file as the file system describes it, without a look into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceState {
    /// Size, bytes.
    pub bytes: u64,
    /// Time of the last modification.
    pub modified: Timestamp,
    /// Number of the file in its file system.
    pub file: FileId,
}

/// A run whose export lay at a path, or in the file that lies there now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EarlierRun {
    /// The run.
    pub run: KnownRun,
    /// Its robot.
    pub robot: String,
    /// Start of its recording.
    pub started_at: Timestamp,
    /// What is stored of it was read from these first bytes.
    pub read: ContentPrefix,
    /// Whether it lay at the path.
    pub same_path: bool,
    /// Whether it lay in the file.
    pub same_file: bool,
}

/// Most runs that are compared with a file: one lay at its path, and few in files of its number.
const MOST_EARLIER: i64 = 16;

pub(super) async fn find(
    executor: impl SqliteExecutor<'_>,
    path: &str,
    state: SourceState,
) -> Result<Option<KnownRun>, sqlx::Error> {
    sqlx::query(
        "SELECT run.run_id, iif(superseded_by_run_id IS NULL, status, 'superseded') AS status, run.reason,
                run.cycles_stored
         FROM source_file JOIN run USING (run_id)
         WHERE source_file.path = ? AND source_file.bytes = ? AND source_file.modified = ?",
    )
    .bind(path)
    .bind(count(state.bytes))
    .bind(state.modified.as_microsecond())
    .try_map(|row| known_run(&row))
    .fetch_optional(executor)
    .await
}

/// Runs whose export lay at `path` or in the file of this number: that of the path first, then the newest.
pub(super) async fn earlier_runs(
    executor: impl SqliteExecutor<'_>,
    path: &str,
    file: FileId,
) -> Result<Vec<EarlierRun>, sqlx::Error> {
    sqlx::query(
        "WITH earlier AS (
             SELECT run_id FROM source_file WHERE path = ?1
             UNION
             SELECT run_id FROM run WHERE inode = ?2 AND device = ?3
         )
         SELECT run_id, iif(superseded_by_run_id IS NULL, status, 'superseded') AS status, reason, cycles_stored,
                robot.name AS robot, started_at,
                EXISTS (SELECT 1 FROM source_file WHERE path = ?1 AND source_file.run_id = run.run_id) AS same_path,
                ifnull(inode = ?2 AND device = ?3, 0) AS same_file,
                iif(status = 'streaming', ifnull(prefix_bytes, source_bytes), source_bytes) AS bytes,
                iif(status = 'streaming', ifnull(prefix_hash, content_hash), content_hash) AS hash
         FROM earlier
         JOIN run USING (run_id)
         JOIN robot USING (robot_id)
         ORDER BY same_path DESC, run_id DESC
         LIMIT ?4",
    )
    .bind(path)
    .bind(file.inode.cast_signed())
    .bind(file.device.cast_signed())
    .bind(MOST_EARLIER)
    .try_map(|row: SqliteRow| {
        let hash: Vec<u8> = row.try_get("hash")?;
        let hash = hash.try_into().map_err(|_| sqlx::Error::Decode("a hash of another length".into()))?;
        Ok(EarlierRun {
            run: known_run(&row)?,
            robot: row.try_get("robot")?,
            started_at: time(&row, "started_at")?,
            read: ContentPrefix { bytes: size(&row, "bytes")?, hash: ContentHash(hash) },
            same_path: row.try_get("same_path")?,
            same_file: row.try_get("same_file")?,
        })
    })
    .fetch_all(executor)
    .await
}

pub(super) async fn remember(
    executor: impl SqliteExecutor<'_>,
    path: &str,
    state: SourceState,
    run_id: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO source_file (path, bytes, modified, run_id) VALUES (?, ?, ?, ?)
         ON CONFLICT (path) DO UPDATE
         SET bytes = excluded.bytes, modified = excluded.modified, run_id = excluded.run_id",
    )
    .bind(path)
    .bind(count(state.bytes))
    .bind(state.modified.as_microsecond())
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// Writes down which file a run is read from.
pub(super) async fn set_file(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    file: FileId,
) -> Result<(), sqlx::Error> {
    sqlx::query("UPDATE run SET device = ?, inode = ? WHERE run_id = ?")
        .bind(file.device.cast_signed())
        .bind(file.inode.cast_signed())
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(())
}
