//! Springs and counterbalances in parallel with a joint's motor, and their parameters.

use super::joint_index::JointIndex;

/// A spring that drives a joint in addition to its motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// The joint that it drives.
    pub joint: JointIndex,
    /// Dependence of its force on the position.
    pub form: SpringForm,
    /// Its two parameters in the order of [`Spring::terms`], if known; the simulator uses them.
    pub nominal: Option<[f64; 2]>,
}

/// Dependence of a spring's force on the joint's position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SpringForm {
    /// Wound with the joint: the motor's torque is `k_s q + t_s`.
    Direct,
    /// Between a pin on the link before and one on the joint's link: a coil spring, gas spring or hydraulic cylinder.
    /// It pulls the pins together with `t_c + k_c (l - l_0)`, where `l` is their distance and `l_0` the shortest one.
    Cylinder {
        /// Distances of the two pins from the joint's axis, m; they differ.
        pins: [f64; 2],
        /// Position with both pins on the same side of the axis, rad.
        aligned: f64,
    },
}

crate::named_enum! {
    /// A parameter of a spring.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum SpringTerm {
        /// `k_s`: torque per position.
        Stiffness = "k_s",
        /// `t_s`: torque at position 0.
        Preload = "t_s",
        /// `k_c`: force of a cylinder per length.
        CylinderStiffness = "k_c",
        /// `t_c`: force of a cylinder at its shortest length.
        CylinderPreload = "t_c",
    }
}

impl Spring {
    /// Its two parameters.
    #[must_use]
    pub fn terms(&self) -> [SpringTerm; 2] {
        match self.form {
            SpringForm::Direct => [SpringTerm::Stiffness, SpringTerm::Preload],
            SpringForm::Cylinder { .. } => [SpringTerm::CylinderStiffness, SpringTerm::CylinderPreload],
        }
    }

    /// Torque of the motor per unit of each parameter at the position `q`, rad (m).
    ///
    /// A cylinder of length `l = sqrt(a² + b² - 2 a b cos p)`, with the angle `p` between the pins at `a` and `b`,
    /// has the lever `dl/dq = a b sin p / l`.
    #[inline]
    #[must_use]
    pub fn columns(&self, q: f64) -> [f64; 2] {
        match self.form {
            SpringForm::Direct => [q, 1.0],
            SpringForm::Cylinder { pins: [a, b], aligned } => {
                let (sine, cosine) = (q - aligned).sin_cos();
                let length = (a * a + b * b - 2.0 * a * b * cosine).sqrt();
                let lever = a * b * sine / length;
                [(length - (a - b).abs()) * lever, lever]
            }
        }
    }
}
