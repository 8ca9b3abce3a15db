//! Maps the columns of an export to channels: the header is matched with a layout, by name, or by number if the layout
//! requires it.

use std::path::Path;

use super::cell::{self, Decimal};
use super::clock::{ClockOrigin, TimeColumn};
use super::fields::fields;
use crate::rejection::Rejection;
use armwatch_config::{
    Channel, Column, DecimalMark, JointColumns, Layout, MotorSide, StageSource, TemperatureUnit, TextTime,
    TimeSource,
};
use armwatch_model::robot::{JointIndex, Robot, name::composed};
use armwatch_model::run::slower::SlowerChannels;

/// Most column names listed in a message.
const LISTED_COLUMNS: usize = 40;

/// Most columns of an export, as many as layouts can number: each is a column of every block.
pub const MAX_COLUMNS: usize = 10_000;

/// Meaning of a column of the export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Not needed; its cells are not checked.
    Ignored,
    /// Time.
    Time,
    /// Position of a joint.
    Position(JointIndex),
    /// Velocity of a joint.
    Velocity(JointIndex),
    /// Torque of a joint.
    Torque(JointIndex),
    /// Stage signal: its column with this index, from 0.
    Stage(usize),
    /// Cycle counter.
    Cycle,
    /// Joint under friction test.
    FrictionJoint,
    /// Speed level of the friction test.
    FrictionLevel,
    /// Temperature of a joint's motor. A cell without a number is a missing measurement.
    MotorTemperature(JointIndex, TemperatureUnit),
    /// Ambient temperature, likewise.
    AmbientTemperature(TemperatureUnit),
}

impl Role {
    /// Unit of a temperature; `None` for all other roles.
    pub fn temperature_unit(self) -> Option<TemperatureUnit> {
        match self {
            Self::MotorTemperature(_, unit) | Self::AmbientTemperature(unit) => Some(unit),
            _ => None,
        }
    }
}

/// Columns and units of the channels of an export.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnMap {
    /// Separator between columns.
    pub delimiter: u8,
    /// Decimal mark of numbers.
    pub decimal: DecimalMark,
    /// Names in the export's order, trimmed.
    pub names: Vec<String>,
    /// Role of each column, in the export's order.
    pub roles: Vec<Role>,
    /// Source of time.
    pub time: TimeColumn,
    /// Form of times in text columns.
    pub text_time: TextTime,
    /// Number that times in a numeric column are relative to, that of the first row; `None` before it is read.
    pub time_origin: Option<Decimal>,
    /// Fields that each row must have: all up to the last column that has a name or is needed.
    pub least_fields: usize,
    /// Column index of each joint's position; empty if none are recorded.
    pub position: Vec<usize>,
    /// Column index of each joint's velocity, where recorded.
    pub velocity: Option<Vec<usize>>,
    /// Column index of each joint's torque, where recorded, `[n]`.
    pub torque: Vec<Option<usize>>,
    /// Column indices of the stage signal, in the order of its columns.
    pub stage: Vec<usize>,
    /// Column index of the cycle counter, where recorded.
    pub cycle: Option<usize>,
    /// Column indices of friction joint and speed level, where both are recorded.
    pub friction: Option<FrictionColumns>,
    /// Column index of each joint's motor temperature, where recorded, `[n]`.
    pub motor_temperature: Vec<Option<usize>>,
    /// Column index of the ambient temperature, if recorded.
    pub ambient_temperature: Option<usize>,
    /// Factors to SI.
    pub to_si: Factors,
    /// Meaning of the stage signal's columns.
    pub stage_source: StageSource,
    /// Channels recorded on the motor's side.
    pub motor_side: MotorSide,
    /// Channels that may have rows without a value, which are NaN then.
    pub slower: SlowerChannels,
    /// Largest speed level; 0 if the description names none, and any is accepted then.
    pub levels: usize,
}

/// Column indices of the friction signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrictionColumns {
    /// Joint under test.
    pub joint: usize,
    /// Speed level.
    pub level: usize,
}

/// Factors from the export's units to SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Factors {
    /// To s.
    pub time: f64,
    /// To rad (m), for each joint, `[n]`.
    pub position: Vec<f64>,
    /// To rad/s (m/s), `[n]`.
    pub velocity: Vec<f64>,
    /// To Nm (N), including currents and percentages of rated torque, `[n]`.
    pub torque: Vec<f64>,
}

impl ColumnMap {
    /// Number of joints `n`.
    pub fn joint_count(&self) -> usize {
        self.torque.len()
    }

    /// Returns true if a cell of this role may be empty.
    pub fn may_be_empty(&self, role: Role) -> bool {
        match role {
            Role::Torque(_) => self.slower.torque.is_some(),
            Role::Velocity(_) => self.slower.velocity.is_some(),
            _ => false,
        }
    }
}

/// Finds the layout's columns in the header line of an export of `robot`.
///
/// Order does not matter and unknown columns are ignored. Names are composed (NFC) and trimmed, and quotes around them
/// are removed. Velocities may be absent altogether, unless a column has a similar name. Cycle, friction joint and
/// level are used if present, the last two only together. Temperatures are used if present, each independently.
///
/// # Errors
/// A rejection at line 1: no header, a column twice, another number of joints than the robot has, no stage signal, or a
/// missing column with its nearest spelling.
pub fn map_columns(
    header: &str,
    layout: &Layout,
    robot: &Robot,
    path: &Path,
) -> Result<ColumnMap, Rejection> {
    if fields(header, layout.delimiter).nth(MAX_COLUMNS).is_some() {
        let reason = format!("a header of more than {MAX_COLUMNS} columns");
        return Err(Rejection::of_file(path, reason, "check the delimiter of the layout").at_line(1));
    }
    let names: Vec<String> = match layout.header {
        true => fields(header, layout.delimiter).map(|name| composed(name).into_owned()).collect(),
        false => (1..=fields(header, layout.delimiter).count()).map(|number| number.to_string()).collect(),
    };
    let factors =
        layout.factors(robot).map_err(|misfit| Rejection::of_file(path, misfit.problem, misfit.remedy))?;
    let search = Search { names: &names, layout, robot, path };
    if layout.header {
        search.refuse_missing_header()?;
        search.refuse_foreign_delimiter()?;
        search.refuse_joint_count()?;
    }

    let time = match &layout.time {
        TimeSource::Column(column) => TimeColumn::Recorded(search.needed(&column.column)?),
        TimeSource::Restarting(column) => TimeColumn::Restarting(search.needed(&column.column)?),
        TimeSource::Counter { column, wraps_at } => {
            TimeColumn::Wrapping { column: search.needed(&column.column)?, period: *wraps_at }
        }
        TimeSource::Text { column, .. } => {
            TimeColumn::Stamped { column: search.needed(column)?, origin: ClockOrigin::default() }
        }
        TimeSource::SampleRate(rate) => TimeColumn::Counted(*rate),
    };
    let position = search.needed_by_joint(&layout.position)?;
    let velocity = match &layout.velocity {
        Some(column) if search.is_recorded(column) => Some(search.needed_by_joint(column)?),
        _ => None,
    };
    let torque = search.torques()?;
    let stage_columns = layout.stage.kind().columns();
    let stage =
        stage_columns.into_iter().map(|column| search.stage(column)).collect::<Result<Vec<_>, _>>()?;
    let cycle = search.optional(layout.cycle.as_ref())?;
    let joint = search.optional(layout.friction_joint.as_ref())?;
    let level = search.optional(layout.friction_level.as_ref())?;
    let friction = joint.zip(level).map(|(joint, level)| FrictionColumns { joint, level });

    let motor_temperature = search.motor_temperatures()?;
    let ambient = layout.ambient_temperature.as_ref();
    let ambient_temperature = search.optional(ambient.map(|ambient| &ambient.column))?;

    let mut roles = vec![Role::Ignored; names.len()];
    let mut twice = None;
    let mut assign = |column: usize, role: Role| {
        if let Some(slot) = roles.get_mut(column) {
            if *slot != Role::Ignored {
                twice = Some(column);
            }
            *slot = role;
        }
    };
    time.column().into_iter().for_each(|column| assign(column, Role::Time));
    for joint in robot.joint_indices() {
        position.get(joint.index()).into_iter().for_each(|column| assign(*column, Role::Position(joint)));
        torque[joint.index()].into_iter().for_each(|column| assign(column, Role::Torque(joint)));
        if let Some(velocity) = &velocity {
            assign(velocity[joint.index()], Role::Velocity(joint));
        }
    }
    for (joint, column) in robot.joint_indices().zip(&motor_temperature) {
        if let (Some(column), Some(motor)) = (column, &layout.motor_temperature) {
            assign(*column, Role::MotorTemperature(joint, motor.unit));
        }
    }
    if let (Some(column), Some(ambient)) = (ambient_temperature, ambient) {
        assign(column, Role::AmbientTemperature(ambient.unit));
    }
    stage.iter().enumerate().for_each(|(place, column)| assign(*column, Role::Stage(place)));
    cycle.into_iter().for_each(|column| assign(column, Role::Cycle));
    if let Some(friction) = friction {
        assign(friction.joint, Role::FrictionJoint);
        assign(friction.level, Role::FrictionLevel);
    }
    // Names in the layout differ, but a number may select the column that another key names.
    if let Some(column) = twice {
        return Err(search
            .rejection(
                "a column that the layout reads twice",
                format!("correct the numbers of columns in layout \"{}\"", layout.name),
            )
            .in_column(&names[column]));
    }
    let needed = |(name, role): (&String, &Role)| !name.is_empty() || *role != Role::Ignored;
    let least_fields = names.iter().zip(&roles).rposition(needed).map_or(0, |last| last + 1);
    Ok(ColumnMap {
        delimiter: layout.delimiter,
        decimal: layout.text.decimal,
        least_fields,
        names,
        roles,
        time,
        text_time: match &layout.time {
            TimeSource::Text { form, .. } => form.clone(),
            _ => TextTime::Timestamp,
        },
        time_origin: None,
        position,
        velocity,
        torque,
        stage,
        cycle,
        friction,
        motor_temperature,
        ambient_temperature,
        to_si: Factors {
            time: layout.time.to_si(),
            position: factors.position,
            velocity: factors.velocity,
            torque: factors.torque,
        },
        stage_source: layout.stage.clone(),
        motor_side: layout.motor_side,
        slower: layout.slower,
        levels: robot.speed_levels.len(),
    })
}

/// Number of columns in a header that the layout names.
pub(super) fn known_columns(header: &str, layout: &Layout, robot: &Robot, path: &Path) -> usize {
    if !layout.header {
        return 0;
    }
    let names: Vec<String> =
        fields(header, layout.delimiter).take(MAX_COLUMNS).map(|name| composed(name).into_owned()).collect();
    let search = Search { names: &names, layout, robot, path };
    names.iter().filter(|name| search.is_named(name)).count()
}

/// Data for all searches in the header.
struct Search<'a> {
    names: &'a [String],
    layout: &'a Layout,
    robot: &'a Robot,
    path: &'a Path,
}

impl Search<'_> {
    fn rejection(&self, reason: impl Into<Box<str>>, remedy: impl Into<Box<str>>) -> Rejection {
        Rejection::of_file(self.path, reason, remedy).at_line(1)
    }

    fn listed(&self) -> String {
        let shown: Vec<&str> = self.names.iter().take(LISTED_COLUMNS).map(String::as_str).collect();
        let more = self.names.len().saturating_sub(LISTED_COLUMNS);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        format!("{}{more}", shown.join(", "))
    }

    fn refuse_missing_header(&self) -> Result<(), Rejection> {
        let mut cells = self.names.iter().filter(|name| !name.is_empty()).peekable();
        if cells.peek().is_some() && !cells.all(|name| cell::number(name, self.layout.text.decimal).is_ok()) {
            return Ok(());
        }
        Err(self.rejection(
            "no header line: the first line holds only numbers",
            format!("export with a line of the column names in layout \"{}\"", self.layout.name),
        ))
    }

    fn refuse_foreign_delimiter(&self) -> Result<(), Rejection> {
        let [only] = self.names else { return Ok(()) };
        let found = [(',', "comma"), (';', "semicolon"), ('\t', "tab"), ('|', "bar")];
        let found = found.iter().find(|(sign, _)| only.contains(*sign)).map(|(_, name)| *name);
        // in a layout's notation for blanks
        let least = 2 * self.robot.joint_count();
        let in_blanks = only.split_whitespace().nth(least).map(|_| "\"blank\"");
        match found.or(in_blanks) {
            Some(name) => Err(self.rejection(
                format!("a header separated by {name}, not by {:?}", char::from(self.layout.delimiter)),
                format!("set the delimiter of layout \"{}\"", self.layout.name),
            )),
            None => Ok(()),
        }
    }

    /// Refuses an export of an arm with another number of joints, which are counted by their position columns.
    fn refuse_joint_count(&self) -> Result<(), Rejection> {
        let JointColumns::Pattern(pattern) = &self.layout.position.columns else { return Ok(()) };
        let Some((before, after)) = pattern.split_once("{joint}") else { return Ok(()) };
        let numbers = self.names.iter().filter_map(|name| {
            name.strip_prefix(before)?.strip_suffix(after)?.parse::<usize>().ok().filter(|n| *n > 0)
        });
        let found = numbers.max().unwrap_or(0);
        let joints = self.robot.joint_count();
        // If there are fewer positions than joints and the torques are complete, a column is missing.
        let torque_of = |joint: usize| {
            self.layout.torque.columns.of_joint(joint).is_some_and(|c| self.find(&c).is_some())
        };
        if found == 0 || found == joints || (found < joints && torque_of(joints)) {
            return Ok(());
        }
        Err(self.rejection(
            format!(
                "wrong joint count: the export has positions for {found} joints, the description of {} has {joints}",
                self.robot.model
            ),
            "give this robot the description and layout of its model in the configuration",
        ))
    }

    fn find(&self, column: &Column) -> Option<usize> {
        match column {
            Column::Name(name) => self.names.iter().position(|n| n == name),
            Column::Number(number) => number.checked_sub(1).filter(|at| *at < self.names.len()),
        }
    }

    /// An optional column, which must not appear twice if it is selected by name.
    fn optional(&self, column: Option<&Column>) -> Result<Option<usize>, Rejection> {
        let Some(column) = column else { return Ok(None) };
        if let Column::Name(name) = column
            && self.names.iter().filter(|n| *n == name).count() > 1
        {
            return Err(self
                .rejection("a column that exists twice", "export each column once")
                .in_column(name));
        }
        Ok(self.find(column))
    }

    fn needed(&self, column: &Column) -> Result<usize, Rejection> {
        self.optional(Some(column))?.ok_or_else(|| {
            let remedy = match column {
                Column::Name(name) => format!(
                    "{}correct the export or layout \"{}\"; the export has {}",
                    self.suggestion(name),
                    self.layout.name,
                    self.listed()
                ),
                Column::Number(_) => format!(
                    "correct the numbers of columns in layout \"{}\"; the export has {} columns",
                    self.layout.name,
                    self.names.len()
                ),
            };
            self.rejection("missing column", remedy).in_column(&column.to_string())
        })
    }

    fn needed_by_joint(&self, channel: &Channel) -> Result<Vec<usize>, Rejection> {
        self.columns(channel).map(|column| self.needed(&column)).collect()
    }

    /// Columns of the torques, for the joints that have one.
    fn torques(&self) -> Result<Vec<Option<usize>>, Rejection> {
        let of_joint =
            |joint| self.layout.torque_column(joint).map(|column| self.needed(&column)).transpose();
        self.robot.joint_indices().map(of_joint).collect()
    }

    /// Columns of the motors' temperatures, for the joints that have one.
    fn motor_temperatures(&self) -> Result<Vec<Option<usize>>, Rejection> {
        let columns = self.layout.motor_temperature.as_ref().map(|motor| &motor.columns);
        (1..=self.robot.joint_count())
            .map(|joint| self.optional(columns.and_then(|columns| columns.of_joint(joint)).as_ref()))
            .collect()
    }

    /// The channel's columns, one per joint.
    fn columns<'c>(&self, channel: &'c Channel) -> impl Iterator<Item = Column> + use<'c> {
        (1..=self.robot.joint_count()).filter_map(|joint| channel.columns.of_joint(joint))
    }

    fn stage(&self, column: &Column) -> Result<usize, Rejection> {
        self.optional(Some(column))?.ok_or_else(|| {
            let name = column.to_string();
            let remedy = format!(
                "{}name the column that distinguishes excitation, friction and warming, and its values, as \
                the stage signal of layout \"{}\"; the export has {}",
                self.suggestion(&name),
                self.layout.name,
                self.listed()
            );
            self.rejection("no stage signal: the column is missing", remedy).in_column(&name)
        })
    }

    /// Returns true if the export seems to record these columns: one exists, or one has a similar name.
    fn is_recorded(&self, channel: &Channel) -> bool {
        self.columns(channel).any(|column| {
            let name = column.to_string();
            self.find(&column).is_some() || self.nearest(&name).is_some_and(|n| edit_distance(n, &name) <= 1)
        })
    }

    /// A question about the column whose name is nearest to `name`; names the character in it that is invisible or
    /// looks like another.
    fn suggestion(&self, name: &str) -> String {
        let Some(nearest) = self.nearest(name) else { return String::new() };
        let odd = nearest.chars().find(|c| !c.is_ascii() && !c.is_alphanumeric());
        let odd = odd.map(|c| format!(" (with {})", cell::unicode_name(c))).unwrap_or_default();
        format!("did you mean {nearest}{odd}? ")
    }

    /// The spelling nearest to `name` among columns that the layout does not name itself.
    fn nearest(&self, name: &str) -> Option<&str> {
        let distance = |other: &str| edit_distance(other, name);
        self.names
            .iter()
            .filter(|other| !other.is_empty() && !self.is_named(other))
            .min_by_key(|other| distance(other))
            .filter(|other| distance(other) <= name.chars().count() / 2)
            .map(String::as_str)
    }

    fn is_named(&self, name: &str) -> bool {
        let layout = self.layout;
        let time = layout.time.column();
        let is = |column: &Column| matches!(column, Column::Name(named) if named == name);
        let single = [time, layout.cycle.as_ref()]
            .into_iter()
            .chain([layout.friction_joint.as_ref(), layout.friction_level.as_ref()]);
        let joints = [Some(&layout.position), layout.velocity.as_ref(), Some(&layout.torque)];
        let ambient = layout.ambient_temperature.as_ref().map(|ambient| &ambient.column);
        let motors = layout.motor_temperature.as_ref().into_iter().flat_map(|motor| {
            (1..=self.robot.joint_count()).filter_map(|joint| motor.columns.of_joint(joint))
        });
        single.chain([ambient]).flatten().any(is)
            || motors.into_iter().any(|column| is(&column))
            || layout.stage.kind().columns().into_iter().any(is)
            || joints.into_iter().flatten().any(|channel| self.columns(channel).any(|column| is(&column)))
    }
}

/// Levenshtein distance, ignoring case.
fn edit_distance(a: &str, b: &str) -> usize {
    strsim::levenshtein(&a.to_lowercase(), &b.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::native;
    use armwatch_testing::er3a;

    const HEADER: &str = "time,pos_1,pos_2,pos_3,pos_4,pos_5,pos_6,vel_1,vel_2,vel_3,vel_4,vel_5,vel_6,\
                          trq_1,trq_2,trq_3,trq_4,trq_5,trq_6,stage,cycle,joint,level";

    fn mapped(header: &str) -> Result<ColumnMap, Rejection> {
        map_columns(header, &native(), &er3a(), Path::new("a.csv"))
    }

    #[test]
    fn columns_are_found_by_name_wherever_they_stand() {
        let straight = mapped(HEADER).unwrap();
        let backwards: Vec<&str> = HEADER.split(',').rev().collect();
        let reversed = mapped(&backwards.join(",")).unwrap();
        assert_eq!((straight.time, reversed.time), (TimeColumn::Recorded(0), TimeColumn::Recorded(22)));
        assert_eq!(straight.position, [1, 2, 3, 4, 5, 6]);
        assert_eq!(reversed.position, [21, 20, 19, 18, 17, 16]);
        let mut roles = reversed.roles.clone();
        roles.reverse();
        assert_eq!(roles, straight.roles);
        assert!(!roles.contains(&Role::Ignored));
    }

    #[test]
    fn twice_is_only_wrong_for_columns_that_are_needed() {
        assert!(mapped(&format!("{HEADER},note,note,,")).is_ok());
        for name in ["time", "trq_6", "stage", "level"] {
            let rejection = mapped(&format!("{HEADER},{name}")).unwrap_err();
            assert_eq!(&*rejection.reason, "a column that exists twice");
            assert_eq!(rejection.column.as_deref(), Some(name));
        }
    }

    #[test]
    fn half_a_friction_signal_is_none() {
        let map = mapped(&HEADER.replace(",level", "")).unwrap();
        assert_eq!((map.friction, map.cycle), (None, Some(20)));
    }

    #[test]
    fn one_missing_velocity_is_missing_and_all_of_them_are_not_recorded() {
        let rejection = mapped(&HEADER.replace(",vel_4", "")).unwrap_err();
        assert_eq!((&*rejection.reason, rejection.column.as_deref()), ("missing column", Some("vel_4")));
        let without: Vec<&str> = HEADER.split(',').filter(|name| !name.starts_with("vel_")).collect();
        assert_eq!(mapped(&without.join(",")).unwrap().velocity, None);
    }

    #[test]
    fn one_missing_position_is_missing_and_not_another_arm() {
        for joint in 1..=6 {
            let rejection = mapped(&HEADER.replace(&format!(",pos_{joint}"), "")).unwrap_err();
            assert_eq!(&*rejection.reason, "missing column");
            assert_eq!(rejection.column, Some(format!("pos_{joint}").into()));
        }
    }

    #[test]
    fn a_character_without_width_in_a_name_is_named() {
        let header = HEADER.replacen("time", "time\u{200b}", 1);
        let rejection = map_columns(&header, &native(), &er3a(), Path::new("a.csv")).unwrap_err();
        let suggestion = "did you mean time\u{200b} (with U+200B ZERO WIDTH SPACE)? ";
        assert!(rejection.remedy.starts_with(suggestion), "{rejection}");
    }

    #[test]
    fn edit_distances() {
        for (a, b, distance) in [("", "", 0), ("abc", "", 3), ("kitten", "sitting", 3), ("Vel", "vel", 0)] {
            assert_eq!(edit_distance(a, b), distance);
            assert_eq!(edit_distance(b, a), distance);
        }
    }

    #[test]
    fn columns_by_number_ignore_names_and_must_be_there_once() {
        let mut layout = native();
        layout.torque.columns = JointColumns::Each((14..=19).map(Column::Number).collect());
        let renamed = HEADER.replace("trq_", "Drehmoment A").replace(",stage", ",stage,note,note");
        let map = |layout: &Layout| map_columns(&renamed, layout, &er3a(), Path::new("a.csv"));
        assert_eq!(map(&layout).unwrap().torque, [13, 14, 15, 16, 17, 18].map(Some));
        layout.torque.columns = JointColumns::Each([13, 14, 15, 16, 17, 18].map(Column::Number).into());
        let rejection = map(&layout).unwrap_err();
        assert_eq!(
            (&*rejection.reason, rejection.column.as_deref()),
            ("a column that the layout reads twice", Some("vel_6"))
        );
        layout.torque.columns = JointColumns::Each([14, 15, 16, 17, 18, 40].map(Column::Number).into());
        let rejection = map(&layout).unwrap_err();
        assert_eq!((&*rejection.reason, rejection.column.as_deref()), ("missing column", Some("40")));
    }

    #[test]
    fn currents_without_a_gain_are_refused_before_any_row() {
        let mut layout = native();
        layout.torque_quantity = armwatch_config::TorqueQuantity::Current;
        let rejection = map_columns(HEADER, &layout, &er3a(), Path::new("a.csv")).unwrap_err();
        assert!(rejection.reason.contains("drive_gain_nm_a of joint 1"), "{rejection}");
    }
}
