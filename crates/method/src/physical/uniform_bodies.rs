//! Start for arms with links of unknown mass: bodies of uniform density along the geometry.
//!
//! Each link without nominal inertia is a solid cylinder from its joint to the next one. Radii taper from `BASE_RADIUS`
//! of the reach at the base to half of that at the tip; each cylinder extends by one radius beyond both ends. The
//! density is the same for all. It is the least-squares solution for the measured torque: a factor of the bodies'
//! torque, with free friction and motor inertias. The motor inertias of that solution are the start for joints without
//! described ones: behind a gear of a hundred they are far larger than the inertia that a wrist carries, and the
//! geometry does not show them.

use faer::Mat;
use nalgebra::{Matrix3, Vector3};

use super::bodies::{NominalModel, seen_by_factor};
use crate::NumericsError;
use crate::least_squares::factor::TriangularFactor;
use crate::model::base_parameters::BaseParameters;
use crate::model::kinematics::joint_transform;
use armwatch_model::robot::{JointKind, ParameterId, ParameterKind, Robot, StandardParameters, Transform};

/// Radius of the first link over the arm's reach: 8 cm for a reach of a metre, typical of arms.
const BASE_RADIUS: f64 = 0.08;
/// Radius of the last link relative to the first.
const TAPER: f64 = 0.5;
/// Density before data correct it, kg/m³: an aluminium shell with steel gears. An arm of a metre weighs about 50 kg
/// with it.
const TYPICAL_DENSITY: f64 = 2000.0;
/// Largest factor that data may apply to the density; beyond it, the geometry does not help.
const DENSITY_RANGE: f64 = 10.0;
/// Smallest motor inertia relative to the inertia that the joint carries: gears are chosen to match the two.
const MOTOR_SHARE: f64 = 0.3;
/// Smallest motor inertia of a start, kg m² (kg).
const SMALLEST_MOTOR: f64 = 1e-4;
/// Reach of an arm whose axes all meet in a point, m.
const SMALLEST_REACH: f64 = 0.1;
/// Ridge of the density's least squares, relative to each column: linearly dependent columns share the solution, and
/// all others keep theirs.
const RIDGE: f64 = 1e-6;

armwatch_model::named_enum! {
    /// Source of the assumed body of a link.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum BodySource {
        /// Nominal inertia of the description.
        Description = "description",
        /// Cylinder of uniform density along the geometry.
        UniformBody = "uniform body",
    }
}

/// Start for `physical`.
#[derive(Debug, Clone, PartialEq)]
pub struct BodyStart {
    /// Links and motors, all positive.
    pub nominal: NominalModel,
    /// Source of each link `[n]`.
    pub sources: Vec<BodySource>,
    /// Density of the uniform bodies, kg/m³; `None` if there are none.
    pub density: Option<f64>,
}

/// Nominal bodies of the description, and uniform ones of fitted density for links without. The same fit gives the
/// motor inertias that the description lacks, but they are at least `MOTOR_SHARE` of the inertia that the joint carries
/// in the middle of all ranges.
///
/// `factor` is that of `[w | tau]` of the base parameters.
///
/// # Errors
/// [`NumericsError::NotFinite`] if the factor is not finite.
pub(crate) fn start(
    robot: &Robot,
    base: &BaseParameters,
    factor: &TriangularFactor,
) -> Result<BodyStart, NumericsError> {
    let sources: Vec<BodySource> = robot
        .joints
        .iter()
        .map(|joint| if joint.nominal.is_some() { BodySource::Description } else { BodySource::UniformBody })
        .collect();
    let mut inertial = uniform_bodies(robot, TYPICAL_DENSITY);
    let measured = measured_start(robot, base, factor, &inertial)?;
    inertial.iter_mut().for_each(|body| body.0 = body.0.map(|x| measured.density_scale * x));
    let made = sources.contains(&BodySource::UniformBody);
    let density = made.then_some(measured.density_scale * TYPICAL_DENSITY);
    for (body, joint) in inertial.iter_mut().zip(&robot.joints) {
        if let Some(nominal) = &joint.nominal {
            *body = nominal.inertial;
        }
    }
    let carried = carried_inertia(robot, &inertial);
    let motor =
        robot.joints.iter().zip(carried).zip(measured.motor_inertia).map(|((joint, carried), seen)| {
            let given = joint.nominal.map_or(0.0, |nominal| nominal.motor_inertia);
            if given > 0.0 { given } else { seen.max(MOTOR_SHARE * carried).max(SMALLEST_MOTOR) }
        });
    let motor_inertia = motor.collect();
    Ok(BodyStart { nominal: NominalModel { inertial, motor_inertia }, sources, density })
}

/// Cylinders of the given density (kg/m³) along the links `[n]`, about each link's own frame.
#[must_use]
pub fn uniform_bodies(robot: &Robot, density: f64) -> Vec<StandardParameters> {
    let n = robot.joint_count();
    let middle = middle_transforms(robot);
    let ends: Vec<Vector3<f64>> =
        (1..n).map(|next| middle[next].translation).chain([robot.tool.translation]).collect();
    let reach: f64 = middle.first().map_or(0.0, |first| first.translation.norm())
        + ends.iter().map(|end| end.norm()).sum::<f64>();
    let radius = |link: usize| {
        let along = link as f64 / (n.max(2) - 1) as f64;
        BASE_RADIUS * reach.max(SMALLEST_REACH) * (1.0 - (1.0 - TAPER) * along)
    };
    ends.iter().enumerate().map(|(link, end)| cylinder(end, radius(link), density)).collect()
}

/// Solid cylinder from a radius before the origin to a radius beyond `end`, m.
fn cylinder(end: &Vector3<f64>, radius: f64, density: f64) -> StandardParameters {
    let length = end.norm() + 2.0 * radius;
    let axis = if end.norm() > 0.0 { end / end.norm() } else { Vector3::z() };
    let mass = density * std::f64::consts::PI * radius * radius * length;
    let (along, across) =
        (0.5 * mass * radius * radius, mass * (3.0 * radius * radius + length * length) / 12.0);
    let inertia = Matrix3::identity() * across + axis * axis.transpose() * (along - across);
    StandardParameters::from_centre_of_mass(mass, &(end * 0.5), &inertia)
}

/// Frame of each joint in the previous one, with all joints in the middle of their ranges.
fn middle_transforms(robot: &Robot) -> Vec<Transform> {
    let middle =
        |limits: &armwatch_model::robot::JointLimits| 0.5 * (limits.position_min + limits.position_max);
    robot.joints.iter().map(|joint| joint_transform(joint, middle(&joint.limits))).collect()
}

/// Inertia about each joint's axis (mass for a sliding one) of everything it carries.
fn carried_inertia(robot: &Robot, bodies: &[StandardParameters]) -> Vec<f64> {
    let middle = middle_transforms(robot);
    let mut carried = vec![0.0; bodies.len()];
    let mut whole = StandardParameters::default();
    for (i, body) in bodies.iter().enumerate().rev() {
        whole = body.joined(&whole);
        carried[i] = match robot.joints[i].kind {
            JointKind::Revolute => whole.inertia().m33,
            JointKind::Prismatic => whole.mass(),
        };
        whole = whole.seen_from(&middle[i]);
    }
    carried
}

/// Start values that torques determine.
struct MeasuredStart {
    /// Factor on the density of the uniform bodies.
    density_scale: f64,
    /// Motor inertias `[n]`, of any sign.
    motor_inertia: Vec<f64>,
}

/// Best-fitting factor on the density of the `made` bodies of links without nominal inertia, and best-fitting motor
/// inertias, with free friction and couplings.
fn measured_start(
    robot: &Robot,
    base: &BaseParameters,
    factor: &TriangularFactor,
    made: &[StandardParameters],
) -> Result<MeasuredStart, NumericsError> {
    let ids = ParameterId::natural_order(robot);
    let map = seen_by_factor(base, factor, ids.len());
    let b = factor.columns();
    let (mut scaled, mut known) = (vec![0.0; ids.len()], vec![0.0; ids.len()]);
    for (k, id) in ids.iter().enumerate() {
        let ParameterKind::Inertial(place) = id.kind else { continue };
        let (link, place) = (id.joint.index(), usize::from(place));
        match &robot.joints[link].nominal {
            Some(nominal) => known[k] = nominal.inertial.0[place],
            None => scaled[k] = made[link].0[place],
        }
    }
    let torque = |phi: &[f64], i: usize| -> f64 { (0..ids.len()).map(|k| map[(i, k)] * phi[k]).sum() };
    let beside: Vec<usize> =
        (0..ids.len()).filter(|&k| !matches!(ids[k].kind, ParameterKind::Inertial(_))).collect();
    let width = 1 + beside.len();
    let columns = Mat::from_fn(b, width + 1, |i, k| match k {
        0 => torque(&scaled, i),
        k if k < width => map[(i, beside[k - 1])],
        _ => factor.upper()[(i, b)] - torque(&known, i),
    });
    let ridge = Mat::from_fn(width, width + 1, |i, k| {
        // A zero column, as that of the density if all links are described, keeps a zero solution.
        let norm = columns.col(k).norm_l2();
        if i == k { RIDGE * if norm > 0.0 { norm } else { 1.0 } } else { 0.0 }
    });
    let mut solved = TriangularFactor::new(width);
    solved.fold(columns.as_ref());
    solved.fold(ridge.as_ref());
    let solution = solved.inverse_of_upper()? * solved.upper().submatrix(0, width, width, 1);
    let scale = solution[(0, 0)];
    let motors = beside.iter().enumerate().filter(|(_, k)| ids[**k].kind == ParameterKind::MotorInertia);
    Ok(MeasuredStart {
        // Torque that decreases with mass gives no information about mass.
        density_scale: if scale > 0.0 { scale.clamp(1.0 / DENSITY_RANGE, DENSITY_RANGE) } else { 1.0 },
        motor_inertia: motors.map(|(place, _)| solution[(1 + place, 0)]).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::dynamics::inverse_dynamics;
    use crate::physical::pseudo_inertia::{POSITIVE, definiteness};
    use armwatch_model::robot::JointLimits;
    use armwatch_testing::{er3a, scara};

    #[test]
    fn a_cylinder_along_z_has_the_inertia_of_the_textbook() {
        let (radius, length) = (0.1, 0.3 + 0.2);
        let body = cylinder(&Vector3::new(0.0, 0.0, 0.3), radius, 1000.0);
        let mass = 1000.0 * std::f64::consts::PI * 0.01 * length;
        let own = body.inertia_about_centre();
        assert!((body.mass() - mass).abs() < 1e-12 && (body.centre_of_mass().z - 0.15).abs() < 1e-15);
        assert!((own.m33 - 0.5 * mass * radius * radius).abs() < 1e-12);
        assert!((own.m11 - mass * (3.0 * radius * radius + length * length) / 12.0).abs() < 1e-12);
    }

    #[test]
    fn an_arm_of_cylinders_is_one_of_bodies_and_of_a_usual_weight() {
        let robot = er3a();
        let bodies = uniform_bodies(&robot, TYPICAL_DENSITY);
        assert!(bodies.iter().all(|body| definiteness(body) > POSITIVE));
        let mass: f64 = bodies.iter().map(StandardParameters::mass).sum();
        // The manufacturer states 28 kg.
        assert!((10.0..80.0).contains(&mass), "{mass}");
    }

    #[test]
    fn carried_inertia_is_the_torque_of_unit_acceleration() {
        for mut robot in [er3a(), scara()] {
            robot.gravity = Vector3::zeros();
            let bodies = uniform_bodies(&robot, TYPICAL_DENSITY);
            let n = robot.joint_count();
            let middle = |limits: &JointLimits| 0.5 * (limits.position_min + limits.position_max);
            let q: Vec<f64> = robot.joints.iter().map(|joint| middle(&joint.limits)).collect();
            for (j, carried) in carried_inertia(&robot, &bodies).into_iter().enumerate() {
                let (mut qdd, mut tau) = (vec![0.0; n], vec![0.0; n]);
                qdd[j] = 1.0;
                inverse_dynamics(&robot, &bodies, &q, &vec![0.0; n], &qdd, &mut tau);
                assert!((tau[j] - carried).abs() < 1e-12 * carried.max(1.0), "{j}: {} {carried}", tau[j]);
            }
        }
    }
}
