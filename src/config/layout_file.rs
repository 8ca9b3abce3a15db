//! Layouts of exports: `config/exports/*.toml` to [`Layout`].

use std::path::Path;

use super::files;
use super::limits::Limits;
use super::problem::ConfigErrors;
use super::reader::{Table, Value, read_document};
use super::{Layout, MotorSide, ScaledColumn, StageSignal, StageSource, TimeSource};
use crate::run::Stage;

/// Stands for the joint's number, from 1, in the name of a column.
const JOINT: &str = "{joint}";

/// A unit as files name it and its factor to SI.
type Unit = (&'static str, f64);

const DEG: f64 = std::f64::consts::PI / 180.0;
const TIME: &[Unit] = &[("s", 1.0), ("ms", 1e-3)];
const POSITION: &[Unit] = &[("rad", 1.0), ("deg", DEG), ("m", 1.0)];
const VELOCITY: &[Unit] = &[("rad/s", 1.0), ("deg/s", DEG), ("m/s", 1.0)];
const TORQUE: &[Unit] = &[("Nm", 1.0), ("N", 1.0)];

/// Sample rates of exports that count rows instead of recording time.
const SAMPLE_RATE: Limits = Limits::between(0.1, 1e6, "Hz");

/// Separators between columns that cannot be part of a number.
const DELIMITERS: [&str; 4] = [",", ";", "\t", "|"];

/// Most values of the stage signal that may mean one stage.
const MAX_STAGE_VALUES: usize = 100;

/// Reads a layout from `text`; `file_name` only says where problems are.
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
/// Every problem of the layout at once, or that the file cannot be read.
pub fn read_layout(path: &Path) -> Result<Layout, ConfigErrors> {
    parse_layout(&path.display().to_string(), &files::read_text(path)?)
}

fn read_root(root: &Table<'_>) -> Option<Layout> {
    let mut names = ColumnNames::default();
    let name = root.text("name");
    let delimiter = read_delimiter(root);
    let required = |key| root.required(key).and_then(|value| value.table());
    let header = root.optional("header").map_or(Some(true), |value| value.boolean());
    let time = required("time").and_then(|t| read_time(&t, &mut names));
    let mut motor_side = MotorSide::default();
    let position = required("position").and_then(|t| {
        motor_side.position = read_side(&t)?;
        read_scaled(&t, POSITION, Columns::Joints, &mut names)
    });
    let velocity = root.table("velocity").map(|t| read_scaled(&t, VELOCITY, Columns::Joints, &mut names));
    let torque = required("torque").and_then(|t| {
        motor_side.torque = read_side(&t)?;
        read_scaled(&t, TORQUE, Columns::Joints, &mut names)
    });
    let stage = required("stage").and_then(|t| read_stage_source(&t, &mut names));
    let if_present = root.table("if_present");
    let mut column = |key| {
        let value = if_present.as_ref()?.optional(key)?;
        names.take(&value, Columns::One).map(str::to_owned)
    };
    let (cycle, friction_joint, friction_level) =
        (column("cycle"), column("friction_joint"), column("friction_level"));
    let velocity = match velocity {
        Some(velocity) => Some(velocity?),
        None => None,
    };
    Some(Layout {
        name: name?.to_owned(),
        delimiter: delimiter?,
        header: header?,
        time: time?,
        position: position?,
        velocity,
        torque: torque?,
        stage: stage?,
        motor_side,
        cycle,
        friction_joint,
        friction_level,
    })
}

/// How often a name holds a place for the joint's number, as it is or with something added to it.
fn joint_places(name: &str) -> usize {
    let with_sum = |rest: &str| {
        let (digits, _) = rest.split_once('}').unwrap_or(("", ""));
        !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit())
    };
    let sums = name.match_indices("{joint+").filter(|(at, opening)| with_sum(&name[at + opening.len()..]));
    name.matches(JOINT).count() + sums.count()
}

fn read_time<'d>(table: &Table<'d>, names: &mut ColumnNames<'d>) -> Option<TimeSource> {
    match table.optional("sample_rate_hz") {
        Some(value) => value.number(&SAMPLE_RATE).map(TimeSource::SampleRate),
        None => read_scaled(table, TIME, Columns::One, names).map(TimeSource::Column),
    }
}

/// Whether a channel is recorded on the motor's side.
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

fn read_stage_source<'d>(table: &Table<'d>, names: &mut ColumnNames<'d>) -> Option<StageSource> {
    let Some(value) = table.optional("whole_recording") else {
        return read_stage(table, names).map(StageSource::Signal);
    };
    let given = value.text()?;
    let found = Stage::ANALYSED.into_iter().find(|stage| stage.name() == given);
    if found.is_none() {
        value.refuse("must be \"excitation\", \"friction\" or \"warming\"".into(), None);
    }
    found.map(StageSource::Whole)
}

/// Whether a name stands for one column or for one a joint.
#[derive(Clone, Copy, PartialEq)]
enum Columns {
    One,
    Joints,
}

/// Names given so far, so that no column is read twice.
#[derive(Default)]
struct ColumnNames<'d>(Vec<&'d str>);

impl<'d> ColumnNames<'d> {
    fn take(&mut self, value: &Value<'d>, columns: Columns) -> Option<&'d str> {
        let name = value.text()?;
        let problem = match (columns, joint_places(name)) {
            _ if self.0.contains(&name) => Some("this column is already read as something else".to_owned()),
            (Columns::One, 1..) => Some(format!("is one column and must not contain {JOINT}")),
            (Columns::Joints, 0) => {
                Some(format!("must contain {JOINT}, which stands for the joint's number from 1"))
            }
            (Columns::Joints, 2..) => Some(format!("must contain {JOINT} only once")),
            _ => None,
        };
        if let Some(problem) = problem {
            value.refuse(problem, None);
            return None;
        }
        self.0.push(name);
        Some(name)
    }
}

fn read_delimiter(root: &Table<'_>) -> Option<u8> {
    let value = root.required("delimiter")?;
    // Not `text()`: a tab is a delimiter, and looks empty.
    match value.any_text()? {
        text if DELIMITERS.contains(&text) => text.bytes().next(),
        _ => {
            value.refuse("must be one of \",\", \";\", \"\\t\" and \"|\"".into(), None);
            None
        }
    }
}

fn read_scaled<'d>(
    table: &Table<'d>,
    units: &[Unit],
    columns: Columns,
    names: &mut ColumnNames<'d>,
) -> Option<ScaledColumn> {
    let name = table.required("column").and_then(|value| names.take(&value, columns));
    let to_si = table.required("unit").and_then(|value| read_unit(&value, units));
    Some(ScaledColumn { name: name?.to_owned(), to_si: to_si? })
}

fn read_unit(value: &Value<'_>, units: &[Unit]) -> Option<f64> {
    let given = value.text()?;
    let factor = units.iter().find(|(name, _)| *name == given).map(|&(_, factor)| factor);
    if factor.is_none() {
        let known: Vec<_> = units.iter().map(|(name, _)| *name).collect();
        value.refuse(format!("unknown unit, must be one of {}", known.join(", ")), None);
    }
    factor
}

fn read_stage<'d>(table: &Table<'d>, names: &mut ColumnNames<'d>) -> Option<StageSignal> {
    let column = table.required("column").and_then(|value| names.take(&value, Columns::One));
    let mut taken: Vec<(i64, &str)> = Vec::new();
    let mut values = |key| read_stage_values(table, key, &mut taken);
    let (between, excitation) = (values("between"), values("excitation"));
    let (friction, warming) = (values("friction"), values("warming"));
    Some(StageSignal {
        column: column?.to_owned(),
        excitation: excitation?,
        friction: friction?,
        warming: warming?,
        between: between?,
    })
}

fn read_stage_values(table: &Table<'_>, key: &'static str, taken: &mut Vec<(i64, &str)>) -> Option<Vec<i64>> {
    let list = table.required_or_else(key, || Some("write [] if the export has no such rows".into()))?;
    let items = list.items()?;
    if items.len() > MAX_STAGE_VALUES {
        list.refuse(format!("has {} entries, must have at most {MAX_STAGE_VALUES}", items.len()), None);
        return None;
    }
    let mut values = Vec::new();
    for item in &items {
        let value = item.integer(-1_000_000..=1_000_000)?;
        if let Some((_, other)) = taken.iter().find(|(known, _)| *known == value) {
            item.refuse(format!("this value already means {other}"), None);
            return None;
        }
        taken.push((value, key));
        values.push(value);
    }
    if key == "excitation" && values.is_empty() {
        list.refuse("must have an entry: parameters are identified on the excitation stage".into(), None);
        return None;
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NATIVE: &str = include_str!("../../config/exports/native.toml");

    #[test]
    fn the_native_layout_is_the_one_that_users_hold_on_to() {
        let layout = parse_layout("native.toml", NATIVE).expect("no problems");
        assert_eq!((layout.name.as_str(), layout.delimiter), ("native", b','));
        let TimeSource::Column(time) = &layout.time else { panic!("{:?}", layout.time) };
        let columns = [Some(time), Some(&layout.position), layout.velocity.as_ref(), Some(&layout.torque)];
        let names: Vec<_> = columns.iter().flatten().map(|c| (c.name.as_str(), c.to_si)).collect();
        assert_eq!(names, [("time", 1.0), ("pos_{joint}", 1.0), ("vel_{joint}", 1.0), ("trq_{joint}", 1.0)]);
        let StageSource::Signal(stage) = &layout.stage else { panic!("{:?}", layout.stage) };
        assert_eq!(stage.column, "stage");
        assert_eq!((&stage.between[..], &stage.excitation[..]), (&[0][..], &[1][..]));
        assert_eq!((&stage.friction[..], &stage.warming[..]), (&[2][..], &[3][..]));
        let optional = [&layout.cycle, &layout.friction_joint, &layout.friction_level];
        assert_eq!(optional.map(|c| c.as_deref()), [Some("cycle"), Some("joint"), Some("level")]);
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
        let time = TimeSource::Column(ScaledColumn { name: "time".into(), to_si: 1e-3 });
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
}
