//! The expressions that code is written from, against the regressor.

use proptest::prelude::*;

use super::*;
use crate::robot_code::vectors::ROUNDING;
use armwatch_model::robot::ParameterId;
use armwatch_testing::arms::{any_arm, numbers};
use armwatch_testing::{er3a, scara};

fn origin() -> CodeOrigin {
    CodeOrigin {
        program: "a test".into(),
        parameters: vec!["made up */ \"\"\"".into()],
        friction: vec!["warm".into()],
    }
}

fn all(robot: &Robot, values: &[f64]) -> Vec<CodeParameter> {
    let ids = ParameterId::natural_order(robot).into_iter().zip(values);
    ids.map(|(id, &value)| CodeParameter { id, value, std_error: None, stands_for: None }).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_arm_has_the_torque_of_the_regressor(robot in any_arm(), phi in numbers(), sparse: bool) {
        let values: Vec<f64> = phi.iter().map(|x| if sparse && *x < 0.3 { 0.0 } else { *x }).collect();
        let code = TorqueCode::new(&robot, &all(&robot, &values), &robot.model, &origin());
        prop_assert!(code.largest_difference() < ROUNDING, "{}", code.largest_difference());
        for language in CodeLanguage::ALL {
            prop_assert_eq!(code.files(language), code.files(language));
        }
    }
}

#[test]
fn a_wrong_parameter_is_a_difference() {
    let robot = er3a();
    let mut parameters = all(&robot, &[0.3; 200]);
    let vectors = TestVectors::of(&robot, &parameters);
    parameters[25].value *= 1.0 + 1e-9;
    let programs = TorquePrograms::new(&robot, &parameters);
    let difference = vectors.largest_difference(|of| programs.torque_at(&of.q, &of.qd, &of.qdd));
    assert!((1e-11..1e-8).contains(&difference), "{difference}");
}

#[test]
fn what_is_zero_is_not_computed() {
    let robot = er3a();
    let few: Vec<CodeParameter> =
        all(&robot, &[1.0; 200]).into_iter().filter(|of| of.id.to_string() == "J1_Izz").collect();
    let code = TorqueCode::new(&robot, &few, "ER3A", &origin());
    assert_eq!(code.operations(), 1);
    let nothing = TorqueCode::new(&robot, &[], "ER3A", &origin());
    assert_eq!((nothing.operations(), nothing.largest_difference()), (0, 0.0));
}

#[test]
fn the_scara_needs_no_cosine_of_its_shoulder() {
    let robot = scara();
    let code = TorqueCode::new(&robot, &all(&robot, &[0.3; 200]), &robot.model, &origin());
    assert!(code.largest_difference() < ROUNDING);
    let source = &code.files(CodeLanguage::C)[1].text;
    assert!(source.contains("cos(q2)") && !source.contains("cos(q1)"), "{source}");
    assert_eq!(code.name, "scara_example");
}

#[test]
fn names_become_identifiers_and_comments_stay_comments() {
    assert_eq!(identifier("ER3A"), "er3a");
    assert_eq!(identifier("7-axis (left)"), "arm_7_axis_left");
    assert_eq!(identifier("--"), "arm");
    let code = TorqueCode::new(&er3a(), &[], "a", &origin());
    for file in CodeLanguage::ALL.into_iter().flat_map(|language| code.files(language)) {
        assert!(!file.text.contains("made up */") && !file.text.contains("up */ \"\"\""), "{}", file.text);
    }
}

#[test]
fn the_vectors_have_rest_and_slow_motion_and_stay_within_the_limits() {
    let robot = er3a();
    let vectors = TestVectors::of(&robot, &all(&robot, &[0.3; 200]));
    let count = |is: &dyn Fn(&armwatch_method::model::base_parameters::JointState) -> bool| {
        vectors.states.iter().filter(|state| is(state)).count()
    };
    assert_eq!(count(&|state| state.qd.iter().all(|v| *v == 0.0)), 80);
    assert_eq!(count(&|state| state.qd.iter().all(|v| v.abs() <= 0.02)), 160);
    assert_eq!(count(&|state| state.qd.iter().filter(|v| **v == 0.0).count() == 1), 80);
    let within = |state: &armwatch_method::model::base_parameters::JointState| {
        let joints = robot.joints.iter().map(|joint| joint.limits).enumerate();
        joints.into_iter().all(|(j, limits)| {
            (limits.position_min..=limits.position_max).contains(&state.q[j])
                && state.qd[j].abs() <= limits.velocity
                && state.qdd[j].abs() <= limits.acceleration
        })
    };
    assert_eq!(count(&within), vectors.states.len());
    let lines: Vec<String> = vectors.csv().lines().map(str::to_owned).collect();
    assert_eq!(lines.len(), 321);
    assert!(lines[0].starts_with("q_1_rad,") && lines[0].ends_with(",tau_6_nm"));
    let first: Vec<f64> = lines[1].split(',').map(|cell| cell.parse().expect("a number")).collect();
    assert_eq!(first[..6], vectors.states[0].q[..]);
    assert_eq!(first[18..], vectors.tau[0][..]);
}
