//! Growing files that cannot be read further. Their faults are judged when they have settled. Until then this table
//! shows the faults, because silence would look like health.

use std::path::Path;

use serde::Serialize;
use sqlx::Row;

use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{count, in_views, size, time_text};
use jiff::Timestamp;

/// Reason why a growing file cannot be read further.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockReason<'a> {
    /// Its path in the ledger.
    pub path: &'a str,
    /// The robot in its name.
    pub robot: Option<&'a str>,
    /// Its name.
    pub source_name: &'a str,
    /// Line in the decompressed file, from 1.
    pub line: Option<u64>,
    /// The fault.
    pub problem: &'a str,
    /// The remedy.
    pub remedy: &'a str,
}

/// A row of the view `blocked_files`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BlockedFile {
    /// The robot in its name.
    pub robot: Option<String>,
    /// Its name.
    pub source_name: String,
    /// Its path in the ledger.
    #[serde(skip)]
    pub source_path: String,
    /// The run that its cycles belong to, if there is one.
    pub run_id: Option<i64>,
    /// Line in the decompressed file, from 1.
    pub line: Option<u64>,
    /// The remedy.
    pub remedy: String,
    /// Time since which it is blocked.
    #[serde(serialize_with = "in_views")]
    pub blocked_at: Timestamp,
    /// Line, time and problem in words that follow the file's name.
    pub message: String,
}

impl Store {
    /// Stores that a growing file cannot be read further. Returns true if the file, its line or its problem is new;
    /// otherwise the time of the first record is kept.
    pub async fn block_file(&self, block: BlockReason<'_>) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let is_new = self.checked(block_file(&mut transaction, block).await)?;
        self.commit(transaction).await?;
        Ok(is_new)
    }

    /// Deletes the record of a file that is read again, or is gone. Writes nothing if there is none.
    pub async fn unblock_file(&self, path: &str) -> Result<(), StoreError> {
        let known = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM blocked_file WHERE path = $1)");
        if !self.checked(known.bind(path).fetch_one(&self.readers).await)? {
            return Ok(());
        }
        let mut transaction = self.begin().await?;
        self.checked(forget(&mut *transaction, path).await)?;
        self.commit(transaction).await
    }

    /// Growing files that cannot be read further, the longest waiting first.
    pub async fn blocked_files(&self) -> Result<Vec<BlockedFile>, StoreError> {
        self.checked(all(&self.readers).await)
    }

    /// Deletes the records of files of this host that no longer exist.
    pub async fn unblock_vanished(&self, is_there: impl Fn(&Path) -> bool) -> Result<(), StoreError> {
        for file in self.blocked_files().await? {
            if self.local_path(&file.source_path).is_some_and(|path| !is_there(&path)) {
                self.unblock_file(&file.source_path).await?;
            }
        }
        Ok(())
    }
}

async fn block_file(connection: &mut EngineConnection, block: BlockReason<'_>) -> sqlx::Result<bool> {
    let BlockReason { path, robot, source_name, line, problem, remedy } = block;
    let known = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM blocked_file
                        WHERE path = $1 AND problem = $2 AND line IS NOT DISTINCT FROM $3)",
    );
    let known = known.bind(path).bind(problem).bind(line.map(count));
    if known.fetch_one(&mut *connection).await? {
        return Ok(false);
    }
    forget(&mut *connection, path).await?;
    sqlx::query(
        "INSERT INTO blocked_file (path, run_id, robot, source_name, line, problem, remedy)
         VALUES ($1, (SELECT run_id FROM source_file JOIN run USING (run_id)
                      WHERE source_file.path = $1 AND status = 'streaming'), $2, $3, $4, $5, $6)",
    )
    .bind_all((path, robot, source_name, line.map(count), problem, remedy))
    .execute(connection)
    .await?;
    Ok(true)
}

pub(super) async fn forget(executor: impl EngineExecutor<'_>, path: &str) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM blocked_file WHERE path = $1").bind(path).run(executor).await
}

async fn all(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<BlockedFile>> {
    sqlx::query(
        "SELECT robot, source_name, source_path, run_id, line, remedy, blocked_at, message FROM blocked_files
         ORDER BY blocked_at, source_path",
    )
    .try_map(|row: EngineRow| {
        let line: Option<i64> = row.try_get("line")?;
        Ok(BlockedFile {
            robot: row.try_get("robot")?,
            source_name: row.try_get("source_name")?,
            source_path: row.try_get("source_path")?,
            run_id: row.try_get("run_id")?,
            line: line.map(|_| size(&row, "line")).transpose()?,
            remedy: row.try_get("remedy")?,
            blocked_at: time_text(&row, "blocked_at")?,
            message: row.try_get("message")?,
        })
    })
    .fetch_all(executor)
    .await
}
