//! What the next tests of a robot with a long history are compared with, in one row.
//!
//! The row follows from the tests until its latest one, and triggers take it away when one of these changes, goes or comes late
//! (migration 0043). Where it is not there, all tests are read.

use super::baseline_plan::known::{KnownMap, KnownPlan};
use super::baselines::FrictionTests;
use super::known_friction;
use crate::engine::EngineExecutor;
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::conclude::ConclusionTransaction;
use crate::robot::figures::packed::{Reader, add_count, add_joint};
use armwatch_model::robot::JointIndex;

/// First byte of the numbers; other values are of another format.
const FORMAT: u8 = 1;

impl Store {
    /// What the next tests of a robot are compared with, with baselines of so many tests; `None` where all tests have to be read.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_plan(
        &self,
        robot_id: i64,
        baseline_runs: usize,
    ) -> Result<Option<KnownPlan>, StoreError> {
        let numbers: Option<Vec<u8>> = self.checked(
            sqlx::query_scalar("SELECT numbers FROM friction_plan WHERE robot_id = $1 AND basis = $2")
                .bind(robot_id)
                .bind(KnownPlan::basis(baseline_runs))
                .fetch_optional(&self.readers)
                .await,
        )?;
        Ok(numbers.and_then(|numbers| unpacked(&numbers)))
    }

    /// What is known of the tests of a plan, of those that are remembered behind it, and of all later ones.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
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
    /// Keeps what the next tests are compared with, in place of what was kept. Only where the history is still the one that it
    /// follows from.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn keep_friction_plan(
        &mut self,
        plan: &KnownPlan,
        baseline_runs: usize,
    ) -> Result<(), StoreError> {
        let result = sqlx::query(
            "INSERT INTO friction_plan (robot_id, follows_until, basis, numbers) VALUES ($1, $2, $3, $4)
             ON CONFLICT (robot_id) DO UPDATE
             SET follows_until = excluded.follows_until, basis = excluded.basis, numbers = excluded.numbers",
        )
        .bind(self.robot_id)
        .bind(plan.until.0)
        .bind(KnownPlan::basis(baseline_runs))
        .bind(packed(plan))
        .execute(&mut *self.transaction)
        .await;
        self.checked(result)?;
        Ok(())
    }
}

async fn behind(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    from: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND started_at >= $2
         ORDER BY started_at, run_id",
    )
    .bind(robot_id)
    .bind(from)
    .fetch_all(executor)
    .await
}

fn packed(plan: &KnownPlan) -> Vec<u8> {
    let KnownPlan { until, description: (model, hash), full, maps, references } = plan;
    let mut bytes = vec![FORMAT];
    for number in [until.0, until.1, model.unwrap_or(-1)] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.push(u8::from(hash.is_some()));
    let hash = hash.as_deref().unwrap_or_default();
    add_count(&mut bytes, hash.len());
    bytes.extend(hash);
    add_places(&mut bytes, &full.iter().map(|(joint, count)| (*count, *joint)).collect::<Vec<_>>());
    add_places(&mut bytes, references);
    add_count(&mut bytes, maps.len());
    for KnownMap { joints, baseline, learnt, motion, companions, basis } in maps {
        let joints: Vec<(usize, JointIndex)> =
            joints.iter().map(|(joint, ordinal)| (*ordinal as usize, *joint)).collect();
        add_places(&mut bytes, &joints);
        for keys in [baseline, learnt, motion] {
            add_count(&mut bytes, keys.len());
            keys.iter().for_each(|key| bytes.extend(key.to_le_bytes()));
        }
        add_places(&mut bytes, companions);
        bytes.extend(basis);
    }
    bytes
}

fn add_places(bytes: &mut Vec<u8>, places: &[(usize, JointIndex)]) {
    add_count(bytes, places.len());
    for (place, joint) in places {
        add_count(bytes, *place);
        add_joint(bytes, *joint);
    }
}

/// `None` for bytes of another format.
fn unpacked(bytes: &[u8]) -> Option<KnownPlan> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let until = (reader.i64()?, reader.i64()?);
    let model = Some(reader.i64()?).filter(|model| *model >= 0);
    let has_hash = reader.u8()? != 0;
    let length = reader.u32()? as usize;
    let hash = reader.bytes(length)?.to_vec();
    let full = places(&mut reader)?.into_iter().map(|(count, joint)| (joint, count)).collect();
    let references = places(&mut reader)?;
    let maps = reader.list(|reader| {
        let joints = places(reader)?;
        Some(KnownMap {
            joints: joints.into_iter().map(|(ordinal, joint)| (joint, ordinal as u32)).collect(),
            baseline: reader.list(Reader::i64)?,
            learnt: reader.list(Reader::i64)?,
            motion: reader.list(Reader::i64)?,
            companions: places(reader)?,
            basis: reader.take()?,
        })
    })?;
    let description = (model, has_hash.then_some(hash));
    reader.0.is_empty().then_some(KnownPlan { until, description, full, maps, references })
}

fn places(reader: &mut Reader<'_>) -> Option<Vec<(usize, JointIndex)>> {
    reader.list(|reader| Some((reader.u32()? as usize, reader.joint()?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_comes_back_as_it_was() {
        let joint = JointIndex::new(3);
        let map = KnownMap {
            joints: vec![(joint, 2)],
            baseline: vec![1, 2],
            learnt: vec![1, 2, i64::MAX],
            motion: vec![],
            companions: vec![(0, joint)],
            basis: [7; 32],
        };
        let plan = KnownPlan {
            until: (-5, 9),
            description: (Some(4), Some(vec![1; 32])),
            full: vec![(joint, 70_000)],
            maps: vec![map.clone(), map],
            references: vec![(1, joint)],
        };
        let bytes = packed(&plan);
        assert_eq!(unpacked(&bytes), Some(plan.clone()));
        assert_eq!(unpacked(&bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked(&[2]), None);
        let without = KnownPlan { description: (None, None), ..plan };
        assert_eq!(unpacked(&packed(&without)), Some(without));
    }
}
