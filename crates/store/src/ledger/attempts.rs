//! Attempts that are counted before they begin, so that work which ends the program is not tried forever.
//!
//! The regular end of an attempt deletes its row, so a remaining row names work that the program did not survive. Kills
//! from outside hit any work. Therefore only consecutive lives of the program add up: [`Store::take_over_attempts`]
//! deletes the rows of work that was not in progress when the last life ended. Before the [last
//! attempt](Attempt::is_last), the program waits until it has lived for [`QUIET_START`], which repeated kills from
//! outside do not allow.

use std::hash::{BuildHasher, RandomState};
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use crate::engine::{Bind, EngineConnection, EngineExecutor, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::count;

/// Most consecutive attempts that may end the program.
pub const MOST_ATTEMPTS: u32 = 3;

/// Age of the program before it makes the last attempt at some work. Repeated kills from outside come sooner, so no
/// work is blamed for them.
pub const QUIET_START: Duration = Duration::from_secs(10);

/// This process: a random number that identifies it, and the start of its work.
static PROCESS: LazyLock<(i64, Instant)> =
    LazyLock::new(|| (RandomState::new().hash_one(std::process::id()).cast_signed(), Instant::now()));

/// Remaining time before this process may make last attempts; `None` if it may.
pub fn wait_for_quiet() -> Option<Duration> {
    QUIET_START.checked_sub(PROCESS.1.elapsed())
}

/// A kind of work whose attempts are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttemptKind {
    /// The life of a daemon, by its host.
    Program,
    /// Reading an export, by its path in the ledger.
    Export,
    /// Drawing conclusions, by the robot.
    Conclusion,
    /// Sending a message about an alarm, by its key in table `delivery`.
    Delivery,
}

impl AttemptKind {
    fn name(self) -> &'static str {
        match self {
            Self::Program => "program",
            Self::Export => "export",
            Self::Conclusion => "conclusion",
            Self::Delivery => "delivery",
        }
    }
}

/// Number of an attempt at some work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attempt {
    /// Number of the attempt, from 1.
    pub number: u32,
}

impl Attempt {
    /// Returns true if earlier attempts have ended the program so often that this one must not be made.
    pub fn is_spent(self) -> bool {
        self.number > MOST_ATTEMPTS
    }

    /// Returns true if this is the last attempt that may end the program.
    pub fn is_last(self) -> bool {
        self.number == MOST_ATTEMPTS
    }
}

/// The file of an attempt at an export. Another file at the path starts a new count. So does a file that has more
/// stored cycles than at the attempt before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AttemptOn {
    /// Number of the file in its file system.
    pub inode: u64,
    /// Its size, bytes.
    pub bytes: u64,
}

impl Store {
    /// Counts an attempt before it is made. An attempt that this process has begun and not ended is the same attempt.
    ///
    /// # Errors
    /// [`StoreError`] of the database; the attempt must not be made then.
    pub async fn begin_attempt_at(
        &self,
        work: AttemptKind,
        subject: &str,
        on: AttemptOn,
    ) -> Result<Attempt, StoreError> {
        let mut transaction = self.begin().await?;
        let attempt = self.checked(begin(&mut transaction, (work, subject), on, PROCESS.0).await)?;
        self.commit(transaction).await?;
        Ok(attempt)
    }

    /// Earlier attempts at some work that the program did not survive.
    pub async fn failed_attempts(&self, work: AttemptKind, subject: &str) -> Result<u32, StoreError> {
        let found: sqlx::Result<Option<i64>> = sqlx::query_scalar(
            "SELECT attempts FROM attempt
             WHERE work = $1 AND subject = $2 AND version = $3 AND process IS DISTINCT FROM $4",
        )
        .bind_all((work.name(), subject, env!("CARGO_PKG_VERSION"), PROCESS.0))
        .fetch_optional(&self.readers)
        .await;
        Ok(self.checked(found)?.map_or(0, |attempts| u32::try_from(attempts).unwrap_or(u32::MAX)))
    }

    /// Records the end of an attempt with any outcome. Writes nothing if no attempt is stored.
    pub async fn end_attempt(&self, work: AttemptKind, subject: &str) -> Result<(), StoreError> {
        let any =
            sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM attempt WHERE work = $1 AND subject = $2)");
        if !self.checked(any.bind(work.name()).bind(subject).fetch_one(&self.readers).await)? {
            return Ok(());
        }
        let mut transaction = self.begin().await?;
        self.checked(end(&mut *transaction, work, subject).await)?;
        self.commit(transaction).await
    }

    /// Records that an attempt was interrupted, which is no evidence against its work: earlier attempts still count.
    pub async fn break_off_attempt(&self, work: AttemptKind, subject: &str) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(break_off(&mut transaction, Some((work, subject)), PROCESS.0).await)?;
        self.commit(transaction).await
    }

    /// Records that all work of this process was interrupted, because it ends in good order.
    pub(crate) async fn break_off_attempts(&self) -> Result<(), StoreError> {
        let any = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM attempt WHERE process = $1)");
        if !self.checked(any.bind(PROCESS.0).fetch_one(&self.readers).await)? {
            return Ok(());
        }
        let mut transaction = self.begin().await?;
        self.checked(break_off(&mut transaction, None, PROCESS.0).await)?;
        self.commit(transaction).await
    }

    /// Begins the life of a daemon. If the last life did not end in good order, work that was not in progress then is
    /// innocent, and its rows are deleted. Returns the other exports by their paths on this host, with the number of
    /// attempts that the program did not survive.
    pub async fn take_over_attempts(&self) -> Result<Vec<(PathBuf, u32)>, StoreError> {
        let host = self.located(String::new());
        let mut transaction = self.begin().await?;
        self.checked(take_over(&mut transaction, &host, PROCESS.0).await)?;
        let suspects = self.checked(suspects(&mut *transaction, PROCESS.0).await)?;
        self.commit(transaction).await?;
        let here = |(subject, attempts): (String, i64)| {
            let path = self.local_path(&subject)?;
            Some((std::path::absolute(&path).unwrap_or(path), u32::try_from(attempts).unwrap_or(u32::MAX)))
        };
        Ok(suspects.into_iter().filter_map(here).collect())
    }
}

pub(crate) async fn begin(
    connection: &mut EngineConnection,
    (work, subject): (AttemptKind, &str),
    on: AttemptOn,
    process: i64,
) -> sqlx::Result<Attempt> {
    // a run that never began has no cycles
    let attempts: i64 = sqlx::query_scalar(
        "INSERT INTO attempt (work, subject, attempts, process, version, inode, bytes, cycles)
         VALUES ($1, $2, 1, $3, $4, $5, $6, coalesce((
             SELECT run.cycles_stored FROM source_file JOIN run USING (run_id)
             WHERE $1 = 'export' AND source_file.path = $2), 0))
         ON CONFLICT (work, subject) DO UPDATE
         SET attempts = CASE
                 WHEN attempt.process IS NOT DISTINCT FROM excluded.process THEN attempt.attempts
                 WHEN attempt.inode = excluded.inode AND attempt.bytes <= excluded.bytes
                      AND attempt.cycles >= excluded.cycles AND attempt.version = excluded.version
                     THEN attempt.attempts + 1
                 ELSE 1 END,
             process = excluded.process, version = excluded.version, inode = excluded.inode,
             bytes = excluded.bytes, cycles = excluded.cycles
         RETURNING attempts",
    )
    .bind_all((work.name(), subject, process, env!("CARGO_PKG_VERSION"), on.inode.cast_signed()))
    .bind(count(on.bytes))
    .fetch_one(connection)
    .await?;
    Ok(Attempt { number: u32::try_from(attempts).unwrap_or(u32::MAX) })
}

/// Like [`begin`], for a message.
pub(crate) async fn begin_delivery(
    connection: &mut EngineConnection,
    delivery_id: i64,
) -> sqlx::Result<Attempt> {
    begin(connection, (AttemptKind::Delivery, &delivery_id.to_string()), AttemptOn::default(), PROCESS.0)
        .await
}

pub(crate) async fn end(
    executor: impl EngineExecutor<'_>,
    work: AttemptKind,
    subject: &str,
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM attempt WHERE work = $1 AND subject = $2")
        .bind_all((work.name(), subject))
        .run(executor)
        .await
}

/// Like [`end`], for messages whose keys are a JSON array.
pub(crate) async fn end_deliveries(
    executor: impl EngineExecutor<'_>,
    delivery_ids: &str,
) -> sqlx::Result<()> {
    sqlx::query(
        "DELETE FROM attempt
         WHERE work = 'delivery' AND subject IN (SELECT CAST(value AS TEXT) FROM json_each($1))",
    )
    .bind(delivery_ids)
    .run(executor)
    .await
}

/// Deletes the record that a process was at some work, or at any.
async fn break_off(
    connection: &mut EngineConnection,
    of: Option<(AttemptKind, &str)>,
    process: i64,
) -> sqlx::Result<()> {
    for sql in [
        "DELETE FROM attempt
         WHERE process = $1 AND work = coalesce($2, work) AND subject = coalesce($3, subject)
               AND (attempts = 1 OR work = 'program')",
        "UPDATE attempt SET attempts = attempts - 1, process = NULL
         WHERE process = $1 AND work = coalesce($2, work) AND subject = coalesce($3, subject)",
    ] {
        sqlx::query(sql)
            .bind_all((process, of.map(|(work, _)| work.name()), of.map(|(_, subject)| subject)))
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

async fn take_over(connection: &mut EngineConnection, host: &str, process: i64) -> sqlx::Result<()> {
    let life = begin(&mut *connection, (AttemptKind::Program, host), AttemptOn::default(), process).await?;
    if life.number > 1 {
        sqlx::query(
            "DELETE FROM attempt
             WHERE process IS NULL AND attempts < $1 AND (work <> 'export' OR subject LIKE $2 || '%')",
        )
        .bind_all((MOST_ATTEMPTS, host))
        .execute(&mut *connection)
        .await?;
    }
    // none of it is in progress until this life begins it again
    sqlx::query("UPDATE attempt SET process = NULL WHERE process <> $1 AND (work <> 'export' OR subject LIKE $2 || '%')")
        .bind_all((process, host))
        .run(connection)
        .await
}

async fn suspects(executor: impl EngineExecutor<'_>, process: i64) -> sqlx::Result<Vec<(String, i64)>> {
    sqlx::query_as(
        "SELECT subject, attempts FROM attempt
         WHERE work = 'export' AND version = $1 AND process IS DISTINCT FROM $2
         ORDER BY subject",
    )
    .bind_all((env!("CARGO_PKG_VERSION"), process))
    .fetch_all(executor)
    .await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::support::fresh;

    const FILE: AttemptOn = AttemptOn { inode: 7, bytes: 100 };

    struct Lives {
        _folder: tempfile::TempDir,
        store: Store,
        process: i64,
    }

    impl Lives {
        async fn new() -> Self {
            let (folder, store) = fresh().await;
            let lives = Self { _folder: folder, store, process: 1 };
            lives.start().await;
            lives
        }

        async fn start(&self) {
            let mut connection = self.store.writer.acquire().await.expect("a connection");
            take_over(&mut connection, "", self.process).await.expect("taken over");
        }

        /// The process is killed, and another one starts.
        async fn killed(&mut self) {
            self.process += 1;
            self.start().await;
        }

        async fn ended(&mut self) {
            let mut connection = self.store.writer.acquire().await.expect("a connection");
            break_off(&mut connection, None, self.process).await.expect("ended");
            drop(connection);
            self.killed().await;
        }

        async fn begin(&self, subject: &str, on: AttemptOn) -> Attempt {
            let mut connection = self.store.writer.acquire().await.expect("a connection");
            begin(&mut connection, (AttemptKind::Export, subject), on, self.process)
                .await
                .expect("an attempt")
        }

        async fn suspects(&self) -> Vec<(String, i64)> {
            suspects(&self.store.readers, self.process).await.expect("suspects")
        }
    }

    #[tokio::test]
    async fn three_lives_one_after_the_other_are_spent() {
        let mut lives = Lives::new().await;
        for number in 1..=3 {
            let attempt = lives.begin("/a.csv", FILE).await;
            assert_eq!((attempt.number, attempt.is_last(), attempt.is_spent()), (number, number == 3, false));
            assert_eq!(lives.begin("/a.csv", FILE).await, attempt, "the same attempt");
            lives.killed().await;
            assert_eq!(lives.suspects().await, [("/a.csv".to_owned(), i64::from(number))]);
        }
        assert!(lives.begin("/a.csv", FILE).await.is_spent());
        // it stays spent while it waits for a decision, whatever ends the program then
        for _ in 0..2 {
            lives.killed().await;
        }
        assert!(lives.begin("/a.csv", FILE).await.is_spent());
    }

    #[tokio::test]
    async fn a_life_that_ended_without_it_clears_an_export_and_a_regular_end_says_nothing() {
        let mut lives = Lives::new().await;
        lives.begin("/a.csv", FILE).await;
        lives.begin("/b.csv", FILE).await;
        lives.killed().await;
        assert_eq!(lives.begin("/a.csv", FILE).await.number, 2);
        lives.killed().await;
        assert_eq!(lives.suspects().await, [("/a.csv".to_owned(), 2)], "the second life ended without b");
        // a stop in good order while a was being read
        assert!(lives.begin("/a.csv", FILE).await.is_last());
        lives.ended().await;
        assert!(lives.begin("/a.csv", FILE).await.is_last());
        lives.ended().await;
        lives.ended().await;
        assert_eq!(lives.suspects().await, [("/a.csv".to_owned(), 2)]);
        // other work ends it
        lives.killed().await;
        assert!(lives.suspects().await.is_empty());
    }

    #[tokio::test]
    async fn another_file_and_progress_begin_to_count_anew() {
        let mut lives = Lives::new().await;
        for (on, number) in [
            (FILE, 1),
            (AttemptOn { bytes: 120, ..FILE }, 2),
            (AttemptOn { inode: 8, bytes: 120 }, 1),
            (AttemptOn { inode: 8, bytes: 60 }, 1),
            (AttemptOn { inode: 8, bytes: 60 }, 2),
        ] {
            assert_eq!(lives.begin("/a.csv", on).await.number, number, "{on:?}");
            lives.killed().await;
        }
        for sql in [
            "INSERT INTO robot (name) VALUES ('R01')",
            "INSERT INTO run (robot_id, model, started_at, source_name, source_path, source_bytes, content_hash, status,
                              cycles_stored)
             VALUES (1, 'er3a', 0, 'a.csv', '/a.csv', 60, randomblob(32), 'streaming', 1)",
            "INSERT INTO source_file (path, bytes, modified, run_id) VALUES ('/a.csv', 60, 0, 1)",
        ] {
            sqlx::query(sql).execute(&lives.store.writer).await.expect("a row");
        }
        let same = AttemptOn { inode: 8, bytes: 60 };
        for number in [1, 2, 3] {
            assert_eq!(lives.begin("/a.csv", same).await.number, number, "a cycle was stored once");
            lives.killed().await;
        }
    }
}
