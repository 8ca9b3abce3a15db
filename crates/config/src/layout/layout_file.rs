//! Layouts of exports: `config/exports/*.toml` to [`Layout`].

use std::path::Path;

use super::channels::{
    BLANKS, Channel, JointDelays, JointSigns, Layout, MotorSide, RowRule, TimeSource, TorqueQuantity,
};
use super::column::{Column, JointColumns};
use super::column_names::{ColumnNames, NamedUnit, named_unit, read_unit};
use super::parts::PartMatch;
use super::stage_source::read_stage_source;
use super::{layout_time, parts, temperature, text_format};
use crate::toml::files;
use crate::toml::problem::ConfigErrors;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value, read_document};
use armwatch_model::robot::{JointIndex, MAX_JOINTS};
use armwatch_model::run::slower::{Slower, SlowerChannels};

const DEG: f64 = std::f64::consts::PI / 180.0;
const REV: f64 = std::f64::consts::TAU;
const POSITION: &[NamedUnit] = &[("rad", 1.0), ("deg", DEG), ("rev", REV), ("m", 1.0)];
const VELOCITY: &[NamedUnit] =
    &[("rad/s", 1.0), ("deg/s", DEG), ("rev/s", REV), ("rpm", REV / 60.0), ("m/s", 1.0)];
/// Drives after CiA 402 give torque and current in thousandths of the rated one.
const TORQUE: &[NamedUnit] =
    &[("Nm", 1.0), ("N", 1.0), ("A", 1.0), ("mA", 1e-3), ("%", 1e-2), ("permille", 1e-3)];

/// Largest delay of a channel, caused by a drive's filter or a slow bus, in either direction.
const DELAY: Limits = Limits::within(0.5, "s");

/// Separators between columns that cannot be part of a number.
const DELIMITERS: [&str; 4] = [",", ";", "\t", "|"];

/// Most bad rows that a layout may skip; an export with more is broken, or has another layout.
const MAX_BAD_ROWS: i64 = 100_000;

/// Units of a layout's columns, by their names in its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LayoutUnits {
    /// Unit of the time column; `None` if rows are counted.
    pub time: Option<&'static str>,
    /// Unit of positions.
    pub position: &'static str,
    /// Unit of velocities.
    pub velocity: Option<&'static str>,
    /// Unit of torques.
    pub torque: &'static str,
}

/// The units of the columns that `layout` reads. A prismatic joint's units have the names of a revolute one's if both
/// are SI.
pub fn layout_units(layout: &Layout) -> LayoutUnits {
    let torque: &[NamedUnit] = match layout.torque_quantity {
        TorqueQuantity::Torque => &TORQUE[..2],
        TorqueQuantity::Current => &TORQUE[2..4],
        TorqueQuantity::FractionOfRated => &TORQUE[4..],
    };
    LayoutUnits {
        time: layout_time::unit_of(&layout.time),
        position: unit_name(POSITION, layout.position.to_si),
        velocity: layout.velocity.as_ref().map(|velocity| unit_name(VELOCITY, velocity.to_si)),
        torque: unit_name(torque, layout.torque.to_si),
    }
}

fn unit_name(units: &[NamedUnit], to_si: f64) -> &'static str {
    named_unit(units, to_si).unwrap_or("its own unit")
}

/// Reads a layout from `text`; `file_name` is only used in problems.
///
/// # Errors
///
/// Every problem of the layout at once.
pub fn parse_layout(file_name: &str, text: &str) -> Result<Layout, ConfigErrors> {
    read_document(file_name, text, read_root)
}

/// Reads a layout from the file at `path`.
///
/// # Errors
///
/// Every problem of the layout at once, or a failed read.
pub fn read_layout(path: &Path) -> Result<Layout, ConfigErrors> {
    parse_layout(&path.display().to_string(), &files::read_text(path)?)
}

fn read_root(root: &Table<'_>) -> Option<Layout> {
    let mut names = ColumnNames::default();
    let name = root.text("name");
    let delimiter = read_delimiter(root);
    let text = text_format::read(root);
    let rows = root.table("rows").map_or(Some(RowRule::default()), |table| read_rows(&table));
    let parts = root.table("parts").map(|table| (parts::read(&table), table));
    let required = |key| root.required(key).and_then(|value| value.table());
    let header = root.optional("header").map_or(Some(true), |value| value.boolean());
    let time = required("time").and_then(|t| layout_time::read(&t, &mut names));
    let start = root.table("start").map(|table| layout_time::read_start(&table));
    let mut motor_side = MotorSide::default();
    let position = required("position").and_then(|t| {
        if t.optional("recorded").map_or(Some(true), |value| value.boolean())? {
            motor_side.position = read_side(&t)?;
            return read_channel(&t, POSITION, &mut names);
        }
        Some(Channel {
            columns: JointColumns::NotRecorded,
            to_si: 1.0,
            sign: JointSigns::All(1.0),
            delay: JointDelays::default(),
        })
    });
    let mut slower = SlowerChannels::default();
    let velocity = root.table("velocity").map(|t| {
        slower.velocity = read_slower(&t)?;
        read_late_channel(&t, VELOCITY, &mut names)
    });
    let mut torque_quantity = TorqueQuantity::Torque;
    let mut without_torque = Vec::new();
    let torque = required("torque").and_then(|t| {
        motor_side.torque = read_side(&t)?;
        torque_quantity = read_quantity(&t);
        slower.torque = read_slower(&t)?;
        without_torque = read_without_torque(&t)?;
        let mut torque = read_late_channel(&t, TORQUE, &mut names)?;
        if let JointColumns::Each(columns) = &mut torque.columns {
            // the list names the others; this column is never searched
            without_torque
                .iter()
                .for_each(|joint| columns.insert(joint.index().min(columns.len()), Column::Number(0)));
        }
        Some(torque)
    });
    let motor_temperature = root.table("motor_temperature").map(|t| temperature::read_motor(&t, &mut names));
    let ambient_temperature =
        root.table("ambient_temperature").map(|t| temperature::read_ambient(&t, &mut names));
    let stage = required("stage").and_then(|t| read_stage_source(&t, &mut names));
    if position.as_ref().is_some_and(|position| position.columns == JointColumns::NotRecorded)
        && stage.as_ref().is_some_and(|stage| stage.kind().needs_positions())
    {
        let hint = "name a column of the stages, or write whole_recording under [stage]";
        root.refuse(
            "stages cannot come from the motion if positions are not recorded".into(),
            Some(hint.into()),
        );
        return None;
    }
    let if_present = root.table("if_present");
    let mut column = |key| {
        let value = if_present.as_ref()?.optional(key)?;
        names.take(&value)
    };
    let (cycle, friction_joint, friction_level) =
        (column("cycle"), column("friction_joint"), column("friction_level"));
    let velocity = match velocity {
        Some(velocity) => Some(velocity?),
        None => None,
    };
    let start = match start {
        Some(start) => Some(start?),
        None => None,
    };
    let parts = match parts {
        Some((rule, table)) => {
            let rule = rule?;
            let has_numbers = matches!(time, Some(TimeSource::Column(_)));
            if rule.matching == PartMatch::Time && !has_numbers {
                let hint = "match rows by number: match = \"row\"";
                table.refuse(
                    "rows can match by time only if time is a column of numbers".into(),
                    Some(hint.into()),
                );
                return None;
            }
            Some(rule)
        }
        None => None,
    };
    Some(Layout {
        name: name?.to_owned(),
        delimiter: delimiter?,
        text: text?,
        rows: rows?,
        parts,
        header: header?,
        time: time?,
        start,
        position: position?,
        velocity,
        torque: torque?,
        without_torque,
        slower,
        torque_quantity,
        motor_temperature: motor_temperature.flatten(),
        ambient_temperature: ambient_temperature.flatten(),
        stage: stage?,
        motor_side,
        cycle,
        friction_joint,
        friction_level,
    })
}

/// Reads which rows may be skipped.
fn read_rows(table: &Table<'_>) -> Option<RowRule> {
    let skip_bad = table.optional("skip_bad").map_or(Some(0), |value| value.integer(0..=MAX_BAD_ROWS))?;
    Some(RowRule { skip_bad: u64::try_from(skip_bad).ok()? })
}

/// Returns true if a channel is recorded on the motor's side.
fn read_side(table: &Table<'_>) -> Option<bool> {
    let Some(value) = table.optional("side") else { return Some(false) };
    match value.text()? {
        "joint" => Some(false),
        "motor" => Some(true),
        _ => {
            value.refuse("must be \"joint\" or \"motor\"".into(), None);
            None
        }
    }
}

fn read_delimiter(root: &Table<'_>) -> Option<u8> {
    let value = root.required("delimiter")?;
    // Not `text()`: a tab is a delimiter, but counts as empty.
    match value.any_text()? {
        text if DELIMITERS.contains(&text) => text.bytes().next(),
        "blank" => Some(BLANKS),
        _ => {
            value.refuse("must be one of \",\", \";\", \"\\t\", \"|\" and \"blank\"".into(), None);
            None
        }
    }
}

fn read_channel(table: &Table<'_>, units: &[NamedUnit], names: &mut ColumnNames) -> Option<Channel> {
    let columns = names.take_joints(table);
    let to_si = table.required("unit").and_then(|value| read_unit(&value, units));
    let sign = table.optional("sign").map_or(Some(JointSigns::All(1.0)), |value| read_sign(&value));
    Some(Channel { columns: columns?, to_si: to_si?, sign: sign?, delay: JointDelays::default() })
}

/// A channel that may be recorded later than the positions.
fn read_late_channel(table: &Table<'_>, units: &[NamedUnit], names: &mut ColumnNames) -> Option<Channel> {
    let delay = match table.optional("delay_s") {
        None => Some(JointDelays::default()),
        Some(value) if value.is_array() => value.numbers(None, &DELAY).map(JointDelays::Each),
        Some(value) => value.number(&DELAY).map(JointDelays::All),
    };
    let channel = read_channel(table, units, names)?;
    Some(Channel { delay: delay?, ..channel })
}

/// Reads if a channel may have rows without a value, and which value they get.
fn read_slower(table: &Table<'_>) -> Option<Option<Slower>> {
    let Some(value) = table.optional("slower") else { return Some(None) };
    match value.text()? {
        "hold" => Some(Some(Slower::Hold)),
        "resample" => Some(Some(Slower::Resample)),
        _ => {
            value.refuse("must be \"hold\" or \"resample\"".into(), None);
            None
        }
    }
}

fn read_sign(value: &Value<'_>) -> Option<JointSigns> {
    let one = |value: &Value<'_>| {
        let sign = value.integer(-1..=1)?;
        if sign == 0 {
            value.refuse("must be 1 or -1".into(), None);
        }
        (sign != 0).then_some(sign as f64)
    };
    if !value.is_array() {
        return one(value).map(JointSigns::All);
    }
    let signs: Vec<_> = value.items()?.iter().map(one).collect();
    signs.into_iter().collect::<Option<_>>().map(JointSigns::Each)
}

/// Joints whose torque is not recorded, in their order.
fn read_without_torque(table: &Table<'_>) -> Option<Vec<JointIndex>> {
    let Some(value) = table.optional("not_recorded") else { return Some(Vec::new()) };
    let most = i64::try_from(MAX_JOINTS).ok()?;
    let joint = |item: &Value<'_>| JointIndex::from_number(usize::try_from(item.integer(1..=most)?).ok()?);
    let mut joints: Vec<JointIndex> = value.items()?.iter().map(joint).collect::<Option<_>>()?;
    joints.sort_unstable();
    joints.dedup();
    Some(joints)
}

/// Quantity of a torque column by its unit; a wrong unit is refused where its factor is read.
fn read_quantity(table: &Table<'_>) -> TorqueQuantity {
    match table.optional("unit").and_then(|value| value.peek_text()) {
        Some("A" | "mA") => TorqueQuantity::Current,
        Some("%" | "permille") => TorqueQuantity::FractionOfRated,
        _ => TorqueQuantity::Torque,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::column::ScaledColumn;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    #[test]
    fn the_native_layout_is_the_one_that_users_hold_on_to() {
        let layout = parse_layout("native.toml", NATIVE).expect("no problems");
        assert_eq!((layout.name.as_str(), layout.delimiter), ("native", b','));
        let TimeSource::Column(time) = &layout.time else { panic!("{:?}", layout.time) };
        assert_eq!((time.column.to_string().as_str(), time.to_si), ("time", 1.0));
        let pattern = |name: &str| Channel {
            delay: JointDelays::default(),
            columns: JointColumns::Pattern(name.into()),
            to_si: 1.0,
            sign: JointSigns::All(1.0),
        };
        assert_eq!(layout.position, pattern("pos_{joint}"));
        assert_eq!(layout.velocity, Some(pattern("vel_{joint}")));
        assert_eq!(
            (&layout.torque, layout.torque_quantity),
            (&pattern("trq_{joint}"), TorqueQuantity::Torque)
        );
        let crate::StageSource::Signal(stage) = &layout.stage else { panic!("{:?}", layout.stage) };
        assert_eq!(stage.column, Column::Name("stage".into()));
        assert_eq!((&stage.between[..], &stage.excitation[..]), (&[0][..], &[1][..]));
        assert_eq!((&stage.friction[..], &stage.warming[..]), (&[2][..], &[3][..]));
        let optional = [&layout.cycle, &layout.friction_joint, &layout.friction_level];
        let names = optional.map(|c| c.as_ref().map(Column::to_string));
        assert_eq!(names, ["cycle", "joint", "level"].map(|name| Some(name.to_owned())));
    }

    #[test]
    fn foreign_units_become_factors_and_velocity_may_be_missing() {
        let text = NATIVE
            .replace("[velocity]\ncolumn = \"vel_{joint}\"\nunit = \"rad/s\"\n", "")
            .replace("unit = \"rad\"", "unit = \"deg\"")
            .replace("unit = \"s\"", "unit = \"ms\"")
            .replace("delimiter = \",\"", "delimiter = \"\\t\"");
        let layout = parse_layout("foreign.toml", &text).expect("no problems");
        assert_eq!(layout.velocity, None);
        assert_eq!(layout.position.to_si, 1.0_f64.to_radians());
        let time = TimeSource::Column(ScaledColumn { column: Column::Name("time".into()), to_si: 1e-3 });
        assert_eq!((&layout.time, layout.delimiter), (&time, b'\t'));
    }

    #[test]
    fn a_column_that_is_read_twice_and_a_value_with_two_meanings_are_refused() {
        let text =
            NATIVE.replace("\"trq_{joint}\"", "\"pos_{joint}\"").replace("warming = [3]", "warming = [2]");
        let errors = parse_layout("twice.toml", &text).expect_err("two problems");
        let keys: Vec<_> = errors.0.iter().map(|p| p.key.as_str()).collect();
        assert_eq!(keys, ["torque.column", "stage.warming[1]"]);
        assert!(errors.0[1].problem.contains("already means friction"), "{errors}");
    }

    #[test]
    fn a_log_without_positions_says_so() {
        let text = NATIVE.replace("column = \"pos_{joint}\"\nunit = \"rad\"", "recorded = false");
        let layout = parse_layout("log.toml", &text).expect("no problems");
        assert_eq!(layout.position.columns, JointColumns::NotRecorded);
        let errors = parse_layout("log.toml", &text.replace("recorded = false", "")).expect_err("forgotten");
        assert!(errors.to_string().contains("position.column or columns: is missing"), "{errors}");
        let beside =
            parse_layout("log.toml", &text.replace("recorded = false", "recorded = false\nunit = \"rad\""));
        assert!(beside.expect_err("of what?").to_string().contains("position.unit: unknown key"));
    }

    #[test]
    fn late_channels_have_a_delay_for_all_joints_or_for_each() {
        let of = |keys: &str| {
            let text = NATIVE.replace("unit = \"Nm\"", &format!("unit = \"Nm\"\n{keys}"));
            parse_layout("late.toml", &text).map(|layout| layout.torque.delay).map_err(|e| e.to_string())
        };
        assert_eq!(of(""), Ok(JointDelays::All(0.0)));
        assert_eq!(of("delay_s = 0.012"), Ok(JointDelays::All(0.012)));
        let each = [0.0, 0.01, 0.01, 0.0, -0.002, 0.0];
        assert_eq!(of(&format!("delay_s = {each:?}")), Ok(JointDelays::Each(each.to_vec())));
        assert!(of("delay_s = 12").expect_err("ms").contains("must be between -0.5 and 0.5 s"));
        let of_positions = NATIVE.replace("unit = \"rad\"", "unit = \"rad\"\ndelay_s = 0.01");
        let errors =
            parse_layout("late.toml", &of_positions).expect_err("positions are what others are late to");
        assert!(errors.to_string().contains("position.delay_s: unknown key"), "{errors}");
    }

    #[test]
    fn columns_go_by_name_or_number_and_signs_by_joint() {
        let text = NATIVE
            .replace("column = \"time\"", "column = 1")
            .replace(
                "column = \"pos_{joint}\"\nunit = \"rad\"",
                "columns = [2, \"b\"]\nunit = \"rev\"\nsign = -1",
            )
            .replace("unit = \"rad/s\"", "unit = \"rpm\"\nsign = [1, -1]")
            .replace("unit = \"Nm\"", "unit = \"permille\"\nside = \"motor\"");
        let layout = parse_layout("numbers.toml", &text).expect("no problems");
        let columns = JointColumns::Each(vec![Column::Number(2), Column::Name("b".into())]);
        let tau = std::f64::consts::TAU;
        assert_eq!(
            layout.position,
            Channel { columns, to_si: tau, sign: JointSigns::All(-1.0), delay: JointDelays::default() }
        );
        let velocity = layout.velocity.expect("recorded");
        assert_eq!((velocity.to_si, velocity.sign), (tau / 60.0, JointSigns::Each(vec![1.0, -1.0])));
        assert_eq!((layout.torque.to_si, layout.torque_quantity), (1e-3, TorqueQuantity::FractionOfRated));
        assert!(layout.motor_side.torque && !layout.motor_side.position);
    }
}
