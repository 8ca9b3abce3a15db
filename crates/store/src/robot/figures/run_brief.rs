//! What is known of a complete test without its cycles, in one short row: of ten thousand tests, conclusions read ten
//! thousand of these, and the cycles of a dozen.
//!
//! The row follows from the test's series and goes with it (migration 0040). What was found in the cycles is kept with it,
//! each with the hash of all that it follows from, so that detectors see by themselves whether it holds.

use super::cycle_friction::Inertial;
use super::joint_summary::{self, SummaryRow};
use super::packed::{Reader, add_count, add_numbers};
use super::run_series::RunSeries;
use crate::engine::EngineExecutor;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::brief::{Brief, JointBrief, brief};

/// First byte of each column; other values are of another format, whose rows a migration takes away.
const FORMAT: u8 = 2;

/// What a test comes to by joint, and what stands for its cycles.
pub(in crate::robot) type Known = (Vec<SummaryRow>, Brief);

/// Stores what is known in brief of a test of which nothing is, without judgements.
pub(in crate::robot) async fn insert(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    (joints, brief): &Known,
) -> Result<(), sqlx::Error> {
    sqlx::query("INSERT INTO run_brief (run_id, joints, brief, judgements) VALUES ($1, $2, $3, $4)")
        .bind(run_id)
        .bind(packed_joints(joints))
        .bind(packed(brief))
        .bind(packed_judgements(&[]))
        .execute(executor)
        .await?;
    Ok(())
}

/// What a series comes to in brief.
pub(in crate::robot) fn of_series(series: RunSeries, run_id: i64, inertial: &Inertial) -> Known {
    let RunSeries { joints, friction, rmsd, parameters } = series;
    let run = RunSummary {
        run_id,
        cycle_friction: friction,
        whole_cycle_rmsd: rmsd,
        parameters: inertial.of_run(&parameters),
        ..RunSummary::default()
    };
    (joints, brief(&run))
}

/// Keeps what was found in the cycles of a test. Call in the transaction of the conclusion that found it.
pub(in crate::robot) async fn keep_judgements(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    judgements: &[(u64, Vec<u8>)],
) -> Result<(), sqlx::Error> {
    sqlx::query("UPDATE run_brief SET judgements = $1 WHERE run_id = $2")
        .bind(packed_judgements(judgements))
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(())
}

/// The columns of a row; `None` for those of another format.
pub(in crate::robot) fn unpacked(joints: &[u8], brief: &[u8], judgements: &[u8]) -> Option<Known> {
    let joints = unpacked_joints(joints)?;
    let mut brief = unpacked_brief(brief)?;
    // of another format, nothing is kept
    brief.judgements = unpacked_judgements(judgements).unwrap_or_default();
    Some((joints, brief))
}

fn packed_joints(joints: &[SummaryRow]) -> Vec<u8> {
    let mut bytes = vec![FORMAT];
    add_count(&mut bytes, joints.len());
    joints.iter().for_each(|row| joint_summary::pack(&mut bytes, row));
    bytes
}

fn unpacked_joints(bytes: &[u8]) -> Option<Vec<SummaryRow>> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let joints = reader.list(joint_summary::unpack)?;
    reader.0.is_empty().then_some(joints)
}

fn packed(brief: &Brief) -> Vec<u8> {
    let Brief { content, length, has_parameters, joints, judgements: _ } = brief;
    let mut bytes = vec![FORMAT];
    bytes.extend(content.to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend([u8::from(*has_parameters), 0, 0]);
    add_count(&mut bytes, joints.len());
    for JointBrief { friction, inner, furthest, has_rmsd } in joints {
        bytes.extend(friction.to_le_bytes());
        bytes.extend(inner.to_le_bytes());
        add_numbers(&mut bytes, [*furthest]);
        bytes.push(u8::from(*has_rmsd));
    }
    bytes
}

fn unpacked_brief(bytes: &[u8]) -> Option<Brief> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let (content, length) = (u64::from_le_bytes(reader.take()?), reader.u32()?);
    let [has_parameters, ..] = reader.take::<3>()?;
    let joints = reader.list(|reader| {
        let (friction, inner, furthest) = (reader.u32()?, reader.u32()?, reader.f64()?);
        Some(JointBrief { friction, inner, furthest, has_rmsd: reader.u8()? != 0 })
    })?;
    let judgements = Vec::new();
    let has_parameters = has_parameters != 0;
    reader.0.is_empty().then_some(Brief { content, length, has_parameters, joints, judgements })
}

fn packed_judgements(judgements: &[(u64, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = vec![FORMAT];
    add_count(&mut bytes, judgements.len());
    for (key, found) in judgements {
        bytes.extend(key.to_le_bytes());
        add_count(&mut bytes, found.len());
        bytes.extend(found);
    }
    bytes
}

fn unpacked_judgements(bytes: &[u8]) -> Option<Vec<(u64, Vec<u8>)>> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let judgements = reader.list(|reader| {
        let key = u64::from_le_bytes(reader.take()?);
        let length = reader.u32()? as usize;
        Some((key, reader.bytes(length)?.to_vec()))
    })?;
    reader.0.is_empty().then_some(judgements)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_brief_comes_back_to_the_last_bit() {
        let joint =
            |friction| JointBrief { friction, inner: 22, furthest: 1.0 / 3.0, has_rmsd: friction > 3 };
        let brief = Brief {
            content: u64::MAX - 7,
            length: 24,
            has_parameters: true,
            joints: vec![joint(24), joint(0)],
            judgements: vec![(7, vec![1, 2, 3]), (1 << 63, Vec::new())],
        };
        let (joints, bytes) = (packed_joints(&[]), packed(&brief));
        let judgements = packed_judgements(&brief.judgements);
        assert_eq!(bytes.len(), 20 + 2 * 17);
        assert_eq!(unpacked(&joints, &bytes, &judgements), Some((Vec::new(), brief.clone())));
        assert_eq!(unpacked(&joints, &bytes[1..], &judgements), None);
        assert_eq!(unpacked(&joints[1..], &bytes, &judgements), None);
        let without = Brief { judgements: Vec::new(), ..brief };
        assert_eq!(unpacked(&joints, &bytes, &judgements[..9]), Some((Vec::new(), without)));
    }
}
