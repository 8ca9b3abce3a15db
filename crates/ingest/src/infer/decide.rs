//! What is known of an export's columns, put together to a layout with reasons.

use super::arms::{Arm, is_of};
use super::blocks::by_motion;
use super::head::Head;
use super::joints::{Joints, by_name, time};
use super::motion_sections::{position_section, time_section, torque_section, velocity_section};
use super::motion_units::{decide_units, slopes};
use super::names;
use super::names::{Kind, Said};
use super::proposal::Hints;
use super::section::Section;
use super::sets::sets;
use super::stage_sections::{optional_section, signals, stage_section};
use super::temperatures::temperatures;

/// The sections of a layout file for the export, and the number of joints. Of several arms, the columns of `arm` and those
/// that say none are taken.
pub(super) fn propose(head: &Head, hints: Hints<'_>, arm: Option<&Arm>) -> (Vec<Section>, usize) {
    let mut sets = if head.header { sets(head, hints.robot) } else { Vec::new() };
    if let Some(arm) = arm {
        sets.retain(|set| is_of(set, arm));
    }
    let joints = match head.header {
        true => by_name(head, hints.robot, &sets),
        false => by_motion(head, hints),
    };
    let time = time(head, &joints);
    let slopes = slopes(&joints, time.column.map(|(_, values)| values));
    let units = decide_units(head, &joints, time.column, &slopes, hints);
    let mut sections = vec![time_section(head, &time, &units, slopes.overall, hints)];
    sections.push(position_section(&joints, &units));
    sections.extend(velocity_section(&joints, &units, &slopes));
    sections.push(torque_section(&joints, &units, hints));
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
    (sections, joints.count)
}

fn rest_section(head: &Head, joints: &Joints<'_>, used: &[usize]) -> Section {
    let rest: Vec<String> = (head.columns.iter().enumerate())
        .filter(|(at, column)| !used.contains(at) && !column.name.is_empty())
        .map(|(at, column)| {
            let said = names::said(&column.name, &column.under);
            let what = match (joints.others.iter().find(|(other, _)| *other == at), said) {
                (Some((_, what)), _) => what,
                (None, Said { kind: Some(Kind::Other(what)), .. }) => what,
                (None, Said { kind: Some(Kind::Temperature), .. }) => {
                    "a temperature, not told to be the motors' or the hall's"
                }
                (None, Said { intent: Some(_), .. }) => "by its name wanted or calculated, not measured",
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
