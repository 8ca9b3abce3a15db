//! Maintenance entered by people, its effect on alarms, and the epochs of joints that follow from it.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt;

use jiff::{SignedDuration, Timestamp};
use sqlx::Row;

use super::alarms::alarm_life::{maintain, open_again};
use super::alarms::anomalies::Person;
use super::settled;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::ledger::attempts::{self, AttemptKind};
use crate::values::{joint, joint_number, json_list, time};
use armwatch_model::anomaly::epoch::{Maintenance, TestMoment, epochs};
use armwatch_model::robot::JointIndex;

/// Author of maintenance without a name.
pub(super) const SOMEBODY: &str = "somebody";

/// Shortest time between two entries of the same maintenance. Equal entries of a joint that are closer are one, entered
/// twice as by a double click: no one does the same maintenance twice within a minute.
const SAME_WORK: SignedDuration = SignedDuration::from_mins(1);

/// Maintenance of a robot with the robot's name and the time of entry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MaintenanceRow {
    /// The robot.
    pub robot: String,
    /// The maintenance.
    pub work: Maintenance,
    /// Time of entry, by the machine's clock.
    pub recorded_at: Timestamp,
}

impl fmt::Display for MaintenanceRow {
    /// Place, time and work, such as `Left, joint 3, 2026-03-01 14:30Z: gearbox changed`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Maintenance { joint, at, what, .. } = &self.work;
        let place = joint.map_or_else(|| "the whole arm".to_owned(), |joint| format!("joint {joint}"));
        write!(f, "{}, {place}, {}: {what}", self.robot, at.strftime("%Y-%m-%d %H:%MZ"))
    }
}

/// Maintenance of a robot to be entered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewMaintenance {
    /// The robot.
    pub robot: String,
    /// The joint; `None` for the whole arm.
    pub joint: Option<JointIndex>,
    /// Time of the maintenance.
    pub at: Timestamp,
    /// Work that was done.
    pub what: String,
    /// Person who enters it.
    pub who: Option<String>,
}

/// Reason why maintenance was not entered; nothing was changed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotEntered {
    /// No robot has this name.
    NoRobot,
    /// The same maintenance was entered before.
    Known(Box<MaintenanceRow>),
}

impl Store {
    /// Enters maintenance of a robot and returns its key. Anomalies of its place that began before it and are open,
    /// acknowledged or shelved are put into maintenance. The conclusions of the robot become stale.
    ///
    /// The same maintenance within a minute is one entry, also if two programs enter it at once.
    pub async fn enter_maintenance(
        &self,
        of: &NewMaintenance,
    ) -> Result<Result<i64, NotEntered>, StoreError> {
        let mut transaction = self.begin().await?;
        let entered = enter(&mut transaction, of).await;
        let entered = self.checked(entered)?;
        if entered.is_ok() {
            // the history has changed, so a conclusion that ended the program may be tried again
            let forgotten = attempts::end(&mut *transaction, AttemptKind::Conclusion, &of.robot).await;
            self.checked(forgotten)?;
            self.commit(transaction).await?;
        }
        Ok(entered)
    }

    /// Removes an entry and returns it; `None` if none has this key. Anomalies that are in maintenance by no other
    /// entry become open, and the conclusions of the robot become stale.
    pub async fn remove_maintenance(
        &self,
        maintenance_id: i64,
    ) -> Result<Option<MaintenanceRow>, StoreError> {
        let mut transaction = self.begin().await?;
        let removed = remove(&mut transaction, maintenance_id).await;
        let removed = self.checked(removed)?;
        self.commit(transaction).await?;
        Ok(removed)
    }

    /// Corrects an entry and returns its key, which is a new one if the place or the time has changed. Alarms and
    /// baselines are then as if the old entry had never existed. `None` if none has this key.
    pub async fn edit_maintenance(
        &self,
        maintenance_id: i64,
        of: &NewMaintenance,
    ) -> Result<Option<Result<i64, NotEntered>>, StoreError> {
        let mut transaction = self.begin().await?;
        let edited = edit(&mut transaction, maintenance_id, of).await;
        let edited = self.checked(edited)?;
        if matches!(edited, Some(Ok(_))) {
            self.commit(transaction).await?;
        }
        Ok(edited)
    }

    /// Maintenance of one robot or, without a name, of all, by time.
    pub async fn maintenance(&self, robot: Option<&str>) -> Result<Vec<MaintenanceRow>, StoreError> {
        self.checked(rows(&self.readers, robot).await)
    }

    /// Number of a robot's joints in its tests; `None` if no robot has this name.
    pub async fn known_joints(&self, robot: &str) -> Result<Option<usize>, StoreError> {
        let found: Option<i64> = self.checked(
            sqlx::query_scalar(
                "SELECT coalesce((SELECT max(summary.joint) FROM run JOIN run_joint_summary AS summary USING (run_id)
                                WHERE run.robot_id = robot.robot_id), 0)
                 FROM robot WHERE name = $1",
            )
            .bind(robot)
            .fetch_optional(&self.readers)
            .await,
        )?;
        Ok(found.map(|joints| usize::try_from(joints).unwrap_or(0)))
    }
}

/// True if the new entry is the same as a known one.
fn is_same(known: &Maintenance, new: &NewMaintenance) -> bool {
    known.joint == new.joint && known.what == new.what && known.at.duration_since(new.at).abs() < SAME_WORK
}

async fn enter(
    connection: &mut EngineConnection,
    of: &NewMaintenance,
) -> sqlx::Result<Result<i64, NotEntered>> {
    let known = rows(&mut *connection, Some(&of.robot)).await?;
    if let Some(row) = known.into_iter().find(|row| is_same(&row.work, of)) {
        return Ok(Err(NotEntered::Known(Box::new(row))));
    }
    let entered: Option<i64> = sqlx::query_scalar(
        "INSERT INTO maintenance (robot_id, joint, at, what, who)
         SELECT robot_id, $2, $3, $4, $5 FROM robot WHERE name = $1
         RETURNING maintenance_id",
    )
    .bind_all((&of.robot, of.joint.map(joint_number), of.at.as_microsecond(), &of.what, of.who.as_deref()))
    .fetch_optional(&mut *connection)
    .await?;
    let Some(entered) = entered else { return Ok(Err(NotEntered::NoRobot)) };
    settled::reopen(&mut *connection, &of.robot, of.at).await?;
    let by = Person { who: of.who.as_deref().unwrap_or(SOMEBODY), why: Some(&of.what) };
    for anomaly_id in unsettled_before(&mut *connection, of).await? {
        maintain(&mut *connection, anomaly_id, by).await?;
    }
    Ok(Ok(entered))
}

/// Anomalies of the place of maintenance that began before it, have not ended, and are neither closed nor in
/// maintenance by another entry.
async fn unsettled_before(executor: impl EngineExecutor<'_>, of: &NewMaintenance) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT anomaly.anomaly_id
         FROM anomaly JOIN robot ON robot.robot_id = anomaly.robot_id
         WHERE robot.name = $1 AND ($2 IS NULL OR anomaly.joint = $2)
               AND (anomaly.first_seen_at < $3 OR anomaly.onset_at < $3)
               AND (anomaly.state IN ('open', 'acknowledged', 'shelved')
                    OR anomaly.state = 'maintenance' AND anomaly.shelved_until IS NOT NULL)
               AND NOT anomaly.ended AND NOT anomaly.withdrawn
         ORDER BY anomaly.anomaly_id",
    )
    .bind_all((&of.robot, of.joint.map(joint_number), of.at.as_microsecond()))
    .fetch_all(executor)
    .await
}

async fn edit(
    connection: &mut EngineConnection,
    maintenance_id: i64,
    of: &NewMaintenance,
) -> sqlx::Result<Option<Result<i64, NotEntered>>> {
    let all = rows(&mut *connection, None).await?;
    let Some(old) = all.into_iter().find(|row| row.work.maintenance_id == maintenance_id) else {
        return Ok(None);
    };
    if (&old.robot, old.work.joint, old.work.at) != (&of.robot, of.joint, of.at) {
        remove(&mut *connection, maintenance_id).await?;
        return enter(connection, of).await.map(Some);
    }
    sqlx::query("UPDATE maintenance SET what = $1, who = $2 WHERE maintenance_id = $3")
        .bind_all((&of.what, of.who.as_deref(), maintenance_id))
        .execute(connection)
        .await?;
    Ok(Some(Ok(maintenance_id)))
}

async fn remove(
    connection: &mut EngineConnection,
    maintenance_id: i64,
) -> sqlx::Result<Option<MaintenanceRow>> {
    let all = rows(&mut *connection, None).await?;
    let removed = all.into_iter().find(|row| row.work.maintenance_id == maintenance_id);
    sqlx::query("DELETE FROM maintenance WHERE maintenance_id = $1")
        .bind(maintenance_id)
        .execute(&mut *connection)
        .await?;
    if let Some(row) = &removed {
        settled::reopen(&mut *connection, &row.robot, row.work.at).await?;
        for anomaly_id in maintained_by_nothing(&mut *connection, row).await? {
            open_again(&mut *connection, anomaly_id).await?;
        }
    }
    Ok(removed)
}

/// Anomalies at the place of a removed entry that are in maintenance by no other entry, including withdrawn ones. A
/// later event has given an anomaly another state, so that it is not among them.
async fn maintained_by_nothing(
    executor: impl EngineExecutor<'_>,
    removed: &MaintenanceRow,
) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT anomaly.anomaly_id
         FROM anomaly JOIN robot ON robot.robot_id = anomaly.robot_id
         WHERE robot.name = $1 AND ($2 IS NULL OR anomaly.joint = $2)
               AND anomaly.state = 'maintenance' AND anomaly.shelved_until IS NULL
               AND NOT EXISTS (
                   SELECT 1 FROM maintenance
                   WHERE maintenance.robot_id = anomaly.robot_id
                         AND (maintenance.joint IS NULL OR maintenance.joint = anomaly.joint)
                         AND (anomaly.first_seen_at < maintenance.at OR anomaly.onset_at < maintenance.at))
         ORDER BY anomaly.anomaly_id",
    )
    .bind_all((&removed.robot, removed.work.joint.map(joint_number)))
    .fetch_all(executor)
    .await
}

async fn rows(executor: impl EngineExecutor<'_>, robot: Option<&str>) -> sqlx::Result<Vec<MaintenanceRow>> {
    sqlx::query(
        "SELECT robot.name AS robot, maintenance_id, joint, at, what, who, recorded_at
         FROM maintenance JOIN robot USING (robot_id)
         WHERE $1 IS NULL OR robot.name = $1
         ORDER BY at, maintenance_id",
    )
    .bind(robot)
    .try_map(|row: EngineRow| {
        Ok(MaintenanceRow {
            robot: row.try_get("robot")?,
            work: maintenance(&row)?,
            recorded_at: time(&row, "recorded_at")?,
        })
    })
    .fetch_all(executor)
    .await
}

fn maintenance(row: &EngineRow) -> sqlx::Result<Maintenance> {
    let of_joint = row.try_get::<Option<i64>, _>("joint")?.is_some();
    Ok(Maintenance {
        maintenance_id: row.try_get("maintenance_id")?,
        joint: if of_joint { Some(joint(row, "joint")?) } else { None },
        at: time(row, "at")?,
        what: row.try_get("what")?,
        who: row.try_get("who")?,
    })
}

/// Maintenance of one robot, by time.
pub(crate) async fn of_robot(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
) -> sqlx::Result<Vec<Maintenance>> {
    sqlx::query(
        "SELECT maintenance_id, joint, at, what, who FROM maintenance
         WHERE robot_id = $1 ORDER BY at, maintenance_id",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| maintenance(&row))
    .fetch_all(executor)
    .await
}

/// Key of a description: epochs differ if it differs.
pub type DescriptionKey = (Option<i64>, Option<Vec<u8>>);

/// Data of the robot's complete tests that determine epochs, with their keys, oldest first. A test whose description
/// was not stored in full has that of the oldest test of the same model with one.
pub(crate) async fn test_moments(
    connection: &mut EngineConnection,
    robot_id: i64,
) -> sqlx::Result<Vec<(i64, TestMoment<DescriptionKey>)>> {
    let found = sqlx::query(
        "SELECT run_id, started_at, robot_model_id, figures_hash FROM run
         WHERE robot_id = $1 AND kind = 'test' AND status = 'complete'
         ORDER BY started_at, run_id",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| test_moment(&row))
    .fetch_all(&mut *connection)
    .await?;
    described(connection, robot_id, found).await
}

/// Like [`test_moments`], for the tests of these keys; one of them may be incomplete.
pub(super) async fn moments_of(
    connection: &mut EngineConnection,
    robot_id: i64,
    keys: &[i64],
) -> sqlx::Result<Vec<(i64, TestMoment<DescriptionKey>)>> {
    let found = sqlx::query(
        "SELECT run_id, started_at, robot_model_id, figures_hash FROM run
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
         ORDER BY started_at, run_id",
    )
    .bind(json_list(keys))
    .try_map(|row: EngineRow| test_moment(&row))
    .fetch_all(&mut *connection)
    .await?;
    described(connection, robot_id, found).await
}

fn test_moment(row: &EngineRow) -> sqlx::Result<(i64, TestMoment<DescriptionKey>)> {
    let description: DescriptionKey = (row.try_get("robot_model_id")?, row.try_get("figures_hash")?);
    Ok((row.try_get("run_id")?, TestMoment { started_at: time(row, "started_at")?, description }))
}

/// Gives tests without a description that of the robot's oldest test of the same model with one.
async fn described(
    connection: &mut EngineConnection,
    robot_id: i64,
    mut tests: Vec<(i64, TestMoment<DescriptionKey>)>,
) -> sqlx::Result<Vec<(i64, TestMoment<DescriptionKey>)>> {
    let mut given: HashMap<Option<i64>, Vec<u8>> = HashMap::new();
    for (_, TestMoment { description: (model, hash), .. }) in &tests {
        if let Some(hash) = hash {
            given.entry(*model).or_insert_with(|| hash.clone());
        }
    }
    let mut oldest: HashMap<Option<i64>, Option<Vec<u8>>> = HashMap::new();
    for (_, TestMoment { description: (model, hash), .. }) in &mut tests {
        if hash.is_some() {
            continue;
        }
        let known = match oldest.entry(*model) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let of_complete = oldest_description(&mut *connection, robot_id, *model).await?;
                // of an incomplete test, if no other has one
                new.insert(of_complete.or_else(|| given.get(model).cloned()))
            }
        };
        hash.clone_from(known);
    }
    Ok(tests)
}

async fn oldest_description(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    model: Option<i64>,
) -> sqlx::Result<Option<Vec<u8>>> {
    sqlx::query_scalar(
        "SELECT figures_hash FROM run
         WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND robot_model_id IS NOT DISTINCT FROM $2
               AND figures_hash IS NOT NULL
         ORDER BY started_at, run_id LIMIT 1",
    )
    .bind_all((robot_id, model))
    .fetch_optional(executor)
    .await
}

/// Ordinals of the epochs of each joint, by run, for tests that include the first of each epoch; `joints` ordinals per
/// run.
pub(crate) async fn epoch_ordinals(
    connection: &mut EngineConnection,
    robot_id: i64,
    joints: usize,
    among: &[i64],
) -> sqlx::Result<HashMap<i64, Vec<u32>>> {
    let tests = moments_of(&mut *connection, robot_id, among).await?;
    let work = of_robot(connection, robot_id).await?;
    let (run_ids, moments): (Vec<i64>, Vec<TestMoment<DescriptionKey>>) = tests.into_iter().unzip();
    let mut by_run = vec![vec![0; joints]; run_ids.len()];
    for joint in (0..joints).map(JointIndex::new) {
        for (ordinal, epoch) in (0..).zip(epochs(joint, &moments, &work)) {
            epoch.tests.into_iter().for_each(|test| by_run[test][joint.index()] = ordinal);
        }
    }
    Ok(run_ids.into_iter().zip(by_run).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(text: &str) -> Timestamp {
        text.parse().expect("a time")
    }

    fn work(joint: Option<usize>, at: &str) -> Maintenance {
        let joint = joint.and_then(JointIndex::from_number);
        Maintenance { maintenance_id: 7, joint, at: time(at), what: "gearbox changed".into(), who: None }
    }

    #[test]
    fn the_same_work_is_known_again_and_other_work_is_not() {
        let entered = |joint: usize, at: &str, what: &str| NewMaintenance {
            robot: "Left".into(),
            joint: JointIndex::from_number(joint),
            at: time(at),
            what: what.into(),
            who: Some("mueller".into()),
        };
        let known = work(Some(3), "2026-03-01T14:30:00Z");
        let (same, what) = ("2026-03-01T14:30:00Z", "gearbox changed");
        assert!(is_same(&known, &entered(3, same, what)));
        assert!(is_same(&known, &entered(3, "2026-03-01T14:30:20Z", what)));
        assert!(!is_same(&known, &entered(4, same, what)));
        assert!(!is_same(&known, &entered(3, same, "brake changed")));
        assert!(!is_same(&known, &entered(3, "2026-03-02T14:30:00Z", what)));
        // a joint is not the whole arm
        assert!(!is_same(&work(None, same), &entered(3, same, what)));
    }

    #[test]
    fn an_entry_says_where_when_and_what() {
        let recorded_at = time("2026-03-02T08:00:00Z");
        let row = |joint| MaintenanceRow {
            robot: "Left".into(),
            work: work(joint, "2026-03-01T14:30:00Z"),
            recorded_at,
        };
        assert_eq!(row(Some(3)).to_string(), "Left, joint 3, 2026-03-01 14:30Z: gearbox changed");
        assert_eq!(row(None).to_string(), "Left, the whole arm, 2026-03-01 14:30Z: gearbox changed");
    }
}
