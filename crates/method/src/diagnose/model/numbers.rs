//! Numbers of a description that torques can contradict, and changes of one of them.

use std::fmt;

use nalgebra::Vector3;

use armwatch_model::robot::{
    DhParameters, GeometrySource, JointGeometry, JointIndex, Robot, Transform, UrdfOrigin,
};

/// Number in a joint's placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PlaceNumber {
    /// Distance `a` of a Denavit-Hartenberg row, m.
    A,
    /// Twist `alpha` of a Denavit-Hartenberg row, rad.
    Alpha,
    /// Offset `d` of a Denavit-Hartenberg row, m.
    D,
    /// Zero of the joint: `theta_offset` of a Denavit-Hartenberg row, rad.
    ThetaOffset,
    /// Origin of a URDF joint along axis 0, 1, 2 (x, y, z) of the link before, m.
    Origin(usize),
    /// Direction of a URDF joint: a turn about axis 0, 1, 2 of the link before, rad.
    Turn(usize),
}

/// Number of a description, or of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DescribedNumber {
    /// Number in a joint's placement.
    Place(JointIndex, PlaceNumber),
    /// Component 0, 1, 2 (x, y, z) of gravity in the base frame, m/s².
    Gravity(usize),
    /// Factor on a joint's torque: unit, gear ratio, drive gain.
    TorqueGain(JointIndex),
    /// Delay of the torques relative to the positions, s.
    TorqueDelay,
}

impl DescribedNumber {
    /// All numbers of a robot's description that affect its torques.
    #[must_use]
    pub fn all(robot: &Robot) -> Vec<Self> {
        use PlaceNumber::{A, Alpha, D, Origin, ThetaOffset, Turn};
        let mut all = Vec::new();
        for (joint, described) in robot.joint_indices().zip(&robot.joints) {
            let places: &[PlaceNumber] = match described.geometry.source() {
                GeometrySource::Urdf(_) => &[Origin(0), Origin(1), Origin(2), Turn(0), Turn(1), Turn(2)],
                _ => &[A, Alpha, D, ThetaOffset],
            };
            all.extend(places.iter().map(|&place| Self::Place(joint, place)));
        }
        all.extend((0..3).map(Self::Gravity));
        all.extend(robot.joint_indices().map(Self::TorqueGain));
        all.push(Self::TorqueDelay);
        all
    }

    /// Robot with this number larger by `change`; unchanged for numbers of the torque signal.
    #[must_use]
    pub fn changed(self, robot: &Robot, change: f64) -> Robot {
        let mut robot = robot.clone();
        match self {
            Self::Place(joint, place) => change_place(&mut robot, joint, place, change),
            Self::Gravity(axis) => robot.gravity[axis] += change,
            Self::TorqueGain(_) | Self::TorqueDelay => {}
        }
        robot
    }

    /// Value in the description: gain 1 and delay 0 for the torque's; `None` for directions of a URDF joint, which turn
    /// as a whole.
    #[must_use]
    pub fn value(self, robot: &Robot) -> Option<f64> {
        match self {
            Self::Place(joint, PlaceNumber::Origin(axis)) => {
                Some(robot.joints[joint.index()].geometry.placement().translation[axis])
            }
            Self::Place(_, PlaceNumber::Turn(_)) => None,
            Self::Place(joint, place) => {
                let row = robot.joints[joint.index()].geometry.dh_row()?;
                Some(match place {
                    PlaceNumber::A => row.a,
                    PlaceNumber::Alpha => row.alpha,
                    PlaceNumber::D => row.d,
                    _ => row.theta_offset,
                })
            }
            Self::Gravity(axis) => Some(robot.gravity[axis]),
            Self::TorqueGain(_) => Some(1.0),
            Self::TorqueDelay => Some(0.0),
        }
    }

    /// Returns true if the number is an angle, which is printed in degrees.
    #[must_use]
    pub fn is_angle(self) -> bool {
        use PlaceNumber::{Alpha, ThetaOffset, Turn};
        matches!(self, Self::Place(_, Alpha | ThetaOffset | Turn(_)))
    }
}

impl fmt::Display for DescribedNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const AXES: [char; 3] = ['x', 'y', 'z'];
        match self {
            Self::Place(joint, PlaceNumber::A) => write!(f, "a_m of joint {joint}"),
            Self::Place(joint, PlaceNumber::Alpha) => write!(f, "alpha_deg of joint {joint}"),
            Self::Place(joint, PlaceNumber::D) => write!(f, "d_m of joint {joint}"),
            Self::Place(joint, PlaceNumber::ThetaOffset) => write!(f, "theta_offset_deg of joint {joint}"),
            Self::Place(joint, PlaceNumber::Origin(axis)) => {
                write!(f, "origin {} of joint {joint}", AXES[*axis])
            }
            Self::Place(joint, PlaceNumber::Turn(axis)) => {
                write!(f, "direction of joint {joint} about {}", AXES[*axis])
            }
            Self::Gravity(axis) => write!(f, "gravity along {} of the base", AXES[*axis]),
            Self::TorqueGain(joint) => write!(f, "scale of the torque of joint {joint}"),
            Self::TorqueDelay => write!(f, "time of the torques"),
        }
    }
}

fn change_place(robot: &mut Robot, joint: JointIndex, place: PlaceNumber, change: f64) {
    let geometry = robot.joints[joint.index()].geometry;
    match *geometry.source() {
        GeometrySource::ModifiedDh(row) => {
            robot.joints[joint.index()].geometry = JointGeometry::modified_dh(moved(row, place, change));
        }
        GeometrySource::StandardDh(row) => {
            let mut rows: Vec<DhParameters> =
                robot.joints.iter().filter_map(|joint| joint.geometry.dh_row()).collect();
            rows[joint.index()] = moved(row, place, change);
            set_standard(robot, &rows);
        }
        GeometrySource::Urdf(origin) => {
            robot.joints[joint.index()].geometry = turned(&geometry, origin, place, change);
        }
    }
}

/// Sets a standard Denavit-Hartenberg table.
pub(super) fn set_standard(robot: &mut Robot, rows: &[DhParameters]) {
    let (places, _) = JointGeometry::standard_dh(rows);
    robot.joints.iter_mut().zip(places).for_each(|(joint, place)| joint.geometry = place);
}

fn moved(row: DhParameters, place: PlaceNumber, change: f64) -> DhParameters {
    match place {
        PlaceNumber::A => DhParameters { a: row.a + change, ..row },
        PlaceNumber::Alpha => DhParameters { alpha: row.alpha + change, ..row },
        PlaceNumber::D => DhParameters { d: row.d + change, ..row },
        _ => DhParameters { theta_offset: row.theta_offset + change, ..row },
    }
}

fn turned(geometry: &JointGeometry, origin: UrdfOrigin, place: PlaceNumber, change: f64) -> JointGeometry {
    let mut placement = *geometry.placement();
    match place {
        PlaceNumber::Origin(axis) => placement.translation[axis] += change,
        PlaceNumber::Turn(axis) => {
            let mut rpy = Vector3::zeros();
            rpy[axis] = change;
            placement.rotation = Transform::from_xyz_rpy([0.0; 3], rpy.into()).rotation * placement.rotation;
        }
        _ => {}
    }
    JointGeometry::urdf(placement, origin)
}
