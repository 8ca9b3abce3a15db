//! Quantities that a file may give in one of several units, with the unit at the end of the key: `alpha_deg` or
//! `alpha_rad`. Exactly one of them is given.

use std::f64::consts::PI;

use super::range::Limits;
use super::table::{Table, Value};
use armwatch_model::robot::JointKind;

/// A unit and its permitted range.
pub(crate) struct KeyUnit {
    /// End of the key.
    suffix: &'static str,
    to_si: f64,
    limits: Limits,
}

/// The units of a quantity, for revolute and for prismatic joints.
pub(crate) struct KeyUnits {
    revolute: [KeyUnit; 2],
    prismatic: [KeyUnit; 1],
}

/// Factor from degrees to radians; the one that `f64::to_radians` uses.
const DEG: f64 = PI / 180.0;

/// An angle of the geometry, up to a full turn.
pub(crate) const TURN: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg", to_si: DEG, limits: Limits::within(360.0, "deg") },
        KeyUnit { suffix: "rad", to_si: 1.0, limits: Limits::within(6.3, "rad") },
    ],
    prismatic: [KeyUnit { suffix: "m", to_si: 1.0, limits: Limits::within(10.0, "m") }],
};

/// A position; last joints of some arms turn many times.
pub(crate) const POSITION: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg", to_si: DEG, limits: Limits::within(3600.0, "deg") },
        KeyUnit { suffix: "rad", to_si: 1.0, limits: Limits::within(62.84, "rad") },
    ],
    prismatic: [KeyUnit { suffix: "m", to_si: 1.0, limits: Limits::within(100.0, "m") }],
};

/// A largest speed; above zero.
pub(crate) const VELOCITY: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg_s", to_si: DEG, limits: Limits::above(0.0, 6000.0, "deg/s") },
        KeyUnit { suffix: "rad_s", to_si: 1.0, limits: Limits::above(0.0, 105.0, "rad/s") },
    ],
    prismatic: [KeyUnit { suffix: "m_s", to_si: 1.0, limits: Limits::above(0.0, 50.0, "m/s") }],
};

/// A speed, which may be zero.
pub(crate) const SPEED: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg_s", to_si: DEG, limits: Limits::between(0.0, 6000.0, "deg/s") },
        KeyUnit { suffix: "rad_s", to_si: 1.0, limits: Limits::between(0.0, 105.0, "rad/s") },
    ],
    prismatic: [KeyUnit { suffix: "m_s", to_si: 1.0, limits: Limits::between(0.0, 50.0, "m/s") }],
};

/// A largest acceleration; above zero.
pub(crate) const ACCELERATION: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg_s2", to_si: DEG, limits: Limits::above(0.0, 1e5, "deg/s^2") },
        KeyUnit { suffix: "rad_s2", to_si: 1.0, limits: Limits::above(0.0, 1746.0, "rad/s^2") },
    ],
    prismatic: [KeyUnit { suffix: "m_s2", to_si: 1.0, limits: Limits::above(0.0, 1000.0, "m/s^2") }],
};

/// A largest jerk; above zero.
pub(crate) const JERK: KeyUnits = KeyUnits {
    revolute: [
        KeyUnit { suffix: "deg_s3", to_si: DEG, limits: Limits::above(0.0, 1e7, "deg/s^3") },
        KeyUnit { suffix: "rad_s3", to_si: 1.0, limits: Limits::above(0.0, 174_600.0, "rad/s^3") },
    ],
    prismatic: [KeyUnit { suffix: "m_s3", to_si: 1.0, limits: Limits::above(0.0, 1e5, "m/s^3") }],
};

/// A value with its unit in the file.
pub(crate) struct Given<'d> {
    /// In SI: rad, m, s.
    pub si: f64,
    /// Its number in the file.
    pub raw: f64,
    /// End of its key, such as `deg`.
    pub unit: &'static str,
    /// Its position in the file.
    pub value: Value<'d>,
}

/// The quantity whose keys begin with `stem`, of a revolute or prismatic joint.
pub(crate) fn quantity<'t, 'd>(
    table: &'t Table<'d>,
    stem: &str,
    kind: JointKind,
    units: &'t KeyUnits,
) -> QuantityKey<'t, 'd> {
    let units: &[KeyUnit] = match kind {
        JointKind::Revolute => &units.revolute,
        JointKind::Prismatic => &units.prismatic,
    };
    QuantityKey { table, keys: units.iter().map(|unit| format!("{stem}_{}", unit.suffix)).collect(), units }
}

/// See [`quantity`].
pub(crate) struct QuantityKey<'t, 'd> {
    table: &'t Table<'d>,
    keys: Vec<String>,
    units: &'t [KeyUnit],
}

impl<'d> QuantityKey<'_, 'd> {
    /// The value, which must be given.
    pub fn required(&self) -> Option<Given<'d>> {
        let (i, value) = self.table.one_of(&self.keys())?;
        self.in_unit(i, value)
    }

    /// The value, if given; the inner `None` is an invalid one.
    pub fn optional(&self) -> Option<Option<Given<'d>>> {
        let (i, value) = self.table.at_most_one_of(&self.keys())?;
        Some(self.in_unit(i, value))
    }

    fn in_unit(&self, i: usize, value: Value<'d>) -> Option<Given<'d>> {
        let unit = &self.units[i];
        let raw = value.number_or_hint(&unit.limits, |raw| self.other_unit(i, raw))?;
        Some(Given { si: raw * unit.to_si, raw, unit: unit.suffix, value })
    }

    /// Another unit that was probably meant, if a number is invalid in its own unit but valid in that one.
    fn other_unit(&self, i: usize, raw: f64) -> Option<String> {
        let (key, _) = self
            .keys
            .iter()
            .zip(self.units)
            .enumerate()
            .find(|(k, (_, unit))| *k != i && unit.limits.admit(raw))?
            .1;
        Some(format!("did you mean {key} = {raw}?"))
    }

    fn keys(&self) -> Vec<&str> {
        self.keys.iter().map(String::as_str).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_become_the_same_radians_as_everywhere() {
        for degrees in [-140.0_f64, 0.1, 75.0, 510.0] {
            assert_eq!(degrees * DEG, degrees.to_radians());
        }
    }
}
