//! Space occupied by the links, and obstacles around the arm.

use nalgebra::Vector3;

use super::geometry::Transform;

/// A capsule around a part of a link: all points within a radius of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    /// Number of the joint that moves the link; 0 for the base.
    pub link: usize,
    /// Ends of the line in the link's frame, whose z is the joint's axis; for the base in the base frame. m.
    pub ends: [Vector3<f64>; 2],
    /// Radius, m.
    pub radius: f64,
}

/// Space occupied by the links of an arm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ArmShape {
    /// Capsules, any number per link.
    pub capsules: Vec<Capsule>,
    /// Pairs of links that must not touch, as numbers of [`Capsule::link`].
    pub pairs: Vec<[usize; 2]>,
}

/// Surroundings of an arm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cell {
    /// Obstacles, which must stay clear of all capsules of the arm except those of the base.
    pub obstacles: Vec<Obstacle>,
}

/// A thing that an arm must not touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Obstacle {
    /// Name, for messages.
    pub name: String,
    /// Form and place in the arm's base frame.
    pub form: ObstacleForm,
}

/// Form of an obstacle; all lengths in m, in the arm's base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObstacleForm {
    /// Everything behind a plane.
    Plane {
        /// A point of the plane.
        point: Vector3<f64>,
        /// Unit vector to the arm's side.
        normal: Vector3<f64>,
    },
    /// A box.
    Box {
        /// Its centre and axes.
        place: Transform,
        /// Half its edges, along its axes.
        half_edges: Vector3<f64>,
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Centres of its ends.
        ends: [Vector3<f64>; 2],
        /// Radius.
        radius: f64,
    },
}
