//! The friction columns of a description: those of the arm, and of joints that differ.

use crate::config::toml::range::Limits;
use crate::config::toml::table::{Table, Value};
use crate::robot::{FrictionLaw, FrictionModel, JointKind};

const MODEL: &str = "friction_model";
const ASYMMETRIC: &str = "asymmetric";
const SMOOTH_SPEED: &str = "smooth_speed_rad_s";
/// The same of a sliding joint.
const SMOOTH_SPEED_OF_SLIDE: &str = "smooth_speed_m_s";

const RAD_S: Limits = Limits::above(0.0, 10.0, "rad/s");
const M_S: Limits = Limits::above(0.0, 10.0, "m/s");

/// What a table says of friction, each part where it says it.
struct Given<'d> {
    law: Option<Law>,
    speed: Option<(Value<'d>, f64)>,
    asymmetric: Option<bool>,
}

#[derive(Clone, Copy, PartialEq)]
enum Law {
    None,
    Polynomial,
    ViscousCoulomb,
    Smooth,
}

/// Reads the model of all joints at the root of a description.
pub(in crate::config) fn read_of_arm(root: &Table<'_>) -> Option<FrictionModel> {
    let given = read(root, SMOOTH_SPEED, &RAD_S)?;
    if given.law == Some(Law::Smooth) && given.speed.is_none() {
        // notes that it is missing
        let _ = root.required(SMOOTH_SPEED);
        return None;
    }
    resolved(root, &given, FrictionModel::POLYNOMIAL)
}

/// Reads what one joint has in place of the `arm`'s model; `Some(None)` where it says nothing.
pub(in crate::config) fn read_of_joint(
    table: &Table<'_>,
    kind: JointKind,
    arm: FrictionModel,
) -> Option<Option<FrictionModel>> {
    let (key, limits) = match kind {
        JointKind::Revolute => (SMOOTH_SPEED, RAD_S),
        JointKind::Prismatic => (SMOOTH_SPEED_OF_SLIDE, M_S),
    };
    let given = read(table, key, &limits)?;
    if given.law.is_none() && given.speed.is_none() && given.asymmetric.is_none() {
        return Some(None);
    }
    let arm_speed = matches!(arm.law, FrictionLaw::Smooth { .. });
    if given.law == Some(Law::Smooth) && given.speed.is_none() && !arm_speed {
        let _ = table.required(key);
        return None;
    }
    resolved(table, &given, arm).map(Some)
}

fn read<'d>(table: &Table<'d>, speed_key: &str, limits: &Limits) -> Option<Given<'d>> {
    let law = table.optional(MODEL).map(|value| read_law(&value));
    let speed = table.optional(speed_key).map(|value| value.number(limits).map(|speed| (value, speed)));
    let asymmetric = table.optional(ASYMMETRIC).map(|value| value.boolean());
    let law = match law {
        Some(law) => Some(law?),
        None => None,
    };
    let speed = match speed {
        Some(speed) => Some(speed?),
        None => None,
    };
    let asymmetric = match asymmetric {
        Some(asymmetric) => Some(asymmetric?),
        None => None,
    };
    Some(Given { law, speed, asymmetric })
}

fn read_law(value: &Value<'_>) -> Option<Law> {
    match value.text()? {
        "polynomial" => Some(Law::Polynomial),
        "viscous_coulomb" => Some(Law::ViscousCoulomb),
        "smooth" => Some(Law::Smooth),
        "none" => Some(Law::None),
        _ => {
            value.refuse(
                "must be \"polynomial\", \"viscous_coulomb\", \"smooth\" or \"none\"".into(),
                Some(
                    "f1 to f4 of [3.10]; Coulomb, viscous and offset; the same with a tanh for the sign; no friction in the \
                     measured torque"
                        .into(),
                ),
            );
            None
        }
    }
}

/// The model that is given, with `default` for what is not.
fn resolved(table: &Table<'_>, given: &Given<'_>, default: FrictionModel) -> Option<FrictionModel> {
    let speed = match (&given.speed, default.law) {
        (Some((_, speed)), _) => Some(*speed),
        (None, FrictionLaw::Smooth { speed }) => Some(speed),
        (None, _) => None,
    };
    let law = match given.law {
        Some(Law::None) => FrictionLaw::None,
        Some(Law::Polynomial) => FrictionLaw::Polynomial,
        Some(Law::ViscousCoulomb) => FrictionLaw::ViscousCoulomb,
        Some(Law::Smooth) => FrictionLaw::Smooth { speed: speed? },
        None => match default.law {
            FrictionLaw::Smooth { .. } => FrictionLaw::Smooth { speed: speed? },
            other => other,
        },
    };
    if let (Some((value, _)), false) = (&given.speed, matches!(law, FrictionLaw::Smooth { .. })) {
        value.refuse("only means something with friction_model = \"smooth\"".into(), None);
        return None;
    }
    let has_directions = matches!(law, FrictionLaw::ViscousCoulomb | FrictionLaw::Smooth { .. });
    let asymmetric = given.asymmetric.unwrap_or(default.asymmetric && has_directions);
    if asymmetric && !has_directions {
        let model = if law == FrictionLaw::None { "the model \"none\"" } else { "the polynomial model" };
        let hint = "choose friction_model = \"viscous_coulomb\" or \"smooth\"";
        table.refuse(format!("asymmetric friction has no columns in {model}"), Some(hint.into()));
        return None;
    }
    Some(FrictionModel { law, asymmetric })
}

#[cfg(test)]
mod tests {
    use crate::config::robot::robot_file::parse_robot;
    use crate::robot::{FrictionLaw, FrictionModel, Robot};

    const ER3A: &str = include_str!("../../../config/robots/er3a.toml");

    /// The shipped arm with keys at its root and in the table of one joint, from 0.
    fn with(root: &str, joint: usize, keys: &str) -> Result<Robot, String> {
        // comments name the table too
        let mut parts = ER3A.split("\n[[joint]]\n");
        let root = if root.is_empty() { "friction_model = \"polynomial\"" } else { root };
        let mut text = parts.next().expect("a root").replacen("friction_model = \"polynomial\"", root, 1);
        for (at, part) in parts.enumerate() {
            text.push_str("\n[[joint]]\n");
            if at == joint {
                text.push_str(&format!("{keys}\n"));
            }
            text.push_str(part);
        }
        parse_robot("a.toml", &text).map_err(|errors| errors.to_string())
    }

    #[test]
    fn a_joint_may_have_a_law_and_a_smooth_speed_of_its_own() {
        let smooth = |speed| FrictionModel { law: FrictionLaw::Smooth { speed }, asymmetric: false };
        let robot =
            with("friction_model = \"smooth\"\nsmooth_speed_rad_s = 0.03", 4, "smooth_speed_rad_s = 0.2");
        let robot = robot.expect("no problems");
        let models: Vec<FrictionModel> =
            robot.joint_indices().map(|joint| robot.friction_of(joint)).collect();
        let mut expected = vec![smooth(0.03); 6];
        expected[4] = smooth(0.2);
        assert_eq!(models, expected);

        let robot =
            with("", 2, "friction_model = \"viscous_coulomb\"\nasymmetric = true").expect("no problems");
        let third = robot.joint_indices().nth(2).expect("six joints");
        assert_eq!(
            robot.friction_of(third),
            FrictionModel { law: FrictionLaw::ViscousCoulomb, asymmetric: true }
        );
        assert_eq!(robot.friction, FrictionModel::POLYNOMIAL);
        assert_eq!(robot.parameter_count(), 6 * 15);
        let robot = with("", 2, "friction_model = \"none\"").expect("no problems");
        assert_eq!(robot.parameter_count(), 6 * 15 - 4);
    }

    #[test]
    fn what_a_joint_cannot_have_is_refused() {
        for (root, keys, said) in [
            ("", "smooth_speed_rad_s = 0.2", "only means something with friction_model = \"smooth\""),
            ("", "friction_model = \"smooth\"", "smooth_speed_rad_s: is missing"),
            ("", "asymmetric = true", "no columns in the polynomial model"),
            ("", "friction_model = \"none\"\nasymmetric = true", "no columns in the model \"none\""),
            ("", "friction_model = \"stribeck\"", "must be \"polynomial\""),
            ("friction_model = \"smooth\"", "", "smooth_speed_rad_s: is missing"),
            ("torque_sensors = \"axle\"", "", "must be \"motor\" or \"link\""),
        ] {
            let errors = with(root, 1, keys).expect_err(said);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }
}
