//! What is known of an export's columns, put together to a layout with reasons.

use super::Hints;
use super::head::{Head, HeadColumn};
use super::names::{self, Group, Kind, Said};
use super::stages::{self, Meaning};
use super::temperatures::temperatures;
use super::units::{self, Choice, Figures, Known, Slope};
use super::write::quoted;
use crate::robot::Robot;

/// Sample rates that are believed, Hz: what a layout takes.
const SAMPLE_RATES: std::ops::RangeInclusive<f64> = 0.1..=1e6;

/// Part of a layout file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Section {
    /// Name of the table; `None` for the start of the file.
    pub(super) title: Option<&'static str>,
    pub(super) comments: Vec<String>,
    pub(super) keys: Vec<Key>,
}

/// A key with its value and why it has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) name: &'static str,
    /// As TOML writes it.
    pub(super) value: String,
    pub(super) reasons: Vec<String>,
    /// Set where a person must decide; the key is then a comment.
    pub(super) question: Option<String>,
}

impl Key {
    pub(super) fn decided(name: &'static str, value: impl Into<String>) -> Self {
        Self { name, value: value.into(), reasons: Vec::new(), question: None }
    }

    pub(super) fn because(mut self, reason: &str) -> Self {
        self.reasons.push(reason.to_owned());
        self
    }

    fn asked(mut self, question: &str) -> Self {
        self.question = Some(question.to_owned());
        self
    }
}

/// Columns of one quantity, one a joint.
#[derive(Debug, Clone, PartialEq)]
struct Found<'h> {
    /// Where they stand in the export.
    columns: Vec<usize>,
    /// Key and value of the layout.
    key: (&'static str, String),
    said: Said,
    /// `[n][rows]`
    values: Vec<&'h [f64]>,
    why: String,
}

/// The columns of all joints.
struct Joints<'h> {
    position: Option<Found<'h>>,
    velocity: Option<Found<'h>>,
    torque: Option<Found<'h>>,
    count: usize,
}

impl Joints<'_> {
    fn has(&self, column: usize) -> bool {
        let all = [&self.position, &self.velocity, &self.torque];
        all.into_iter().flatten().any(|found| found.columns.contains(&column))
    }
}

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
    sections.push(torque_section(&joints));
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

fn values(column: &HeadColumn) -> Option<&[f64]> {
    column.values.as_deref()
}

fn by_name<'h>(head: &'h Head, robot: Option<&Robot>) -> Joints<'h> {
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
    let count = robot.map_or_else(
        || of(Kind::Position).map(|(group, _)| group.columns.len()).max().unwrap_or(0),
        Robot::joint_count,
    );
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
fn by_place<'h>(head: &'h Head, hints: Hints<'_>) -> Joints<'h> {
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

fn time_column<'h>(head: &'h Head, joints: &Joints<'_>) -> Option<(usize, &'h [f64])> {
    let free = head.columns.iter().enumerate().filter(|(at, _)| !joints.has(*at));
    let candidates: Vec<(usize, &HeadColumn, &[f64])> =
        free.filter_map(|(at, column)| Some((at, column, values(column)?))).collect();
    let is_time = |column: &HeadColumn| names::said(&column.name, &column.under).kind == Some(Kind::Time);
    let by_name = candidates.iter().find(|(_, column, values)| is_time(column) && nearly_rises(values));
    let by_numbers = || candidates.iter().find(|(.., values)| rises(Some(values)));
    by_name.or_else(by_numbers).map(|(at, _, values)| (*at, *values))
}

struct Slopes {
    overall: Option<Slope>,
    /// Of each joint.
    each: Vec<Option<Slope>>,
}

fn slopes(joints: &Joints<'_>, time: Option<&[f64]>) -> Slopes {
    let (Some(position), Some(velocity)) = (&joints.position, &joints.velocity) else {
        return Slopes { overall: None, each: Vec::new() };
    };
    let each = position.values.iter().zip(&velocity.values);
    Slopes {
        overall: units::joint_slope(&position.values, &velocity.values, time),
        each: each.map(|(position, velocity)| units::slope(position, velocity, time)).collect(),
    }
}

/// Units that were found, and what they were found by.
struct Units {
    choices: Vec<Choice>,
    known: Known,
    figures: Figures,
    /// Positions are beyond the arm's limits in any unit.
    beyond_limits: bool,
}

fn decide_units(
    head: &Head,
    joints: &Joints<'_>,
    time: Option<(usize, &[f64])>,
    slopes: &Slopes,
    robot: Option<&Robot>,
) -> Units {
    let unit = |found: &Option<Found<'_>>, allowed: &[units::Unit]| {
        let said = found.as_ref()?.said.unit?;
        allowed.iter().find(|(name, _)| *name == said).map(|(name, _)| *name)
    };
    let of_time = time.and_then(|(column, _)| {
        let column = &head.columns[column];
        let said = names::said(&column.name, &column.under).unit;
        if column.timestamps {
            Some("s")
        } else {
            said.filter(|said| units::TIME.iter().any(|(u, _)| u == said))
        }
    });
    let known = Known {
        position: unit(&joints.position, &units::POSITION),
        velocity: unit(&joints.velocity, &units::VELOCITY),
        time: of_time,
    };
    let most = |found: &Found<'_>| units::largest(found.values.iter().copied().flatten());
    let limit = |robot: &Robot| {
        let limits = robot.joints.iter().map(|joint| &joint.limits);
        limits.fold(0.0_f64, |most, limit| most.max(limit.position_min.abs()).max(limit.position_max.abs()))
    };
    let mut figures = Figures {
        position: joints.position.as_ref().map_or(0.0, most),
        velocity: joints.velocity.as_ref().map(most),
        step: time.and_then(|(_, values)| units::median_step(values)),
        slope: slopes.overall,
        limit: robot.map(limit),
        is_motor: joints.position.as_ref().is_some_and(|found| found.said.is_motor),
    };
    let choices = units::choices(known, figures);
    if choices.is_empty() && !figures.is_motor && robot.is_some() {
        figures.is_motor = true;
        let choices = units::choices(known, figures);
        let beyond_limits = !choices.is_empty();
        return Units { choices, known, figures, beyond_limits };
    }
    Units { choices, known, figures, beyond_limits: false }
}

impl Units {
    fn choice(&self) -> Option<Choice> {
        self.choices.first().copied()
    }

    /// Why a unit is what it is, where the name does not say.
    fn by_numbers(&self) -> String {
        let Some(Choice { position, velocity, time }) = self.choice() else { return String::new() };
        match (self.figures.slope, self.figures.velocity) {
            (Some(slope), _) => format!(
                "velocity is {:.4} times the change of position over that of time (in {:.0} % of places): as {} over \
                 {} and {} would be; positions reach {:.4}",
                slope.ratio.abs(),
                100.0 * slope.agreement,
                velocity.0,
                position.0,
                time.0,
                self.figures.position
            ),
            (None, _) => format!("positions reach {:.4}", self.figures.position),
        }
    }
}

impl Units {
    /// Other units of position that would go as well, said behind the reason for the first.
    fn alternatives(&self) -> String {
        let Some(first) = self.choice() else { return String::new() };
        let mut others: Vec<&str> = self.choices.iter().map(|choice| choice.position.0).collect();
        others.retain(|unit| *unit != first.position.0);
        others.dedup();
        match others.is_empty() {
            true => String::new(),
            false => format!("; {} would go as well and is less usual", others.join(" or ")),
        }
    }
}

/// A number with three digits that count.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = 10_f64.powi(2 - value.abs().log10().floor() as i32);
    (value * digits).round() / digits
}

fn time_section(
    head: &Head,
    time: Option<(usize, &[f64])>,
    units: &Units,
    slope: Option<Slope>,
    hints: Hints<'_>,
) -> Section {
    let mut section = Section { title: Some("time"), ..Section::default() };
    let Some((at, values)) = time else {
        section.keys.push(sample_rate(slope, hints));
        return section;
    };
    let column = &head.columns[at];
    section.keys.push(Key::decided("column", column_name(head, at)).because("it rises from row to row"));
    if column.timestamps {
        section.keys.push(Key::decided("unit", quoted("timestamp")).because("its cells are dates and times"));
        return section;
    }
    let step = units.figures.step.unwrap_or(0.0);
    match (units.known.time, units.choice(), slope) {
        (Some(unit), ..) => {
            section.keys.push(Key::decided("unit", quoted(unit)).because("the name says so"));
        }
        (None, Some(choice), Some(_)) if choice.time.0 == units::TICKS => {
            let reason = format!(
                "no unit of time goes with the velocities; they are the change of position over {:.6} s a count",
                choice.time.1
            );
            section.keys.push(Key::decided("unit", quoted(units::TICKS)).because(&reason));
            section.keys.push(Key::decided("tick_s", rounded(choice.time.1).to_string()));
        }
        (None, Some(choice), _) if slope.is_some() || step != 1.0 => {
            let reason = format!(
                "rows are {} apart, {:.4} Hz; {}",
                rounded(step),
                1.0 / (step * choice.time.1),
                units.by_numbers()
            );
            section.keys.push(Key::decided("unit", quoted(choice.time.0)).because(&reason));
        }
        _ => {
            let question =
                format!("rows are {step} apart: in which unit? s, ms, us, ns, or ticks with tick_s");
            section.keys.push(Key::decided("unit", quoted("ms")).asked(&question));
        }
    }
    section.keys.extend(wrap(values));
    section
}

fn sample_rate(slope: Option<Slope>, hints: Hints<'_>) -> Key {
    match (hints.sample_rate, slope) {
        (Some(rate), _) => Key::decided("sample_rate_hz", format!("{rate:?}")).because("as it was given"),
        (None, Some(slope)) if SAMPLE_RATES.contains(&slope.ratio.abs()) => {
            let rate = rounded(slope.ratio.abs());
            let reason =
                "no column rises; velocities are the change of position from row to row at this rate";
            Key::decided("sample_rate_hz", format!("{rate:?}")).because(reason)
        }
        (None, _) => Key::decided("sample_rate_hz", "250.0")
            .asked("no column rises from row to row: how many rows are there a second?"),
    }
}

/// Where the counter of a time that falls begins anew.
fn wrap(values: &[f64]) -> Option<Key> {
    let (before, after) = values.windows(2).map(|pair| (pair[0], pair[1])).find(|(a, b)| a >= b)?;
    let periods = [1_u64 << 16, 1 << 31, 1 << 32];
    let period = periods.into_iter().find(|period| before < *period as f64 && before > 0.9 * *period as f64);
    let reason = format!("it falls from {before} to {after}");
    let key = Key::decided("wraps_at", period.unwrap_or(1 << 32).to_string()).because(&reason);
    Some(match period {
        Some(_) => key,
        None => key.asked("is this a counter that began anew, and after how many?"),
    })
}

fn joint_question(title: &'static str, count: usize) -> Section {
    let names = if count == 0 { "no name of a column says so" } else { "no name of as many columns says so" };
    let question =
        format!("which columns hold the {title}s? {names}; --robot helps where columns have no names");
    let key = Key::decided("columns", "[2, 3, 4, 5, 6, 7]").asked(&question);
    Section { title: Some(title), comments: Vec::new(), keys: vec![key] }
}

fn position_section(joints: &Joints<'_>, units: &Units) -> Section {
    let Some(found) = &joints.position else { return joint_question("position", joints.count) };
    let mut keys = vec![Key::decided(found.key.0, found.key.1.clone()).because(&found.why)];
    keys.push(match (units.known.position, units.choice()) {
        (Some(unit), _) => Key::decided("unit", quoted(unit)).because("the name gives it"),
        (None, Some(choice)) => Key::decided("unit", quoted(choice.position.0))
            .because(&(units.by_numbers() + &units.alternatives())),
        (None, None) => Key::decided("unit", quoted("rad")).asked(&format!(
            "positions reach {:.4}: rad, deg or rev? No unit goes with the limits and velocities",
            units.figures.position
        )),
    });
    if found.said.is_motor || units.beyond_limits {
        let reason = match units.beyond_limits {
            true => "positions are far beyond the arm's limits in any unit: motors turn so",
            false => "the name says motor",
        };
        keys.push(Key::decided("side", quoted("motor")).because(reason));
    }
    Section { title: Some("position"), comments: Vec::new(), keys }
}

fn velocity_section(joints: &Joints<'_>, units: &Units, slopes: &Slopes) -> Option<Section> {
    let found = joints.velocity.as_ref()?;
    let mut keys = vec![Key::decided(found.key.0, found.key.1.clone()).because(&found.why)];
    keys.push(match (units.known.velocity, units.choice()) {
        (Some(unit), _) => Key::decided("unit", quoted(unit)).because("the name gives it"),
        (None, Some(choice)) => Key::decided("unit", quoted(choice.velocity.0)).because(&units.by_numbers()),
        (None, None) => Key::decided("unit", quoted("rad/s")).asked(&format!(
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
        let reason = "these velocities are against the change of position";
        keys.push(Key::decided("sign", format!("[{}]", signs.join(", "))).because(reason));
    }
    Some(Section { title: Some("velocity"), comments: Vec::new(), keys })
}

fn torque_section(joints: &Joints<'_>) -> Section {
    let Some(found) = &joints.torque else { return joint_question("torque", joints.count) };
    let most = units::largest(found.values.iter().copied().flatten());
    let unit = match (found.said.unit, found.said.kind) {
        (Some(unit @ ("Nm" | "N" | "A" | "mA" | "%" | "permille")), _) => {
            Key::decided("unit", quoted(unit)).because("the name gives it")
        }
        (_, Some(Kind::Current)) => Key::decided("unit", quoted("A"))
            .because(&format!("a current without unit; the largest is {most:.4}")),
        _ => Key::decided("unit", quoted("Nm")).because(&format!(
            "a torque without unit; the largest is {most:.4}. Not % or permille of rated?"
        )),
    };
    let needs_gain = !unit.value.contains('N');
    let mut keys = vec![Key::decided(found.key.0, found.key.1.clone()).because(&found.why), unit];
    if needs_gain {
        keys[1]
            .reasons
            .push("the robot's description must turn it into torque: docs/torque-sources.md".into());
    }
    if found.said.is_motor {
        keys.push(Key::decided("side", quoted("motor")).because("the name says motor"));
    }
    Section { title: Some("torque"), comments: Vec::new(), keys }
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

/// A column as a layout names it.
fn column_name(head: &Head, at: usize) -> String {
    let names: Vec<&str> = head.columns.iter().map(|column| column.name.as_str()).collect();
    if head.header { reference(&names, at) } else { (at + 1).to_string() }
}

fn stage_section(head: &Head, joints: &Joints<'_>, signals: &Signals) -> Section {
    let mut section = Section { title: Some("stage"), ..Section::default() };
    let signal = signals.stage.and_then(|(at, named)| Some((at, named, values(&head.columns[at])?)));
    let Some((at, named, signal)) = signal else {
        let reason = "no column of few whole numbers is a stage signal: all rows are taken as excitation. A column \
                      that tells the stages goes here by name, with the values of each";
        section.keys.push(Key::decided("whole_recording", quoted("excitation")).because(reason));
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
        Key::decided("column", column_name(head, at)).because(&format!("{why}; it has {}", seen.join("; "))),
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

fn meaning_keys(meaning: Option<Meaning>, alphabet: &[i64], reason: &str) -> Vec<Key> {
    let list =
        |values: &[i64]| format!("[{}]", values.iter().map(i64::to_string).collect::<Vec<_>>().join(", "));
    match meaning {
        Some(meaning) => vec![
            Key::decided("between", list(&meaning.between)).because(reason),
            Key::decided("excitation", list(&meaning.excitation)),
            Key::decided("friction", list(&meaning.friction)),
            Key::decided("warming", list(&meaning.warming)),
        ],
        None => {
            let question = format!("which of {} means what? The motion does not tell", list(alphabet));
            let ask = |name| Key::decided(name, "[]").asked(&question);
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
            Key::decided(name, column_name(head, at?))
                .because("the name says so, and it holds whole numbers"),
        )
    };
    let keys: Vec<Key> = columns.into_iter().filter_map(key).collect();
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
