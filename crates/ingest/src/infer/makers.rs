//! Exports of makers: the columns of a file are compared with those of the shipped layouts before anything is guessed.
//!
//! A layout fits if the file has every column that it names for time, positions, velocities and torques, and the
//! numbers do not contradict its units. The stages come from the file, because they depend on the user's program.

use super::head::Head;
use super::names::{ColumnKind, NameMeaning};
use super::sets::{Order, Set};
use super::{names, units};
use crate::bytes::scope::TIME as SCOPE_TIME;
use armwatch_config::{
    BLANKS, Column, JointColumns, Layout, LayoutUnits, TimeSource, TorqueQuantity, layout_units,
    maker_layouts, parse_layout,
};

/// The layout of recordings of `sensor_msgs/JointState`, whose columns have the names of the joints.
const JOINT_STATES: &str = "ros_joint_states";

/// The quantities of joint states.
const QUANTITIES: [&str; 3] = ["position", "velocity", "effort"];

/// Fewest joints of an arm.
const LEAST_JOINTS: usize = 2;

/// A shipped layout that fits.
pub(super) struct Maker {
    pub(super) name: &'static str,
    /// Its columns; empty if the names of the joints decide.
    channels: Vec<Set>,
    units: LayoutUnits,
}

/// Recorders whose form is not published: the shipped layout, words for the maker in the name of a file or above its columns, and
/// variables of the controller in the names of the columns.
const RECORDERS: [(&str, &[&str], &[&str]); 5] = [
    ("br_trace", &["b r automation", "b r trace", "automation studio", "acopos"], &["MpAxis", "gAxis01"]),
    ("staubli_recorder", &["stäubli", "staubli"], &[]),
    ("denso_control_log", &["denso", "wincaps"], &[]),
    ("abb_tunemaster", &["abb", "tune master", "tunemaster", "test signal viewer"], &["ROB_1"]),
    ("fanuc_axis_log", &["fanuc"], &["$MOR_GRP", "$SCR_GRP"]),
];

/// The shipped layout of a recorder whose columns the user's program names, with the evidence for it.
pub(super) struct Recorder {
    pub(super) layout: &'static str,
    /// A sentence.
    pub(super) evidence: String,
}

/// The recorder whose form the file has, or which it names; `None` if it names several.
pub(super) fn recorder(head: &Head) -> Option<Recorder> {
    let form = match head.columns.first()?.name.as_str() {
        SCOPE_TIME => Some("twincat_scope"),
        // two lines of the project are above the names
        "Cycle" if head.delimiter == BLANKS && head.skip_lines == 2 => Some("codesys_trace"),
        _ => None,
    };
    if let Some(layout) = form {
        return Some(Recorder { layout, evidence: "The file has its form.".into() });
    }
    let title = format!(" {} ", names::tokens(&head.title).join(" "));
    let named = RECORDERS.iter().filter_map(|&(layout, words, variables)| {
        let word = words.iter().find(|words| title.contains(&format!(" {words} ")));
        let variable =
            || variables.iter().find(|of| head.columns.iter().any(|column| column.name.contains(**of)));
        let evidence = match word {
            Some(word) => format!("The name of the file, or a line above its columns, says \"{word}\"."),
            None => format!("The names of its columns say \"{}\".", variable()?),
        };
        Some(Recorder { layout, evidence })
    });
    let mut named: Vec<Recorder> = named.collect();
    named.pop().filter(|_| named.is_empty())
}

/// The shipped layout whose columns the file has.
pub(super) fn recognise(head: &Head) -> Option<Maker> {
    if !head.header {
        return None;
    }
    // a layout that still asks a question does not load, and has no columns to compare
    let layouts = maker_layouts().filter_map(|(name, text)| Some((name, parse_layout(name, text).ok()?)));
    let is_joint_state = is_joint_state(head);
    let fitting = layouts.filter_map(|(name, layout)| {
        let units = layout_units(&layout);
        let channels = match name {
            JOINT_STATES if is_joint_state => Vec::new(),
            _ => channels(head, &layout, units)?,
        };
        // the time of joint states has the unit of the program that recorded them
        let units = if channels.is_empty() { LayoutUnits { time: None, ..units } } else { units };
        Some((layout.delimiter != head.delimiter, Maker { name, channels, units }))
    });
    fitting.min_by_key(|(other_delimiter, _)| *other_delimiter).map(|(_, maker)| maker)
}

impl Maker {
    /// The unit of time; `None` if the file gives it.
    pub(super) fn time_unit(&self) -> Option<&'static str> {
        let known = |unit: &&str| units::TIME.iter().any(|(name, _)| name == unit);
        self.units.time.filter(known)
    }

    /// The sets of the export, with those of the layout instead of others of their quantities, with its units.
    pub(super) fn sets(&self, mut sets: Vec<Set>) -> Vec<Set> {
        if !self.channels.is_empty() {
            sets.retain(|set| quantity(set.said.kind).is_none());
            sets.extend(self.channels.iter().cloned());
        }
        for set in &mut sets {
            let unit = quantity(set.said.kind).and_then(|kind| self.unit(kind));
            if set.said.unit.is_none() {
                (set.said.unit, set.said.is_unit_shipped) = (unit, true);
            }
        }
        sets
    }

    fn unit(&self, kind: ColumnKind) -> Option<&'static str> {
        match kind {
            ColumnKind::Position => Some(self.units.position),
            ColumnKind::Velocity => self.units.velocity,
            _ => Some(self.units.torque),
        }
    }

    /// Units in words.
    pub(super) fn shown_units(&self) -> String {
        let all = [self.units.time, Some(self.units.position), self.units.velocity, Some(self.units.torque)];
        all.into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// The quantities of joint columns in layouts.
fn quantity(kind: Option<ColumnKind>) -> Option<ColumnKind> {
    kind.filter(|kind| {
        matches!(kind, ColumnKind::Position | ColumnKind::Velocity | ColumnKind::Torque | ColumnKind::Current)
    })
}

/// The columns of a layout in the file; `None` if one is missing.
fn channels(head: &Head, layout: &Layout, units: LayoutUnits) -> Option<Vec<Set>> {
    let (TimeSource::Column(time) | TimeSource::Counter { column: time, .. }) = &layout.time else {
        return None;
    };
    column(head, &time.column)?;
    let torque = match layout.torque_quantity {
        TorqueQuantity::Current => ColumnKind::Current,
        TorqueQuantity::Torque | TorqueQuantity::FractionOfRated => ColumnKind::Torque,
    };
    let side = layout.motor_side;
    let mut all = vec![(ColumnKind::Position, &layout.position.columns, units.position, side.position)];
    all.push((torque, &layout.torque.columns, units.torque, side.torque));
    if let Some(velocity) = &layout.velocity {
        all.push((ColumnKind::Velocity, &velocity.columns, units.velocity?, side.position));
    }
    let sets: Vec<Set> = all
        .into_iter()
        .map(|(kind, columns, unit, is_motor)| set(head, columns, kind, unit, is_motor))
        .collect::<Option<_>>()?;
    sets.windows(2).all(|pair| pair[0].columns.len() == pair[1].columns.len()).then_some(sets)
}

fn set(
    head: &Head,
    columns: &JointColumns,
    kind: ColumnKind,
    unit: &'static str,
    is_motor: bool,
) -> Option<Set> {
    let of_joint = |joint: usize| columns.of_joint(joint).map(|of| column(head, &of));
    // a pattern matches as many joints as the file has, a list must match completely
    let found: Vec<Option<usize>> = match columns {
        JointColumns::Pattern(_) => (1..).map_while(of_joint).take_while(Option::is_some).collect(),
        _ => (1..).map_while(of_joint).collect(),
    };
    let found: Vec<usize> = found.into_iter().collect::<Option<_>>()?;
    let said = NameMeaning {
        kind: Some(kind),
        unit: Some(unit),
        is_unit_shipped: true,
        is_measured: true,
        is_motor,
        ..NameMeaning::default()
    };
    let (template, first) = match columns {
        JointColumns::Pattern(pattern) if pattern.contains("{joint}") => (pattern.clone(), 1),
        _ => (head.columns[*found.first()?].name.clone(), 0),
    };
    (found.len() >= LEAST_JOINTS).then_some(Set {
        template,
        first,
        columns: found,
        order: Order::Number,
        said,
    })
}

fn column(head: &Head, column: &Column) -> Option<usize> {
    let Column::Name(name) = column else { return None };
    let at = head.columns.iter().position(|of| of.name == *name)?;
    head.has_plain_name(at).then_some(at)
}

/// Returns true for columns of joint states: equal numbers of positions and efforts, named or numbered.
fn is_joint_state(head: &Head) -> bool {
    let count = |quantity: &str| {
        let numbered = |c: char| c.is_ascii_digit() || matches!(c, '[' | ']');
        let names = head.columns.iter().map(|column| column.name.trim_end_matches(numbered));
        names
            .filter(|name| {
                name.strip_suffix(quantity).is_some_and(|before| before.ends_with(['/', '.', ':']))
            })
            .count()
    };
    let [positions, velocities, efforts] = QUANTITIES.map(count);
    efforts >= LEAST_JOINTS
        && positions == efforts
        && (velocities == efforts || velocities == 0)
        && head.columns.iter().any(|column| names::said(&column.name, "").kind == Some(ColumnKind::Time))
}
