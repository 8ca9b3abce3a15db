//! Converts columns of numbers to channels in SI, and checks the numbers of a column.
//!
//! Both readers end in [`samples`], so units are converted in one place. [`refusal`] explains for a single number why
//! it is refused; [`samples`] only detects that a column has a bad one.

use super::cell::{self, Decimal};
use super::clock::{self, PreviousTime, TimeColumn, Turn};
use super::column_map::{ColumnMap, Role};
use armwatch_config::DecimalMark;
use armwatch_model::robot::JointIndex;
use armwatch_model::run::slower::Slower;
use armwatch_model::run::temperature::{TemperatureTrack, Temperatures};
use armwatch_model::run::{FrictionSignal, RawSamples, Stage, StageReading};

/// Largest time, s: three thousand years in seconds, which every clock satisfies; doubles still resolve fifteen
/// microseconds there.
pub const MAX_TIME: f64 = 1e11;
/// Largest position, rad (m): an unlimited axis reaches this after some 1600 turns; encoder counts instead of angles
/// exceed it.
pub const MAX_POSITION: f64 = 1e4;
/// Largest velocity, rad/s (m/s): a hundred thousand turns per minute, faster than any motor shaft.
const MAX_VELOCITY: f64 = 1e4;
/// Largest torque, Nm (N): a hundred times that of the largest arms.
const MAX_TORQUE: f64 = 1e7;
/// Largest cycle number: a thousand times the daily cycles of the shortest tests.
const MAX_CYCLE: u32 = 1_000_000;

/// One column of numbers for each column of the export, in its order and units; empty if the column is not needed.
pub type RawColumns = Vec<Vec<f64>>;

/// Returns true if the cells of a column of this role are words.
pub fn is_text(role: Role, map: &ColumnMap) -> bool {
    matches!(role, Role::Stage(_)) && map.stage_source.kind().has_words()
}

/// The number of a word in a column of words; `None` for a word without a meaning there.
pub fn word_number(cell: &str, map: &ColumnMap) -> Option<f64> {
    map.stage_source.kind().word_number(cell.trim())
}

/// The channels in SI, or `None` if any number is refused or time does not rise strictly.
///
/// Times in `columns` are relative to the first row of the export, except counts of a counter, which are as recorded.
/// `previous` is the row before. Factors of 1 cost nothing.
pub fn samples(columns: RawColumns, map: &ColumnMap, previous: Option<PreviousTime>) -> Option<RawSamples> {
    samples_and_clock(columns, map, previous).map(|(samples, _)| samples)
}

/// Behaviour of a clock over consecutive rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ClockRun {
    /// Its turns, each with the row after it.
    pub turns: Vec<(usize, Turn)>,
    /// The last row, if times are text.
    pub last: Option<PreviousTime>,
}

/// Like [`samples`], also returning the behaviour of the clock.
pub fn samples_and_clock(
    mut columns: RawColumns,
    map: &ColumnMap,
    previous: Option<PreviousTime>,
) -> Option<(RawSamples, ClockRun)> {
    let factors = &map.to_si;
    let previous_time = previous.map(|previous| previous.seconds);
    let mut run = ClockRun::default();
    let mut cycle = match map.cycle {
        Some(column) => Some(cycles(&taken(&mut columns, column))?),
        None => None,
    };
    let time = match map.time {
        TimeColumn::Recorded(column) => scaled(taken(&mut columns, column), factors.time, MAX_TIME)?,
        TimeColumn::Restarting(column) => {
            let mut readings = scaled(taken(&mut columns, column), factors.time, MAX_TIME)?;
            let ((turns, last), counted) = clock::of_recordings(&mut readings, cycle, previous);
            (run, cycle) = (ClockRun { turns, last }, Some(counted));
            readings
        }
        TimeColumn::Stamped { column, origin } => {
            let mut readings = taken(&mut columns, column);
            (run.turns, run.last) = origin.go_on(&mut readings, previous);
            scaled(readings, 1.0, MAX_TIME)?
        }
        TimeColumn::Wrapping { column, period } => {
            let origin = map.time_origin.map_or(0.0, Decimal::to_f64);
            let previous = previous_time.map(|time| time / factors.time + origin);
            let mut counts = unwrapped(taken(&mut columns, column), period, previous);
            counts.iter_mut().for_each(|count| *count -= origin);
            scaled(counts, factors.time, MAX_TIME)?
        }
        TimeColumn::Counted(rate) => {
            let rows = map
                .torque
                .iter()
                .flatten()
                .next()
                .and_then(|column| columns.get(*column))
                .map_or(0, Vec::len);
            counted(0..rows, rate, previous_time)
        }
    };
    if !rises(&time, previous_time) {
        return None;
    }
    let mut joints = |indices: &[usize], factors: &[f64], limit: f64, rule| -> Option<Vec<Vec<f64>>> {
        let of_joints = indices.iter().zip(factors);
        of_joints
            .map(|(column, factor)| scaled_where(taken(&mut columns, *column), *factor, limit, rule))
            .collect()
    };
    let position = match map.position.is_empty() {
        true => vec![vec![f64::NAN; time.len()]; map.joint_count()],
        false => joints(&map.position, &factors.position, MAX_POSITION, None)?,
    };
    let velocity = match &map.velocity {
        Some(indices) => Some(joints(indices, &factors.velocity, MAX_VELOCITY, map.slower.velocity)?),
        None => None,
    };
    let torque = map.torque.iter().zip(&factors.torque).map(|(column, factor)| match column {
        Some(column) => scaled_where(taken(&mut columns, *column), *factor, MAX_TORQUE, map.slower.torque),
        // it is not used anywhere: `Joint::has_torque`
        None => Some(vec![0.0; time.len()]),
    });
    let torque = torque.collect::<Option<Vec<_>>>()?;
    let of_stages = map.stage.iter().map(|column| taken(&mut columns, *column)).collect();
    let stage = map.stage_source.kind().reading(of_stages, time.len())?;
    let friction_signal = match map.friction {
        Some(friction) => {
            let joint = taken(&mut columns, friction.joint);
            let level = taken(&mut columns, friction.level);
            Some(friction_signals(&stage, &joint, &level, map)?)
        }
        None => None,
    };
    let temperatures = temperatures(&mut columns, map);
    let samples =
        RawSamples { time, position, velocity, torque, stage, cycle, friction_signal, temperatures };
    Some((samples, run))
}

/// The number in a cell of a temperature column, in its unit; NaN if the cell contains none, because controllers omit
/// unchanged values.
pub fn temperature(cell: &str, decimal: DecimalMark) -> f64 {
    cell::number(cell, decimal).unwrap_or(f64::NAN)
}

/// Tracks of the recorded temperatures; `None` if there is no such column.
fn temperatures(columns: &mut RawColumns, map: &ColumnMap) -> Option<Temperatures> {
    let mut track = |column: usize| {
        let unit = map.roles.get(column).and_then(|role| role.temperature_unit())?;
        let mut track = TemperatureTrack::default();
        taken(columns, column).into_iter().for_each(|value| track.push(Some(unit.kelvin(value))));
        Some(track)
    };
    let motor: Vec<Option<TemperatureTrack>> =
        map.motor_temperature.iter().map(|column| column.and_then(&mut track)).collect();
    let ambient = map.ambient_temperature.and_then(track);
    let recorded = ambient.is_some() || motor.iter().any(Option::is_some);
    recorded.then_some(Temperatures { motor, ambient })
}

/// Why `value`, in the export's unit, is invalid in a column of this role; the words complete "value is ..".
pub fn refusal(value: f64, role: Role, map: &ColumnMap) -> Option<String> {
    if role == Role::Ignored || role.temperature_unit().is_some() {
        return None;
    }
    if !value.is_finite() {
        return Some("not a finite number".into());
    }
    let beyond = |factor: f64, limit: f64, what: &str, unit: &str| {
        let outside = (value * factor).abs() > limit;
        outside.then(|| format!("beyond any {what} (more than {limit:e} {unit} after conversion)"))
    };
    let factors = &map.to_si;
    let of = |factors: &[f64], joint: JointIndex| factors.get(joint.index()).copied().unwrap_or(1.0);
    match role {
        Role::Ignored | Role::MotorTemperature(..) | Role::AmbientTemperature(_) => None,
        Role::Time => beyond(factors.time, MAX_TIME, "clock", "s"),
        Role::Position(j) => beyond(of(&factors.position, j), MAX_POSITION, "joint's position", "rad"),
        Role::Velocity(j) => beyond(of(&factors.velocity, j), MAX_VELOCITY, "joint's velocity", "rad/s"),
        Role::Torque(j) => beyond(of(&factors.torque, j), MAX_TORQUE, "joint's torque", "Nm"),
        Role::Stage(_) => map.stage_source.kind().refusal(value),
        Role::Cycle => out_of_range(value, 0, u64::from(MAX_CYCLE)),
        Role::FrictionJoint => out_of_range(value, 0, map.joint_count() as u64),
        Role::FrictionLevel => out_of_range(value, 0, u64::from(max_level(map))),
    }
}

/// Returns true if a number written as `cell` could be the beginning of another valid number: a line that is cut after
/// it may be incomplete.
pub fn may_continue(cell: &str, role: Role, map: &ColumnMap) -> bool {
    let longer = |number: &dyn std::fmt::Display| {
        let text = number.to_string();
        text.len() > cell.len() && text.starts_with(cell)
    };
    match role {
        Role::Ignored => false,
        Role::Time | Role::Position(_) | Role::Velocity(_) | Role::Torque(_) | Role::Cycle => true,
        Role::MotorTemperature(..) | Role::AmbientTemperature(_) => true,
        Role::Stage(_) => map.stage_source.kind().may_continue(cell),
        Role::FrictionJoint => (0..=map.joint_count()).any(|joint| longer(&joint)),
        Role::FrictionLevel => (0..=max_level(map)).any(|level| longer(&level)),
    }
}

/// Counts of a counter that restarts after `period`, continued from `previous`.
fn unwrapped(mut counts: Vec<f64>, period: f64, previous: Option<f64>) -> Vec<f64> {
    let mut before = previous;
    for count in &mut counts {
        *count = counted_on(*count, period, before);
        before = Some(*count);
    }
    counts
}

/// A count of a counter that restarts after `period`, plus as many periods as bring it nearest to the one before: a
/// step back by less than half a period stays one.
pub fn counted_on(count: f64, period: f64, before: Option<f64>) -> f64 {
    match before {
        Some(before) if before >= count => count + ((before - count) / period).round() * period,
        _ => count,
    }
}

fn taken(columns: &mut RawColumns, column: usize) -> Vec<f64> {
    columns.get_mut(column).map(std::mem::take).unwrap_or_default()
}

/// Like [`scaled`]; with a rule for rows without a value, these are NaN.
fn scaled_where(mut values: Vec<f64>, factor: f64, limit: f64, slower: Option<Slower>) -> Option<Vec<f64>> {
    if slower.is_none() {
        return scaled(values, factor, limit);
    }
    values.iter_mut().for_each(|value| *value *= factor);
    values.iter().all(|value| value.is_nan() || value.abs() <= limit).then_some(values)
}

fn scaled(mut values: Vec<f64>, factor: f64, limit: f64) -> Option<Vec<f64>> {
    if factor != 1.0 {
        values.iter_mut().for_each(|value| *value *= factor);
    }
    // NaN compares false, so it is refused too. Folding without an early exit lets the compiler use vector
    // instructions.
    let inside = values.iter().fold(true, |inside, value| inside & (value.abs() <= limit));
    inside.then_some(values)
}

fn rises(time: &[f64], previous: Option<f64>) -> bool {
    let joins = match (previous, time.first()) {
        (Some(previous), Some(first)) => previous < *first,
        _ => true,
    };
    joins && time.iter().zip(time.iter().skip(1)).all(|(a, b)| a < b)
}

/// Times of rows at `rate`, Hz, after a row at `previous`, s; `rows` are their numbers from there. They are computed
/// from the number, so that errors do not accumulate.
pub(crate) fn counted(rows: impl IntoIterator<Item = usize>, rate: f64, previous: Option<f64>) -> Vec<f64> {
    let first = previous.map_or(0.0, |time| (time * rate).round() + 1.0);
    rows.into_iter().map(|row| (first + row as f64) / rate).collect()
}

fn cycles(values: &[f64]) -> Option<Vec<u32>> {
    values.iter().map(|value| in_range(*value, 0, u64::from(MAX_CYCLE)).map(|v| v as u32)).collect()
}

fn friction_signals(
    stage: &StageReading,
    joint: &[f64],
    level: &[f64],
    map: &ColumnMap,
) -> Option<Vec<Option<FrictionSignal>>> {
    let (joints, levels) = (map.joint_count() as u64, u64::from(max_level(map)));
    joint
        .iter()
        .zip(level)
        .enumerate()
        .map(|(row, (joint, level))| {
            let joint = in_range(*joint, 0, joints)?;
            let level = in_range(*level, 0, levels)?;
            // Between two joints of the friction stage either may be zero. If the stage is not known yet, values
            // outside it are removed later.
            let may_be_friction = match stage {
                StageReading::Known(stages) => stages.get(row) == Some(&Stage::Friction),
                StageReading::Level(_) | StageReading::Unknown => true,
            };
            let tested = may_be_friction && level > 0;
            let joint = JointIndex::from_number(joint as usize).filter(|_| tested);
            Some(joint.map(|joint| FrictionSignal { joint, level: level as u8 }))
        })
        .collect()
}

fn max_level(map: &ColumnMap) -> u8 {
    if map.levels == 0 { u8::MAX } else { u8::try_from(map.levels).unwrap_or(u8::MAX) }
}

/// The integer value of a double, if it has one. Beyond 2^53 neighbouring integers share a double.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < 9_007_199_254_740_992.0).then_some(value as i64)
}

fn in_range(value: f64, least: u64, most: u64) -> Option<u64> {
    whole(value).and_then(|v| u64::try_from(v).ok()).filter(|v| (least..=most).contains(v))
}

fn out_of_range(value: f64, least: u64, most: u64) -> Option<String> {
    match (whole(value), in_range(value, least, most)) {
        (_, Some(_)) => None,
        (None, _) => Some("not a whole number".into()),
        _ => Some(format!("not in {least} to {most}")),
    }
}
