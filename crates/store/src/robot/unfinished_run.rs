//! A test that is still being written: the inputs of its evaluation, and its effect on anomalies.
//!
//! A finding of such a test is an anomaly with a number, a state and events like others, marked with the test. It stays
//! until the test is complete, whatever the following cycles show, so that it is announced only once. Then the robot's
//! whole history decides ([`super::alarms::anomalies::reconcile`]): the anomaly continues or is withdrawn.

use jiff::Timestamp;
use sqlx::Row;

use super::alarms::alarm_state::{AlarmState, Announcement, EventKind, Life, Now, go_on};
use super::alarms::anomalies::{
    Reconciled, StoredAnomaly, episode, insert_anomaly, record, run_starts, stored_anomalies, update_anomaly,
};
use super::alarms::episodes::{Episode, goes_on, is_another_fault, same};
use super::conclude::ConclusionTransaction;
use super::{maintenance, settled};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{finite, size, time};
use armwatch_model::anomaly::Anomaly;

/// A test that is still being written, and its robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenTest {
    /// Key of the run.
    pub run_id: i64,
    /// Key of the robot.
    pub robot_id: i64,
    /// Its name.
    pub robot: String,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// Cycles stored so far.
    pub cycles: u32,
    /// Number of changes of the robot's history when this was read.
    pub history: i64,
    /// True if the conclusion from that history is stored.
    pub is_concluded: bool,
    /// True if every complete test of the robot began before it.
    pub is_latest: bool,
}

impl Store {
    /// The test of this key while it is being written; `None` if it is no test, or no longer open.
    pub async fn open_test(&self, run_id: i64) -> Result<Option<OpenTest>, StoreError> {
        self.checked(open_test(&self.readers, run_id).await)
    }

    /// Ordinals of the epochs of the first `joints` joints that an open test belongs to; see
    /// [`RunSummary::epochs`](armwatch_model::anomaly::RunSummary::epochs).
    pub async fn open_test_epochs(&self, test: &OpenTest, joints: usize) -> Result<Vec<u32>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        let (robot_id, run_id) = (test.robot_id, test.run_id);
        let among = self.checked(settled::latest_keys(&mut connection, robot_id).await)?;
        let among = [&among[..], &[run_id]].concat();
        let of = maintenance::epoch_ordinals(&mut connection, robot_id, joints, &among).await;
        Ok(self.checked(of)?.remove(&run_id).unwrap_or_default())
    }
}

impl ConclusionTransaction {
    /// Includes the present findings of an open test, and stores the events. `None`, and nothing stored, if the test is
    /// no longer open: then the complete test decides.
    ///
    /// A finding that continues an anomaly of the robot's complete tests is announced only if it is worse by a step.
    pub async fn reconcile_open(
        &mut self,
        test: &OpenTest,
        findings: &[Anomaly],
    ) -> Result<Option<Reconciled>, StoreError> {
        let result = reconcile_open(&mut self.transaction, test, findings, Timestamp::now()).await;
        self.checked(result)
    }
}

async fn open_test(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Option<OpenTest>> {
    sqlx::query(
        "SELECT run.run_id, run.robot_id, robot.name AS robot, run.started_at, run.cycles_stored, robot.history,
                robot.history = robot.concluded AS is_concluded,
                NOT EXISTS (SELECT 1 FROM run AS later
                            WHERE later.robot_id = run.robot_id AND later.kind = 'test' AND later.status = 'complete'
                                  AND later.started_at >= run.started_at) AS is_latest
         FROM run JOIN robot USING (robot_id)
         WHERE run.run_id = $1 AND run.kind = 'test' AND run.status = 'streaming'",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(OpenTest {
            run_id: row.try_get("run_id")?,
            robot_id: row.try_get("robot_id")?,
            robot: row.try_get("robot")?,
            started_at: time(&row, "started_at")?,
            cycles: size(&row, "cycles_stored")?,
            history: row.try_get("history")?,
            is_concluded: row.try_get("is_concluded")?,
            is_latest: row.try_get("is_latest")?,
        })
    })
    .fetch_optional(executor)
    .await
}

async fn reconcile_open(
    connection: &mut EngineConnection,
    test: &OpenTest,
    findings: &[Anomaly],
    clock: Timestamp,
) -> sqlx::Result<Option<Reconciled>> {
    let run_id = test.run_id;
    if open_test(&mut *connection, run_id).await?.is_none() {
        return Ok(None);
    }
    let is_own = |of: &StoredAnomaly| of.open_test.as_ref().is_some_and(|open| open.run_id == run_id);
    let all = stored_anomalies(&mut *connection, test.robot_id).await?;
    let starts = run_starts(&mut *connection, test.robot_id, &all).await?;
    let (own, others): (Vec<StoredAnomaly>, Vec<StoredAnomaly>) = all.into_iter().partition(is_own);
    let mut events = Vec::new();
    let mut new = Vec::new();
    for anomaly in findings {
        let found = episode(anomaly);
        let Some(known) = others.iter().find(|of| goes_on(&of.episode, &found)) else {
            new.push(anomaly);
            continue;
        };
        let (life, happened) = go_on(&known.before, &now(anomaly, &known.episode), clock);
        if !happened.is_empty() {
            show_worse(&mut *connection, known.anomaly_id, anomaly, &life).await?;
        }
        for what in happened {
            events.push(record(&mut *connection, known.anomaly_id, what, None).await?);
        }
    }
    let episodes: Vec<Episode> = own.iter().map(|of| of.episode.clone()).collect();
    let found: Vec<Episode> = new.iter().map(|anomaly| episode(anomaly)).collect();
    for (anomaly, known) in new.into_iter().zip(same(&episodes, &found, &starts)) {
        let Some(known) = known.map(|o| &own[o]) else {
            let state = AlarmState::Open;
            let id = insert_anomaly(&mut *connection, test.robot_id, anomaly, state, Some(run_id)).await?;
            events.push(record(&mut *connection, id, EventKind::Opened, None).await?);
            continue;
        };
        let (life, happened) = go_on(&known.before, &now(anomaly, &known.episode), clock);
        update_anomaly(&mut *connection, known.anomaly_id, anomaly, &life, Some(run_id)).await?;
        for what in happened {
            events.push(record(&mut *connection, known.anomaly_id, what, None).await?);
        }
    }
    Ok(Some(Reconciled { events }))
}

fn now(anomaly: &Anomaly, known: &Episode) -> Now {
    let kinds = (known.kind, anomaly.kind);
    Now {
        shown: Announcement { severity: anomaly.severity, score: finite(anomaly.score).map(f64::abs) },
        ended: false,
        last_seen_at: anomaly.last_seen_at,
        corrected: kinds.0 != kinds.1,
        is_another_fault: is_another_fault(kinds.0, kinds.1),
    }
}

/// Shows the contribution of an open test to an anomaly of complete ones. The anomaly keeps its time and place of
/// onset.
async fn show_worse(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    anomaly: &Anomaly,
    life: &Life,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE anomaly
         SET severity = $1, score = $2, threshold = $3, value = $4, baseline = $5, message = $6, last_run_id = $7,
             last_seen_at = $8, peak_value = CASE WHEN $2 > coalesce(peak_score, 0) THEN $4 ELSE peak_value END,
             peak_score = max(coalesce($2, 0), coalesce(peak_score, 0)), state = $9, shelved_until = $10, resolved_seen_at = $11
         WHERE anomaly_id = $12",
    )
    .bind_all((anomaly.severity.name(), finite(anomaly.score), finite(anomaly.threshold)))
    .bind_all((finite(anomaly.value), finite(anomaly.baseline), &anomaly.message, anomaly.last_run_id))
    .bind_all((anomaly.last_seen_at.as_microsecond(), life.state.name()))
    .bind(life.shelved_until.map(Timestamp::as_microsecond))
    .bind_all((life.resolved_seen_at.map(Timestamp::as_microsecond), anomaly_id))
    .run(executor)
    .await
}
