//! Places of joints: rigid transforms, and the conventions of descriptions for them.

use nalgebra::{Matrix3, Vector3};

/// Pose of one frame in another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// Axes of the frame as columns, expressed in the other frame.
    pub rotation: Matrix3<f64>,
    /// Origin of the frame in the other frame, m.
    pub translation: Vector3<f64>,
}

impl Transform {
    /// A frame that coincides with the other one.
    pub const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    /// `Rx(angle)`: turned about the x axis, rad.
    #[must_use]
    pub fn about_x(angle: f64) -> Self {
        let (s, c) = angle.sin_cos();
        Self { rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c), ..Self::IDENTITY }
    }

    /// `Rz(angle)`: turned about the z axis, rad.
    #[must_use]
    pub fn about_z(angle: f64) -> Self {
        let (s, c) = angle.sin_cos();
        Self { rotation: Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0), ..Self::IDENTITY }
    }

    /// Moved by `(x, y, z)`, m.
    #[must_use]
    pub fn moved(x: f64, y: f64, z: f64) -> Self {
        Self { translation: Vector3::new(x, y, z), ..Self::IDENTITY }
    }

    /// Origin `xyz` in m and roll, pitch, yaw in rad as in URDF: `Rz(yaw) Ry(pitch) Rx(roll)`.
    #[must_use]
    pub fn from_xyz_rpy(xyz: [f64; 3], rpy: [f64; 3]) -> Self {
        let (s, c) = rpy[1].sin_cos();
        let pitch = Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c);
        let rotation = Self::about_z(rpy[2]).rotation * pitch * Self::about_x(rpy[0]).rotation;
        Self { rotation, translation: Vector3::from(xyz) }
    }

    /// The smallest rotation that takes the z axis to the unit vector `axis`.
    ///
    /// `1 + [v] + [v]² / (1 + c)` with `v = z x axis`, `c = z axis` (Rodrigues): exact for axes
    /// along x, y or z. Opposite to z, a half turn about x.
    #[must_use]
    pub fn z_to(axis: &Vector3<f64>) -> Self {
        if axis.z <= -1.0 {
            return Self {
                rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0),
                ..Self::IDENTITY
            };
        }
        let v = Vector3::z().cross(axis).cross_matrix();
        Self { rotation: Matrix3::identity() + v + v * v / (1.0 + axis.z), ..Self::IDENTITY }
    }

    /// The transform that applies `next` in this frame: `T(a,c) = T(a,b) T(b,c)`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            translation: self.translation + self.to_outer(&next.translation),
        }
    }

    /// Pose of the other frame in this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { rotation: self.rotation.transpose(), translation: -self.to_inner(&self.translation) }
    }

    /// A free vector of this frame, expressed in the other: `R v`.
    #[inline]
    #[must_use]
    pub fn to_outer(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let r = &self.rotation;
        Vector3::new(
            r.m11 * v.x + r.m12 * v.y + r.m13 * v.z,
            r.m21 * v.x + r.m22 * v.y + r.m23 * v.z,
            r.m31 * v.x + r.m32 * v.y + r.m33 * v.z,
        )
    }

    /// A free vector of the other frame, expressed in this one: `R' v`.
    #[inline]
    #[must_use]
    pub fn to_inner(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let r = &self.rotation;
        Vector3::new(
            r.m11 * v.x + r.m21 * v.y + r.m31 * v.z,
            r.m12 * v.x + r.m22 * v.y + r.m32 * v.z,
            r.m13 * v.x + r.m23 * v.y + r.m33 * v.z,
        )
    }
}

/// A row of a Denavit-Hartenberg table, of either convention: m and rad.
///
/// A revolute joint has `theta = q + theta_offset`; a prismatic one `theta = theta_offset` and slides
/// by `d + q`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DhParameters {
    /// Distance between two axes along their common normal x, m.
    pub a: f64,
    /// Angle between two axes about that normal, rad.
    pub alpha: f64,
    /// Offset along the joint's axis, m.
    pub d: f64,
    /// Added to the joint position to give `theta`, rad.
    pub theta_offset: f64,
}

/// Joint of a URDF file, unchanged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UrdfOrigin {
    /// Origin in the parent link's frame, m.
    pub xyz: [f64; 3],
    /// Roll, pitch, yaw of the joint's frame in the parent link's, rad.
    pub rpy: [f64; 3],
    /// Axis in the joint's frame, as in the file.
    pub axis: [f64; 3],
}

/// Form of a joint's place in a description.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GeometrySource {
    /// Modified Denavit-Hartenberg (Craig): `T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)` [2.1, 2.2]. `a` and `alpha`
    /// belong to axis `i-1`, and frame `i` is on axis `i`.
    ModifiedDh(DhParameters),
    /// Standard Denavit-Hartenberg: `T(i-1,i) = Rz(theta) Dz(d) Dx(a) Rx(alpha)`. Frame `i` is at the far end of link
    /// `i`, on axis `i+1`.
    StandardDh(DhParameters),
    /// A joint of a URDF file.
    Urdf(UrdfOrigin),
}

/// Place of a joint on the link before it, computed once.
///
/// The joint's frame has its z along the axis; the joint rotates about that z or slides along it. In every convention,
/// the moving frame is at the near (proximal) end of the link that the joint moves, and that link's parameters refer to
/// it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointGeometry {
    placement: Transform,
    source: GeometrySource,
}

impl JointGeometry {
    /// From a row of a modified DH table: `Rx(alpha) Dx(a) Dz(d) Rz(theta_offset)`.
    #[must_use]
    pub fn modified_dh(row: DhParameters) -> Self {
        let placement = Transform::about_x(row.alpha)
            .then(&Transform::moved(row.a, 0.0, row.d))
            .then(&Transform::about_z(row.theta_offset));
        Self { placement, source: GeometrySource::ModifiedDh(row) }
    }

    /// From a complete standard DH table, base outwards; the second value is the table's last frame in the frame of the
    /// last joint.
    ///
    /// Joint `i` acts along `z(i-1)`. Its place therefore consists of the part of row `i-1` after that row's joint,
    /// `Dz(d) Dx(a) Rx(alpha)`, and of `Rz(theta_offset)` of row `i`.
    #[must_use]
    pub fn standard_dh(rows: &[DhParameters]) -> (Vec<Self>, Transform) {
        let mut before = Transform::IDENTITY;
        let joints = rows
            .iter()
            .map(|row| {
                let placement = before.then(&Transform::about_z(row.theta_offset));
                before = Transform::moved(row.a, 0.0, row.d).then(&Transform::about_x(row.alpha));
                Self { placement, source: GeometrySource::StandardDh(*row) }
            })
            .collect();
        (joints, before)
    }

    /// A joint of a URDF file. Its frame, rotated so that z is the axis, is at `placement` in the frame of the link
    /// before.
    #[must_use]
    pub fn urdf(placement: Transform, origin: UrdfOrigin) -> Self {
        Self { placement, source: GeometrySource::Urdf(origin) }
    }

    /// Frame of the joint at position 0 in the frame of the link before it.
    #[inline]
    #[must_use]
    pub fn placement(&self) -> &Transform {
        &self.placement
    }

    /// Its row of a Denavit-Hartenberg table of either convention, if it has one.
    #[must_use]
    pub fn dh_row(&self) -> Option<DhParameters> {
        match self.source {
            GeometrySource::ModifiedDh(row) | GeometrySource::StandardDh(row) => Some(row),
            GeometrySource::Urdf(_) => None,
        }
    }

    /// Its form in the description.
    #[must_use]
    pub fn source(&self) -> &GeometrySource {
        &self.source
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;

    /// Rounding errors of a handful of operations.
    const ROUNDING: f64 = 1e-15;

    #[test]
    fn roll_pitch_and_yaw_turn_about_fixed_axes_in_this_order() {
        // Roll takes y to z, yaw then leaves z alone; pitch takes z to x, yaw then takes x to y.
        let roll_yaw = Transform::from_xyz_rpy([0.0; 3], [FRAC_PI_2, 0.0, FRAC_PI_2]);
        assert!((roll_yaw.to_outer(&Vector3::y()) - Vector3::z()).norm() < ROUNDING);
        let pitch_yaw = Transform::from_xyz_rpy([0.0; 3], [0.0, FRAC_PI_2, FRAC_PI_2]);
        assert!((pitch_yaw.to_outer(&Vector3::z()) - Vector3::y()).norm() < ROUNDING);
    }

    #[test]
    fn z_is_taken_to_any_axis_by_a_rotation() {
        for axis in
            [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, -0.48, -0.64]]
        {
            let axis = Vector3::from(axis);
            let turn = Transform::z_to(&axis);
            assert!((turn.to_outer(&Vector3::z()) - axis).norm() < ROUNDING, "{axis}");
            assert!((turn.rotation.determinant() - 1.0).abs() < ROUNDING);
            assert!(
                (turn.rotation * turn.rotation.transpose() - Matrix3::identity()).norm() < 4.0 * ROUNDING
            );
        }
    }

    #[test]
    fn there_and_back_is_nowhere() {
        let pose = Transform::from_xyz_rpy([0.1, -0.2, 0.3], [0.4, -0.5, 2.0 * PI / 3.0]);
        let nowhere = pose.then(&pose.inverse());
        assert!((nowhere.rotation - Matrix3::identity()).norm() < 4.0 * ROUNDING);
        assert!(nowhere.translation.norm() < ROUNDING);
    }
}
