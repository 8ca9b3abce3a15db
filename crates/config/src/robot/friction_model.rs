//! The friction columns of a description: those of the arm, and of joints with another model.

use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{FrictionLaw, FrictionModel, Joint, JointKind, LawKind, LoadFriction, LoadKind};

const MODEL: &str = "friction_model";
const ASYMMETRIC: &str = "asymmetric";
const LOAD: &str = "load_friction";

const RAD_S: Limits = Limits::above(0.0, 10.0, "rad/s");
const M_S: Limits = Limits::above(0.0, 10.0, "m/s");

/// Every law.
static LAWS: [LawKind; FrictionLaw::KINDS.len()] = FrictionLaw::KINDS;

/// Every dependence on load.
static LOADS: [LoadKind; LoadFriction::KINDS.len()] = LoadFriction::KINDS;

/// Keys of a table about friction, each part if present.
struct GivenFriction<'d> {
    law: Option<&'static LawKind>,
    /// Speeds with the laws that they belong to.
    speeds: Vec<(&'static LawKind, Value<'d>, f64)>,
    asymmetric: Option<bool>,
    load: Option<LoadFriction>,
}

/// The model of an arm from its root table.
#[derive(Clone, Copy, Default)]
pub(crate) struct ArmModel {
    /// The default model of joints; its speed is zero if the root gives none.
    pub(crate) model: FrictionModel,
    /// Key of the speed that the root's law needs and the root does not give: each joint must give its own.
    missing_speed: Option<&'static str>,
}

/// Reads the model of all joints at the root of a description.
pub(crate) fn read_of_arm(root: &Table<'_>) -> Option<ArmModel> {
    let given = read(root, JointKind::Revolute)?;
    match given.law.filter(|_| given.speeds.is_empty()) {
        Some(law) if law.speed_keys.is_some() => {
            let asymmetric = given.asymmetric.unwrap_or(false);
            let load = given.load.unwrap_or_default();
            let model = FrictionModel { law: (law.with_speed)(0.0), asymmetric, load };
            check_directions(root, law, asymmetric)?;
            Some(ArmModel { model, missing_speed: speed_key(law, JointKind::Revolute) })
        }
        _ => {
            let model = resolved(root, JointKind::Revolute, &given, FrictionModel::POLYNOMIAL)?;
            Some(ArmModel { model, missing_speed: None })
        }
    }
}

impl ArmModel {
    /// The model of joints without their own; notes a missing speed if there is such a joint.
    pub(crate) fn of_other_joints(self, root: &Table<'_>, joints: &[Joint]) -> Option<FrictionModel> {
        let Some(key) = self.missing_speed else { return Some(self.model) };
        let own: Option<Vec<FrictionModel>> = joints.iter().map(|joint| joint.friction).collect();
        match own.and_then(|own| own.first().copied()) {
            // the arm's model applies to no joint
            Some(first) => Some(first),
            None => {
                let hint = || Some("give it here, or in every [[joint]]".into());
                let _ = root.required_or_else(key, hint);
                None
            }
        }
    }
}

/// Reads the model of one joint that differs from the `arm`'s; `Some(None)` if the table gives none.
pub(crate) fn read_of_joint(
    table: &Table<'_>,
    kind: JointKind,
    arm: FrictionModel,
) -> Option<Option<FrictionModel>> {
    let given = read(table, kind)?;
    let law_alone = given.law.is_none() && given.speeds.is_empty() && given.asymmetric.is_none();
    if law_alone && given.load.is_none() {
        return Some(None);
    }
    resolved(table, kind, &given, arm).map(Some)
}

/// Key of the speed of a law in the table of a joint.
fn speed_key(law: &LawKind, kind: JointKind) -> Option<&'static str> {
    law.speed_keys.map(|[revolute, prismatic]| match kind {
        JointKind::Revolute => revolute,
        JointKind::Prismatic => prismatic,
    })
}

fn read<'d>(table: &Table<'d>, kind: JointKind) -> Option<GivenFriction<'d>> {
    let limits = match kind {
        JointKind::Revolute => RAD_S,
        JointKind::Prismatic => M_S,
    };
    // all parts are read before any fails, so that one pass reports all problems
    let law = table.optional(MODEL).map(|value| read_law(&value));
    let speeds: Vec<_> = LAWS
        .iter()
        .filter_map(|law| Some((law, table.optional(speed_key(law, kind)?)?)))
        .map(|(law, value)| value.number(&limits).map(|speed| (law, value, speed)))
        .collect();
    let asymmetric = table.optional(ASYMMETRIC).map(|value| value.boolean());
    let load = read_load(table, kind, &limits);
    let law = match law {
        Some(law) => Some(law?),
        None => None,
    };
    let speeds = speeds.into_iter().collect::<Option<_>>()?;
    let asymmetric = match asymmetric {
        Some(asymmetric) => Some(asymmetric?),
        None => None,
    };
    Some(GivenFriction { law, speeds, asymmetric, load: load? })
}

/// Reads the dependence of friction on load; `Some(None)` if the table gives none.
fn read_load(table: &Table<'_>, kind: JointKind, limits: &Limits) -> Option<Option<LoadFriction>> {
    let key = match kind {
        JointKind::Revolute => "load_speed_rad_s",
        JointKind::Prismatic => "load_speed_m_s",
    };
    let (given, speed) = (table.optional(LOAD), table.optional(key));
    let Some(given) = given else {
        return match speed {
            Some(speed) => {
                speed.refuse(format!("has an effect only with {LOAD} = \"stribeck\""), None);
                None
            }
            None => Some(None),
        };
    };
    let name = given.text()?;
    let Some(found) = LOADS.iter().find(|of| of.name == name) else {
        let about: Vec<String> = LOADS.iter().map(|of| format!("{}: {}", of.name, of.about)).collect();
        let names = listed(LOADS.iter().map(|of| of.name));
        given.refuse(format!("must be {names}"), Some(about.join("; ")));
        return None;
    };
    match ((found.with_speed)(0.0).speed(), speed) {
        (Some(_), Some(speed)) => speed.number(limits).map(|speed| Some((found.with_speed)(speed))),
        (Some(_), None) => {
            // notes that it is missing
            let _ = table.required(key);
            None
        }
        (None, Some(speed)) => {
            speed.refuse(format!("has an effect only with {LOAD} = \"stribeck\""), None);
            None
        }
        (None, None) => Some(Some((found.with_speed)(0.0))),
    }
}

/// Names in quotes, the last after "or".
fn listed(names: impl Iterator<Item = &'static str>) -> String {
    let quoted: Vec<String> = names.map(|name| format!("\"{name}\"")).collect();
    match quoted.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => quoted.concat(),
    }
}

fn read_law(value: &Value<'_>) -> Option<&'static LawKind> {
    let given = value.text()?;
    let found = LAWS.iter().find(|law| law.name == given);
    if found.is_none() {
        let names = listed(LAWS.iter().map(|law| law.name));
        let about: Vec<&str> = LAWS.iter().map(|law| law.about).collect();
        value.refuse(format!("must be {names}"), Some(about.join("; ")));
    }
    found
}

/// The given model, with `default` for missing parts.
fn resolved(
    table: &Table<'_>,
    kind: JointKind,
    given: &GivenFriction<'_>,
    default: FrictionModel,
) -> Option<FrictionModel> {
    let chosen = match given.law {
        Some(law) => law,
        None => LAWS.iter().find(|law| law.name == default.law.name())?,
    };
    let speed = given.speeds.iter().find(|(law, ..)| law.name == chosen.name).map(|(_, _, speed)| *speed);
    let of_arm = default.law.speed().filter(|speed| default.law.name() == chosen.name && *speed > 0.0);
    let speed = speed.or(of_arm);
    if let (Some(key), None) = (speed_key(chosen, kind), speed) {
        // notes that it is missing
        let _ = table.required(key);
        return None;
    }
    if let Some((law, value, _)) = given.speeds.iter().find(|(law, ..)| law.name != chosen.name) {
        value.refuse(format!("has an effect only with {MODEL} = \"{}\"", law.name), None);
        return None;
    }
    let law = (chosen.with_speed)(speed.unwrap_or_default());
    let asymmetric = given.asymmetric.unwrap_or(default.asymmetric && chosen.has_directions);
    check_directions(table, chosen, asymmetric)?;
    let of_arm = if law == FrictionLaw::None { LoadFriction::None } else { default.load };
    let load = given.load.unwrap_or(of_arm);
    if law == FrictionLaw::None && load != LoadFriction::None {
        let hint = Some(format!("choose another {MODEL}, or {LOAD} = \"none\""));
        table.refuse("load-dependent friction has no columns in the model \"none\"".to_owned(), hint);
        return None;
    }
    Some(FrictionModel { law, asymmetric, load })
}

/// Notes that a law has no separate columns for each direction, if they are requested.
fn check_directions(table: &Table<'_>, law: &LawKind, asymmetric: bool) -> Option<()> {
    if asymmetric && !law.has_directions {
        let model = match (law.with_speed)(0.0) {
            FrictionLaw::None => "the model \"none\"".to_owned(),
            law => format!("the {} model", law.name()),
        };
        let others = listed(LAWS.iter().filter(|law| law.has_directions).map(|law| law.name));
        let hint = format!("choose {MODEL} = {others}");
        table.refuse(format!("asymmetric friction has no columns in {model}"), Some(hint));
        return None;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use crate::robot::robot_file::parse_robot;
    use armwatch_model::robot::{FrictionLaw, FrictionModel, LoadFriction, Robot};

    const ER3A: &str = include_str!("../../../../config/robots/er3a.toml");

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
        let smooth =
            |speed| FrictionModel { law: FrictionLaw::Smooth { speed }, ..FrictionModel::POLYNOMIAL };
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
            FrictionModel { law: FrictionLaw::ViscousCoulomb, asymmetric: true, load: LoadFriction::None }
        );
        assert_eq!(robot.friction, FrictionModel::POLYNOMIAL);
        assert_eq!(robot.parameter_count(), 6 * 15);
        let robot = with("", 2, "friction_model = \"none\"").expect("no problems");
        assert_eq!(robot.parameter_count(), 6 * 15 - 4);
    }

    #[test]
    fn a_joint_may_have_friction_under_load_of_its_own() {
        let root = "friction_model = \"polynomial\"\nload_friction = \"linear\"";
        let robot =
            with(root, 2, "load_friction = \"stribeck\"\nload_speed_rad_s = 0.05").expect("no problems");
        let loads: Vec<LoadFriction> =
            robot.joint_indices().map(|joint| robot.friction_of(joint).load).collect();
        let mut expected = vec![LoadFriction::Linear; 6];
        expected[2] = LoadFriction::Stribeck { speed: 0.05 };
        assert_eq!(loads, expected);
        assert_eq!(robot.parameter_count(), 6 * 16 + 1);
        // a joint without friction has none under load either
        let robot = with(root, 2, "friction_model = \"none\"").expect("no problems");
        assert_eq!(robot.parameter_count(), 6 * 16 - 5);
    }

    #[test]
    fn a_smooth_speed_in_every_joint_needs_none_at_the_root() {
        let text = |joints: &[usize]| {
            let mut parts = ER3A.split("\n[[joint]]\n");
            let root = parts.next().expect("a root");
            let mut text = root.replacen("friction_model = \"polynomial\"", "friction_model = \"smooth\"", 1);
            for (at, part) in parts.enumerate() {
                let speed = if joints.contains(&at) {
                    format!("smooth_speed_rad_s = 0.0{}\n", at + 1)
                } else {
                    String::new()
                };
                text.push_str(&format!("\n[[joint]]\n{speed}{part}"));
            }
            text
        };
        let robot = parse_robot("a.toml", &text(&[0, 1, 2, 3, 4, 5])).expect("no problems");
        for (joint, speed) in robot.joint_indices().zip([0.01, 0.02, 0.03, 0.04, 0.05, 0.06]) {
            assert_eq!(robot.friction_of(joint).law, FrictionLaw::Smooth { speed });
        }
        // one joint without: one problem, and none about the others
        let errors = parse_robot("a.toml", &text(&[0, 1, 3, 4, 5])).expect_err("no speed for joint 3");
        let keys: Vec<&str> = errors.0.iter().map(|problem| problem.key.as_str()).collect();
        assert_eq!(keys, ["smooth_speed_rad_s"], "{errors}");
    }

    #[test]
    fn what_a_joint_cannot_have_is_refused() {
        for (root, keys, said) in [
            ("", "smooth_speed_rad_s = 0.2", "has an effect only with friction_model = \"smooth\""),
            ("", "friction_model = \"smooth\"", "smooth_speed_rad_s: is missing"),
            ("", "asymmetric = true", "no columns in the polynomial model"),
            ("", "friction_model = \"none\"\nasymmetric = true", "no columns in the model \"none\""),
            ("", "friction_model = \"stribeck\"", "must be \"polynomial\""),
            ("friction_model = \"smooth\"", "", "smooth_speed_rad_s: is missing"),
            ("", "load_friction = \"cubic\"", "must be \"none\", \"linear\""),
            ("", "load_friction = \"stribeck\"", "load_speed_rad_s: is missing"),
            (
                "",
                "load_friction = \"linear\"\nload_speed_rad_s = 0.1",
                "has an effect only with load_friction",
            ),
            ("", "load_speed_rad_s = 0.1", "has an effect only with load_friction"),
            ("", "friction_model = \"none\"\nload_friction = \"linear\"", "no columns in the model \"none\""),
            ("torque_sensors = \"axle\"", "", "must be \"motor\" or \"link\""),
        ] {
            let errors = with(root, 1, keys).expect_err(said);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }
}
