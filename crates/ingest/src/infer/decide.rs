//! What is known of an export's columns, put together to a layout with reasons.

use super::head::Head;
use super::joints::{Joints, by_name, by_place, column_name, time_column, values};
use super::motion_sections::{position_section, time_section, torque_section, velocity_section};
use super::motion_units::{decide_units, slopes};
use super::names::{Kind, Said};
use super::proposal::Hints;
use super::section::{Section, TomlKey, quoted};
use super::stages::Meaning;
use super::temperatures::temperatures;
use super::{names, stages};

/// The sections of a layout file for the export.
pub(super) fn propose(head: &Head, hints: Hints<'_>) -> Vec<Section> {
    let joints = match head.header {
        true => by_name(head, hints.robot),
        false => by_place(head, hints),
    };
    let time = time_column(head, &joints);
    let slopes = slopes(&joints, time.map(|(_, values)| values));
    let units = decide_units(head, &joints, time, &slopes, hints.robot);
    let mut sections = vec![time_section(head, time, &units, slopes.overall, hints)];
    sections.push(position_section(&joints, &units));
    sections.extend(velocity_section(&joints, &units, &slopes));
    sections.push(torque_section(&joints, &units, hints));
    let signals = signals(head, &joints, time.map(|(column, _)| column));
    let is_time = |at: usize| time.is_some_and(|(column, _)| column == at);
    let temperatures = temperatures(head, joints.count, |at| joints.has(at) || is_time(at));
    sections.extend(temperatures.sections);
    sections.push(stage_section(head, &joints, &signals));
    sections.extend(optional_section(head, &signals));
    let others: Vec<usize> = temperatures.columns.into_iter().chain(time.map(|(column, _)| column)).collect();
    sections.push(rest_section(head, &joints, &signals, &others));
    sections
}

/// Columns that are not joints' and not time.
struct Signals {
    stage: Option<(usize, bool)>,
    cycle: Option<usize>,
    friction_joint: Option<usize>,
    friction_level: Option<usize>,
}

fn signals(head: &Head, joints: &Joints<'_>, time: Option<usize>) -> Signals {
    let free: Vec<usize> =
        (0..head.columns.len()).filter(|at| !joints.has(*at) && Some(*at) != time).collect();
    let said = |at: usize| names::said(&head.columns[at].name, &head.columns[at].under).kind;
    let alphabet = |at: usize| values(&head.columns[at]).and_then(stages::alphabet);
    let whole = |at: &usize| {
        values(&head.columns[*at]).is_some_and(|values| values.iter().all(|v| v.fract() == 0.0 && *v >= 0.0))
    };
    let named = |kind: Kind| free.iter().copied().find(|at| said(*at) == Some(kind) && whole(at));
    let within = |at: &usize, most: usize| {
        alphabet(*at).is_some_and(|values| values.iter().all(|value| (0..=most as i64).contains(value)))
    };
    let by_name = free.iter().copied().find(|at| said(*at) == Some(Kind::Stage) && alphabet(*at).is_some());
    let may_be = |at: &usize| {
        said(*at).is_none() && alphabet(*at).is_some_and(|values| (2..=8).contains(&values.len()))
    };
    let mut others = free.iter().copied().filter(may_be);
    // Of several, none is more likely than another.
    let by_values = match (others.next(), others.next()) {
        (Some(only), None) => Some((only, false)),
        _ => None,
    };
    Signals {
        stage: by_name.map(|at| (at, true)).or(by_values),
        cycle: named(Kind::Cycle),
        friction_joint: named(Kind::FrictionJoint).filter(|at| within(at, joints.count)),
        friction_level: named(Kind::FrictionLevel).filter(|at| within(at, 255)),
    }
}

fn stage_section(head: &Head, joints: &Joints<'_>, signals: &Signals) -> Section {
    let mut section = Section { title: Some("stage"), ..Section::default() };
    let signal = signals.stage.and_then(|(at, named)| Some((at, named, values(&head.columns[at])?)));
    let Some((at, named, signal)) = signal else {
        let reason = "no column of few whole numbers is a stage signal: all rows are taken as excitation. A column \
                      that tells the stages goes here by name, with the values of each";
        section.keys.push(TomlKey::decided("whole_recording", quoted("excitation")).because(reason));
        return section;
    };
    let alphabet = stages::alphabet(signal).unwrap_or_default();
    let under = stages::values(signal, &alphabet, &speeds(joints));
    let seen: Vec<String> = under
        .iter()
        .map(|v| format!("{} in {} rows, {:.1} joints moving", v.value, v.rows, v.moving))
        .collect();
    let why = if named { "the name says so" } else { "the only column of few whole numbers" };
    section.keys.push(
        TomlKey::decided("column", column_name(head, at))
            .because(&format!("{why}; it has {}", seen.join("; "))),
    );
    let (meaning, reason) = match (stages::native(&alphabet), stages::by_motion(&under)) {
        (Some(native), _) => (Some(native), "0 to 3 as in the native layout"),
        (None, motion) => (
            motion,
            "by the motion: joints one by one are friction, all together excitation and, later, warming",
        ),
    };
    section.keys.extend(meaning_keys(meaning, &alphabet, reason));
    section
}

fn meaning_keys(meaning: Option<Meaning>, alphabet: &[i64], reason: &str) -> Vec<TomlKey> {
    let list =
        |values: &[i64]| format!("[{}]", values.iter().map(i64::to_string).collect::<Vec<_>>().join(", "));
    match meaning {
        Some(meaning) => vec![
            TomlKey::decided("between", list(&meaning.between)).because(reason),
            TomlKey::decided("excitation", list(&meaning.excitation)),
            TomlKey::decided("friction", list(&meaning.friction)),
            TomlKey::decided("warming", list(&meaning.warming)),
        ],
        None => {
            let question = format!("which of {} means what? The motion does not tell", list(alphabet));
            let ask = |name| TomlKey::decided(name, "[]").asked(&question);
            ["between", "excitation", "friction", "warming"].map(ask).into()
        }
    }
}

/// Speeds of the joints `[n][rows]`, from positions where none are recorded.
fn speeds(joints: &Joints<'_>) -> Vec<Vec<f64>> {
    match (&joints.velocity, &joints.position) {
        (Some(velocity), _) => velocity.values.iter().map(|values| values.to_vec()).collect(),
        (None, Some(position)) => position
            .values
            .iter()
            .map(|values| {
                let change = values.windows(2).map(|pair| pair[1] - pair[0]);
                change.chain([0.0]).collect()
            })
            .collect(),
        (None, None) => Vec::new(),
    }
}

fn optional_section(head: &Head, signals: &Signals) -> Option<Section> {
    let columns = [
        ("cycle", signals.cycle),
        ("friction_joint", signals.friction_joint),
        ("friction_level", signals.friction_level),
    ];
    let key = |(name, at): (&'static str, Option<usize>)| {
        Some(
            TomlKey::decided(name, column_name(head, at?))
                .because("the name says so, and it holds whole numbers"),
        )
    };
    let keys: Vec<TomlKey> = columns.into_iter().filter_map(key).collect();
    (!keys.is_empty()).then(|| Section { title: Some("if_present"), comments: Vec::new(), keys })
}

fn rest_section(head: &Head, joints: &Joints<'_>, signals: &Signals, others: &[usize]) -> Section {
    let used = [signals.cycle, signals.friction_joint, signals.friction_level];
    let is_used = |at: usize| {
        joints.has(at)
            || others.contains(&at)
            || used.contains(&Some(at))
            || signals.stage.is_some_and(|(stage, _)| stage == at)
    };
    let rest: Vec<String> = (head.columns.iter().enumerate())
        .filter(|(at, column)| !is_used(*at) && !column.name.is_empty())
        .map(|(_, column)| match names::said(&column.name, &column.under) {
            Said { kind: Some(Kind::Other(what)), .. } => format!("{} ({what})", column.name),
            Said { kind: Some(Kind::Temperature), .. } => {
                format!("{} (a temperature, not told to be the motors' or the hall's)", column.name)
            }
            Said { is_target: true, .. } => format!("{} (a target, not a measurement)", column.name),
            _ => column.name.clone(),
        })
        .collect();
    let comments = match rest.is_empty() {
        true => Vec::new(),
        false => vec![format!("Not read: {}.", rest.join(", "))],
    };
    Section { title: None, comments, keys: Vec::new() }
}
