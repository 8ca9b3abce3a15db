//! Geometry of a description: its convention, rows of Denavit-Hartenberg tables, the tool.

use crate::toml::quantity::{TURN, quantity};
use crate::toml::range::Limits;
use crate::toml::table::Table;
use armwatch_model::robot::{DhParameters, JointKind, Transform};

/// Longest link length or offset. No industrial arm has a link of that length, so that a value in mm is not accepted as
/// one in m.
const LENGTH: Limits = Limits::within(10.0, "m");

/// Angles in degrees between this and `2 pi` probably are radians. Smaller ones are twists from a calibration.
const SUSPICIOUS_DEG: f64 = 0.5;

/// The convention of a description's geometry, in the key `convention`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Convention {
    ModifiedDh,
    StandardDh,
    Urdf,
}

/// Reads the convention, which has no default: tables of both kinds look alike.
pub(crate) fn read_convention(root: &Table<'_>) -> Option<Convention> {
    let hint = || {
        Some(
            "write \"modified_dh\" (Craig): a row holds a and alpha of the previous axis, T = Rx(alpha) Dx(a) \
             Rz(theta) Dz(d), and the first row usually has a = 0 and alpha = 0; \"standard_dh\": T = Rz(theta) \
             Dz(d) Dx(a) Rx(alpha), and it is the last row that usually does; or \"urdf\" with urdf = \"FILE\""
                .to_owned(),
        )
    };
    let value = root.required_or_else("convention", hint)?;
    match value.text()? {
        "modified_dh" => Some(Convention::ModifiedDh),
        "standard_dh" => Some(Convention::StandardDh),
        "urdf" => Some(Convention::Urdf),
        _ => {
            value.refuse("is not known".into(), hint());
            None
        }
    }
}

/// Reads `[tool]`: `xyz_m` and `rpy_deg` or `rpy_rad`; the identity without it.
pub(crate) fn read_tool(root: &Table<'_>) -> Option<Transform> {
    let Some(value) = root.optional("tool") else { return Some(Transform::IDENTITY) };
    let table = value.table()?;
    let xyz = table.numbers("xyz_m", Some(3), &LENGTH);
    let rpy = match table.at_most_one_of(&["rpy_deg", "rpy_rad"]) {
        None => Some(vec![0.0; 3]),
        Some((0, value)) => value
            .numbers(Some(3), &Limits::within(360.0, "deg"))
            .map(|rpy| rpy.into_iter().map(f64::to_radians).collect()),
        Some((_, value)) => value.numbers(Some(3), &Limits::within(6.3, "rad")),
    };
    Some(Transform::from_xyz_rpy(xyz?.try_into().ok()?, rpy?.try_into().ok()?))
}

/// Reads a row of a Denavit-Hartenberg table.
pub(crate) fn read_dh_row(table: &Table<'_>) -> Option<DhParameters> {
    let a = read_length(table, "a_m");
    let alpha = read_fixed_angle(table, "alpha");
    let d = read_length(table, "d_m");
    let theta_offset = read_fixed_angle(table, "theta_offset");
    Some(DhParameters { a: a?, alpha: alpha?, d: d?, theta_offset: theta_offset? })
}

fn read_length(table: &Table<'_>, key: &str) -> Option<f64> {
    let in_metres = |raw: f64| Some(format!("did you mean {} m?", raw / 1000.0)).filter(|_| raw.is_finite());
    table.required(key)?.number_or_hint(&LENGTH, in_metres)
}

/// An angle of the geometry, with a check for confused degrees and radians.
fn read_fixed_angle(table: &Table<'_>, stem: &str) -> Option<f64> {
    let given = quantity(table, stem, JointKind::Revolute, &TURN).required()?;
    let degrees = given.raw.abs();
    if given.unit == "deg" && (SUSPICIOUS_DEG..=std::f64::consts::TAU).contains(&degrees) {
        given.value.refuse(
            "looks like radians given as degrees".into(),
            Some(format!(
                "write {stem}_rad = {0} if it is in rad, {stem}_rad = {1:.6} if it is {0} deg",
                given.raw, given.si
            )),
        );
        return None;
    }
    Some(given.si)
}
