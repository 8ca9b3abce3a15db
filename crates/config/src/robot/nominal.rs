//! The table `[joint.nominal]`: values of a joint from a drawing or a catalogue, with a check of their physical
//! consistency.

use nalgebra::{Matrix3, Vector3};

use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{FRICTION_COUNT, JointKind, NominalJoint, StandardParameters, WarmUpShape};

/// Largest excess of the largest principal moment over the sum of the others, relative to the given inertia: drawings
/// round to about four digits, and a thin rod is exactly on the limit.
const ROUNDING: f64 = 1e-4;

/// Number of speeds for checking the friction curve, evenly up to the largest speed.
const FRICTION_SPEEDS: usize = 50;

/// Seconds per minute, for values of a file.
const MINUTE: f64 = 60.0;

/// Keys of f1..f4 for a revolute joint.
const REVOLUTE_FRICTION: [&str; FRICTION_COUNT] = ["f1_nm", "f2_nm_s_rad", "f3_nm_s2_rad2", "f4_nm_s3_rad3"];

/// Keys of f1..f4 for a prismatic joint.
const PRISMATIC_FRICTION: [&str; FRICTION_COUNT] = ["f1_n", "f2_n_s_m", "f3_n_s2_m2", "f4_n_s3_m3"];

/// Key of an inertia about the origin of the joint's frame.
const ABOUT_ORIGIN: &str = "inertia_kg_m2";

/// Key of an inertia about the centre of mass.
const ABOUT_CENTRE: &str = "inertia_about_centre_of_mass_kg_m2";

/// Reads the table; `velocity` is the joint's largest speed in SI, if it was valid.
pub(crate) fn read(table: &Table<'_>, kind: JointKind, velocity: Option<f64>) -> Option<NominalJoint> {
    let inertial = read_inertial(table);
    let ((inertia_key, inertia_limits), (noise_key, noise_limits)) = keys(kind);
    let motor_inertia = table.number(inertia_key, &inertia_limits);
    let friction = table.required("friction").and_then(|value| read_friction(&value, kind, velocity));
    let warm_up = table.required("warm_up").and_then(|value| read_warm_up(&value.table()?));
    let torque_noise = table.number(noise_key, &noise_limits);
    Some(NominalJoint {
        inertial: inertial?,
        motor_inertia: motor_inertia?,
        friction: friction?,
        warm_up: warm_up?,
        torque_noise: torque_noise?,
    })
}

/// Reads the table of a joint whose inertia comes from another source: missing values stay as in `given`.
pub(crate) fn read_beside(
    table: &Table<'_>,
    kind: JointKind,
    given: NominalJoint,
    velocity: f64,
) -> Option<NominalJoint> {
    let ((inertia_key, inertia_limits), (noise_key, noise_limits)) = keys(kind);
    let motor_inertia = table.number_or(inertia_key, &inertia_limits, given.motor_inertia);
    let friction = table.optional("friction").map(|value| read_friction(&value, kind, Some(velocity)));
    let warm_up = table.optional("warm_up").map(|value| read_warm_up(&value.table()?));
    let torque_noise = table.number_or(noise_key, &noise_limits, given.torque_noise);
    Some(NominalJoint {
        motor_inertia: motor_inertia?,
        friction: friction.unwrap_or(Some(given.friction))?,
        warm_up: warm_up.unwrap_or(Some(given.warm_up))?,
        torque_noise: torque_noise?,
        ..given
    })
}

/// Keys and limits of the motor's inertia and of the torque noise.
fn keys(kind: JointKind) -> ((&'static str, Limits), (&'static str, Limits)) {
    match kind {
        JointKind::Revolute => (
            ("motor_inertia_kg_m2", Limits::between(0.0, 1e4, "kg m^2")),
            ("torque_noise_nm", Limits::between(0.0, 1e4, "Nm")),
        ),
        JointKind::Prismatic => (
            ("motor_inertia_kg", Limits::between(0.0, 1e5, "kg")),
            ("force_noise_n", Limits::between(0.0, 1e5, "N")),
        ),
    }
}

/// Reads the mass with either first moment and inertia about the origin of the joint's frame, or centre of mass and
/// inertia about that centre.
pub(crate) fn read_inertial(table: &Table<'_>) -> Option<StandardParameters> {
    let mass = table.number("mass_kg", &Limits::above(0.0, 1e4, "kg"));
    let about_centre = table.optional("centre_of_mass_m");
    let (moment, key) = match &about_centre {
        Some(value) => (value.numbers(Some(3), &Limits::within(10.0, "m")), ABOUT_CENTRE),
        None => (table.numbers("first_moment_kg_m", Some(3), &Limits::within(1e4, "kg m")), ABOUT_ORIGIN),
    };
    let inertia = table.required(key).and_then(|value| Some((read_matrix(&value)?, value)));
    let (mass, moment, (inertia, value)) = (mass?, Vector3::from_column_slice(&moment?), inertia?);
    let parameters = match about_centre {
        Some(_) => StandardParameters::from_centre_of_mass(mass, &moment, &inertia),
        None => StandardParameters::new(mass, &moment, &inertia),
    };
    if let Err(reason) = check_body(&parameters) {
        value.refuse(
            reason,
            Some(format!(
                "{}, and Ixy, Ixz, Iyz are entries of the matrix: negative products of inertia",
                meaning(key)
            )),
        );
        return None;
    }
    Some(parameters)
}

fn meaning(key: &str) -> &'static str {
    match key {
        ABOUT_CENTRE => "inertia is about the centre of mass, axes of the joint's frame",
        _ => "inertia is about the origin of the link's frame, not about the centre of mass",
    }
}

fn read_matrix(value: &Value<'_>) -> Option<Matrix3<f64>> {
    let entries = value.table()?;
    let limits = Limits::within(1e4, "kg m^2");
    let [xx, xy, xz, yy, yz, zz] =
        ["xx", "xy", "xz", "yy", "yz", "zz"].map(|key| entries.number(key, &limits));
    let (xx, xy, xz, yy, yz, zz) = (xx?, xy?, xz?, yy?, yz?, zz?);
    Some(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// Checks that some distribution of positive mass has these parameters. About the centre of mass no principal moment
/// may be negative or exceed the sum of the other two, which for a positive mass is equivalent to a positive
/// semidefinite pseudo-inertia matrix (Wensing, Kim, Slotine 2018).
pub(crate) fn check_body(parameters: &StandardParameters) -> Result<(), String> {
    let mass = parameters.mass();
    let centre = parameters.first_moment() / mass;
    let origin = parameters.inertia();
    let mut inertia = origin + centre * centre.transpose() * mass;
    for k in 0..3 {
        inertia[(k, k)] -= mass * centre.norm_squared();
    }
    let mut moments: Vec<f64> = inertia.symmetric_eigenvalues().iter().copied().collect();
    moments.sort_by(f64::total_cmp);
    let slack = ROUNDING * origin.trace().abs();
    let shown = moments.iter().map(|m| format!("{m:.4}")).collect::<Vec<_>>().join(", ");
    match moments[..] {
        [small, _, _] if small < -slack => Err(format!(
            "no body has this inertia: about the centre of mass the principal moments are {shown} kg m^2, \
            one of them negative"
        )),
        [small, middle, large] if large > small + middle + slack => Err(format!(
            "no body has this inertia: about the centre of mass the principal moments are {shown} kg m^2, \
            and the largest exceeds the sum of the others"
        )),
        _ => Ok(()),
    }
}

fn read_friction(value: &Value<'_>, kind: JointKind, velocity: Option<f64>) -> Option<[f64; FRICTION_COUNT]> {
    let (keys, unit) = match kind {
        JointKind::Revolute => (REVOLUTE_FRICTION, "rad/s"),
        JointKind::Prismatic => (PRISMATIC_FRICTION, "m/s"),
    };
    let limits = Limits::within(1e6, "");
    let [f1, f2, f3, f4] = {
        let entries = value.table()?;
        // Coulomb and viscous friction alone are sufficient.
        let [first, second, third, fourth] = keys;
        [
            entries.number(first, &limits),
            entries.number(second, &limits),
            entries.number_or(third, &limits, 0.0),
            entries.number_or(fourth, &limits, 0.0),
        ]
    };
    let friction = [f1?, f2?, f3?, f4?];
    if let Some(speed) = driving_speed(friction, velocity?) {
        value.refuse(
            format!("friction would drive the joint instead of braking it at {speed:.3} {unit}"),
            Some("f1 + f2 v + f3 v^2 + f4 v^3 must not be negative up to velocity_max".into()),
        );
        return None;
    }
    Some(friction)
}

/// The first speed with negative friction [3.10].
fn driving_speed([f1, f2, f3, f4]: [f64; FRICTION_COUNT], velocity: f64) -> Option<f64> {
    (0..=FRICTION_SPEEDS)
        .map(|i| velocity * i as f64 / FRICTION_SPEEDS as f64)
        .find(|v| f1 + v * (f2 + v * (f3 + v * f4)) < 0.0)
}

fn read_warm_up(table: &Table<'_>) -> Option<WarmUpShape> {
    // A negative fraction is an arm whose friction increases as it warms; friction must not vanish.
    let fraction = Limits::between(-0.9, 10.0, "of warm friction");
    let time = Limits::above(0.0, 1000.0, "min");
    let b = table.number("b", &fraction);
    let t1 = table.number("t1_min", &time);
    let c = table.number("c", &fraction);
    let t2 = table.number("t2_min", &time);
    let (t1, t2) = (t1?, t2?);
    if t1 <= t2 {
        table.refuse(format!("t1_min is the slow part and must be larger than t2_min, which is {t2}"), None);
        return None;
    }
    Some(WarmUpShape { b: b?, t1: t1 * MINUTE, c: c?, t2: t2 * MINUTE })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A uniform box of mass 2 kg, 0.1 x 0.2 x 0.3 m, with its centre at (0.3, -0.2, 0.1).
    fn solid_box() -> [f64; 10] {
        let (m, [x, y, z]) = (2.0, [0.3, -0.2, 0.1]);
        let [a, b, c] = [0.1f64, 0.2, 0.3].map(|side| m * side * side / 12.0);
        let (xx, yy, zz) =
            (b + c + m * (y * y + z * z), a + c + m * (x * x + z * z), a + b + m * (x * x + y * y));
        [m, m * x, m * y, m * z, xx, -m * x * y, -m * x * z, yy, -m * y * z, zz]
    }

    #[test]
    fn a_solid_box_is_a_body() {
        assert_eq!(check_body(&StandardParameters(solid_box())), Ok(()));
    }

    #[test]
    fn a_box_with_the_signs_of_its_products_turned_is_none() {
        let mut parameters = solid_box();
        for k in [5, 6, 8] {
            parameters[k] = -parameters[k];
        }
        let reason = check_body(&StandardParameters(parameters)).expect_err("not a body");
        assert!(reason.contains("principal moments"), "{reason}");
    }

    #[test]
    fn inertia_about_the_centre_of_mass_taken_for_inertia_about_the_origin_is_none() {
        let mut parameters = solid_box();
        parameters[4..].copy_from_slice(&[0.0217, 0.0, 0.0, 0.0167, 0.0, 0.0083]);
        let reason = check_body(&StandardParameters(parameters)).expect_err("not a body");
        assert!(reason.contains("negative"), "{reason}");
    }

    #[test]
    fn a_thin_rod_on_the_limit_is_a_body_and_a_thinner_one_is_none() {
        let rod = |zz: f64| StandardParameters([1.0, 0.0, 0.0, 0.0, 0.0833, 0.0, 0.0, 0.0833, 0.0, zz]);
        assert_eq!(check_body(&rod(0.0)), Ok(()));
        assert_eq!(check_body(&rod(0.1666)), Ok(()));
        assert!(check_body(&rod(0.17)).is_err());
        assert!(check_body(&rod(-0.01)).is_err());
    }

    #[test]
    fn friction_that_drives_is_found_at_its_speed() {
        assert_eq!(driving_speed([1.0, 2.0, -0.1, 0.0], 4.0), None);
        // 1 + v - v^2 vanishes at the golden ratio, 1.618.
        let speed = driving_speed([1.0, 1.0, -1.0, 0.0], 4.0).expect("drives");
        assert!((1.618..1.618 + 4.0 / FRICTION_SPEEDS as f64).contains(&speed), "{speed}");
    }
}
