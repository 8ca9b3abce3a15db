use proptest::prelude::*;

use super::*;
use crate::model::kinematics::forward_kinematics;
use armwatch_testing::arms::{any_arm, arm, joint, numbers};
use armwatch_testing::{change_dh, er3a};

/// Precision of the reference, which has twelve digits.
const REFERENCE_DIGITS: f64 = 1e-9;
/// Tolerance of fourth-order central differences over [`STEP`]: truncation and rounding are both smaller.
const DIFFERENCES: f64 = 1e-8;
/// Step of a numeric derivative, rad or s.
const STEP: f64 = 1e-3;
/// Rounding of a few hundred operations.
const ROUNDING: f64 = 1e-12;

fn slope(f: impl Fn(f64) -> f64, step: f64) -> f64 {
    (8.0 * (f(step) - f(-step)) - (f(2.0 * step) - f(-2.0 * step))) / (12.0 * step)
}

fn nominal(robot: &Robot) -> Vec<StandardParameters> {
    robot.joints.iter().map(|j| j.nominal.expect("the ER3A has nominal parameters").inertial).collect()
}

fn model(robot: &Robot, phi: &[f64]) -> DynamicModel {
    let ids = ParameterId::natural_order(robot);
    DynamicModel::from_parameters(robot, ids.into_iter().zip(phi.iter().copied()))
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[test]
fn the_er3a_agrees_with_pinocchio() {
    let robot = er3a();
    let parameters = nominal(&robot);
    let reference = include_str!("../../../../../tests/reference/er3a_inverse_dynamics.csv");
    let mut rows = 0;
    for line in reference.lines().skip(1) {
        let row: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let (q, qd, qdd, expected) = (&row[..6], &row[6..12], &row[12..18], &row[18..24]);
        let mut tau = [0.0; 6];
        inverse_dynamics(&robot, &parameters, q, qd, qdd, &mut tau);
        let deviation: Vec<f64> = tau.iter().zip(expected).map(|(a, b)| a - b).collect();
        assert!(norm(&deviation) < REFERENCE_DIGITS * norm(expected), "row {rows}: {deviation:?}");
        let pose = forward_kinematics(&robot, q);
        assert!((pose.translation - Vector3::from_column_slice(&row[24..27])).norm() < REFERENCE_DIGITS);
        assert!((pose.rotation - nalgebra::Matrix3::from_row_slice(&row[27..36])).norm() < REFERENCE_DIGITS);
        rows += 1;
    }
    assert_eq!(rows, 60);
}

#[test]
fn a_pendulum_takes_its_textbook_torque() {
    // A rod along x of its frame; the axis is horizontal.
    let robot = arm(vec![joint(JointKind::Revolute, 0.0, 0.0, 0.0, 0.0)], [0.0, -9.81, 0.0]);
    let (mass, length, inertia) = (2.0, 0.4, 0.5);
    let mut rod = StandardParameters::default();
    (rod.0[0], rod.0[1], rod.0[9]) = (mass, mass * length, inertia);
    let mut tau = [0.0];
    inverse_dynamics(&robot, &[rod], &[0.3], &[2.0], &[1.5], &mut tau);
    let expected = inertia * 1.5 + mass * 9.81 * length * 0.3_f64.cos();
    assert!((tau[0] - expected).abs() < ROUNDING * expected);
}

#[test]
fn a_lift_takes_weight_and_acceleration_whatever_its_speed() {
    let robot = arm(vec![joint(JointKind::Prismatic, 0.0, 0.0, 0.2, 0.0)], [0.0, 0.0, -9.81]);
    let mut box_ = StandardParameters::default();
    (box_.0[0], box_.0[1]) = (3.0, 0.6);
    let mut tau = [0.0];
    inverse_dynamics(&robot, &[box_], &[0.4], &[1.2], &[0.7], &mut tau);
    assert!((tau[0] - 3.0 * (9.81 + 0.7)).abs() < ROUNDING * 30.0);
}

#[test]
fn a_mass_sliding_on_a_turntable_feels_coriolis_and_centrifugal_force() {
    // The slide's z axis is horizontal and turns with the table: tau = 2 m r w v, f = -m r w^2.
    let robot = arm(
        vec![
            joint(JointKind::Revolute, 0.0, 0.0, 0.0, 0.0),
            joint(JointKind::Prismatic, 0.0, std::f64::consts::FRAC_PI_2, 0.0, 0.0),
        ],
        [0.0, 0.0, -9.81],
    );
    let mut point = StandardParameters::default();
    point.0[0] = 1.7;
    let (r, w, v) = (0.6, 2.5, 0.8);
    let mut tau = [0.0; 2];
    inverse_dynamics(
        &robot,
        &[StandardParameters::default(), point],
        &[0.4, r],
        &[w, v],
        &[0.0, 0.0],
        &mut tau,
    );
    assert!((tau[0] - 2.0 * 1.7 * r * w * v).abs() < ROUNDING * 10.0, "{tau:?}");
    assert!((tau[1] + 1.7 * r * w * w).abs() < ROUNDING * 10.0, "{tau:?}");
}

#[test]
fn hanging_from_the_ceiling_is_a_base_turned_over() {
    let mut ceiling = er3a();
    ceiling.gravity = Vector3::new(0.0, 0.0, 9.81);
    let mut turned = er3a();
    change_dh(&mut turned, 0, |row| row.alpha += std::f64::consts::PI);
    let parameters = nominal(&ceiling);
    let (q, qd, qdd) = (
        [0.3, -0.4, 0.5, 0.6, -0.7, 0.8],
        [1.0, -2.0, 1.5, 2.0, -1.0, 3.0],
        [4.0, -3.0, 2.0, -1.0, 5.0, 6.0],
    );
    let (mut a, mut b) = ([0.0; 6], [0.0; 6]);
    inverse_dynamics(&ceiling, &parameters, &q, &qd, &qdd, &mut a);
    inverse_dynamics(&turned, &parameters, &q, &qd, &qdd, &mut b);
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() < ROUNDING * 20.0);
    }
    let (mut floor, mut hanging) = ([0.0; 6], [0.0; 6]);
    gravity_torque(&er3a(), &parameters, &q, &mut floor);
    gravity_torque(&ceiling, &parameters, &q, &mut hanging);
    assert!(norm(&floor) > 1.0);
    for (a, b) in floor.iter().zip(hanging) {
        assert!((a + b).abs() < ROUNDING * 20.0);
    }
}

proptest! {
    #[test]
    fn gravity_torque_is_the_gradient_of_potential_energy(
        robot in any_arm(), phi in numbers(), q in numbers(),
    ) {
        let n = robot.joint_count();
        let model = model(&robot, &phi);
        let still = vec![0.0; n];
        let mut tau = vec![0.0; n];
        model.load(&robot, &q, &still, &still, &mut tau);
        for j in 0..n {
            let gradient = slope(|step| {
                let mut q = q[..n].to_vec();
                q[j] += step;
                mechanical_energy(&robot, &model, &q, &still).potential
            }, STEP);
            prop_assert!((tau[j] - gradient).abs() < DIFFERENCES * (1.0 + norm(&tau)));
        }
    }

    #[test]
    fn the_power_of_the_torques_is_the_rate_of_energy(
        robot in any_arm(), phi in numbers(), q in numbers(), qd in numbers(), qdd in numbers(),
    ) {
        let n = robot.joint_count();
        let model = model(&robot, &phi);
        let mut tau = vec![0.0; n];
        model.load(&robot, &q, &qd, &qdd, &mut tau);
        let power: f64 = tau.iter().zip(&qd).map(|(tau, qd)| tau * qd).sum();
        let rate = slope(|t| {
            let q: Vec<f64> = (0..n).map(|i| q[i] + qd[i] * t + 0.5 * qdd[i] * t * t).collect();
            let qd: Vec<f64> = (0..n).map(|i| qd[i] + qdd[i] * t).collect();
            let energy = mechanical_energy(&robot, &model, &q, &qd);
            energy.kinetic + energy.potential
        }, STEP);
        prop_assert!((power - rate).abs() < DIFFERENCES * (1.0 + norm(&tau)), "{power} {rate}");
    }

    #[test]
    fn a_model_adds_friction_motor_inertia_and_couplings_to_the_links(
        robot in any_arm(), phi in numbers(), q in numbers(), qd in numbers(), qdd in numbers(),
    ) {
        let n = robot.joint_count();
        let model = model(&robot, &phi);
        let (mut whole, mut rigid) = (vec![0.0; n], vec![0.0; n]);
        model.torque(&robot, &q, &qd, &qdd, &mut whole);
        model.load(&robot, &q, &qd, &qdd, &mut rigid);
        let terms = robot.friction.terms().len();
        let mut extra: Vec<f64> = (0..n)
            .map(|j| {
                let columns = robot.friction.columns(qd[j]);
                let friction: f64 =
                    (0..terms).map(|k| columns[k] * phi[10 * n + terms * j + k]).sum();
                friction + phi[(10 + terms) * n + j] * qdd[j]
            })
            .collect();
        for (k, coupling) in robot.couplings.iter().enumerate() {
            let columns = coupling_columns(coupling, robot.friction.law, &qd, &qdd);
            for term in 0..3 {
                let value = phi[(11 + terms) * n + 3 * k + term];
                extra[coupling.joint.index()] += columns.joint[term] * value;
                extra[coupling.motor_joint.index()] += columns.motor_joint[term] * value;
            }
        }
        for j in 0..n {
            prop_assert!((whole[j] - rigid[j] - extra[j]).abs() < ROUNDING * (1.0 + norm(&rigid)));
        }
    }
}
