//! Data for comparing the next tests of a robot with a long history, in one row.
//!
//! The row is computed from the tests up to the latest. It is valid as long as none of these changes, is deleted or
//! arrives late, which `robot.past_revision` counts, and while the program uses the method that computed it. Otherwise
//! all tests are read.

use super::baseline_plan::known::KnownPlan;
use super::baselines::FrictionTests;
use super::known_friction;
use crate::engine::{Bind, EngineExecutor};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::conclude::ConclusionTransaction;
use crate::robot::figures::packed::{packed, unpacked};
use crate::values::count;

impl Store {
    /// Data for comparing the next tests of a robot, with baselines of `baseline_runs` tests; `None` if all tests have
    /// to be read.
    pub async fn friction_plan(
        &self,
        robot_id: i64,
        baseline_runs: usize,
        method: u64,
    ) -> Result<Option<KnownPlan>, StoreError> {
        let numbers: Option<Vec<u8>> = self.checked(
            sqlx::query_scalar(
                "SELECT friction_plan.numbers FROM friction_plan JOIN robot USING (robot_id)
                 WHERE robot_id = $1 AND revision = past_revision AND baseline_runs = $2 AND method = $3",
            )
            .bind_all((robot_id, count(baseline_runs), method.cast_signed()))
            .fetch_optional(&self.readers)
            .await,
        )?;
        Ok(numbers.and_then(|numbers| unpacked(&numbers)))
    }

    /// Data of the tests of a plan, of the tests that it remembers, and of all later ones.
    pub async fn friction_tests_of(
        &self,
        robot_id: i64,
        plan: &KnownPlan,
    ) -> Result<FrictionTests, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        let keys = behind(&mut *connection, robot_id, plan.remembers_from()).await;
        let keys = [plan.tests(), self.checked(keys)?].concat();
        self.checked(known_friction::of_keys(&mut connection, robot_id, &keys).await)
    }
}

impl ConclusionTransaction {
    /// Stores the data for comparing the next tests, replacing earlier ones. Does so only if the history is still the
    /// one that they were computed from.
    pub async fn keep_friction_plan(
        &mut self,
        plan: &KnownPlan,
        baseline_runs: usize,
        method: u64,
    ) -> Result<(), StoreError> {
        let numbers = self.checked(packed(plan))?;
        let result = sqlx::query(
            "INSERT INTO friction_plan (robot_id, revision, baseline_runs, method, numbers)
             SELECT robot_id, past_revision, $2, $3, $4 FROM robot WHERE robot_id = $1
             ON CONFLICT (robot_id) DO UPDATE
             SET revision = excluded.revision, baseline_runs = excluded.baseline_runs, method = excluded.method,
                 numbers = excluded.numbers",
        )
        .bind_all((self.robot_id, count(baseline_runs), method.cast_signed(), numbers))
        .execute(&mut *self.transaction)
        .await;
        self.checked(result)?;
        Ok(())
    }
}

async fn behind(executor: impl EngineExecutor<'_>, robot_id: i64, from: i64) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND started_at >= $2
         ORDER BY started_at, run_id",
    )
    .bind_all((robot_id, from))
    .fetch_all(executor)
    .await
}
