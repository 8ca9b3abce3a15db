//! Combines the evidence about an export's columns to a layout with reasons.

use super::arms::{Arm, is_of};
use super::blocks::by_motion;
use super::head::Head;
use super::joints::{Joints, by_name, time};
use super::makers::{Maker, Recorder, recognise, recorder};
use super::motion_sections::{
    is_other_quantity, position_section, time_section, torque_section, velocity_section,
};
use super::motion_units::{Shipped, decide_units, slopes};
use super::names;
use super::names::{ColumnKind, NameMeaning};
use super::proposal::Hints;
use super::section::Section;
use super::sets::sets;
use super::stage_sections::{optional_section, signals, stage_section};
use super::temperatures::temperatures;
use super::topic_echo::{self, TopicEcho, topic_echo};

/// Proposal for an export.
#[derive(Default)]
pub(super) struct Decided {
    pub(super) sections: Vec<Section>,
    /// Number of joints.
    pub(super) joints: usize,
    /// Name of the shipped layout that fits.
    pub(super) shipped: Option<&'static str>,
}

/// The sections of a layout file for the export. If there are several arms, it uses the columns of `arm` and those
/// without an arm.
pub(super) fn propose(head: &Head, hints: Hints<'_>, arm: Option<&Arm>) -> Decided {
    let echo = topic_echo(head, hints.robot);
    if let Some(decided) = echo.and_then(|echo| of_topic_echo(head, hints, &echo)) {
        return decided;
    }
    let maker = recognise(head);
    if let Some(decided) =
        maker.as_ref().and_then(|maker| of_columns(head, hints, ColumnOrigin::Maker(maker), arm))
    {
        return decided;
    }
    let recorder = recorder(head);
    let origin = recorder.as_ref().map_or(ColumnOrigin::Unknown, ColumnOrigin::Recorder);
    let mut decided = of_columns(head, hints, origin, arm).unwrap_or_default();
    if let Some(maker) = maker {
        let said = format!(
            "The columns have the names of the shipped layout {}, and the numbers are not in its units ({}).",
            maker.name,
            maker.shown_units()
        );
        decided.sections.insert(0, Section { title: None, comments: vec![said], keys: Vec::new() });
    }
    decided
}

/// The sections for rows of `ros2 topic echo`; `None` if the numbers are in other units.
fn of_topic_echo(head: &Head, hints: Hints<'_>, echo: &TopicEcho<'_>) -> Option<Decided> {
    let joints = &echo.joints;
    let slopes = slopes(joints, Some(&echo.time));
    let decided = |shipped| decide_units(head, joints, Some((1, &echo.time)), &slopes, hints, shipped);
    let units = decided(Shipped { time: Some("ns"), is_trusted: true });
    if !decided(Shipped::default()).allow(&units) || is_other_quantity(joints, &units, hints) {
        return None;
    }
    let mut sections = echo.sections();
    sections.push(position_section(joints, &units));
    sections.extend(velocity_section(joints, &units, &slopes));
    sections.push(torque_section(joints, &units, hints, ColumnOrigin::Unknown));
    let signals = signals(head, joints, |at| at < echo.columns || joints.has(at));
    sections.push(stage_section(head, joints, &signals));
    Some(Decided { sections, joints: joints.count, shipped: Some(topic_echo::LAYOUT) })
}

/// The origin of an export with names of columns.
#[derive(Clone, Copy)]
pub(super) enum ColumnOrigin<'a> {
    /// Columns and units are those of a shipped layout.
    Maker(&'a Maker),
    /// The maker is known, and units are not.
    Recorder(&'a Recorder),
    Unknown,
}

/// The sections for columns of a maker or of another recorder; `None` if the numbers contradict the maker's units.
fn of_columns(head: &Head, hints: Hints<'_>, origin: ColumnOrigin<'_>, arm: Option<&Arm>) -> Option<Decided> {
    let maker = if let ColumnOrigin::Maker(maker) = origin { Some(maker) } else { None };
    let mut sets = if head.header { sets(head, hints.robot) } else { Vec::new() };
    if let Some(maker) = maker {
        sets = maker.sets(sets);
    }
    if let Some(arm) = arm {
        sets.retain(|set| is_of(set, arm));
    }
    let joints = match head.header {
        true => by_name(head, hints.robot, &sets),
        false => by_motion(head, hints),
    };
    let time = time(head, &joints);
    let slopes = slopes(&joints, time.column.map(|(_, values)| values));
    let decided = |shipped| decide_units(head, &joints, time.column, &slopes, hints, shipped);
    let units = decided(Shipped { time: maker.and_then(Maker::time_unit), is_trusted: true });
    if maker.is_some()
        && (!decided(Shipped::default()).allow(&units) || is_other_quantity(&joints, &units, hints))
    {
        return None;
    }
    let mut sections = vec![time_section(head, &time, &units, slopes.overall, hints)];
    sections.push(position_section(&joints, &units));
    sections.extend(velocity_section(&joints, &units, &slopes));
    sections.push(torque_section(&joints, &units, hints, origin));
    let mut used: Vec<usize> = time.columns().collect();
    used.extend((0..head.columns.len()).filter(|at| joints.has(*at)));
    let temperatures = temperatures(head, &sets, joints.count, |at| used.contains(&at));
    sections.extend(temperatures.sections);
    used.extend(temperatures.columns);
    let signals = signals(head, &joints, |at| used.contains(&at));
    sections.push(stage_section(head, &joints, &signals));
    sections.extend(optional_section(head, &signals));
    used.extend(signals.columns());
    sections.push(rest_section(head, &joints, &used));
    let shipped = match origin {
        ColumnOrigin::Maker(maker) => Some(maker.name),
        ColumnOrigin::Recorder(recorder) => {
            sections.insert(
                0,
                Section { title: None, comments: vec![recorder.evidence.clone()], keys: Vec::new() },
            );
            Some(recorder.layout)
        }
        ColumnOrigin::Unknown => None,
    };
    Some(Decided { sections, joints: joints.count, shipped })
}

fn rest_section(head: &Head, joints: &Joints<'_>, used: &[usize]) -> Section {
    let rest: Vec<String> = (head.columns.iter().enumerate())
        .filter(|(at, column)| !used.contains(at) && !column.name.is_empty())
        .map(|(at, column)| {
            let said = names::said(&column.name, &column.under);
            let what = match (joints.others.iter().find(|(other, _)| *other == at), said) {
                (Some((_, what)), _) => what,
                (None, NameMeaning { kind: Some(ColumnKind::Other(what)), .. }) => what,
                (None, NameMeaning { kind: Some(ColumnKind::Temperature), .. }) => {
                    "a temperature, but not known if of motors or ambient"
                }
                (None, NameMeaning { intent: Some(_), .. }) => {
                    "by its name a command or a calculated value, not measured"
                }
                _ => return column.name.clone(),
            };
            format!("{} ({what})", column.name)
        })
        .collect();
    let comments = match rest.is_empty() {
        true => Vec::new(),
        false => vec![format!("Not read: {}.", rest.join(", "))],
    };
    Section { title: None, comments, keys: Vec::new() }
}
