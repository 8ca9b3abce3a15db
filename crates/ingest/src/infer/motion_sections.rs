//! The sections of a layout on time, positions, velocities and torques, with reasons.

use super::decide::ColumnOrigin;
use super::head::Head;
use super::joints::{Joints, QuantityColumns, Time};
use super::motion_units::{Slopes, Units};
use super::names::ColumnKind;
use super::proposal::Hints;
use super::section::{Section, TomlKey, quoted};
use super::time_form::lost_digits;
use super::torque_size::Size;
use super::units::Slope;
use super::{torque_size, units};
use armwatch_model::robot::Robot;

/// Currents from here on are not in A: the motors of the largest arms take some 100 A.
const LEAST_MILLIAMPERES: f64 = 300.0;

/// A number with three significant digits.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = 10_f64.powi(2 - value.abs().log10().floor() as i32);
    (value * digits).round() / digits
}

pub(super) fn time_section(
    head: &Head,
    time: &Time<'_>,
    units: &Units,
    slope: Option<Slope>,
    hints: Hints<'_>,
) -> Section {
    let mut section = Section { title: Some("time"), ..Section::default() };
    let unreadable = time.unreadable.first().map(|at| unreadable_time(head, *at));
    let Some((at, values)) = time.column else {
        match (unreadable, time.unreadable.first()) {
            (Some(question), Some(at)) => {
                section.keys.push(TomlKey::decided("column", head.reference(*at)).open(&question));
                section.keys.push(TomlKey::decided("unit", quoted("timestamp")).open("in which unit?"));
            }
            _ => section.keys.push(sample_rate(units, slope, hints)),
        }
        return section;
    };
    let column = &head.columns[at];
    let question = unreadable.or_else(|| other_times(head, time));
    section.keys.push(
        TomlKey::decided("column", head.reference(at))
            .because("it rises from row to row")
            .asked_if(question.as_ref()),
    );
    if let (None, false) = (&question, time.others.is_empty()) {
        section.comments.push(format!("The same time is also in {}.", listed_times(head, time)));
    }
    if let Some(form) = column.time_forms.key() {
        section.keys.push(form);
        return section;
    }
    let step = units.figures.step.unwrap_or(0.0);
    match (units.known.time, units.choice(), slope) {
        (Some(unit), ..) => {
            section.keys.push(TomlKey::decided("unit", quoted(unit)).because("from the name"));
        }
        (None, Some(choice), _) if units.times().len() > 1 => {
            let question = format!(
                "rows are {} apart: {}? The velocities go with each; {}",
                rounded(step),
                units.times().join(" or "),
                units.by_numbers()
            );
            section.keys.push(TomlKey::decided("unit", quoted(choice.time.0)).asked(&question));
        }
        (None, Some(choice), Some(_)) if choice.time.0 == units::TICKS => {
            let reason = format!(
                "no unit of time fits the velocities; they are the change of position over {:.6} s per count",
                choice.time.1
            );
            section.keys.push(TomlKey::decided("unit", quoted(units::TICKS)).because(&reason));
            section.keys.push(TomlKey::decided("tick_s", rounded(choice.time.1).to_string()));
        }
        (None, Some(choice), _) if slope.is_some() || step != 1.0 => {
            let reason = format!(
                "rows are {} apart, {:.4} Hz; {}",
                rounded(step),
                1.0 / (step * choice.time.1),
                units.by_numbers()
            );
            section.keys.push(TomlKey::decided("unit", quoted(choice.time.0)).because(&reason));
        }
        (None, None, Some(slope)) => {
            let question = format!(
                "rows are {} apart, and no unit of time fits the velocities: with rad/s and rad, or deg/s \
                and deg, a count would be {} s. In which unit is it?",
                rounded(step),
                rounded(slope.ratio.abs().recip())
            );
            section.keys.push(TomlKey::decided("unit", quoted("ms")).open(&question));
        }
        _ => {
            let question = format!(
                "rows are {} apart: in which unit? s, ms, us, ns, or ticks with tick_s",
                rounded(step)
            );
            section.keys.push(TomlKey::decided("unit", quoted("ms")).asked(&question));
        }
    }
    section.keys.extend(restart(values).or_else(|| wrap(values)));
    section
}

/// Question about a column with the name of a time that is unreadable as one.
fn unreadable_time(head: &Head, at: usize) -> String {
    let column = &head.columns[at];
    let name = head.reference(at);
    if let Some(question) = lost_digits(&column.cells) {
        return format!(
            "column {name} is called a time, and {question} Without a time, missing rows cannot be seen"
        );
    }
    let Some(values) = &column.values else {
        return format!(
            "column {name} is called a time, and its cells are neither numbers nor dates in a known form; the first is \
             {:?}. Which form is it? Without a time, missing rows cannot be seen",
            column.first()
        );
    };
    let stands = values.windows(2).filter(|pair| pair[0] == pair[1]).count();
    let fall = values.windows(2).enumerate().find(|(_, pair)| pair[0] > pair[1]);
    let fall = fall.map_or_else(String::new, |(row, pair)| {
        format!(" and falls from {} to {} after row {}", rounded(pair[0]), rounded(pair[1]), row + 1)
    });
    format!(
        "column {name} is called a time, but does not change in {stands} of {} rows{fall}. How must it be \
        read? Without a time, missing rows cannot be seen",
        values.len()
    )
}

/// Question about channels that have separate times.
fn other_times(head: &Head, time: &Time<'_>) -> Option<String> {
    let apart = |(_, distance): &&(usize, f64)| *distance != 0.0;
    let most = time.others.iter().filter(apart).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    Some(format!(
        "other columns also have a time: {}. That of column {} differs by {} in the column's unit. Does \
        this time belong to the positions? Channels that were recorded later have delay_s",
        listed_times(head, time),
        head.reference(most.0),
        rounded(most.1)
    ))
}

fn listed_times(head: &Head, time: &Time<'_>) -> String {
    let group = |shifted: bool| -> Vec<String> {
        let of = time.others.iter().filter(|(_, distance)| (*distance != 0.0) == shifted);
        of.map(|(at, distance)| match shifted {
            true => format!("{} ({} later)", head.reference(*at), rounded(*distance)),
            false => head.reference(*at),
        })
        .collect()
    };
    [group(false), group(true)].concat().join(", ")
}

fn sample_rate(units: &Units, slope: Option<Slope>, hints: Hints<'_>) -> TomlKey {
    let key = |rate: f64| TomlKey::decided("sample_rate_hz", format!("{rate:?}"));
    let fits = units.rates.first().map(|rate| rounded(*rate));
    match (hints.sample_rate, fits, slope) {
        (Some(given), Some(fits), Some(_)) if units.is_rate_refuted => key(fits).asked(&format!(
            "{given:?} Hz were given, and the velocities are the change of position from row to row at {fits:?} Hz. Which is \
             right?"
        )),
        (Some(given), ..) => key(given).because("as given"),
        (None, Some(fits), Some(_)) => {
            let reason =
                "no column increases; velocities are the change of position from row to row at this rate";
            match units.rates.as_slice() {
                [_] => key(fits).because(reason),
                [_, others @ ..] => {
                    let others: Vec<String> = others.iter().map(|rate| format!("{:?}", rounded(*rate))).collect();
                    key(fits).because(reason).asked(&format!(
                        "other units would fit {} Hz. How many rows are there per second?",
                        others.join(" or ")
                    ))
                }
                [] => key(fits),
            }
        }
        _ => key(250.0).open("no column increases from row to row: how many rows are there per second?"),
    }
}

/// The key for a falling time that starts another recording. Whole numbers are more often a counter.
fn restart(values: &[f64]) -> Option<TomlKey> {
    let first = *values.first()?;
    let falls: Vec<&[f64]> = values.windows(2).filter(|pair| pair[0] > pair[1]).collect();
    let (length, step) = (falls.first()?[0] - first, units::median_step(values)?);
    if values.iter().all(|value| value.fract() == 0.0)
        || falls.iter().any(|pair| pair[1] - first > 0.1 * length)
    {
        return None;
    }
    let reason =
        format!("it falls from {} to {}, and {} times in total", falls[0][0], falls[0][1], falls.len());
    let key = TomlKey::decided("restarts", "true".to_owned()).because(&reason);
    // a counter always falls from the same value
    Some(match falls.iter().any(|pair| (pair[0] - falls[0][0]).abs() > 2.0 * step) {
        true => key,
        false => key.asked("does the file have several recordings, one beginning at each of these rows?"),
    })
}

/// The value after which a falling time restarts.
fn wrap(values: &[f64]) -> Option<TomlKey> {
    let (before, after) = values.windows(2).map(|pair| (pair[0], pair[1])).find(|(a, b)| a > b)?;
    let periods = [1_u64 << 16, 1 << 31, 1 << 32];
    let period = periods.into_iter().find(|period| before < *period as f64 && before > 0.9 * *period as f64);
    let reason = format!("it falls from {before} to {after}");
    let key = TomlKey::decided("wraps_at", period.unwrap_or(1 << 32).to_string()).because(&reason);
    Some(match period {
        Some(_) => key,
        None => key.asked("is this a counter that started again, and after how many counts?"),
    })
}

fn joint_question(title: &'static str, count: usize) -> Section {
    let names =
        if count == 0 { "no column name shows this" } else { "no name of as many columns shows this" };
    let question = format!(
        "which columns hold the {title}s? {names}; --description or --robot helps if columns have no names"
    );
    let key = TomlKey::decided("columns", "[..]").open(&question);
    Section { title: Some(title), comments: Vec::new(), keys: vec![key] }
}

pub(super) fn position_section(joints: &Joints<'_>, units: &Units) -> Section {
    let Some(found) = &joints.position else {
        let mut section = joint_question("position", joints.count);
        section
            .comments
            .push("A log without positions, of currents and temperatures, has recorded = false here.".into());
        return section;
    };
    let mut keys = vec![
        TomlKey::decided(found.key.0, found.key.1.clone())
            .because(&found.why)
            .asked_if(found.question.as_ref()),
    ];
    keys.push(match (units.known.position, units.choice()) {
        (Some(unit), _) => TomlKey::decided("unit", quoted(unit)).because(unit_reason(found)),
        (None, Some(choice)) => TomlKey::decided("unit", quoted(choice.position.0))
            .because(&(units.by_numbers() + &units.alternatives())),
        (None, None) => TomlKey::decided("unit", quoted("rad")).asked(&format!(
            "positions reach {:.4}: rad, deg or rev? No unit fits the limits and velocities",
            units.figures.position
        )),
    });
    if found.said.is_motor || units.beyond_limits {
        let reason = match units.beyond_limits {
            true => "positions are far beyond the arm's limits in any unit, as for motors",
            false => "the name contains motor",
        };
        keys.push(TomlKey::decided("side", quoted("motor")).because(reason));
    }
    Section { title: Some("position"), comments: Vec::new(), keys }
}

pub(super) fn velocity_section(joints: &Joints<'_>, units: &Units, slopes: &Slopes) -> Option<Section> {
    let found = joints.velocity.as_ref()?;
    let mut keys = vec![
        TomlKey::decided(found.key.0, found.key.1.clone())
            .because(&found.why)
            .asked_if(found.question.as_ref()),
    ];
    keys.push(match (units.known.velocity, units.choice()) {
        (Some(unit), _) => TomlKey::decided("unit", quoted(unit)).because(unit_reason(found)),
        (None, Some(choice)) => {
            TomlKey::decided("unit", quoted(choice.velocity.0)).because(&units.by_numbers())
        }
        (None, None) => TomlKey::decided("unit", quoted("rad/s")).asked(&format!(
            "velocities reach {:.4}: rad/s, deg/s, rpm or rev/s?",
            units.figures.velocity.unwrap_or(0.0)
        )),
    });
    let signs: Vec<&str> = slopes
        .each
        .iter()
        .map(|slope| if slope.is_some_and(|slope| slope.ratio < 0.0) { "-1" } else { "1" })
        .collect();
    if signs.contains(&"-1") {
        let reason = "these velocities have the opposite sign of the change of position";
        keys.push(TomlKey::decided("sign", format!("[{}]", signs.join(", "))).because(reason));
    }
    Some(Section { title: Some("velocity"), comments: Vec::new(), keys })
}

/// Returns true if torques in Nm, or currents in A, have the size of another quantity.
pub(super) fn is_other_quantity(joints: &Joints<'_>, units: &Units, hints: Hints<'_>) -> bool {
    let Some(found) = &joints.torque else { return true };
    match found.said.unit {
        Some("Nm") => size_of(found, joints, units, hints).is_some_and(|size| !size.is_like_torque()),
        Some("A") => units::largest(found.values.iter().copied().flatten()) >= LEAST_MILLIAMPERES,
        _ => false,
    }
}

/// The section on torques.
pub(super) fn torque_section(
    joints: &Joints<'_>,
    units: &Units,
    hints: Hints<'_>,
    origin: ColumnOrigin<'_>,
) -> Section {
    let Some(found) = &joints.torque else { return joint_question("torque", joints.count) };
    let size = size_of(found, joints, units, hints);
    let mut unit = torque_unit(found, size, hints);
    if matches!(origin, ColumnOrigin::Recorder(_)) && found.said.unit.is_none() && size.is_none() {
        unit.question.get_or_insert_with(|| {
            "the name gives no unit, and drives of this maker may record percent or permille of the rated torque or current. \
             Which unit is it?"
                .into()
        });
    }
    let needs_gain = !unit.value.contains('N');
    let mut keys = vec![
        TomlKey::decided(found.key.0, found.key.1.clone())
            .because(&found.why)
            .asked_if(found.question.as_ref()),
        unit,
    ];
    if needs_gain {
        keys[1]
            .reasons
            .push("the description of the robot must convert it to torque: docs/exports.md".into());
    }
    if matches!(origin, ColumnOrigin::Maker(_))
        && found.said.kind == Some(ColumnKind::Current)
        && !has_gains(hints)
    {
        keys[1].question = Some(
            "currents become torques by drive_gain_nm_a of each joint of the description, and the \
            manufacturer publishes none. Does the description have them? `armwatch robot drive-gains` \
            estimates them"
                .into(),
        );
    }
    if found.said.is_motor {
        keys.push(TomlKey::decided("side", quoted("motor")).because("the name contains motor"));
    }
    Section { title: Some("torque"), comments: Vec::new(), keys }
}

/// Why a unit is known.
fn unit_reason(found: &QuantityColumns<'_>) -> &'static str {
    if found.said.is_unit_shipped { "as in the shipped layout" } else { "the name gives it" }
}

/// Returns true if the description converts currents to torques.
fn has_gains(hints: Hints<'_>) -> bool {
    let has_gain = |robot: &Robot| {
        robot.joints.iter().any(|joint| joint.drive_gain.is_some() || joint.motor_torque_constant.is_some())
    };
    hints.robot.is_some_and(has_gain)
}

/// Size of the recorded torques compared with those of gravity, if positions are the joints' and their unit is known.
fn size_of(
    found: &QuantityColumns<'_>,
    joints: &Joints<'_>,
    units: &Units,
    hints: Hints<'_>,
) -> Option<Size> {
    let position =
        joints.position.as_ref().filter(|position| !position.said.is_motor && !units.beyond_limits)?;
    if found.said.is_motor {
        return None;
    }
    let to_si = units.choice()?.position.1;
    let radians: Vec<Vec<f64>> =
        position.values.iter().map(|values| values.iter().map(|value| value * to_si).collect()).collect();
    torque_size::size(hints, &radians, &found.values)
}

/// The unit of torques: by their name, otherwise only if nothing indicates currents.
fn torque_unit(found: &QuantityColumns<'_>, size: Option<Size>, hints: Hints<'_>) -> TomlKey {
    let most = units::largest(found.values.iter().copied().flatten());
    let named_torque = found.said.kind == Some(ColumnKind::Torque);
    let compared = size.map_or_else(String::new, |size| format!("; {}", size.text()));
    match (found.said.unit, found.said.kind) {
        (Some(unit @ ("Nm" | "N" | "A" | "mA" | "%" | "permille")), _) => {
            TomlKey::decided("unit", quoted(unit)).because(unit_reason(found))
        }
        (_, Some(ColumnKind::Current)) if most >= LEAST_MILLIAMPERES => TomlKey::decided("unit", quoted("mA")).asked(&format!(
            "a current without unit: A or mA? The largest is {most:.4}, more than the motors of an arm draw in A"
        )),
        (_, Some(ColumnKind::Current)) => TomlKey::decided("unit", quoted("A"))
            .because(&format!("a current without unit; the largest is {most:.4}")),
        _ if size.is_some_and(|size| !size.is_like_torque()) => {
            let what = if named_torque { "the name contains torque, but the numbers are not as large as \
                torques in Nm" }
                else { "no name identifies these, and they are not as large as torques in Nm" };
            TomlKey::decided("unit", quoted("Nm"))
                .asked(&format!("{what}{compared}. Currents in A, or % or permille of rated?"))
        }
        _ if named_torque => TomlKey::decided("unit", quoted("Nm")).because(&format!(
            "a torque without unit; the largest is {most:.4}{compared}. Not % or permille of rated?"
        )),
        _ if has_gains(hints) => TomlKey::decided("unit", quoted("A")).asked(&format!(
            "the names do not distinguish torques in Nm from currents in A, and the description has drive \
            gains, which currents need; the largest is {most:.4}{compared}"
        )),
        _ if size.is_some() => TomlKey::decided("unit", quoted("Nm"))
            .because(&format!(
                "no name shows this; they are as large as the torques of the arm: {}",
                compared.trim_start_matches("; ")
            )),
        _ => TomlKey::decided("unit", quoted("Nm")).asked(&format!(
            "the names do not distinguish torques in Nm, currents in A and % of rated; the largest is {most:.4}"
        )),
    }
}
