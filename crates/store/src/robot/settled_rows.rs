//! Rows of what is settled of a robot's histories, of tests and of ordinary work, boundary by boundary, and keys of the
//! runs of windows.

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, Row};

use super::figures::packed::{Reader, add_count, add_numbers};
use crate::engine::{EngineConnection, EngineExecutor, EngineRow};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{Alternative, Anomaly, AnomalyKind, Onset, Severity};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::RunKind;

/// First byte of the numbers; other values are of another format.
const FORMAT: u8 = 1;

/// Says what has settled an anomaly.
pub(super) async fn settle_anomaly(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    settled_by: Option<i64>,
) -> Result<(), sqlx::Error> {
    if settled_by.is_some() {
        sqlx::query("UPDATE anomaly SET settled_history_id = $1 WHERE anomaly_id = $2")
            .bind(settled_by)
            .bind(anomaly_id)
            .execute(executor)
            .await?;
    }
    Ok(())
}

/// Settles what was taken back of a history before the window: runs that begin with this one say no more of it.
pub(super) async fn settle_withdrawn(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    settled: &Settled,
) -> Result<(), sqlx::Error> {
    let Some((leads_from, _)) = settled.leads_from else { return Ok(()) };
    let of_kind = Quantity::ALL.iter().filter(|of| of.history() == kind).map(|of| format!("'{of}'"));
    let quantities = of_kind.collect::<Vec<_>>().join(", ");
    sqlx::query(AssertSqlSafe(format!(
        "UPDATE anomaly
         SET settled_history_id = (SELECT settled_history_id FROM settled_history
                                   WHERE robot_id = $1 AND kind = $2 AND runs = $3)
         WHERE robot_id = $1 AND settled_history_id IS NULL AND withdrawn AND last_seen_at < $4
               AND open_run_id IS NULL AND quantity IN ({quantities})"
    )))
    .bind(robot_id)
    .bind(kind.name())
    .bind(i64::try_from(settled.runs).unwrap_or(i64::MAX))
    .bind(leads_from.as_microsecond())
    .execute(executor)
    .await?;
    Ok(())
}

/// Keys of the tests by which epochs of a robot's latest tests are told apart.
pub(super) async fn latest_keys(
    connection: &mut EngineConnection,
    robot_id: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    let settled = latest(&mut *connection, robot_id, RunKind::Test).await?.unwrap_or_default();
    let keys = keys(connection, robot_id, RunKind::Test, &settled, usize::MAX).await?;
    Ok([settled.first_of_epochs, keys].concat())
}

/// Keys of the runs of a window, oldest first: tests with a result or without, and logs that are held against a test.
pub(super) async fn keys(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    settled: &Settled,
    most: usize,
) -> Result<Vec<i64>, sqlx::Error> {
    let from = settled.leads_from.map_or((i64::MIN, i64::MIN), |(at, run_id)| (at.as_microsecond(), run_id));
    // each kind has an index of its own
    let statement = match kind {
        RunKind::Test => {
            "SELECT run_id FROM run
             WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND (started_at, run_id) >= ($2, $3)
             ORDER BY started_at, run_id LIMIT $4"
        }
        RunKind::Production => {
            "SELECT run_id FROM run
             WHERE robot_id = $1 AND kind = 'production' AND status = 'complete' AND (started_at, run_id) >= ($2, $3)
                   AND EXISTS (SELECT 1 FROM production_summary AS summary WHERE summary.run_id = run.run_id)
             ORDER BY started_at, run_id LIMIT $4"
        }
    };
    let behind: Vec<i64> = sqlx::query_scalar(statement)
        .bind(robot_id)
        .bind(from.0)
        .bind(from.1)
        .bind(i64::try_from(most).unwrap_or(i64::MAX))
        .fetch_all(executor)
        .await?;
    Ok(settled.read.iter().copied().chain(behind).collect())
}

pub(super) async fn forget_others(
    connection: &mut EngineConnection,
    robot_id: i64,
    kind: RunKind,
    basis: u64,
) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM settled_history WHERE robot_id = $1 AND kind = $2 AND basis <> $3")
        .bind(robot_id)
        .bind(kind.name())
        .bind(basis.cast_signed())
        .execute(&mut *connection)
        .await?;
    // of another format, nothing is known of what comes behind it either
    let is_readable = match latest_row(&mut *connection, robot_id, kind).await? {
        Some((runs, numbers)) => unpacked(runs, &numbers).is_some(),
        None => true,
    };
    if !is_readable {
        sqlx::query("DELETE FROM settled_history WHERE robot_id = $1 AND kind = $2")
            .bind(robot_id)
            .bind(kind.name())
            .execute(connection)
            .await?;
    }
    Ok(())
}

async fn latest_row(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
) -> Result<Option<(i64, Vec<u8>)>, sqlx::Error> {
    sqlx::query(
        "SELECT runs, numbers FROM settled_history WHERE robot_id = $1 AND kind = $2 ORDER BY runs DESC LIMIT 1",
    )
    .bind(robot_id)
    .bind(kind.name())
    .try_map(|row: EngineRow| Ok((row.try_get("runs")?, row.try_get("numbers")?)))
    .fetch_optional(executor)
    .await
}

pub(super) async fn latest(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
) -> Result<Option<Settled>, sqlx::Error> {
    let row = latest_row(executor, robot_id, kind).await?;
    Ok(row.and_then(|(runs, numbers)| unpacked(runs, &numbers)))
}

pub(super) async fn insert(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    settled: &Settled,
    basis: u64,
) -> Result<i64, sqlx::Error> {
    let until = settled.follows_until.map_or(i64::MAX, |(at, _)| at.as_microsecond());
    sqlx::query_scalar(
        "INSERT INTO settled_history (robot_id, kind, runs, follows_until, basis, numbers)
         VALUES ($1, $2, $3, $4, $5, $6)
         RETURNING settled_history_id",
    )
    .bind(robot_id)
    .bind(kind.name())
    .bind(i64::try_from(settled.runs).unwrap_or(i64::MAX))
    .bind(until)
    .bind(basis.cast_signed())
    .bind(packed(settled))
    .fetch_one(executor)
    .await
}

fn packed(settled: &Settled) -> Vec<u8> {
    let mut bytes = vec![FORMAT];
    for keys in [&settled.read, &settled.first_of_epochs] {
        add_count(&mut bytes, keys.len());
        keys.iter().for_each(|key| bytes.extend(key.to_le_bytes()));
    }
    add_count(&mut bytes, settled.epochs.len());
    settled.epochs.iter().for_each(|count| bytes.extend(count.to_le_bytes()));
    for (at, run_id) in [settled.leads_from, settled.follows_until].into_iter().flatten() {
        bytes.extend(at.as_microsecond().to_le_bytes());
        bytes.extend(run_id.to_le_bytes());
    }
    add_count(&mut bytes, settled.open.len());
    settled.open.iter().for_each(|anomaly| pack(&mut bytes, anomaly));
    bytes
}

/// `None` for bytes of another format.
fn unpacked(runs: i64, bytes: &[u8]) -> Option<Settled> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let read = reader.list(Reader::i64)?;
    let first_of_epochs = reader.list(Reader::i64)?;
    let epochs = reader.list(Reader::u32)?;
    let (leads_from, follows_until) = (moment(&mut reader)?, moment(&mut reader)?);
    let open = reader.list(anomaly)?;
    reader.0.is_empty().then_some(Settled {
        runs: usize::try_from(runs).ok()?,
        read,
        leads_from: Some(leads_from),
        follows_until: Some(follows_until),
        first_of_epochs,
        epochs,
        open,
    })
}

fn moment(reader: &mut Reader<'_>) -> Option<Moment> {
    Some((moment_of(reader)?, reader.i64()?))
}

fn moment_of(reader: &mut Reader<'_>) -> Option<Timestamp> {
    Timestamp::from_microsecond(reader.i64()?).ok()
}

fn pack(bytes: &mut Vec<u8>, of: &Anomaly) {
    let place = |position: Option<usize>| u8::try_from(position.unwrap_or_default()).unwrap_or_default();
    bytes.push(of.joint.map_or(0, |joint| u8::try_from(joint.number()).unwrap_or(u8::MAX)));
    bytes.push(place(AnomalyKind::ALL.iter().position(|kind| *kind == of.kind)));
    for of in [of.severity, of.peak_severity] {
        bytes.push(place(Severity::ALL.iter().position(|severity| *severity == of)));
    }
    bytes.push(u8::from(of.ended));
    add_numbers(
        bytes,
        [
            of.score,
            of.threshold,
            of.value,
            of.baseline,
            of.peak_value,
            of.peak_score,
            of.odds.unwrap_or(-1.0),
        ],
    );
    // no cycle has the number 0
    for cycle in [of.first_cycle, of.onset.cycle] {
        bytes.extend(cycle.unwrap_or_default().to_le_bytes());
    }
    for run_id in [of.first_run_id, of.last_run_id, of.onset.run_id] {
        bytes.extend(run_id.to_le_bytes());
    }
    for at in [of.first_seen_at, of.last_seen_at, of.onset.at] {
        bytes.extend(at.as_microsecond().to_le_bytes());
    }
    add_text(bytes, of.quantity.name());
    add_text(bytes, &of.message);
    add_count(bytes, of.alternatives.len());
    for Alternative { cause, odds } in &of.alternatives {
        add_text(bytes, cause);
        add_numbers(bytes, [*odds]);
    }
}

fn anomaly(reader: &mut Reader<'_>) -> Option<Anomaly> {
    let joint = usize::from(reader.u8()?);
    let kind = *AnomalyKind::ALL.get(usize::from(reader.u8()?))?;
    let severity = *Severity::ALL.get(usize::from(reader.u8()?))?;
    let peak_severity = *Severity::ALL.get(usize::from(reader.u8()?))?;
    let ended = reader.u8()? != 0;
    let [score, threshold, value, baseline, peak_value, peak_score, odds] = reader.numbers()?;
    let cycle = |number: u32| (number > 0).then_some(number);
    let (first_cycle, onset_cycle) = (cycle(reader.u32()?), cycle(reader.u32()?));
    let (first_run_id, last_run_id, onset_run_id) = (reader.i64()?, reader.i64()?, reader.i64()?);
    let (first_seen_at, last_seen_at) = (moment_of(reader)?, moment_of(reader)?);
    let onset = Onset { run_id: onset_run_id, cycle: onset_cycle, at: moment_of(reader)? };
    let (quantity, message) = (Quantity::from_name(&text(reader)?)?, text(reader)?);
    let alternatives =
        reader.list(|reader| Some(Alternative { cause: text(reader)?, odds: reader.f64()? }))?;
    Some(Anomaly {
        joint: if joint == 0 { None } else { Some(JointIndex::from_number(joint)?) },
        kind,
        quantity,
        severity,
        score,
        threshold,
        value,
        baseline,
        peak_value,
        peak_score,
        peak_severity,
        first_cycle,
        first_run_id,
        last_run_id,
        first_seen_at,
        last_seen_at,
        onset,
        odds: (odds >= 0.0).then_some(odds),
        alternatives,
        ended,
        message,
    })
}

fn add_text(bytes: &mut Vec<u8>, text: &str) {
    add_count(bytes, text.len());
    bytes.extend(text.as_bytes());
}

fn text(reader: &mut Reader<'_>) -> Option<String> {
    let length = reader.u32()? as usize;
    String::from_utf8(reader.bytes(length)?.to_vec()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_settled_comes_back_to_the_last_bit() {
        let at = |hour: i64| Timestamp::from_microsecond(hour * 3_600_000_000).expect("a time");
        let open = |joint, kind, quantity, cycle, odds| Anomaly {
            joint,
            kind,
            quantity,
            severity: Severity::Warning,
            score: 1.0 / 3.0,
            threshold: f64::MIN_POSITIVE,
            value: -0.25,
            baseline: 1e300,
            peak_value: 2.0,
            peak_score: 3.0,
            peak_severity: Severity::Critical,
            first_cycle: cycle,
            first_run_id: 7,
            last_run_id: i64::MAX,
            first_seen_at: at(1),
            last_seen_at: at(9),
            onset: Onset { run_id: 6, cycle, at: at(0) },
            odds,
            alternatives: vec![Alternative { cause: "höher".into(), odds: 1e-9 }],
            ended: cycle.is_none(),
            message: "joint 3: friction".into(),
        };
        let joint = Some(JointIndex::new(2));
        let settled = Settled {
            runs: 1500,
            read: vec![1, 2, i64::MAX],
            leads_from: Some((at(5), 8)),
            follows_until: Some((at(8), 12)),
            first_of_epochs: vec![1],
            epochs: vec![1, 3],
            open: vec![
                open(joint, AnomalyKind::Drift, Quantity::FrictionIndex, Some(3), Some(4.0)),
                open(None, AnomalyKind::Payload, Quantity::Load, None, None),
            ],
        };
        let bytes = packed(&settled);
        assert_eq!(unpacked(1500, &bytes), Some(settled));
        assert_eq!(unpacked(1500, &bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked(1500, &[&bytes[..], &[0]].concat()), None);
        assert_eq!(unpacked(1500, &[9]), None);
    }
}
