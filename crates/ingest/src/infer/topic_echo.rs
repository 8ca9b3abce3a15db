//! Rows of `ros2 topic echo --csv` of joint states: the fields of the message one after another, without names of
//! columns.

use super::head::{Head, HeadColumn};
use super::joints::{Joints, QuantityColumns};
use super::names::{ColumnKind, NameMeaning};
use super::section::{Section, TomlKey, quoted};
use super::sets::{ORDER_QUESTION, list};
use armwatch_model::robot::Robot;

/// Name of the shipped layout.
pub(super) const LAYOUT: &str = "ros_topic_echo";

/// Columns before the names of the joints: seconds, nanoseconds and frame of the stamp.
const STAMP: usize = 3;

/// Nanoseconds per second.
const SECOND: f64 = 1e9;

/// Seconds from 1970 to 1980: an earlier stamp is that of a simulation.
const SINCE_1980: f64 = 315_532_800.0;

/// The content of such rows.
pub(super) struct TopicEcho<'h> {
    pub(super) joints: Joints<'h>,
    /// Time of each row since the first one, ns.
    pub(super) time: Vec<f64>,
    /// Columns that are read or known: those of the stamp and the names.
    pub(super) columns: usize,
    is_dated: bool,
}

/// Recognises the rows: a stamp, as many names that never change, and as many positions, velocities and efforts.
pub(super) fn topic_echo<'h>(head: &'h Head, robot: Option<&Robot>) -> Option<TopicEcho<'h>> {
    if head.header {
        return None;
    }
    let whole = |at: usize| -> Option<&[f64]> {
        head.columns
            .get(at)?
            .values
            .as_deref()
            .filter(|values| values.iter().all(|value| value.fract() == 0.0))
    };
    let (seconds, nanoseconds) = (whole(0)?, whole(1)?);
    let name = |column: &HeadColumn| {
        let words = column.words.as_ref().filter(|_| column.values.is_none())?;
        (words.words.len() == 1).then(|| words.words[0].clone())
    };
    let names: Vec<String> =
        head.columns.iter().skip(STAMP).map_while(name).filter(|name| !name.is_empty()).collect();
    let n = names.len();
    let time: Vec<f64> =
        seconds.iter().zip(nanoseconds).map(|(s, ns)| (s - seconds[0]) * SECOND + ns).collect();
    let is_stamp = nanoseconds.iter().all(|ns| (0.0..SECOND).contains(ns))
        && time.windows(2).all(|pair| pair[0] < pair[1]);
    if n < 2 || head.columns.len() != STAMP + 4 * n || !is_stamp {
        return None;
    }
    let of_robot = robot.and_then(|robot| {
        let place = |name: Option<&str>| names.iter().position(|known| Some(known.as_str()) == name);
        robot.joints.iter().map(|joint| place(joint.name.as_deref())).collect::<Option<Vec<usize>>>()
    });
    let question = of_robot
        .is_none()
        .then(|| format!("the joints of the message are {}: {ORDER_QUESTION}", names.join(", ")));
    let places = of_robot.unwrap_or_else(|| (0..n).collect());
    let found = |block: usize, kind: ColumnKind, unit: &'static str| -> Option<QuantityColumns<'h>> {
        let columns: Vec<usize> = places.iter().map(|place| STAMP + block * n + place).collect();
        Some(QuantityColumns {
            key: ("columns", list(head, &columns)),
            values: columns.iter().map(|at| head.columns[*at].values.as_deref()).collect::<Option<_>>()?,
            columns,
            said: NameMeaning {
                kind: Some(kind),
                unit: Some(unit),
                is_unit_shipped: true,
                is_measured: true,
                ..NameMeaning::default()
            },
            why: "from the place in the message".to_owned(),
            question: question.clone(),
        })
    };
    let joints = Joints {
        position: Some(found(1, ColumnKind::Position, "rad")?),
        velocity: Some(found(2, ColumnKind::Velocity, "rad/s")?),
        torque: Some(found(3, ColumnKind::Torque, "Nm")?),
        count: places.len(),
        others: Vec::new(),
    };
    Some(TopicEcho { joints, time, columns: STAMP + n, is_dated: seconds[0] >= SINCE_1980 })
}

impl TopicEcho<'_> {
    /// The sections on time and, if the stamp is a date, on the start.
    pub(super) fn sections(&self) -> Vec<Section> {
        let keys = vec![
            TomlKey::decided("column", "2")
                .because("the nanoseconds of the stamp, which start again each second"),
            TomlKey::decided("unit", quoted("ns")),
            TomlKey::decided("wraps_at", "1000000000"),
        ];
        let comments = vec!["A gap of whole seconds between two messages cannot be seen.".to_owned()];
        let time = Section { title: Some("time"), comments, keys };
        let start = Section {
            title: Some("start"),
            comments: Vec::new(),
            keys: vec![
                TomlKey::decided("column", "1").because("the seconds of the stamp, since 1970"),
                TomlKey::decided("unit", quoted("s")),
            ],
        };
        std::iter::once(time).chain(self.is_dated.then_some(start)).collect()
    }
}
