//! The layout: converts the columns of an export to channels in SI, with the values that this needs from the robot.

use std::sync::Arc;

use super::column::{Column, JointColumns, ScaledColumn};
use super::parts::PartRule;
use super::stage_source::StageSource;
use super::temperature::{AmbientTemperature, MotorTemperature};
use super::text_format::TextFormat;
use crate::moment::MomentFormat;
use crate::robot::joint::{
    DRIVE_GAIN, DRIVE_GAIN_OF_SLIDE, MOTOR_TORQUE_CONSTANT, RATED_JOINT_FORCE, RATED_JOINT_TORQUE,
    RATED_MOTOR_TORQUE,
};
use armwatch_model::robot::{Joint, JointIndex, JointKind, Robot};
use armwatch_model::run::channel_delays::ChannelDelays;
use armwatch_model::run::slower::SlowerChannels;

/// Delimiter of exports whose columns are separated by any number of blanks and tabs, such as those of numpy's
/// `savetxt`, MATLAB's `-ascii` and `printf`.
pub const BLANKS: u8 = b' ';

/// A layout, which converts an export's columns to channels in SI.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Name, such as `native`.
    pub name: String,
    /// Separator between columns; [`BLANKS`] for any number of blanks.
    pub delimiter: u8,
    /// Encoding, decimal mark and lines around the header.
    pub text: TextFormat,
    /// Rows that may be skipped.
    pub rows: RowRule,
    /// The files that are parts of one recording, if exports consist of several.
    pub parts: Option<PartRule>,
    /// True if the first line names the columns; without names, columns are selected by number from 1.
    pub header: bool,
    /// Source of time.
    pub time: TimeSource,
    /// Column whose first row gives the start of the recording; `None` if the file's name or time gives it.
    pub start: Option<StartSource>,
    /// Columns of joint positions; [`JointColumns::NotRecorded`] for logs of currents and temperatures.
    pub position: Channel,
    /// Columns of joint velocities, if recorded.
    pub velocity: Option<Channel>,
    /// Columns of joint torques, or of the quantities that give them.
    pub torque: Channel,
    /// Joints whose torque is not recorded. The list of [`Layout::torque`] has placeholders for them.
    pub without_torque: Vec<JointIndex>,
    /// Channels that may have rows without a value.
    pub slower: SlowerChannels,
    /// Quantity in the torque columns.
    pub torque_quantity: TorqueQuantity,
    /// Columns of the motors' temperatures; used if the export has them.
    pub motor_temperature: Option<MotorTemperature>,
    /// Column of the ambient temperature; used if the export has it.
    pub ambient_temperature: Option<AmbientTemperature>,
    /// Source of the stages.
    pub stage: StageSource,
    /// The channels that are recorded on the motor's side of the transmission.
    pub motor_side: MotorSide,
    /// Column of the cycle counter; used if the export has it.
    pub cycle: Option<Column>,
    /// Column of the joint under friction test, from 1; used if the export has it.
    pub friction_joint: Option<Column>,
    /// Column of the speed level, from 1; used if the export has it.
    pub friction_level: Option<Column>,
}

/// Source of a recording's start in its rows.
#[derive(Debug, Clone, PartialEq)]
pub struct StartSource {
    /// The column; it may be that of time too.
    pub column: Column,
    /// Form of its cells.
    pub form: StartForm,
}

/// Form of a time in a cell.
#[derive(Debug, Clone, PartialEq)]
pub enum StartForm {
    /// ISO 8601, or day first with points.
    Timestamp,
    /// A form of `strptime`.
    Format(MomentFormat),
    /// A number since 1970; factor to s.
    Since1970(f64),
}

/// Rows of an export that may be skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RowRule {
    /// Most rows that have a wrong number of fields, or a cell that is empty or not understood.
    pub skip_bad: u64,
}

/// Source of a row's time.
#[derive(Debug, Clone, PartialEq)]
pub enum TimeSource {
    /// A column.
    Column(ScaledColumn),
    /// A column that restarts with each of several recordings in one export.
    Restarting(ScaledColumn),
    /// A column that restarts after its largest value.
    Counter {
        /// The column.
        column: ScaledColumn,
        /// One more than the largest value, in the column's unit.
        wraps_at: f64,
    },
    /// A column of text.
    Text {
        /// The column.
        column: Column,
        /// Form of the time in its cells.
        form: TextTime,
    },
    /// The number of the row and this sample rate, Hz.
    SampleRate(f64),
}

/// Form of a row's time in a text cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TextTime {
    /// ISO 8601, with or without zone, or day first with points.
    Timestamp,
    /// A form of `strptime`, with or without date.
    Format(MomentFormat),
    /// Elapsed time with units: `T#1h2m3s4ms`.
    Duration,
}

impl TextTime {
    /// Seconds after which a time of day restarts, if all cells have this form; `None` for forms without restart. A
    /// timestamp without a date is a time of day.
    pub fn period_s(&self) -> Option<f64> {
        match self {
            Self::Timestamp => Some(86_400.0),
            Self::Format(format) => format.period_s(),
            Self::Duration => None,
        }
    }
}

impl TimeSource {
    /// The column, if there is one.
    pub fn column(&self) -> Option<&Column> {
        match self {
            Self::Column(column) | Self::Restarting(column) | Self::Counter { column, .. } => {
                Some(&column.column)
            }
            Self::Text { column, .. } => Some(column),
            Self::SampleRate(_) => None,
        }
    }

    /// Factor from the column's unit to s; 1 if there is none.
    pub fn to_si(&self) -> f64 {
        match self {
            Self::Column(column) | Self::Restarting(column) | Self::Counter { column, .. } => column.to_si,
            Self::Text { .. } | Self::SampleRate(_) => 1.0,
        }
    }
}

/// Channels that are recorded at the motors, on the motor side of gears and couplings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MotorSide {
    /// Positions and velocities.
    pub position: bool,
    /// Torques, or the currents or fractions that give them.
    pub torque: bool,
}

/// One column per joint, with unit and sign.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// The columns.
    pub columns: JointColumns,
    /// Factor from the columns' unit to SI: rad (m), rad/s (m/s); for a torque column to Nm (N), A, or the fraction of
    /// the rated torque.
    pub to_si: f64,
    /// Signs of the recording relative to the description.
    pub sign: JointSigns,
    /// Delay of a value behind the positions of its row, s.
    pub delay: JointDelays,
}

/// +1 if a column has the sign of the description, -1 if it has the opposite one.
#[derive(Debug, Clone, PartialEq)]
pub enum JointSigns {
    /// One for all joints.
    All(f64),
    /// One per joint.
    Each(Vec<f64>),
}

impl JointSigns {
    /// The sign of the joint at `index`, from 0; 1 beyond the end of a list.
    fn of(&self, index: usize) -> f64 {
        match self {
            Self::All(sign) => *sign,
            Self::Each(signs) => signs.get(index).copied().unwrap_or(1.0),
        }
    }
}

/// Delays of a channel, s.
#[derive(Debug, Clone, PartialEq)]
pub enum JointDelays {
    /// One for all joints.
    All(f64),
    /// One per joint.
    Each(Vec<f64>),
}

impl Default for JointDelays {
    fn default() -> Self {
        Self::All(0.0)
    }
}

impl JointDelays {
    /// The delays of `n` joints.
    fn of_joints(&self, n: usize) -> Vec<f64> {
        match self {
            Self::All(delay) => vec![*delay; n],
            Self::Each(delays) => delays.clone(),
        }
    }
}

/// Quantity in the torque columns. Each is converted to a torque on the recorded side ([`MotorSide::torque`]); the
/// transmission then converts from motors to joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TorqueQuantity {
    /// Torque, Nm (N).
    #[default]
    Torque,
    /// Motor current, A: times `drive_gain_nm_a` at the joint, times `motor_torque_constant_nm_a` at
    /// the motor.
    Current,
    /// Fraction of the rated torque: of `rated_joint_torque_nm` at the joint, of
    /// `rated_motor_torque_nm` at the motor.
    FractionOfRated,
}

/// Factors from the columns of each joint to SI `[n]`, including signs and drives: rad (m), rad/s (m/s), Nm (N), each
/// on the recorded side.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFactors {
    /// Factors of positions.
    pub position: Vec<f64>,
    /// Factors of velocities; 1 if none are recorded.
    pub velocity: Vec<f64>,
    /// Factors of torques.
    pub torque: Vec<f64>,
}

/// Why a layout does not fit a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Misfit {
    /// The problem, with the affected joints.
    pub problem: String,
    /// The remedy.
    pub remedy: String,
}

impl Layout {
    /// The factors for reading exports of `robot`.
    ///
    /// # Errors
    /// [`Misfit`] if a list of the layout has another length than the joints, or the description lacks a value that
    /// converts current or percent to torque.
    pub fn factors(&self, robot: &Robot) -> Result<JointFactors, Misfit> {
        let n = robot.joint_count();
        self.check_lists(robot)?;
        self.check_without_torque(robot)?;
        let scaled =
            |channel: &Channel| (0..n).map(|j| channel.to_si * channel.sign.of(j)).collect::<Vec<f64>>();
        let mut torque = scaled(&self.torque);
        if let Some(of_joint) = self.drive() {
            let known: Vec<Option<f64>> = robot.joints.iter().map(|joint| of_joint(joint).1).collect();
            self.check_drive(robot, of_joint, &known)?;
            torque.iter_mut().zip(known).for_each(|(factor, gain)| *factor *= gain.unwrap_or(1.0));
        }
        Ok(JointFactors {
            position: scaled(&self.position),
            velocity: self.velocity.as_ref().map_or_else(|| vec![1.0; n], scaled),
            torque,
        })
    }

    /// The column of a joint's torque; `None` if it is not recorded.
    pub fn torque_column(&self, joint: JointIndex) -> Option<Column> {
        let is_recorded = !self.without_torque.contains(&joint);
        self.torque.columns.of_joint(joint.number()).filter(|_| is_recorded)
    }

    /// The robot, with a mark on the joints whose torque is missing in this layout.
    pub fn described(&self, robot: Arc<Robot>) -> Arc<Robot> {
        if self.without_torque.is_empty() {
            return robot;
        }
        let mut marked = Robot::clone(&robot);
        for joint in marked.joint_indices() {
            marked.joints[joint.index()].has_torque = !self.without_torque.contains(&joint);
        }
        Arc::new(marked)
    }

    /// Key and value of the description that multiplies each joint's torque column, `[n]`; `None` for layouts in Nm,
    /// and if the description lacks one.
    pub fn drive_values(&self, robot: &Robot) -> Option<Vec<(&'static str, f64)>> {
        let of_joint = self.drive()?;
        let pair = |joint: &Joint| match of_joint(joint) {
            (key, Some(value)) => Some((key, value)),
            (_, None) => None,
        };
        robot.joints.iter().map(pair).collect()
    }

    /// Delays of recorded torques and velocities of `robot`.
    pub fn delays(&self, robot: &Robot) -> ChannelDelays {
        let n = robot.joint_count();
        ChannelDelays {
            torque: self.torque.delay.of_joints(n),
            velocity: self.velocity.as_ref().map_or_else(Vec::new, |channel| channel.delay.of_joints(n)),
        }
    }

    fn check_lists(&self, robot: &Robot) -> Result<(), Misfit> {
        let n = robot.joint_count();
        let signed =
            |channel: &Channel| (channel.columns.clone(), channel.sign.clone(), channel.delay.clone());
        let unsigned = |channel: &MotorTemperature| {
            (channel.columns.clone(), JointSigns::All(1.0), JointDelays::default())
        };
        let channels = [
            ("position", Some(signed(&self.position))),
            ("velocity", self.velocity.as_ref().map(signed)),
            ("torque", Some(signed(&self.torque))),
            ("motor_temperature", self.motor_temperature.as_ref().map(unsigned)),
        ];
        for (name, channel) in channels {
            let Some((columns, sign, delay)) = channel else { continue };
            let columns = match columns {
                JointColumns::Each(columns) => Some(("columns", columns.len())),
                JointColumns::Pattern(_) | JointColumns::NotRecorded => None,
            };
            let sign = match sign {
                JointSigns::Each(signs) => Some(("sign", signs.len())),
                JointSigns::All(_) => None,
            };
            let delay = match delay {
                JointDelays::Each(delays) => Some(("delay_s", delays.len())),
                JointDelays::All(_) => None,
            };
            if let Some((key, length)) =
                [columns, sign, delay].into_iter().flatten().find(|(_, length)| *length != n)
            {
                return Err(Misfit {
                    problem: format!(
                        "{name}.{key} of layout \"{}\" has {length} entries, {} has {n} joints",
                        self.name, robot.model
                    ),
                    remedy: "give one entry per joint, from the base outwards".into(),
                });
            }
        }
        Ok(())
    }

    fn check_without_torque(&self, robot: &Robot) -> Result<(), Misfit> {
        let n = robot.joint_count();
        let Some(last) = self.without_torque.iter().max() else { return Ok(()) };
        let (problem, remedy) = if last.index() >= n {
            (format!("names joint {last}, {} has {n} joints", robot.model), "name joints of this arm")
        } else if self.without_torque.len() == n {
            ("names all joints".into(), "remove the joints that have a torque column")
        } else {
            return Ok(());
        };
        let problem = format!("torque.not_recorded of layout \"{}\" {problem}", self.name);
        Err(Misfit { problem, remedy: remedy.into() })
    }

    /// Key and value that multiply a joint's torque column.
    fn drive(&self) -> Option<OfDrive> {
        match (self.torque_quantity, self.motor_side.torque) {
            (TorqueQuantity::Torque, _) => None,
            (TorqueQuantity::Current, false) => Some(|joint| match joint.kind {
                JointKind::Revolute => (DRIVE_GAIN, joint.drive_gain),
                JointKind::Prismatic => (DRIVE_GAIN_OF_SLIDE, joint.drive_gain),
            }),
            (TorqueQuantity::Current, true) => {
                Some(|joint| (MOTOR_TORQUE_CONSTANT, joint.motor_torque_constant))
            }
            (TorqueQuantity::FractionOfRated, false) => Some(|joint| match joint.kind {
                JointKind::Revolute => (RATED_JOINT_TORQUE, joint.rated_torque),
                JointKind::Prismatic => (RATED_JOINT_FORCE, joint.rated_torque),
            }),
            (TorqueQuantity::FractionOfRated, true) => {
                Some(|joint| (RATED_MOTOR_TORQUE, joint.rated_motor_torque))
            }
        }
    }

    fn check_drive(&self, robot: &Robot, of_joint: OfDrive, known: &[Option<f64>]) -> Result<(), Misfit> {
        let missing: Vec<String> = robot
            .joint_indices()
            .filter(|joint| known[joint.index()].is_none() && !self.without_torque.contains(joint))
            .map(|joint| format!("{} of joint {joint}", of_joint(&robot.joints[joint.index()]).0))
            .collect();
        if missing.is_empty() {
            return Ok(());
        }
        let (quantity, side) = match (self.torque_quantity, self.motor_side.torque) {
            (TorqueQuantity::FractionOfRated, true) => ("percent of rated torque", "motor"),
            (TorqueQuantity::FractionOfRated, false) => ("percent of rated torque", "joint"),
            (_, true) => ("currents", "motor"),
            (_, false) => ("currents", "joint"),
        };
        Err(Misfit {
            problem: format!(
                "layout \"{}\" has {quantity}, side = \"{side}\", and the description of {} lacks {}",
                self.name,
                robot.model,
                missing.join(", ")
            ),
            remedy: format!(
                "add the key to each [[joint]] of the robot's description{}",
                match (self.torque_quantity, self.motor_side.torque) {
                    (TorqueQuantity::Current, _) =>
                        "; start with a value from the catalogue: `armwatch robot drive-gains` corrects it",
                    (_, false) => ", or set torque.side = \"motor\" if the percentage is the motor's",
                    (_, true) => "",
                }
            ),
        })
    }
}

/// Key and value that multiply a joint's torque column.
type OfDrive = fn(&Joint) -> (&'static str, Option<f64>);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Column;
    use crate::JointColumns;
    use crate::layout::layout_file::parse_layout;
    use armwatch_testing::er3a;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    fn with_torque(table: &str) -> Layout {
        let text = NATIVE.replace(
            "column = \"trq_{joint}\"\nunit = \"Nm\"",
            &format!("column = \"trq_{{joint}}\"\n{table}"),
        );
        parse_layout("layout.toml", &text).expect("no problems")
    }

    /// A product of three factors compared with another order of them.
    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 4.0 * f64::EPSILON * b.abs()
    }

    #[test]
    fn currents_and_percentages_become_torque_on_the_side_of_the_recording() {
        let mut robot = er3a();
        for (j, joint) in robot.joints.iter_mut().enumerate() {
            let k = (j + 1) as f64;
            joint.drive_gain = Some(-10.0 * k);
            joint.motor_torque_constant = Some(0.1 * k);
            joint.rated_motor_torque = Some(0.5 * k);
            joint.rated_torque = Some(60.0 * k);
        }
        let third = |table: &str| with_torque(table).factors(&robot).expect("all known").torque[2];
        for (table, expected) in [
            ("unit = \"Nm\"", 1.0),
            ("unit = \"Nm\"\nside = \"motor\"\nsign = -1", -1.0),
            ("unit = \"A\"", -30.0),
            ("unit = \"mA\"\nsign = [1, 1, -1, 1, 1, 1]", 0.030),
            ("unit = \"A\"\nside = \"motor\"", 0.3),
            ("unit = \"%\"", 1.8),
            ("unit = \"%\"\nside = \"motor\"", 0.015),
            ("unit = \"permille\"\nside = \"motor\"\nsign = -1", -0.0015),
        ] {
            assert!(close(third(table), expected), "{table}: {} {expected}", third(table));
        }
    }

    #[test]
    fn what_the_description_lacks_is_named_with_joint_and_key() {
        let mut robot = er3a();
        robot.joints[0].drive_gain = Some(10.0);
        let misfit = with_torque("unit = \"A\"").factors(&robot).expect_err("five are missing");
        assert!(
            misfit.problem.contains("drive_gain_nm_a of joint 2, drive_gain_nm_a of joint 3"),
            "{misfit:?}"
        );
        assert!(!misfit.problem.contains("joint 1,"), "{misfit:?}");
        let misfit = with_torque("unit = \"%\"").factors(&robot).expect_err("no rated joint torque");
        assert!(misfit.problem.contains("rated_joint_torque_nm of joint 1"), "{misfit:?}");
        assert!(misfit.remedy.contains("side = \"motor\""), "{misfit:?}");
        robot.joints[3].kind = JointKind::Prismatic;
        let misfit = with_torque("unit = \"A\"").factors(&robot).expect_err("a slide has another key");
        assert!(misfit.problem.contains("drive_gain_n_a of joint 4"), "{misfit:?}");
        let misfit = with_torque("unit = \"A\"\nside = \"motor\"").factors(&robot).expect_err("none");
        assert!(misfit.problem.contains("motor_torque_constant_nm_a of joint 6"), "{misfit:?}");
        // the shipped description has rated motor torques
        assert!(with_torque("unit = \"%\"\nside = \"motor\"").factors(&er3a()).is_ok());
    }

    #[test]
    fn lists_of_another_length_than_the_arm_are_refused() {
        let misfit = with_torque("unit = \"Nm\"\nsign = [1, -1]").factors(&er3a()).expect_err("two");
        assert!(misfit.problem.contains("torque.sign") && misfit.problem.contains("2 entries"), "{misfit:?}");
    }

    #[test]
    fn a_pattern_names_the_column_of_each_joint() {
        let columns = JointColumns::Pattern("{joint+6}".into());
        assert_eq!(columns.of_joint(2), Some(Column::Name("8".into())));
        let columns = JointColumns::Each(vec![Column::Number(4), Column::Name("b".into())]);
        assert_eq!(columns.of_joint(1), Some(Column::Number(4)));
        assert_eq!((columns.of_joint(3), columns.of_joint(0)), (None, None));
    }
}
