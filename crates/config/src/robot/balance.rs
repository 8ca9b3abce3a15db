//! The tables `[[spring]]`, `[[counterbalance]]` and `[[parallelogram]]`: elements that move an arm in addition to its
//! motors.

use super::nominal::read_inertial;
use super::transmission::read_joint_number;
use crate::toml::quantity::{POSITION, quantity};
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{Joint, JointKind, Parallelogram, Spring, SpringForm};

/// Least difference of the distances of a cylinder's pins, relative to the larger one: with equal ones the cylinder
/// would have no length with both pins on one side.
const LEAST_DIFFERENCE: f64 = 0.01;

/// Elements of an arm in addition to its motors.
pub(crate) struct Balance {
    pub springs: Vec<Spring>,
    pub parallelograms: Vec<Parallelogram>,
}

/// Reads the tables; the result is empty if the arm has none.
pub(crate) fn read(root: &Table<'_>, joints: Option<&[Joint]>) -> Option<Balance> {
    let mut springs: Vec<Spring> = Vec::new();
    let mut sound = true;
    for (key, is_cylinder) in [("spring", false), ("counterbalance", true)] {
        for section in sections(root, key)? {
            let read = joints.and_then(|joints| read_spring(&section, joints, is_cylinder));
            sound &= read.is_some();
            let known = |other: &Spring, of: &Spring| other.joint == of.joint && other.terms() == of.terms();
            match read {
                Some(of) if springs.iter().any(|other| known(other, &of)) => {
                    section.refuse(format!("joint {} already has a {key}", of.joint), None);
                    sound = false;
                }
                of => springs.extend(of),
            }
        }
    }
    let mut parallelograms: Vec<Parallelogram> = Vec::new();
    for section in sections(root, "parallelogram")? {
        let read = joints.and_then(|joints| read_parallelogram(&section, joints));
        sound &= read.is_some();
        match read {
            Some(of) if parallelograms.iter().any(|other| other.forearm == of.forearm) => {
                section.refuse(format!("joint {} already has a parallelogram", of.forearm), None);
                sound = false;
            }
            of => parallelograms.extend(of),
        }
    }
    sound.then_some(Balance { springs, parallelograms })
}

fn sections<'d>(root: &Table<'d>, key: &str) -> Option<Vec<Value<'d>>> {
    match root.optional(key) {
        Some(value) => value.sections(),
        None => Some(Vec::new()),
    }
}

fn read_spring(section: &Value<'_>, joints: &[Joint], is_cylinder: bool) -> Option<Spring> {
    let table = section.table()?;
    let joint = table.required("joint").and_then(|value| read_joint_number(&value, joints.len()));
    let kind = joint.map_or(JointKind::Revolute, |joint| joints[joint.index()].kind);
    let (form, nominal) = if is_cylinder {
        if kind == JointKind::Prismatic {
            table.refuse("the joint must be revolute; [[spring]] also fits prismatic joints".into(), None);
            return None;
        }
        let form = read_cylinder(&table);
        let stiffness = Limits::within(1e7, "N/m");
        let nominal = both(&table, ["stiffness_n_m", "pull_n"], [stiffness, Limits::within(1e6, "N")]);
        (form, nominal)
    } else {
        (Some(SpringForm::Direct), read_direct(&table, kind))
    };
    Some(Spring { joint: joint?, form: form?, nominal: nominal? })
}

/// Reads stiffness and relaxed position of the spring, as stiffness and torque at position 0.
fn read_direct(table: &Table<'_>, kind: JointKind) -> Option<Option<[f64; 2]>> {
    let (key, limits) = match kind {
        JointKind::Revolute => ("stiffness_nm_rad", Limits::within(1e6, "Nm/rad")),
        JointKind::Prismatic => ("stiffness_n_m", Limits::within(1e7, "N/m")),
    };
    let stiffness = table.optional(key).map(|value| value.number(&limits));
    let rest = quantity(table, "rest", kind, &POSITION).optional();
    match (stiffness, rest) {
        (None, None) => Some(None),
        (Some(stiffness), Some(rest)) => {
            let (stiffness, rest) = (stiffness?, rest?.si);
            Some(Some([stiffness, -stiffness * rest]))
        }
        _ => {
            table.refuse(format!("needs both {key} and rest_*, or neither"), Some(IDENTIFIED.into()));
            None
        }
    }
}

/// Why the numbers of a spring may be left out.
const IDENTIFIED: &str = "identification does not need them; the simulator does";

/// Two numbers that must be given together or not at all.
fn both(table: &Table<'_>, keys: [&str; 2], limits: [Limits; 2]) -> Option<Option<[f64; 2]>> {
    let [a, b] = [0, 1].map(|k| table.optional(keys[k]).map(|value| value.number(&limits[k])));
    match (a, b) {
        (None, None) => Some(None),
        (Some(a), Some(b)) => Some(Some([a?, b?])),
        _ => {
            let [a, b] = keys;
            table.refuse(format!("needs both {a} and {b}, or neither"), Some(IDENTIFIED.into()));
            None
        }
    }
}

fn read_cylinder(table: &Table<'_>) -> Option<SpringForm> {
    let pins = table.required("pins_m").and_then(|value| {
        let [a, b] = value.numbers(Some(2), &Limits::above(0.0, 10.0, "m"))?.try_into().ok()?;
        if f64::abs(a - b) < LEAST_DIFFERENCE * a.max(b) {
            value.refuse("must be two different distances from the joint's axis".into(), None);
            return None;
        }
        Some([a, b])
    });
    let aligned = quantity(table, "aligned", JointKind::Revolute, &POSITION).required();
    Some(SpringForm::Cylinder { pins: pins?, aligned: aligned?.si })
}

fn read_parallelogram(section: &Value<'_>, joints: &[Joint]) -> Option<Parallelogram> {
    let table = section.table()?;
    let forearm = table.required("joint").and_then(|value| read_joint_number(&value, joints.len()));
    let nominal = table.table("crank").map(|crank| read_inertial(&crank));
    let (forearm, nominal) = (forearm?, super::joint::optional(nominal)?);
    let read = Parallelogram::new(joints, forearm, nominal);
    if read.is_none() {
        table.refuse(
            format!("joint {forearm} and the joint before it must turn about parallel axes"),
            Some("joint must be the forearm joint, which the crank moves".into()),
        );
    }
    read
}
