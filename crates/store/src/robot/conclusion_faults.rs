//! Robots whose conclusion failed, with the reasons.

use sqlx::Row;

use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::size;

/// A robot whose conclusion failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConclusionFault {
    /// The robot.
    pub robot: String,
    /// Reason.
    pub reason: String,
    /// Consecutive failed attempts.
    pub tries: u32,
}

impl Store {
    /// Stores that the conclusion of a robot failed, with the reason; returns true if the fault or its reason is new.
    /// The fault stays until a conclusion is stored.
    pub async fn note_conclusion_fault(&self, robot: &str, reason: &str) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let is_new = self.checked(note(&mut transaction, robot, reason).await)?;
        self.commit(transaction).await?;
        Ok(is_new)
    }

    /// Robots whose conclusion failed, by name.
    pub async fn conclusion_faults(&self) -> Result<Vec<ConclusionFault>, StoreError> {
        self.checked(all(&self.readers).await)
    }
}

async fn note(connection: &mut EngineConnection, robot: &str, reason: &str) -> sqlx::Result<bool> {
    let known: Option<String> = sqlx::query_scalar(
        "SELECT reason FROM conclusion_fault JOIN robot USING (robot_id) WHERE robot.name = $1",
    )
    .bind(robot)
    .fetch_optional(&mut *connection)
    .await?;
    sqlx::query(
        "INSERT INTO conclusion_fault (robot_id, reason)
         SELECT robot_id, $2 FROM robot WHERE name = $1
         ON CONFLICT (robot_id) DO UPDATE
         SET reason = excluded.reason, tries = conclusion_fault.tries + 1, last_at = excluded.last_at",
    )
    .bind_all((robot, reason))
    .execute(connection)
    .await?;
    Ok(known.as_deref() != Some(reason))
}

async fn all(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<ConclusionFault>> {
    sqlx::query("SELECT robot, reason, tries FROM conclusion_faults ORDER BY robot")
        .try_map(|row: EngineRow| {
            Ok(ConclusionFault {
                robot: row.try_get("robot")?,
                reason: row.try_get("reason")?,
                tries: size(&row, "tries")?,
            })
        })
        .fetch_all(executor)
        .await
}

/// Deletes the fault of a robot, because its conclusion is stored.
pub(crate) async fn forget(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM conclusion_fault WHERE robot_id = $1").bind(robot_id).run(executor).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HealthStatus;
    use crate::tests::support::*;
    use armwatch_model::anomaly::{Findings, Knowledge};
    use armwatch_model::robot::JointIndex;

    #[tokio::test]
    async fn a_fault_stands_until_conclusions_are_stored() {
        let (_folder, store) = fresh().await;
        let run_id = streaming_run(&store, "R00", 0, 1).await;
        assert!(store.note_conclusion_fault("R00", "first").await.expect("noted"));
        assert!(!store.note_conclusion_fault("R00", "first").await.expect("noted"));
        assert!(store.note_conclusion_fault("R00", "second").await.expect("noted"));
        assert!(store.note_conclusion_fault("R99", "unknown to the database").await.is_ok());
        let fault =
            |reason: &str, tries| ConclusionFault { robot: "R00".into(), reason: reason.into(), tries };
        assert_eq!(store.conclusion_faults().await.expect("faults"), [fault("second", 3)]);
        let mut end = store.finish_run(run_id).await.expect("an end");
        end.complete(totals(1)).await.expect("complete");
        end.commit().await.expect("committed");
        let robot = store.stale_robots().await.expect("robots").remove(0);
        let conclusion = store.conclude(robot.robot_id).await.expect("a transaction");
        conclusion.commit(robot.history).await.expect("committed");
        assert_eq!(store.conclusion_faults().await.expect("faults"), []);
    }

    #[tokio::test]
    async fn a_robot_is_unknown_while_nothing_is_concluded_of_it() {
        let (_folder, store) = fresh().await;
        let run_id = streaming_run(&store, "R00", 0, 1).await;
        let joint = JointIndex::new(0);
        let findings = Findings { health: vec![health(joint, Knowledge::Compared)], ..Findings::default() };
        finish(&store, run_id, 1, &findings).await;
        let status = async || {
            let all = store.fleet_health().await.expect("rows");
            let of_joint = all.into_iter().find(|row| row.joint == joint).expect("the joint");
            (of_joint.status, of_joint.reason)
        };
        assert_eq!(status().await.0, HealthStatus::Ok);
        store.note_conclusion_fault("R00", "no inverse").await.expect("noted");
        let reason = "nothing is concluded of the latest tests: no inverse".to_owned();
        assert_eq!(status().await, (HealthStatus::Unknown, Some(reason)));
    }
}
