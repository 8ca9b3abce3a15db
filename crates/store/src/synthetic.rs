//! A synthetic history for measuring the duration of queries on long histories.

use std::path::Path;

use sqlx::AssertSqlSafe;

use super::error::StoreError;
use super::handle::Store;
use super::results::production_evidence::packed;
use armwatch_model::analysis::work_evidence::{DEVIATION, JointEvidence, PRODUCTS};
use armwatch_model::robot::JointIndex;

const STATEMENTS: &str = include_str!("synthetic.sql");

/// Size of each file in a synthetic history, bytes; its modification time is one microsecond after the start of 1970.
pub const SYNTHETIC_FILE_BYTES: u64 = 1000;

/// Cycles inserted in one transaction, some 300 MB: the write-ahead log contains the transaction until its end.
const CYCLES_AT_ONCE: u32 = 24_000;

/// Size of a synthetic history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SyntheticSize {
    /// Robots, with the keys from 1 on.
    pub robots: u32,
    /// Tests of each.
    pub runs: u32,
    /// Cycles of each test.
    pub cycles: u32,
    /// Production logs after each test.
    pub logs: u32,
}

impl SyntheticSize {
    /// Names of its files, by run.
    pub fn file_names(self) -> impl Iterator<Item = String> {
        (0..self.robots * self.runs).map(move |run| {
            let (robot, number) = (run % self.robots + 1, run / self.robots);
            format!("S{robot:03}_{number:06}.csv")
        })
    }
}

/// Evidence of a log with six joints that move differently; it favours no cause.
fn evidence() -> Vec<JointEvidence> {
    let rows = 400;
    let of_joint = |joint: usize| {
        let mut products = [0.0; PRODUCTS];
        for row in 0..rows {
            // component along each direction, and the deviation, Nm
            let wave = |of: usize| (0.02 * (row * (3 + of)) as f64 + (joint * of) as f64).sin();
            let along: [f64; DEVIATION + 1] = std::array::from_fn(|of| match of {
                DEVIATION => 0.1 * wave(of),
                _ => (1.0 + joint as f64) * wave(of),
            });
            for a in 0..=DEVIATION {
                for b in a..=DEVIATION {
                    products[JointEvidence::index(a, b)] += along[a] * along[b] / rows as f64;
                }
            }
        }
        JointEvidence { joint: JointIndex::new(joint), windows: 1, samples: rows, products }
    };
    (0..6).map(of_joint).collect()
}

impl Store {
    /// Fills a database without runs with a history of this size, whose files are in `inbox`.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a database with runs; others of the database.
    pub async fn fill_synthetic(&self, size: SyntheticSize, inbox: &Path) -> Result<(), StoreError> {
        let runs = size.robots * size.runs;
        let at_once = (CYCLES_AT_ONCE / (size.cycles + size.logs)).max(1);
        let evidence: String = packed(&evidence()).iter().map(|byte| format!("{byte:02x}")).collect();
        for first in (0..runs).step_by(at_once as usize) {
            let statements = STATEMENTS
                .replace(":robots", &size.robots.to_string())
                .replace(":runs", &runs.to_string())
                .replace(":cycles", &size.cycles.to_string())
                .replace(":logs", &size.logs.to_string())
                .replace(":evidence", &format!("x'{evidence}'"))
                .replace(":first", &first.to_string())
                .replace(":last", &(first + at_once).min(runs).to_string())
                .replace(":inbox", &inbox.display().to_string().replace('\'', "''"));
            let mut transaction = self.begin().await?;
            let filled = sqlx::raw_sql(AssertSqlSafe(statements)).execute(&mut *transaction).await;
            self.checked(filled)?;
            self.commit(transaction).await?;
        }
        Ok(())
    }

    /// Sets the modification times of files in a database of [`Self::fill_synthetic`], by path, in microseconds since
    /// 1970.
    pub async fn change_synthetic_files(&self, changed: &[(String, i64)]) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        for some in changed.chunks(CYCLES_AT_ONCE as usize) {
            let told = sqlx::query(
                "UPDATE source_file SET modified = told.value ->> 1 FROM json_each($1) AS told
                 WHERE source_file.path = told.value ->> 0",
            )
            .bind(serde_json::json!(some).to_string())
            .execute(&mut *transaction)
            .await;
            self.checked(told)?;
        }
        self.commit(transaction).await
    }
}
