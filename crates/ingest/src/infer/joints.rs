//! Which columns of an export are the joints', and which is time.

use super::head::{Head, HeadColumn};
use super::names::{Group, Kind, Said};
use super::proposal::Hints;
use super::section::quoted;
use super::{names, units};
use armwatch_model::robot::Robot;

/// Columns of one quantity, one a joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found<'h> {
    /// Where they stand in the export.
    pub(super) columns: Vec<usize>,
    /// Key and value of the layout.
    pub(super) key: (&'static str, String),
    pub(super) said: Said,
    /// `[n][rows]`
    pub(super) values: Vec<&'h [f64]>,
    pub(super) why: String,
}

/// The columns of all joints.
pub(super) struct Joints<'h> {
    pub(super) position: Option<Found<'h>>,
    pub(super) velocity: Option<Found<'h>>,
    pub(super) torque: Option<Found<'h>>,
    pub(super) count: usize,
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

pub(super) fn by_name<'h>(head: &'h Head, robot: Option<&Robot>) -> Joints<'h> {
    let names: Vec<&str> = head.columns.iter().map(|column| column.name.as_str()).collect();
    let groups: Vec<(Group, Said)> = names::groups(&names)
        .into_iter()
        .filter(|group| group.columns.iter().all(|column| head.columns[*column].values.is_some()))
        .map(|group| {
            let under = head.columns[group.columns[0]].under.as_str();
            let said = names::said(&group.template, under);
            (group, said)
        })
        .collect();
    let of = |kind: Kind| groups.iter().filter(move |(_, said)| said.kind == Some(kind));
    // a log may have no positions: then the other columns tell how many joints there are
    let most = |kind: Kind| of(kind).map(|(group, _)| group.columns.len()).max();
    let kinds = [Kind::Position, Kind::Velocity, Kind::Torque, Kind::Current, Kind::Temperature];
    let count = robot.map_or_else(|| kinds.into_iter().find_map(most).unwrap_or(0), Robot::joint_count);
    let best = |kind: Kind| {
        let fitting = of(kind).filter(|(group, _)| group.columns.len() >= count.max(1));
        fitting.min_by_key(|(group, said)| (said.is_target, said.is_motor, group.columns.len() != count))
    };
    let found = |(group, said): &(Group, Said)| Found {
        columns: group.columns[..count].to_vec(),
        key: columns_key(group, count, &names),
        said: *said,
        values: group.columns[..count].iter().filter_map(|column| values(&head.columns[*column])).collect(),
        why: named(&group.template, said),
    };
    Joints {
        position: best(Kind::Position).map(found),
        velocity: best(Kind::Velocity).map(found),
        torque: best(Kind::Torque).or_else(|| best(Kind::Current)).map(found),
        count,
    }
}

fn named(template: &str, said: &Said) -> String {
    let side = if said.is_motor { ", and that they are the motors'" } else { "" };
    let unit = said.unit.map_or_else(String::new, |unit| format!(", and gives the unit {unit}"));
    format!("the name {:?} says so{side}{unit}", template.replace("{joint}", "1"))
}

/// One name with a place for the number where that gives the columns, else a list.
pub(super) fn columns_key(group: &Group, count: usize, names: &[&str]) -> (&'static str, String) {
    let columns = &group.columns[..count];
    let simple = columns.iter().all(|column| is_plain_name(names, *column));
    if group.first > 0 && group.columns.len() == count && simple {
        let place = match group.first {
            1 => "{joint}".to_owned(),
            first => format!("{{joint+{}}}", first - 1),
        };
        return ("column", quoted(&group.template.replace("{joint}", &place)));
    }
    let list: Vec<String> = columns.iter().map(|column| reference(names, *column)).collect();
    ("columns", format!("[{}]", list.join(", ")))
}

/// A column by its name, or by its number where the name does not tell it from others.
pub(super) fn reference(names: &[&str], column: usize) -> String {
    match is_plain_name(names, column) {
        true => quoted(names[column]),
        false => (column + 1).to_string(),
    }
}

fn is_plain_name(names: &[&str], column: usize) -> bool {
    let name = names[column];
    !name.trim().is_empty() && !name.contains("{joint") && names.iter().filter(|n| **n == name).count() == 1
}

/// Without names, blocks of as many columns as the arm has joints: positions, then velocities if they are the
/// derivative, then torques; one or two columns may stand before them.
pub(super) fn by_place<'h>(head: &'h Head, hints: Hints<'_>) -> Joints<'h> {
    let none = Joints { position: None, velocity: None, torque: None, count: 0 };
    let Some(n) = hints.robot.map(Robot::joint_count) else { return none };
    let block = |start: usize| -> Option<Vec<&'h [f64]>> {
        head.columns.get(start..start + n)?.iter().map(values).collect()
    };
    let found = |start: usize, why: &str| -> Option<Found<'h>> {
        let numbers: Vec<String> = (start + 1..=start + n).map(|number| number.to_string()).collect();
        Some(Found {
            columns: (start..start + n).collect(),
            key: ("columns", format!("[{}]", numbers.join(", "))),
            said: Said::default(),
            values: block(start)?,
            why: why.to_owned(),
        })
    };
    let first =
        (0..3.min(head.columns.len())).find(|at| !rises(head.columns[*at].values.as_deref())).unwrap_or(0);
    let derivative = block(first)
        .zip(block(first + n))
        .is_some_and(|(position, velocity)| units::joint_slope(&position, &velocity, None).is_some());
    let order = "no names: by their place, positions first, then velocities, then torques";
    Joints {
        position: found(first, order),
        velocity: if derivative {
            found(first + n, "they are the derivative of the positions")
        } else {
            None
        },
        torque: found(first + if derivative { 2 * n } else { n }, order),
        count: n,
    }
}

/// Whether a column rises from row to row.
fn rises(values: Option<&[f64]>) -> bool {
    values.is_some_and(|values| values.len() > 1 && values.windows(2).all(|pair| pair[0] < pair[1]))
}

/// Whether a column rises but for a few places where a counter may begin anew.
fn nearly_rises(values: &[f64]) -> bool {
    let falls = values.windows(2).filter(|pair| pair[0] >= pair[1]).count();
    values.len() > 1 && falls * 1000 <= values.len()
}

pub(super) fn time_column<'h>(head: &'h Head, joints: &Joints<'_>) -> Option<(usize, &'h [f64])> {
    let free = head.columns.iter().enumerate().filter(|(at, _)| !joints.has(*at));
    let candidates: Vec<(usize, &HeadColumn, &[f64])> =
        free.filter_map(|(at, column)| Some((at, column, values(column)?))).collect();
    let is_time = |column: &HeadColumn| names::said(&column.name, &column.under).kind == Some(Kind::Time);
    let by_name = candidates.iter().find(|(_, column, values)| is_time(column) && nearly_rises(values));
    let by_numbers = || candidates.iter().find(|(.., values)| rises(Some(values)));
    by_name.or_else(by_numbers).map(|(at, _, values)| (*at, *values))
}

/// A column as a layout names it.
pub(super) fn column_name(head: &Head, at: usize) -> String {
    let names: Vec<&str> = head.columns.iter().map(|column| column.name.as_str()).collect();
    if head.header { reference(&names, at) } else { (at + 1).to_string() }
}
