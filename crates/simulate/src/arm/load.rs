//! A known body at the end of the arm, which a second recording carries and a first does not.

use nalgebra::{Matrix3, Vector3};

use armwatch_model::robot::Transform;

/// A body that is screwed to the tool frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the tool frame, m.
    pub centre: Vector3<f64>,
    /// Inertia about the centre of mass, axes of the tool frame, kg m².
    pub inertia: Matrix3<f64>,
}

/// A body with its centre of mass: mass kg, centre m and inertia about it kg m², in some frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Body {
    pub mass: f64,
    pub centre: Vector3<f64>,
    pub inertia: Matrix3<f64>,
}

impl Body {
    /// The load in the frame of the last link; `tool` is the pose of the tool frame there.
    pub fn of_load(load: &Load, tool: &Transform) -> Self {
        Self {
            mass: load.mass,
            centre: tool.rotation * load.centre + tool.translation,
            inertia: tool.rotation * load.inertia * tool.rotation.transpose(),
        }
    }

    /// Two bodies that move as one, by the parallel-axis theorem about their common centre.
    pub fn and(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let centre = (self.centre * self.mass + other.centre * other.mass) / mass;
        let about_common = |body: &Self| {
            let r = body.centre - centre;
            body.inertia + (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * body.mass
        };
        Self { mass, centre, inertia: about_common(self) + about_common(other) }
    }
}
