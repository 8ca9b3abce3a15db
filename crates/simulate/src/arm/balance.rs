//! Springs, counterbalances and parallelograms in addition to the motors.

use nalgebra::Vector2;

use super::dynamics::about_centre_of_mass;
use super::load::Body;
use crate::error::SimulateError;
use armwatch_model::robot::{MAX_JOINTS, Parallelogram, Spring, SpringForm};

/// A spring with its numbers.
#[derive(Debug, Clone)]
pub(super) struct DrivingSpring {
    pub joint: usize,
    form: SpringForm,
    /// Stiffness, and torque at position 0 or pull at the shortest length.
    numbers: [f64; 2],
}

impl DrivingSpring {
    pub fn new(spring: &Spring) -> Result<Self, SimulateError> {
        let numbers = spring.nominal.ok_or(SimulateError::NoSpring { joint: spring.joint })?;
        Ok(Self { joint: spring.joint.index(), form: spring.form, numbers })
    }

    /// Torque (force) with which the motor holds the spring at the position `q`, Nm (N); for a cylinder, the moment of
    /// its pull on the moving pin about the axis.
    pub fn torque(&self, q: f64) -> f64 {
        let [stiffness, preload] = self.numbers;
        match self.form {
            SpringForm::Direct => stiffness * q + preload,
            SpringForm::Cylinder { pins: [fixed, moving], aligned } => {
                let (sine, cosine) = (q - aligned).sin_cos();
                let (fixed, moving) = (Vector2::new(fixed, 0.0), moving * Vector2::new(cosine, sine));
                let cylinder = fixed - moving;
                let stretch = cylinder.norm() - (fixed.norm() - moving.norm()).abs();
                let pull = cylinder.normalize() * (preload + stiffness * stretch);
                -moving.perp(&pull)
            }
        }
    }
}

/// The crank of a parallelogram.
#[derive(Debug, Clone)]
pub(super) struct Crank {
    pub upper_arm: usize,
    pub forearm: usize,
    pub sense: f64,
    pub body: Body,
}

impl Crank {
    pub fn new(of: &Parallelogram) -> Result<Self, SimulateError> {
        let nominal = of.nominal.ok_or(SimulateError::NoSpring { joint: of.forearm })?;
        let (centre, inertia) = about_centre_of_mass(&nominal, of.forearm)?;
        Ok(Self {
            upper_arm: of.upper_arm.index(),
            forearm: of.forearm.index(),
            sense: of.sense,
            body: Body { mass: nominal.mass(), centre, inertia },
        })
    }

    /// Angle, speed or acceleration of the crank, from those of the joints: the forearm stays parallel to it.
    pub fn angle(&self, joints: &[f64; MAX_JOINTS]) -> f64 {
        joints[self.upper_arm] + self.sense * joints[self.forearm]
    }
}
