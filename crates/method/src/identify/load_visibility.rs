//! Check that a motion shows load-dependent friction: load and speed of a joint must vary independently.

use super::joint_factors::FactorColumns;
use crate::NumericsError;
use crate::least_squares::orthonormal::{OrthonormalBasis, norm};
use crate::model::base_parameters::{JointState, base_parameters};
use crate::model::dynamics::DynamicModel;
use crate::model::regressor::{Regressor, joint_torque_regressor, load_places, write_load_columns};
use armwatch_model::robot::{
    FrictionLaw, FrictionModel, JointIndex, LoadFriction, ParameterId, ParameterKind, Robot,
};

/// Smallest new part of a column with an independent direction.
const DEPENDENT: f64 = 1e-9;

/// Speed of the additional friction at low speed, as a part of the joint's largest speed.
const STRIBECK_SPEED: f64 = 0.05;

/// Smallest independent part of the load column in a motion that shows it. Below it, the standard error of `mu` is more
/// than ten times that of a motion with independent load and speed.
pub const LEAST_OWN_PART: f64 = 0.1;

/// Visibility of a joint's friction under load in a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadVisibility {
    /// The joint.
    pub joint: JointIndex,
    /// Largest torque of the gear while the joint moves, Nm (N).
    pub largest_load: f64,
    /// Part of the column `|L| sign(v)` that the other columns of the joint do not explain, 0 to 1.
    pub own_part: f64,
}

/// Visibility of `mu |L| sign(v)` by joint in the states of a motion, with the bodies of the description; `None`
/// without such bodies. Joints without friction are omitted.
///
/// # Errors
/// Those of [`base_parameters`].
pub fn load_visibility(
    robot: &Robot,
    states: &[JointState],
) -> Result<Option<Vec<LoadVisibility>>, NumericsError> {
    let robot = &with_load(robot, |_| LoadFriction::Linear);
    let mut bodies = DynamicModel::from_parameters(robot, std::iter::empty());
    for (body, joint) in bodies.inertial.iter_mut().zip(&robot.joints) {
        let Some(nominal) = joint.nominal else { return Ok(None) };
        *body = nominal.inertial;
    }
    bodies.grouped_motor_inertia.fill(0.0);
    let base = base_parameters(robot)?;
    let columns = FactorColumns::new(robot, &base);
    let mut y = Regressor::new(robot);
    let mut load = vec![0.0; robot.joint_count()];
    let mut rows: Vec<Vec<Vec<f64>>> =
        robot.joint_indices().map(|joint| vec![Vec::new(); columns.places(joint).len()]).collect();
    let mut largest = vec![0.0_f64; robot.joint_count()];
    for JointState { q, qd, qdd } in states {
        joint_torque_regressor(robot, q, qd, qdd, &mut y);
        bodies.gear_load(robot, q, qd, qdd, &mut load);
        write_load_columns(robot, qd, &load, &mut y);
        for joint in
            robot.joint_indices().filter(|j| qd[j.index()].abs() >= robot.joints[j.index()].low_speed)
        {
            let j = joint.index();
            largest[j] = largest[j].max(load[j].abs());
            for (column, &place) in rows[j].iter_mut().zip(columns.places(joint)) {
                column.push(y.column(base.kept_columns[place])[j]);
            }
        }
    }
    let of_joint = |(joint, first): (JointIndex, usize)| {
        let j = joint.index();
        let places = columns.places(joint);
        let at = places.iter().position(|&place| base.kept_columns[place] == first)?;
        let mut basis = OrthonormalBasis::default();
        let others = rows[j].iter().enumerate().filter(|(k, _)| *k != at);
        others.for_each(|(_, column)| basis.add(column, DEPENDENT));
        let whole = norm(&rows[j][at]);
        let own_part = if whole > 0.0 { basis.rest(&rows[j][at]).length / whole } else { 0.0 };
        Some(LoadVisibility { joint, largest_load: largest[j], own_part })
    };
    Ok(Some(load_places(robot).filter_map(of_joint).collect()))
}

/// Arm with this load law in all joints that have friction.
pub(crate) fn with_load(robot: &Robot, of: fn(f64) -> LoadFriction) -> Robot {
    let mut changed = robot.clone();
    for (joint, index) in changed.joints.iter_mut().zip(robot.joint_indices()) {
        let model = robot.friction_of(index);
        let speed = model.load.speed().unwrap_or(STRIBECK_SPEED * joint.limits.velocity);
        let load = if model.law == FrictionLaw::None { LoadFriction::None } else { of(speed) };
        joint.friction = Some(FrictionModel { load, ..model });
    }
    changed
}

/// Returns true if a parameter is a coefficient of friction under load.
pub(crate) fn is_of_load(id: ParameterId) -> bool {
    matches!(id.kind, ParameterKind::Friction(term) if term.is_of_load())
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    /// Motion of the shoulder with position and speed from `posture`, which also determine its load.
    fn states(posture: impl Fn(f64) -> [f64; 2]) -> Vec<JointState> {
        (0..400)
            .map(|k| {
                let t = f64::from(k) / 40.0;
                let [q, qd] = posture(t);
                JointState {
                    q: vec![0.0, q, 0.3, 0.0, 0.2, 0.0],
                    qd: vec![0.0, qd, 0.0, 0.0, 0.0, 0.0],
                    qdd: vec![0.0; 6],
                }
            })
            .collect()
    }

    fn shoulder(states: &[JointState]) -> LoadVisibility {
        let found = load_visibility(&er3a(), states).expect("base parameters").expect("bodies");
        found[1]
    }

    #[test]
    fn a_load_that_hardly_changes_looks_like_coulomb_friction() {
        // the same small arc at any speed: the load is nearly constant
        let narrow = shoulder(&states(|t| [0.02 * (7.0 * t).sin(), 0.14 * (7.0 * t).cos() * (1.0 + t)]));
        assert!(narrow.own_part < LEAST_OWN_PART && narrow.largest_load > 1.0, "{narrow:?}");
        let wide = shoulder(&states(|t| {
            [1.2 * (1.3 * t).sin(), 1.56 * (1.3 * t).cos() * (1.0 + 0.3 * (5.0 * t).sin())]
        }));
        assert!(wide.own_part > LEAST_OWN_PART, "{wide:?}");
    }
}
