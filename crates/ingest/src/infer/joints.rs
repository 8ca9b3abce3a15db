//! Finds the joints' columns and the time column of an export.

use super::head::{Head, HeadColumn};
use super::names::{ColumnKind, NameMeaning};
use super::sets::{ORDER_QUESTION, Order, Set};
use super::{names, units};
use armwatch_model::robot::Robot;

/// Columns of one quantity, one per joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct QuantityColumns<'h> {
    /// Their indices in the export.
    pub(super) columns: Vec<usize>,
    /// Key and value of the layout.
    pub(super) key: (&'static str, String),
    pub(super) said: NameMeaning,
    /// `[n][rows]`
    pub(super) values: Vec<&'h [f64]>,
    pub(super) why: String,
    /// Question that a person must answer.
    pub(super) question: Option<String>,
}

/// The columns of all joints.
#[derive(Debug, Default)]
pub(super) struct Joints<'h> {
    pub(super) position: Option<QuantityColumns<'h>>,
    pub(super) velocity: Option<QuantityColumns<'h>>,
    pub(super) torque: Option<QuantityColumns<'h>>,
    pub(super) count: usize,
    /// Other columns of the joints, such as accelerations, with the name of their quantity.
    pub(super) others: Vec<(usize, &'static str)>,
}

impl Joints<'_> {
    pub(super) fn has(&self, column: usize) -> bool {
        let all = [&self.position, &self.velocity, &self.torque];
        all.into_iter().flatten().any(|found| found.columns.contains(&column))
    }
}

pub(super) fn values(column: &HeadColumn) -> Option<&[f64]> {
    column.values.as_deref()
}

/// A set of columns that may be a quantity, with its evidence.
struct Candidate<'s, 'h> {
    set: &'s Set,
    said: NameMeaning,
    values: Vec<&'h [f64]>,
    /// Number of constant columns.
    still: usize,
    /// True for positions whose derivative is recorded, and for velocities that are the derivative of the positions.
    follows: bool,
}

/// The joints' columns by their names.
pub(super) fn by_name<'h>(head: &'h Head, robot: Option<&Robot>, sets: &[Set]) -> Joints<'h> {
    let numeric = |set: &&Set| set.columns.iter().all(|column| head.columns[*column].values.is_some());
    let of = |kind: ColumnKind| sets.iter().filter(numeric).filter(move |set| set.said.kind == Some(kind));
    // a log may have no positions: the other columns then give the number of joints
    let kinds = [
        ColumnKind::Position,
        ColumnKind::Velocity,
        ColumnKind::Torque,
        ColumnKind::Current,
        ColumnKind::Temperature,
    ];
    let usual = |kind: ColumnKind| {
        let best = of(kind)
            .max_by_key(|set| (set.said.intent.is_none(), set.order != Order::Place, set.columns.len()));
        best.map(|set| set.columns.len())
    };
    let alone: Vec<&Set> = sets.iter().filter(numeric).filter(|set| names_joints_alone(set)).collect();
    let all_alone = || alone.iter().map(|set| set.columns.len()).max();
    let by_columns = || kinds.into_iter().find_map(usual).or_else(all_alone).unwrap_or(0);
    let count = robot.map_or_else(by_columns, Robot::joint_count);
    let candidates = |kinds: &[ColumnKind]| -> Vec<Candidate<'_, 'h>> {
        let all = kinds.iter().flat_map(|kind| of(*kind));
        all.filter_map(|set| candidate(head, set, count)).collect()
    };
    let mut positions = candidates(&[ColumnKind::Position]);
    if positions.is_empty() {
        positions.extend(alone.into_iter().filter_map(|set| candidate(head, set, count)));
    }
    let mut velocities = candidates(&[ColumnKind::Velocity]);
    let mut torques = candidates(&[ColumnKind::Torque, ColumnKind::Current]);
    for position in &mut positions {
        for velocity in &mut velocities {
            if units::joint_slope(&position.values, &velocity.values, None).is_some() {
                (position.follows, velocity.follows) = (true, true);
            }
        }
    }
    let position = chosen(head, count, "positions", &mut positions);
    for velocity in &mut velocities {
        velocity.follows = position
            .as_ref()
            .is_some_and(|position| units::joint_slope(&position.values, &velocity.values, None).is_some());
    }
    let velocity = chosen(head, count, "velocities", &mut velocities);
    let mut others = Vec::new();
    if let Some(velocity) = &velocity {
        torques.retain(|torque| {
            let is_acceleration = is_derivative_of_all(&velocity.values, &torque.values);
            if is_acceleration {
                others.extend(torque.set.columns.iter().map(|at| (*at, ACCELERATION)));
            }
            !is_acceleration
        });
    }
    let torque = chosen(head, count, "torques", &mut torques);
    Joints { position, velocity, torque, count, others }
}

fn candidate<'s, 'h>(head: &'h Head, set: &'s Set, count: usize) -> Option<Candidate<'s, 'h>> {
    let columns = set.columns.get(..count.max(1))?;
    let values: Vec<&[f64]> = columns.iter().map(|at| values(&head.columns[*at])).collect::<Option<_>>()?;
    let still = values.iter().filter(|values| is_still(values)).count();
    Some(Candidate { set, said: set.said, values, still, follows: false })
}

/// Returns true for names that say only which joint, such as `J1` to `J6`: controllers call the joints' positions so.
fn names_joints_alone(set: &Set) -> bool {
    let name = set.template.replace("{joint}", "");
    set.order == Order::Number
        && ["j", "a", "joint", "axis", "achse"].contains(&name.trim().to_lowercase().as_str())
}

/// The most likely candidate, with a question where another may be meant or none was measured.
fn chosen<'h>(
    head: &'h Head,
    count: usize,
    what: &str,
    candidates: &mut [Candidate<'_, 'h>],
) -> Option<QuantityColumns<'h>> {
    candidates.sort_by_key(|of| {
        (
            of.said.intent.is_some(),
            of.still,
            of.said.kind == Some(ColumnKind::Current),
            !of.said.is_measured,
            !of.follows,
            of.said.is_motor,
            of.set.columns.len() != count,
            of.set.order == Order::Place,
        )
    });
    let (best, others) = candidates.split_first()?;
    let mut doubts = Vec::new();
    if let Some(word) = best.said.intent {
        doubts.push(format!(
            "the name says {word:?}, and no other column was measured by its name. A value that the \
            controller commands or calculates shows no wear. Are these the measured {what}?"
        ));
    }
    // next to a moving measured channel, an unmeasured one is not a candidate
    let rivals = others
        .iter()
        .filter(|of| best.said.intent.is_some() || of.said.intent.is_none() || best.still > of.still);
    let rivals: Vec<&Candidate<'_, '_>> = rivals.collect();
    let shown: Vec<String> = rivals.iter().map(|of| of.set.shown(head)).collect();
    if !shown.is_empty() {
        let still = match others.iter().map(|of| of.still).max() {
            Some(most) if most > best.still => ", the set in which more columns move",
            _ => "",
        };
        doubts.push(format!(
            "{} sets of columns may hold the {what}: {}{still}, and {}. Which set was measured at the \
            joints of this arm?",
            shown.len() + 1,
            best.set.shown(head),
            shown.join(", ")
        ));
        if let Some(rival) = rivals.first().filter(|_| what == "positions") {
            doubts.push(compared(&best.values, &rival.values));
        }
    } else if best.still > 0 && best.still < best.values.len() && what == "positions" {
        doubts.push(format!(
            "{} of these columns hold one value throughout. Are they the arm's positions?",
            best.still
        ));
    }
    if what == "positions" && best.said.kind != Some(ColumnKind::Position) {
        doubts.push("the names say which joint, and not which quantity. Are these the positions?".into());
    }
    if best.set.order == Order::Place {
        doubts.push(ORDER_QUESTION.into());
    }
    if best.set.columns.len() > count {
        let more = best.set.columns.len();
        doubts.push(format!(
            "there are {more} columns of this name for {count} joints. Are the first ones the arm's?"
        ));
    }
    Some(QuantityColumns {
        columns: best.set.columns[..count].to_vec(),
        key: best.set.key(head, count),
        said: best.said,
        values: best.values.clone(),
        why: named(best.set, &best.said),
        question: (!doubts.is_empty()).then(|| doubts.join(". ").replace("?. ", "? ")),
    })
}

/// How well a second set of positions agrees with the first, as encoders of motors and links should.
fn compared(first: &[&[f64]], second: &[&[f64]]) -> String {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    // the line through both, and the largest distance from it
    let line = |(first, second): (&&[f64], &&[f64])| {
        let (middle, other) = (mean(first), mean(second));
        let squares: f64 = first.iter().map(|value| (value - middle).powi(2)).sum();
        let products: f64 = first.iter().zip(*second).map(|(a, b)| (a - middle) * (b - other)).sum();
        let factor = products / squares;
        let distance = |(a, b): (&f64, &f64)| (b - other - factor * (a - middle)).abs();
        (factor, first.iter().zip(*second).map(distance).fold(0.0, f64::max))
    };
    let moving = first.iter().zip(second).filter(|(first, second)| !is_still(first) && !is_still(second));
    let (factors, distances): (Vec<f64>, Vec<f64>) = moving.map(line).unzip();
    let factors: Vec<String> = factors.iter().map(|factor| format!("{factor:.4}")).collect();
    let most = distances.iter().copied().fold(0.0, f64::max);
    format!(
        "In the joints that move in both, the second set is [{}] times the first, and differs from that by at most {most:.1e}",
        factors.join(", ")
    )
}

/// Quantity of columns that are the derivative of the velocities, whatever their name.
pub(super) const ACCELERATION: &str = "an acceleration, the derivative of the velocities";

/// Returns true if a column is constant.
pub(super) fn is_still(values: &[f64]) -> bool {
    values.windows(2).all(|pair| pair[0] == pair[1])
}

/// Returns true if columns are the derivative of others, with one factor in most moving ones. Torques may follow
/// accelerations too, but with a different inertia for each joint.
pub(super) fn is_derivative_of_all(columns: &[&[f64]], derivatives: &[&[f64]]) -> bool {
    let moving = columns.iter().filter(|values| !is_still(values)).count();
    let slopes =
        columns.iter().zip(derivatives).filter_map(|(values, other)| units::slope(values, other, None));
    let mut ratios: Vec<f64> = slopes.map(|slope| slope.ratio.abs()).collect();
    ratios.sort_by(f64::total_cmp);
    let Some(median) = ratios.get(ratios.len() / 2).copied() else { return false };
    let alike = ratios.iter().filter(|ratio| (*ratio / median - 1.0).abs() <= ONE_FACTOR).count();
    2 * alike > moving && alike > 1
}

/// Largest relative difference between the factors of joints that count as equal.
const ONE_FACTOR: f64 = 0.05;

fn named(set: &Set, said: &NameMeaning) -> String {
    let side = if said.is_motor { ", and that they belong to the motors" } else { "" };
    let unit = said.unit.filter(|_| !said.is_unit_shipped);
    let unit = unit.map_or_else(String::new, |unit| format!(", and gives the unit {unit}"));
    let name = match set.order {
        Order::Names => "of each joint in the description".to_owned(),
        _ => format!("{:?}", set.template.replace("{joint}", "1")),
    };
    format!("the name {name} says so{side}{unit}")
}

/// Returns true if a column rises from row to row.
pub(super) fn rises(values: Option<&[f64]>) -> bool {
    values.is_some_and(|values| values.len() > 1 && values.windows(2).all(|pair| pair[0] < pair[1]))
}

/// Returns true if a column rises except at a few places, such as restarts of a counter.
fn nearly_rises(values: &[f64]) -> bool {
    let falls = values.windows(2).filter(|pair| pair[0] >= pair[1]).count();
    values.len() > 1 && falls * 1000 <= values.len()
}

/// The time column, and the columns related to it.
pub(super) struct Time<'h> {
    pub(super) column: Option<(usize, &'h [f64])>,
    /// Columns with the name of a time that are unreadable as one.
    pub(super) unreadable: Vec<usize>,
    /// Further columns of time, each with its largest distance from the first, in its unit.
    pub(super) others: Vec<(usize, f64)>,
}

impl Time<'_> {
    /// All columns that are or may be a time.
    pub(super) fn columns(&self) -> impl Iterator<Item = usize> {
        let column = self.column.map(|(at, _)| at);
        let others = self.others.iter().map(|(at, _)| *at);
        column.into_iter().chain(self.unreadable.iter().copied()).chain(others)
    }
}

pub(super) fn time<'h>(head: &'h Head, joints: &Joints<'_>) -> Time<'h> {
    let free = || head.columns.iter().enumerate().filter(|(at, _)| !joints.has(*at));
    let candidates: Vec<(usize, &HeadColumn, &[f64])> =
        free().filter_map(|(at, column)| Some((at, column, values(column)?))).collect();
    let is_time = |column: &HeadColumn| {
        head.header && names::said(&column.name, &column.under).kind == Some(ColumnKind::Time)
    };
    let by_name = candidates.iter().find(|(_, column, values)| is_time(column) && nearly_rises(values));
    let by_numbers = || candidates.iter().find(|(.., values)| rises(Some(values)));
    let column = by_name.or_else(by_numbers).map(|(at, _, values)| (*at, *values));
    let unreadable = match by_name {
        Some(_) => Vec::new(),
        None => free()
            .filter(|(at, of)| is_time(of) && column.is_none_or(|(time, _)| time != *at))
            .map(|(at, _)| at)
            .collect(),
    };
    let others = column.map_or_else(Vec::new, |time| other_times(&candidates, time));
    Time { column, unreadable, others }
}

/// Columns that rise like the time, in steps of the same size.
fn other_times(candidates: &[(usize, &HeadColumn, &[f64])], time: (usize, &[f64])) -> Vec<(usize, f64)> {
    let step = units::median_step(time.1).unwrap_or(0.0);
    let is_like = |values: &[f64]| {
        let own = units::median_step(values).unwrap_or(0.0);
        nearly_rises(values) && (own - step).abs() <= 0.01 * step.abs()
    };
    let distance = |values: &[f64]| {
        let apart = values.iter().zip(time.1).map(|(a, b)| a - b);
        apart.fold(0.0_f64, |most, apart| if apart.abs() > most.abs() { apart } else { most })
    };
    let others = candidates.iter().filter(|(at, _, values)| *at != time.0 && is_like(values));
    others.map(|(at, _, values)| (*at, distance(values))).collect()
}
