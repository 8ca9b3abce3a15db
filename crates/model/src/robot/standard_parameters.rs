//! The ten inertial parameters of a link.

use nalgebra::{Matrix3, Vector3};

use super::geometry::Transform;

/// Ten inertial parameters of a link about the origin of its own frame, in the order of [`StandardParameters::NAMES`].
/// `mP` is the first moment, mass times centre of mass; inertia is about the frame's origin, not about the centre of
/// mass.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StandardParameters(pub [f64; 10]);

impl StandardParameters {
    /// Number of inertial parameters of a link.
    pub const COUNT: usize = 10;
    /// Names in order; `m` in kg, `mP*` in kg m, `I**` in kg m².
    pub const NAMES: [&'static str; 10] =
        ["m", "mPx", "mPy", "mPz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"];

    /// From mass, first moment and inertia about the frame's origin.
    #[must_use]
    pub fn new(mass: f64, first_moment: &Vector3<f64>, inertia: &Matrix3<f64>) -> Self {
        let (h, i) = (first_moment, inertia);
        Self([mass, h.x, h.y, h.z, i.m11, i.m12, i.m13, i.m22, i.m23, i.m33])
    }

    /// From mass, centre of mass and inertia about that centre, axes of the frame: by the
    /// parallel-axis theorem `I = I_c + m (c'c 1 - c c')`.
    #[must_use]
    pub fn from_centre_of_mass(mass: f64, centre: &Vector3<f64>, inertia: &Matrix3<f64>) -> Self {
        let shift = Matrix3::identity() * centre.norm_squared() - centre * centre.transpose();
        Self::new(mass, &(centre * mass), &(inertia + shift * mass))
    }

    /// Mass, kg.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.0[0]
    }

    /// First moment `m c`, kg m, in the link frame.
    #[must_use]
    pub fn first_moment(&self) -> Vector3<f64> {
        Vector3::new(self.0[1], self.0[2], self.0[3])
    }

    /// Inertia about the origin of the link frame, kg m².
    #[must_use]
    pub fn inertia(&self) -> Matrix3<f64> {
        let [_, _, _, _, xx, xy, xz, yy, yz, zz] = self.0;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// Centre of mass in the link frame, m; the frame's origin for a link without mass.
    #[must_use]
    pub fn centre_of_mass(&self) -> Vector3<f64> {
        if self.mass() == 0.0 { Vector3::zeros() } else { self.first_moment() / self.mass() }
    }

    /// Inertia about the centre of mass, axes of the link frame, kg m², by the inverse parallel-axis theorem.
    #[must_use]
    pub fn inertia_about_centre(&self) -> Matrix3<f64> {
        let c = self.centre_of_mass();
        let shift = Matrix3::identity() * c.norm_squared() - c * c.transpose();
        self.inertia() - shift * self.mass()
    }

    /// The same body about another frame; `frame` is the pose of this frame in the other one.
    ///
    /// With the second moment `S = tr(I)/2 1 - I` and the first moment `h`:
    /// `S' = R S R' + R h t' + t (R h)' + m t t'`; nothing divides by the mass.
    #[must_use]
    pub fn seen_from(&self, frame: &Transform) -> Self {
        let (mass, t) = (self.mass(), frame.translation);
        let second = |i: Matrix3<f64>| Matrix3::identity() * (0.5 * i.trace()) - i;
        let h = frame.rotation * self.first_moment();
        let moved = frame.rotation * second(self.inertia()) * frame.rotation.transpose()
            + h * t.transpose()
            + t * h.transpose()
            + t * t.transpose() * mass;
        let inertia = Matrix3::identity() * moved.trace() - moved;
        Self::new(mass, &(h + t * mass), &inertia)
    }

    /// Two bodies combined, about the same frame.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }
}
