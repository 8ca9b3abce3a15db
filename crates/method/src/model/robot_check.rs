//! Check of a robot description: geometry, base parameters, identities, and the agreement with external torques and
//! poses.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::base_parameters::{BaseParameters, JointState, PROBE_STATES, base_parameters, probe_state};
use super::dynamics::{DynamicModel, inverse_dynamics, mechanical_energy};
use super::kinematics::forward_kinematics;
use super::regressor::{Regressor, joint_torque_regressor, write_load_columns};
use crate::NumericsError;
use armwatch_model::robot::{ParameterId, ParameterKind, Robot, StandardParameters, Transform};

/// Number of states of the self-check; none of them was used to find the base parameters.
pub const CHECK_STATES: usize = 32;

/// Step of the numeric derivatives, s or rad. Fourth-order central differences then agree with exact derivatives to
/// about 1e-8 at the largest speeds of usual arms.
const STEP: f64 = 2e-4;

/// Result of a check of a robot description.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotCheck {
    /// The description that was checked.
    pub robot: Robot,
    /// Last frame in the base with all joints at position 0.
    pub pose_at_zero: Transform,
    /// Parameters that the arm's torques can show.
    pub base: BaseParameters,
    /// Agreement of the formulas with each other on this robot.
    pub identities: IdentityCheck,
}

/// Largest differences between two methods for the same number, over [`CHECK_STATES`] states and arbitrary parameters,
/// relative to the norm of the torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentityCheck {
    /// Number of states.
    pub states: usize,
    /// Regressor times parameters against inverse dynamics.
    pub regressor: f64,
    /// Base parameters against the full set.
    pub grouping: f64,
    /// Gravity torque against the numeric gradient of potential energy. Also relative to the torque of the whole
    /// motion, so that it is meaningful if gravity does no work.
    pub gravity: f64,
    /// Power of the torques against the numeric rate of energy, relative to the sum of the joints'
    /// absolute powers.
    pub power: f64,
}

/// Torque and pose of a robot in one state, from an external source.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceRow {
    /// Position `[n]`, rad (m).
    pub q: Vec<f64>,
    /// Velocity `[n]`, rad/s (m/s).
    pub qd: Vec<f64>,
    /// Acceleration `[n]`, rad/s² (m/s²).
    pub qdd: Vec<f64>,
    /// Torque of the rigid links, without friction and motor inertia `[n]`, Nm (N).
    pub tau: Vec<f64>,
    /// Origin of the last frame in the base, m.
    pub position: Vector3<f64>,
    /// Axes of the last frame as columns, in the base.
    pub rotation: Matrix3<f64>,
}

/// Largest relative differences between a description and reference rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReferenceAgreement {
    /// Number of rows.
    pub rows: usize,
    /// Torque, relative to the norm of the row's torques; `None` if a joint of the description has no
    /// nominal parameters.
    pub torque: Option<f64>,
    /// Position, relative to the norm of the row's position.
    pub position: f64,
    /// Rotation matrix, relative to its norm.
    pub rotation: f64,
}

/// Checks a robot description: pose at zero, base parameters, identities.
///
/// # Errors
/// Those of [`base_parameters`].
pub fn check(robot: &Robot) -> Result<RobotCheck, NumericsError> {
    let base = base_parameters(robot)?;
    Ok(RobotCheck {
        pose_at_zero: forward_kinematics(robot, &vec![0.0; robot.joint_count()]),
        identities: check_identities(robot, &base),
        base,
        robot: robot.clone(),
    })
}

/// Compares a description and its nominal inertial parameters with external rows.
///
/// # Errors
/// [`NumericsError::TooShort`] without rows, or if a row has fewer channels than the robot joints.
pub fn compare_with_reference(
    robot: &Robot,
    rows: &[ReferenceRow],
) -> Result<ReferenceAgreement, NumericsError> {
    let n = robot.joint_count();
    if rows.is_empty() {
        return Err(NumericsError::TooShort { what: "the reference", rows: 0, needed: 1 });
    }
    let channels = |row: &ReferenceRow| [&row.q, &row.qd, &row.qdd, &row.tau].map(Vec::len);
    if let Some(&rows) = rows.iter().flat_map(channels).collect::<Vec<_>>().iter().find(|&&len| len < n) {
        return Err(NumericsError::TooShort { what: "a channel of a reference row", rows, needed: n });
    }
    let parameters: Option<Vec<StandardParameters>> =
        robot.joints.iter().map(|joint| joint.nominal.map(|nominal| nominal.inertial)).collect();
    let poses: Vec<Transform> = rows.iter().map(|row| forward_kinematics(robot, &row.q)).collect();
    let pairs = || rows.iter().zip(&poses);
    Ok(ReferenceAgreement {
        rows: rows.len(),
        torque: parameters.map(|parameters| {
            worst(rows.iter().map(|row| {
                let mut tau = vec![0.0; n];
                inverse_dynamics(robot, &parameters, &row.q, &row.qd, &row.qdd, &mut tau);
                relative(distance(&tau, &row.tau), norm(&row.tau))
            }))
        }),
        position: worst(
            pairs()
                .map(|(row, pose)| relative((pose.translation - row.position).norm(), row.position.norm())),
        ),
        rotation: worst(
            pairs().map(|(row, pose)| relative((pose.rotation - row.rotation).norm(), row.rotation.norm())),
        ),
    })
}

fn check_identities(robot: &Robot, base: &BaseParameters) -> IdentityCheck {
    let n = robot.joint_count();
    let ids = ParameterId::natural_order(robot);
    // Any numbers are suitable, since every identity is linear in them; bodies may be unphysical.
    let phi: Vec<f64> = (1..=ids.len()).map(|k| 0.1 + (k as f64 * 2_f64.sqrt()).fract()).collect();
    let full = DynamicModel::from_parameters(robot, ids.iter().copied().zip(phi.iter().copied()));
    let mut grouped = DynamicModel::from_parameters(robot, base.kept.iter().copied().zip(base.group(&phi)));
    // these parameters contain another motor inertia than the description
    let motors = grouped.grouped_motor_inertia.iter_mut().zip(&full.motor_inertia).zip(robot.joint_indices());
    for ((grouped, motor), joint) in motors {
        let id = ParameterId { joint, kind: ParameterKind::MotorInertia };
        *grouped = if base.kept.contains(&id) { 0.0 } else { *motor };
    }
    let mut result =
        IdentityCheck { states: CHECK_STATES, regressor: 0.0, grouping: 0.0, gravity: 0.0, power: 0.0 };
    let mut y = Regressor::new(robot);
    let [mut expected, mut other, mut load] = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
    for index in PROBE_STATES..PROBE_STATES + CHECK_STATES {
        let state = probe_state(robot, index);
        full.torque(robot, &state.q, &state.qd, &state.qdd, &mut expected);
        joint_torque_regressor(robot, &state.q, &state.qd, &state.qdd, &mut y);
        full.gear_load(robot, &state.q, &state.qd, &state.qdd, &mut load);
        write_load_columns(robot, &state.qd, &load, &mut y);
        y.torque(&phi, &mut other);
        result.regressor = larger(result.regressor, relative(distance(&other, &expected), norm(&expected)));
        grouped.torque(robot, &state.q, &state.qd, &state.qdd, &mut other);
        result.grouping = larger(result.grouping, relative(distance(&other, &expected), norm(&expected)));
        result.gravity =
            larger(result.gravity, relative(gravity_difference(robot, &full, &state), norm(&expected)));
        result.power = larger(result.power, power_difference(robot, &full, &state));
    }
    result
}

/// Difference between gravity torque and the numeric gradient, over all joints, Nm.
fn gravity_difference(robot: &Robot, model: &DynamicModel, state: &JointState) -> f64 {
    let n = robot.joint_count();
    let mut tau = vec![0.0; n];
    let still = vec![0.0; n];
    model.load(robot, &state.q, &still, &still, &mut tau);
    let gradient: Vec<f64> = (0..n)
        .map(|j| {
            numeric_slope(|step| {
                let mut q = state.q.clone();
                q[j] += step;
                mechanical_energy(robot, model, &q, &still).potential
            })
        })
        .collect();
    distance(&tau, &gradient)
}

fn power_difference(robot: &Robot, model: &DynamicModel, state: &JointState) -> f64 {
    let n = robot.joint_count();
    let mut tau = vec![0.0; n];
    model.load(robot, &state.q, &state.qd, &state.qdd, &mut tau);
    let powers: Vec<f64> = tau.iter().zip(&state.qd).map(|(tau, qd)| tau * qd).collect();
    let rate = numeric_slope(|t| {
        let qd: Vec<f64> = state.qd.iter().zip(&state.qdd).map(|(qd, qdd)| qd + qdd * t).collect();
        // mean of the speeds at both ends, since the acceleration is constant
        let q: Vec<f64> = (0..n).map(|j| state.q[j] + 0.5 * (state.qd[j] + qd[j]) * t).collect();
        let energy = mechanical_energy(robot, model, &q, &qd);
        energy.kinetic + energy.potential
    });
    relative((powers.iter().sum::<f64>() - rate).abs(), powers.iter().map(|p| p.abs()).sum())
}

/// Derivative at 0 by central differences of fourth order.
fn numeric_slope(f: impl Fn(f64) -> f64) -> f64 {
    (8.0 * (f(STEP) - f(-STEP)) - (f(2.0 * STEP) - f(-2.0 * STEP))) / (12.0 * STEP)
}

/// `difference / size`; for a size of zero, the difference itself.
fn relative(difference: f64, size: f64) -> f64 {
    if size > 0.0 { difference / size } else { difference }
}

/// Larger number, or NaN if either is NaN: a difference that is not a number must not count as small.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

fn worst(differences: impl Iterator<Item = f64>) -> f64 {
    differences.fold(0.0, larger)
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::JointKind;
    use armwatch_testing::arms::{arm, joint};
    use armwatch_testing::{change_dh, er3a};

    /// Tolerance of exact identities: rounding, multiplied by a condition number for groupings.
    const ROUNDING: f64 = 1e-10;
    /// Tolerance of numeric derivatives; see [`STEP`].
    const DIFFERENCES: f64 = 1e-8;
    /// Precision of the reference, which has twelve digits.
    const REFERENCE_DIGITS: f64 = 1e-9;

    fn reference() -> Vec<ReferenceRow> {
        include_str!("../../../../tests/reference/er3a_inverse_dynamics.csv")
            .lines()
            .skip(1)
            .map(|line| {
                let row: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
                ReferenceRow {
                    q: row[..6].to_vec(),
                    qd: row[6..12].to_vec(),
                    qdd: row[12..18].to_vec(),
                    tau: row[18..24].to_vec(),
                    position: Vector3::from_column_slice(&row[24..27]),
                    rotation: Matrix3::from_row_slice(&row[27..36]),
                }
            })
            .collect()
    }

    #[test]
    fn the_er3a_passes_its_own_check() {
        let check = check(&er3a()).expect("a check");
        let identities = check.identities;
        assert!(identities.regressor < ROUNDING && identities.grouping < ROUNDING, "{identities:?}");
        assert!(identities.gravity < DIFFERENCES && identities.power < DIFFERENCES, "{identities:?}");
        // Differences of exactly zero would mean that nothing was compared.
        assert!(identities.regressor > 0.0 && identities.grouping > 0.0);
        assert!(identities.gravity > 0.0 && identities.power > 0.0);
    }

    #[test]
    fn an_arm_on_which_gravity_does_no_work_passes() {
        let joints = [0.0, 0.3, 0.25].map(|a| joint(JointKind::Revolute, a, 0.0, 0.1, 0.0)).to_vec();
        let check = check(&arm(joints, [0.0, 0.0, -9.81])).expect("a check");
        assert!(check.identities.gravity < DIFFERENCES, "{:?}", check.identities);
        assert!(check.identities.power > 0.0 && check.identities.power < DIFFERENCES);
    }

    #[test]
    fn a_grouping_that_is_wrong_shows_in_the_check() {
        let robot = er3a();
        let mut base = base_parameters(&robot).expect("base parameters");
        base.grouping[1][0].coefficient *= 1.01;
        assert!(check_identities(&robot, &base).grouping > 1e-5);
    }

    #[test]
    fn the_er3a_agrees_with_the_reference_and_a_wrong_length_does_not() {
        let rows = reference();
        let mut robot = er3a();
        let agreement = compare_with_reference(&robot, &rows).expect("a comparison");
        assert_eq!(agreement.rows, 60);
        assert!(agreement.torque.is_some_and(|t| t < REFERENCE_DIGITS), "{agreement:?}");
        assert!(agreement.position < REFERENCE_DIGITS && agreement.rotation < REFERENCE_DIGITS);
        change_dh(&mut robot, 2, |row| row.a += 0.001);
        let wrong = compare_with_reference(&robot, &rows).expect("a comparison");
        assert!(wrong.torque.is_some_and(|t| t > 1e-4) && wrong.position > 1e-4, "{wrong:?}");
        change_dh(&mut robot, 3, |row| row.theta_offset = 0.0);
        assert!(compare_with_reference(&robot, &rows).expect("a comparison").rotation > 0.1);
        robot.joints[5].nominal = None;
        assert_eq!(compare_with_reference(&robot, &rows).expect("a comparison").torque, None);
    }

    #[test]
    fn a_reference_without_rows_or_with_short_rows_is_refused() {
        let mut rows = reference();
        rows[3].tau.pop();
        assert!(matches!(
            compare_with_reference(&er3a(), &rows),
            Err(NumericsError::TooShort { rows: 5, needed: 6, .. })
        ));
        assert!(compare_with_reference(&er3a(), &[]).is_err());
    }

    #[test]
    fn a_torque_that_is_no_number_is_not_called_agreement() {
        let mut rows = reference();
        rows[7].tau[2] = f64::NAN;
        let agreement = compare_with_reference(&er3a(), &rows).expect("a comparison");
        assert!(agreement.torque.is_some_and(f64::is_nan), "{agreement:?}");
    }

    #[test]
    fn the_text_shows_geometry_limits_pose_and_groupings() {
        let text = check(&er3a()).expect("a check").to_string();
        for line in [
            "Robot er3a, 6 joints",
            "Gravity in the base frame: (0, 0, -9.81) m/s^2",
            "    4  revolute        0.07          90        0.3                180",
            "    6  deg         -360        360          420             1080",
            "  origin  (0.4285, 0, 0.66) m",
            "Base parameters: 64 of 90",
            "  rank 36 inertial, 40 with motor inertia, 64 with friction",
            "   2  J2_mPx   kg m          J2_mPx + 0.27 J3_m + 0.27 J4_m + 0.27 J5_m + 0.27 J6_m",
            "  40  J1_f4    Nm s^3/rad^3  J1_f4",
        ] {
            assert!(text.lines().any(|l| l == line), "no line {line:?} in\n{text}");
        }
    }

    #[test]
    fn sliding_joints_are_told_in_metres() {
        let robot = arm(
            vec![
                joint(JointKind::Prismatic, 0.0, 0.0, 0.25, 0.0),
                joint(JointKind::Revolute, 0.1, 0.0, 0.0, 0.0),
            ],
            [0.0, 0.0, -9.81],
        );
        let text = check(&robot).expect("a check").to_string();
        for line in [
            "    1  prismatic          0           0       0.25                  0",
            "    1  m           -0.2        0.8          1.5                6",
            "   1  J1_m     kg            J1_m + J2_m",
        ] {
            assert!(text.lines().any(|l| l == line), "no line {line:?} in\n{text}");
        }
    }
}
