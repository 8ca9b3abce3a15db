//! Sets of columns with one quantity of all joints.

use std::collections::BTreeSet;

use super::head::Head;
use super::names::{self, ColumnKind, Group, NameMeaning};
use super::section::quoted;
use armwatch_model::robot::Robot;

/// Question about a set whose order only [`Order::Place`] gives.
pub(super) const ORDER_QUESTION: &str = "the columns are in the order of the export. Is this the order of \
    the joints from the base outwards? A description with the names of the joints (--description) \
    determines it";

/// Evidence for the order of the columns of a set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// The number in their names.
    Number,
    /// The description's names of joints.
    Names,
    /// Their place in the export.
    Place,
}

/// Columns of one quantity, one per joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Set {
    /// The name with `{joint}` instead of the joint's number or name; for [`Order::Place`], the first name.
    pub(super) template: String,
    /// Number of the first joint, for [`Order::Number`].
    pub(super) first: usize,
    /// Column indices, from the base outwards.
    pub(super) columns: Vec<usize>,
    pub(super) order: Order,
    pub(super) said: NameMeaning,
}

/// All sets of an export with names, in the order of their first columns.
pub(super) fn sets(head: &Head, robot: Option<&Robot>) -> Vec<Set> {
    let names = head.names();
    let under = |columns: &[usize]| columns.first().map_or("", |at| head.columns[*at].under.as_str());
    let of_group = |group: Group| Set {
        said: names::said(&group.template, under(&group.columns)),
        template: group.template,
        first: group.first,
        columns: group.columns,
        order: Order::Number,
    };
    let of_array = |set: Set| ordered_array(set, head, robot);
    let mut found: Vec<Set> = names::groups(&names).into_iter().map(of_group).map(of_array).collect();
    // a set of all joints replaces those of its parts, such as wrist_1 to wrist_3
    let add = |found: &mut Vec<Set>, set: Set| {
        found.retain(|other| !other.columns.iter().any(|column| set.columns.contains(column)));
        found.push(set);
    };
    by_joint_names(head, robot).into_iter().for_each(|set| add(&mut found, set));
    by_place(head, &found).into_iter().for_each(|set| add(&mut found, set));
    found.sort_by_key(|set| set.columns.first().copied());
    found
}

/// A set such as `effort[0]` to `effort[5]` or `field.effort0`, which ROS writes: the order of the joints is that of
/// the names in the message, often the alphabetical one. The columns `name[0]` to `name[5]` contain the names, if they
/// were exported.
fn ordered_array(set: Set, head: &Head, robot: Option<&Robot>) -> Set {
    // `effort[0]` in ROS 2, and `field.effort0` in the output of `rostopic echo -p`
    let array =
        ["[{joint}]", "{joint}"].into_iter().find_map(|end| Some((set.template.strip_suffix(end)?, end)));
    let Some((array, end)) = array.filter(|_| set.first == 0) else { return set };
    let prefix = array.trim_end_matches(char::is_alphabetic).to_owned();
    let element_name = |name: &str, element: usize| {
        format!("{prefix}{name}{}", end.replace("{joint}", &element.to_string()))
    };
    let name_of = |element: usize| {
        let name = element_name("name", element);
        head.columns.iter().find(|column| column.name == name).map(|column| column.first().to_owned())
    };
    let in_message: Option<Vec<String>> = (0..set.columns.len()).map(name_of).collect();
    let joints: Option<Vec<&str>> =
        robot.and_then(|robot| robot.joints.iter().map(|joint| joint.name.as_deref()).collect());
    let is_of_ros = || head.columns.iter().any(|column| column.name == element_name("effort", 0));
    match (in_message, joints) {
        (Some(names), Some(joints)) => {
            let place = |joint: &&str| names.iter().position(|name| name == joint).map(|at| set.columns[at]);
            match joints.iter().map(place).collect::<Option<Vec<usize>>>() {
                Some(columns) => Set { columns, order: Order::Names, ..set },
                None => Set { order: Order::Place, ..set },
            }
        }
        (None, _) if !is_of_ros() => set,
        (None, Some(joints)) if joints.is_sorted() => set,
        _ => Set { order: Order::Place, ..set },
    }
}

/// Sets whose names contain the description's names of all joints.
fn by_joint_names(head: &Head, robot: Option<&Robot>) -> Vec<Set> {
    let joints: Option<Vec<Vec<String>>> = robot.and_then(|robot| {
        robot.joints.iter().map(|joint| joint.name.as_deref().map(names::tokens)).collect()
    });
    let Some(joints) = joints else { return Vec::new() };
    // template, and the column of each joint
    let mut found: Vec<(Vec<String>, Vec<Option<usize>>)> = Vec::new();
    for (at, column) in head.columns.iter().enumerate() {
        let tokens = names::tokens(&column.name);
        let place = |joint: &Vec<String>| {
            tokens.windows(joint.len().max(1)).position(|window| window == joint.as_slice())
        };
        // if several match, the longest name, such as `arm_lift` before `arm`
        let hits =
            joints.iter().enumerate().filter_map(|(joint, name)| Some((joint, name.len(), place(name)?)));
        let Some((joint, length, place)) = hits.max_by_key(|(_, length, _)| *length) else { continue };
        let template = [&tokens[..place], &["{joint}".to_owned()], &tokens[place + length..]].concat();
        let known = found.iter().position(|(known, _)| *known == template).unwrap_or_else(|| {
            found.push((template, vec![None; joints.len()]));
            found.len() - 1
        });
        found[known].1[joint].get_or_insert(at);
    }
    let set = |(template, columns): (Vec<String>, Vec<Option<usize>>)| {
        let columns: Vec<usize> = columns.into_iter().collect::<Option<_>>()?;
        let text = template.join("_");
        let said = names::said(&text.replace("{joint}", "1"), &head.columns[columns[0]].under);
        Some(Set { template: text, first: 0, columns, order: Order::Names, said })
    };
    found.into_iter().filter_map(set).collect()
}

/// Sets of columns whose names are equal except for the joint, which has a name instead of a number.
fn by_place(head: &Head, known: &[Set]) -> Vec<Set> {
    let kinds = [
        ColumnKind::Position,
        ColumnKind::Velocity,
        ColumnKind::Torque,
        ColumnKind::Current,
        ColumnKind::Temperature,
    ];
    let mut found: Vec<(NameMeaning, Vec<usize>, BTreeSet<Vec<String>>)> = Vec::new();
    for (at, column) in head.columns.iter().enumerate() {
        let said = names::said(&column.name, &column.under);
        if !said.kind.is_some_and(|kind| kinds.contains(&kind)) || said.is_hall || said.is_electronics {
            continue;
        }
        let label: Vec<String> = names::label(&column.name, said);
        match found.iter_mut().find(|(known, ..)| *known == said) {
            Some((_, columns, labels)) => {
                columns.push(at);
                labels.insert(label);
            }
            None => found.push((said, vec![at], BTreeSet::from([label]))),
        }
    }
    // `q1` to `q6` and a gripper's position are six joints and a gripper
    let known_parts = |columns: &[usize]| {
        let within = |set: &&Set| set.columns.iter().all(|column| columns.contains(column));
        known.iter().filter(within).map(|set| set.columns.len()).collect::<Vec<usize>>()
    };
    let is_set = |(_, columns, labels): &(NameMeaning, Vec<usize>, BTreeSet<Vec<String>>)| {
        let parts = known_parts(columns);
        let named = columns.len() - parts.iter().sum::<usize>();
        columns.len() > 1
            && labels.len() == columns.len()
            && labels.iter().all(|label| !label.is_empty())
            && named > 0
            && parts.iter().all(|part| named >= *part)
    };
    let mut sets: Vec<Set> = found
        .into_iter()
        .filter(is_set)
        .map(|(said, columns, _)| {
            let template = head.columns[columns[0]].name.clone();
            Set { template, first: 0, columns, order: Order::Place, said }
        })
        .collect();
    order_alike(head, &mut sets);
    sets
}

/// Orders the columns of all sets like the first set with the same labels.
fn order_alike(head: &Head, sets: &mut [Set]) {
    let labels = |set: &Set| -> Vec<Vec<String>> {
        set.columns.iter().map(|at| names::label(&head.columns[*at].name, set.said)).collect()
    };
    let Some((first, others)) = sets.split_first_mut() else { return };
    let order = labels(first);
    for set in others {
        let own = labels(set);
        let sorted = order.iter().map(|label| own.iter().position(|one| one == label));
        if let Some(places) = sorted.collect::<Option<Vec<usize>>>().filter(|p| p.len() == own.len()) {
            set.columns = places.into_iter().map(|place| set.columns[place]).collect();
        }
    }
}

impl Set {
    /// Key and value of a layout: one name with a placeholder for the number if that gives the first `count` columns,
    /// otherwise a list.
    pub(super) fn key(&self, head: &Head, count: usize) -> (&'static str, String) {
        let columns = &self.columns[..count.min(self.columns.len())];
        let simple = columns.iter().all(|column| head.has_plain_name(*column));
        if self.order == Order::Number && self.first > 0 && self.columns.len() == count && simple {
            let place = match self.first {
                1 => "{joint}".to_owned(),
                first => format!("{{joint+{}}}", first - 1),
            };
            return ("column", quoted(&self.template.replace("{joint}", &place)));
        }
        ("columns", list(head, columns))
    }

    /// The set in a message.
    pub(super) fn shown(&self, head: &Head) -> String {
        match (self.order, self.columns.as_slice()) {
            (Order::Number, _) => format!("{:?}", self.template),
            (_, [first, .., last]) => {
                format!("{:?} to {:?}", head.columns[*first].name, head.columns[*last].name)
            }
            _ => format!("{:?}", self.template),
        }
    }
}

/// Columns as a list of a layout.
pub(super) fn list(head: &Head, columns: &[usize]) -> String {
    let list: Vec<String> = columns.iter().map(|column| head.reference(*column)).collect();
    format!("[{}]", list.join(", "))
}
