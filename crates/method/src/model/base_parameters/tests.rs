use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector3;
use proptest::prelude::*;

use super::*;
use crate::model::dynamics::DynamicModel;
use armwatch_model::robot::JointKind::{Prismatic, Revolute};
use armwatch_model::robot::{
    FrictionLaw, FrictionModel, JointIndex, LoadFriction, Parallelogram, Spring, SpringForm,
};
use armwatch_testing::arms::{any_arm, arm, joint, numbers};
use armwatch_testing::{change_dh, er3a};

/// Shares are accurate to about 1e-13, and terms below [`GROUPING_THRESHOLD`] are omitted.
const GROUPING_TOLERANCE: f64 = 1e-9;

fn names(ids: &[ParameterId]) -> Vec<String> {
    ids.iter().map(ToString::to_string).collect()
}

fn formulas(base: &BaseParameters) -> Vec<String> {
    (0..base.rank).map(|index| base.grouping_formula(index)).collect()
}

/// The 64 parameters of the source.
fn er3a_names() -> Vec<String> {
    let mut expected = vec!["J1_Izz".to_string()];
    for link in 2..=6 {
        expected
            .extend(["mPx", "mPy", "Ixx", "Ixy", "Ixz", "Iyz", "Izz"].map(|name| format!("J{link}_{name}")));
    }
    for joint in 1..=6 {
        expected.extend((1..=4).map(|k| format!("J{joint}_f{k}")));
    }
    expected.extend((3..=6).map(|joint| format!("J{joint}_I_m")));
    expected
}

/// Largest difference between the torque of all parameters and that of their base values, relative to the torque,
/// over states other than those of the analysis.
fn torque_change(robot: &Robot, base: &BaseParameters, phi: &[f64]) -> f64 {
    let n = robot.joint_count();
    let full = DynamicModel::from_parameters(
        robot,
        ParameterId::natural_order(robot).into_iter().zip(phi.iter().copied()),
    );
    let grouped = DynamicModel::from_parameters(robot, base.kept.iter().copied().zip(base.group(phi)));
    (PROBE_STATES..PROBE_STATES + 20)
        .map(|index| {
            let state = probe_state(robot, index);
            let (mut a, mut b) = (vec![0.0; n], vec![0.0; n]);
            full.torque(robot, &state.q, &state.qd, &state.qdd, &mut a);
            grouped.torque(robot, &state.q, &state.qd, &state.qdd, &mut b);
            let deviation: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
            norm(&deviation) / norm(&a)
        })
        .fold(0.0, f64::max)
}

#[test]
fn the_er3a_keeps_the_64_parameters_of_the_source() {
    let base = base_parameters(&er3a()).expect("base parameters");
    assert_eq!(names(&base.kept), er3a_names());
    assert_eq!((base.inertial_rank, base.inertial_and_motor_rank, base.rank), (36, 40, 64));
    let order = ParameterId::natural_order(&er3a());
    assert!(base.kept.iter().zip(&base.kept_columns).all(|(id, &column)| order[column] == *id));
    // Link 1 only turns about the vertical. The first moment of link 2 along its own axis is at a
    // right angle to the arm that carries it (d = 0), so no inertia depends on it.
    let mut unobservable = ["m", "mPx", "mPy", "mPz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz"]
        .map(|name| format!("J1_{name}"))
        .to_vec();
    unobservable.push("J2_mPz".into());
    assert_eq!(names(&base.unobservable), unobservable);
    let gap = base.singular_value_gap;
    assert!(gap.smallest_kept > 0.01 && gap.largest_dropped < 1e-12, "{gap:?}");
}

#[test]
fn the_er3a_groups_mass_into_first_moments_by_the_length_of_the_arm() {
    let base = base_parameters(&er3a()).expect("base parameters");
    let formulas = formulas(&base);
    // Everything that the upper arm carries is 0.27 m along its x axis; axes 2 and 3 are parallel.
    assert_eq!(formulas[1], "J2_mPx + 0.27 J3_m + 0.27 J4_m + 0.27 J5_m + 0.27 J6_m");
    // The motor of joint 1 turns with link 1 alone, so no motion distinguishes it from the link's inertia.
    assert!(formulas[0].ends_with("+ J1_I_m"), "{}", formulas[0]);
    assert_eq!(formulas[40], "J2_f1");
    let position = |name: &str| base.kept.iter().position(|id| id.to_string() == name).expect("kept");
    assert!(formulas[position("J2_Izz")].contains("+ 0.0729 J3_m"), "{}", formulas[position("J2_Izz")]);
    assert!(formulas[position("J2_Izz")].ends_with("+ J2_I_m"));
    assert_eq!(base.grouping_formula(64), "");
}

#[test]
fn a_twist_rounded_to_five_digits_adds_no_parameters() {
    let mut robot = er3a();
    for joint in 0..6 {
        change_dh(&mut robot, joint, |row| row.alpha = (row.alpha * 1e4).round() / 1e4);
    }
    assert!(robot.joints[1].geometry.placement().rotation.m33.abs() > 1e-6);
    let base = base_parameters(&robot).expect("base parameters");
    assert_eq!(names(&base.kept), er3a_names());
    assert!(base.singular_value_gap.largest_dropped > 1e-9);
}

#[test]
fn a_ceiling_keeps_the_set_and_a_wall_shows_the_first_moments_of_link_1() {
    let mut robot = er3a();
    robot.gravity = Vector3::new(0.0, 0.0, 9.81);
    assert_eq!(names(&base_parameters(&robot).expect("ceiling").kept), er3a_names());
    robot.gravity = Vector3::new(9.81, 0.0, 0.0);
    let wall = base_parameters(&robot).expect("wall");
    assert_eq!(names(&wall.kept)[..3], ["J1_mPx", "J1_mPy", "J1_Izz"]);
    assert_eq!((wall.inertial_rank, wall.rank), (38, 66));
}

#[test]
fn a_planar_arm_of_two_links_has_its_textbook_set() {
    let robot = arm(
        vec![joint(Revolute, 0.0, 0.0, 0.0, 0.0), joint(Revolute, 0.5, 0.0, 0.0, 0.0)],
        [0.0, -9.81, 0.0],
    );
    let base = base_parameters(&robot).expect("base parameters");
    let friction = (1..=2).flat_map(|j| (1..=4).map(move |k| format!("J{j}_f{k}")));
    let mut expected: Vec<String> =
        ["J1_mPx + 0.5 J2_m", "J1_mPy", "J1_Izz + 0.25 J2_m + J1_I_m", "J2_mPx", "J2_mPy", "J2_Izz"]
            .map(String::from)
            .to_vec();
    expected.extend(friction);
    expected.push("J2_I_m".into());
    assert_eq!(formulas(&base), expected);
    assert_eq!((base.inertial_rank, base.inertial_and_motor_rank), (6, 7));
}

#[test]
fn a_parallelogram_leaves_the_first_moment_of_its_crank_and_a_preload_is_an_offset() {
    let mut robot = arm(
        vec![joint(Revolute, 0.0, 0.0, 0.0, 0.0), joint(Revolute, 0.5, 0.0, 0.0, 0.0)],
        [0.0, -9.81, 0.0],
    );
    let joints = [0, 1].map(JointIndex::new);
    robot.friction =
        FrictionModel { law: FrictionLaw::ViscousCoulomb, asymmetric: false, load: LoadFriction::None };
    robot.springs = vec![Spring { joint: joints[1], form: SpringForm::Direct, nominal: None }];
    robot.parallelograms = vec![Parallelogram::new(&robot.joints, joints[1], None).expect("parallel axes")];
    let base = base_parameters(&robot).expect("base parameters");
    let formulas = formulas(&base);
    // the crank turns with the forearm, but the other links do not carry it: only its weight is independent
    assert_eq!(formulas[3..6], ["J2_mPx", "J2_mPy", "J2_Izz + J2_c_Izz"], "{formulas:?}");
    assert!(formulas.contains(&"J2_off + J2_t_s".to_owned()), "{formulas:?}");
    assert_eq!(formulas[formulas.len() - 3..], ["J2_k_s", "J2_c_mPx", "J2_c_mPy"], "{formulas:?}");
    assert_eq!(Parallelogram::new(&robot.joints, joints[0], None), None);
    robot.joints[1] = joint(Revolute, 0.5, FRAC_PI_2, 0.0, 0.0);
    assert_eq!(Parallelogram::new(&robot.joints, joints[1], None), None);
}

#[test]
fn a_level_slide_adds_up_masses_and_a_lift_tells_the_motor_apart() {
    let level = arm(
        vec![joint(Prismatic, 0.0, FRAC_PI_2, 0.0, 0.0), joint(Prismatic, 0.0, FRAC_PI_2, 0.0, 0.0)],
        [0.0, 0.0, -9.81],
    );
    // Joint 1 slides horizontally and joint 2, at right angles to it, vertically.
    let base = base_parameters(&level).expect("base parameters");
    let friction = (1..=2).flat_map(|j| (1..=4).map(move |k| format!("J{j}_f{k}")));
    let mut expected = vec!["J1_m + J1_I_m".to_string(), "J2_m".to_string()];
    expected.extend(friction);
    expected.push("J2_I_m".into());
    assert_eq!(formulas(&base), expected);
    assert_eq!(base.unobservable.len(), 18);
}

#[test]
fn a_chain_without_joints_or_with_endless_limits_is_refused() {
    let empty = arm(Vec::new(), [0.0, 0.0, -9.81]);
    assert!(matches!(base_parameters(&empty), Err(NumericsError::TooShort { .. })));
    let mut endless = er3a();
    endless.joints[2].limits.velocity = f64::INFINITY;
    assert!(matches!(base_parameters(&endless), Err(NumericsError::NotFinite(_))));
}

#[test]
fn a_count_that_the_singular_values_contradict_is_refused() {
    let columns = [vec![1.0, 0.0, 0.0], vec![0.0, 1.0, 0.0], vec![0.6, 0.8, 0.0]];
    assert_eq!(confirm_rank(2, &columns).map(|c| c.rank), Ok(2));
    assert!(matches!(confirm_rank(3, &columns), Err(NumericsError::RankUnclear { kept: 3, rank: 2, .. })));
}

#[test]
fn probe_states_fill_the_limits_and_never_repeat() {
    let robot = er3a();
    let states: Vec<JointState> = (0..PROBE_STATES).map(|index| probe_state(&robot, index)).collect();
    for (j, joint) in robot.joints.iter().enumerate() {
        let limits = &joint.limits;
        let mut q: Vec<f64> = states.iter().map(|state| state.q[j]).collect();
        q.sort_by(f64::total_cmp);
        assert!(q[0] >= limits.position_min && q[PROBE_STATES - 1] <= limits.position_max);
        let widest = q.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        // An even grid would leave 1/256; a Kronecker sequence stays within a few times that.
        assert!(widest < 0.02 * (limits.position_max - limits.position_min), "joint {j}: {widest}");
        assert!(q.windows(2).all(|pair| pair[1] > pair[0]));
        assert!(states.iter().all(|state| state.qd[j].abs() <= limits.velocity));
        assert!(states.iter().all(|state| state.qdd[j].abs() <= limits.acceleration));
    }
}

proptest! {
    // Each case factorises up to 2304 x 135.
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn grouping_leaves_the_torque_unchanged(robot in any_arm(), phi in numbers()) {
        let base = base_parameters(&robot).map_err(|e| TestCaseError::fail(e.to_string()))?;
        let change = torque_change(&robot, &base, &phi);
        prop_assert!(change < GROUPING_TOLERANCE, "{change} {:?}", base.singular_value_gap);
        prop_assert!(base.rank < robot.parameter_count());
        prop_assert_eq!(base.kept.len(), base.rank);
    }
}

#[test]
fn grouping_leaves_the_er3a_unchanged_and_matters() {
    let robot = er3a();
    let base = base_parameters(&robot).expect("base parameters");
    let phi: Vec<f64> = (0..90).map(|k| 0.3 + (f64::from(k) * 2_f64.sqrt()).fract()).collect();
    assert!(torque_change(&robot, &base, &phi) < GROUPING_TOLERANCE);
    let mut without = base.clone();
    without.grouping.iter_mut().for_each(Vec::clear);
    assert!(torque_change(&robot, &without, &phi) > 0.1);
}
