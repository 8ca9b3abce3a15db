//! Converts URDF files to a chain of revolute and prismatic joints: fixed joints merged, axes along z.

use std::collections::{HashMap, HashSet};
use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};

use super::nominal::check_body;
use armwatch_model::robot::{JointGeometry, JointKind, StandardParameters, Transform, UrdfOrigin};

/// Replacement for the missing range of a continuous joint, rad: a full turn each way, like in most controllers.
const CONTINUOUS_RANGE: f64 = std::f64::consts::TAU;

/// An angle this close to a multiple of 90 degrees, rad, is set to that multiple: it was rounded. A real arm's frames
/// are not known to 0.006 degrees, and a rounded right angle creates parameters that no recording can identify.
const ROUNDED_ANGLE: f64 = 1e-4;

/// A chain read from a URDF file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct UrdfChain {
    /// Moving joints, base outwards.
    pub joints: Vec<UrdfJoint>,
    /// Frame of the tip link in the frame of the last joint.
    pub end: Transform,
    /// Values that were read differently than written, in sentences.
    pub remarks: Vec<String>,
}

/// A moving joint and its link.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct UrdfJoint {
    pub name: String,
    pub kind: JointKind,
    pub geometry: JointGeometry,
    pub position_min: f64,
    pub position_max: f64,
    pub velocity: f64,
    /// Body of the link and of all links fixed to it, about the joint's frame; `None` without mass.
    pub inertial: Option<StandardParameters>,
    /// Viscous friction, Nm s/rad.
    pub damping: f64,
    /// Coulomb friction, Nm.
    pub friction: f64,
}

/// Reads the chain to `tip`, which must be given if moving joints branch.
///
/// The frame of a moving joint is its URDF frame turned by the smallest rotation that brings z to the joint's axis; the
/// links after it are turned back. Links on fixed joints, and those on moving joints off the chain at position 0, are
/// merged into the link that carries them.
///
/// # Errors
/// The fault of the file, in words.
pub(crate) fn read_chain(text: &str, tip: Option<&str>) -> Result<UrdfChain, String> {
    let mut robot =
        urdf_rs::read_from_string(text).map_err(|error| format!("is not a URDF file: {error}"))?;
    let mut remarks: Vec<String> = exact_angles(&mut robot).into_iter().collect();
    let tree = Tree::new(robot)?;
    let tip = tree.tip(tip)?;
    let path = tree.path_to(&tip)?;
    let on_path: HashSet<&str> = path.iter().map(|joint| joint.name.as_str()).collect();
    let mut joints: Vec<UrdfJoint> = Vec::new();
    // Frame of the current link in the frame of the last moving joint, or in the base.
    let mut link = Transform::IDENTITY;
    for joint in path {
        let place = link.then(&pose(&joint.origin));
        let Some(kind) = moving_kind(joint)? else {
            link = place;
            continue;
        };
        let turn = Transform::z_to(&unit_axis(joint)?);
        link = turn.inverse();
        let inertial = tree.body(&joint.child.link, &link, &on_path, &mut remarks);
        joints.push(read_joint(joint, kind, place.then(&turn), inertial)?);
    }
    if joints.is_empty() {
        return Err(format!("no joint moves between the base and {tip}"));
    }
    Ok(UrdfChain { joints, end: link, remarks })
}

/// Makes rounded right angles of joints exact, and reports them.
fn exact_angles(robot: &mut urdf_rs::Robot) -> Option<String> {
    let mut rounded = Vec::new();
    for joint in &mut robot.joints {
        let mut changed = false;
        for angle in joint.origin.rpy.0.iter_mut() {
            let exact = (*angle / FRAC_PI_2).round() * FRAC_PI_2;
            // exact to floating-point precision
            changed |= (*angle - exact).abs() > 1e-12 && (*angle - exact).abs() < ROUNDED_ANGLE;
            if (*angle - exact).abs() < ROUNDED_ANGLE {
                *angle = exact;
            }
        }
        if changed {
            rounded.push(joint.name.clone());
        }
    }
    (!rounded.is_empty()).then(|| {
        format!(
            "angles within 0.006 degrees of a multiple of 90 degrees are rounded and taken as exact: origin \
            of joint{} {}",
            if rounded.len() == 1 { "" } else { "s" },
            rounded.join(", ")
        )
    })
}

struct Tree {
    robot: urdf_rs::Robot,
    root: String,
}

impl Tree {
    fn new(robot: urdf_rs::Robot) -> Result<Self, String> {
        let mut parents: HashMap<&str, &str> = HashMap::new();
        let links: HashSet<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
        for joint in &robot.joints {
            for end in [&joint.parent.link, &joint.child.link] {
                if !links.contains(end.as_str()) {
                    return Err(format!("joint {} names the missing link {end}", joint.name));
                }
            }
            if parents.insert(&joint.child.link, &joint.parent.link).is_some() {
                return Err(format!(
                    "link {} is the child of two joints: loops are not supported",
                    joint.child.link
                ));
            }
        }
        let mut roots = robot.links.iter().filter(|link| !parents.contains_key(link.name.as_str()));
        let root = match (roots.next(), roots.next()) {
            (Some(root), None) => root.name.clone(),
            (None, _) => return Err("has no base: every link is the child of another".into()),
            (Some(a), Some(b)) => return Err(format!("has two bases, {} and {}", a.name, b.name)),
        };
        Ok(Self { robot, root })
    }

    fn children<'a>(&'a self, link: &'a str) -> impl Iterator<Item = &'a urdf_rs::Joint> {
        self.robot.joints.iter().filter(move |joint| joint.parent.link == link)
    }

    /// The requested tip; otherwise the only leaf, or the child of the last moving joint.
    fn tip(&self, asked: Option<&str>) -> Result<String, String> {
        if let Some(tip) = asked {
            return match self.robot.links.iter().any(|link| link.name == tip) {
                true => Ok(tip.to_owned()),
                false => Err(format!("has no link {tip} for tip_link")),
            };
        }
        let leaves: Vec<&str> = self
            .robot
            .links
            .iter()
            .map(|link| link.name.as_str())
            .filter(|link| self.children(link).next().is_none())
            .collect();
        if let [leaf] = leaves[..] {
            return Ok(leaf.to_owned());
        }
        let chains: Vec<Vec<&urdf_rs::Joint>> =
            leaves.iter().map(|leaf| self.path_to(leaf)).collect::<Result<_, _>>()?;
        let moving = |path: &[&urdf_rs::Joint]| -> Vec<String> {
            path.iter()
                .filter(|joint| joint.joint_type != urdf_rs::JointType::Fixed)
                .map(|joint| joint.name.clone())
                .collect()
        };
        let longest = chains.iter().map(|path| moving(path)).max_by_key(Vec::len).unwrap_or_default();
        if chains.iter().any(|path| !longest.starts_with(&moving(path))) {
            return Err(format!("branches: choose the chain with tip_link, one of {}", leaves.join(", ")));
        }
        let last = self.robot.joints.iter().find(|joint| Some(&joint.name) == longest.last());
        Ok(last.map_or_else(|| self.root.clone(), |joint| joint.child.link.clone()))
    }

    /// Joints from the base to `link`.
    fn path_to(&self, link: &str) -> Result<Vec<&urdf_rs::Joint>, String> {
        let mut path = Vec::new();
        let mut at = link;
        while at != self.root {
            // Every link except the root has a parent joint; a ring of links would never end.
            let joint = self.robot.joints.iter().find(|joint| joint.child.link == at);
            let joint = joint.filter(|_| path.len() < self.robot.joints.len());
            let joint =
                joint.ok_or_else(|| format!("link {link} is not connected to the base {}", self.root))?;
            path.push(joint);
            at = &joint.parent.link;
        }
        path.reverse();
        Ok(path)
    }

    /// Body of the link at the pose `place` with all attached links off the chain; `None` without mass, and if an
    /// inertial tag is invalid, since the rest of the body is then unknown too.
    fn body(
        &self,
        link: &str,
        place: &Transform,
        on_path: &HashSet<&str>,
        remarks: &mut Vec<String>,
    ) -> Option<StandardParameters> {
        let mut waiting = vec![(link.to_owned(), *place)];
        let mut whole: Option<StandardParameters> = None;
        let mut is_known = true;
        while let Some((name, place)) = waiting.pop() {
            match self.own_body(&name) {
                Ok(None) => {}
                Ok(Some(own)) => {
                    let own = own.seen_from(&place);
                    whole = Some(whole.map_or(own, |sum| sum.joined(&own)));
                }
                Err(reason) => {
                    is_known = false;
                    remarks.push(format!(
                        "the inertial tag of link {name} is ignored: {reason}; comparisons with nominal \
                        values and the simulator omit the body of this joint"
                    ));
                }
            }
            for joint in self.children(&name) {
                let fixed = joint.joint_type == urdf_rs::JointType::Fixed;
                if fixed || !on_path.contains(joint.name.as_str()) {
                    waiting.push((joint.child.link.clone(), place.then(&pose(&joint.origin))));
                }
            }
        }
        whole.filter(|_| is_known)
    }

    /// Inertial tag of a link about the link's frame; `None` without mass.
    ///
    /// # Errors
    /// Why no body has these values.
    fn own_body(&self, name: &str) -> Result<Option<StandardParameters>, String> {
        let Some(link) = self.robot.links.iter().find(|link| link.name == name) else { return Ok(None) };
        let (mass, i) = (link.inertial.mass.value, &link.inertial.inertia);
        let inertia = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
        // frames of tools and cameras sometimes have invented inertia
        if mass == 0.0 {
            return Ok(None);
        }
        let body = StandardParameters::from_centre_of_mass(mass, &Vector3::zeros(), &inertia);
        if !body.0.iter().all(|x| x.is_finite()) || mass < 0.0 {
            return Err(format!("it has a mass of {mass} kg"));
        }
        check_body(&body)?;
        Ok(Some(body.seen_from(&pose(&link.inertial.origin))))
    }
}

fn pose(origin: &urdf_rs::Pose) -> Transform {
    Transform::from_xyz_rpy(origin.xyz.0, origin.rpy.0)
}

/// Type of a joint; `None` for a fixed one.
fn moving_kind(joint: &urdf_rs::Joint) -> Result<Option<JointKind>, String> {
    use urdf_rs::JointType;
    if joint.mimic.is_some() {
        return Err(format!(
            "joint {} mimics another: a joint without its own motor cannot be in the chain; choose another tip_link",
            joint.name
        ));
    }
    match joint.joint_type {
        JointType::Fixed => Ok(None),
        JointType::Revolute | JointType::Continuous => Ok(Some(JointKind::Revolute)),
        JointType::Prismatic => Ok(Some(JointKind::Prismatic)),
        JointType::Floating | JointType::Planar | JointType::Spherical => Err(format!(
            "joint {} is {:?}: only revolute, continuous, prismatic and fixed joints can be in the chain",
            joint.name, joint.joint_type
        )
        .to_lowercase()),
    }
}

fn unit_axis(joint: &urdf_rs::Joint) -> Result<Vector3<f64>, String> {
    let axis = Vector3::from(joint.axis.xyz.0);
    let norm = axis.norm();
    match norm.is_finite() && norm > 0.0 {
        true => Ok(axis / norm),
        false => Err(format!("joint {} has no direction of its axis", joint.name)),
    }
}

fn read_joint(
    joint: &urdf_rs::Joint,
    kind: JointKind,
    placement: Transform,
    inertial: Option<StandardParameters>,
) -> Result<UrdfJoint, String> {
    let limit = &joint.limit;
    let continuous = joint.joint_type == urdf_rs::JointType::Continuous;
    let (position_min, position_max) = match continuous {
        true => (-CONTINUOUS_RANGE, CONTINUOUS_RANGE),
        false => (limit.lower, limit.upper),
    };
    let finite = [placement.translation.norm(), placement.rotation.norm()].iter().all(|x| x.is_finite());
    if !finite {
        return Err(format!("joint {} has an origin that is not a number", joint.name));
    }
    let dynamics = joint.dynamics.clone().unwrap_or_default();
    let origin = UrdfOrigin { xyz: joint.origin.xyz.0, rpy: joint.origin.rpy.0, axis: joint.axis.xyz.0 };
    Ok(UrdfJoint {
        name: joint.name.clone(),
        kind,
        geometry: JointGeometry::urdf(placement, origin),
        position_min,
        position_max,
        velocity: limit.velocity,
        inertial,
        damping: dynamics.damping,
        friction: dynamics.friction,
    })
}

#[cfg(test)]
mod tests;
