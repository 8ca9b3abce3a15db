//! Measurements of a run's cycles: all inputs for the analysis of the run as a whole.

use serde::{Deserialize, Serialize};

use super::{FrictionPoint, IdentifiedParameter};
use crate::robot::{JointIndex, ParameterId};

/// Inputs for the analysis of a whole run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunMeasurements {
    /// Friction points by cycle, in the order of their cycle's analysis.
    pub friction_points: Vec<CyclePoint>,
    /// Parameters by cycle, in natural order; refused cycles have none.
    pub parameters: Vec<CycleParameters>,
    /// Moving relative RMSD of the excitation stage, by cycle and joint, if known.
    pub relative_rmsd: Vec<CycleRmsd>,
    /// Moving relative RMSD of the whole cycle, all stages.
    pub whole_cycle_rmsd: Vec<CycleRmsd>,
    /// Noise of the torque channels by cycle and joint, if known.
    pub torque_noise: Vec<CycleNoise>,
}

/// A friction point and its cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CyclePoint {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// The point.
    pub point: FrictionPoint,
}

/// Parameters of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleParameters {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Middle of the cycle since the start of the run, min.
    pub minute: f64,
    /// Mean magnitude of each joint's velocity, rad/s (m/s); empty if unknown.
    pub mean_speeds: Vec<f64>,
    /// Values with standard errors.
    pub parameters: Vec<IdentifiedParameter>,
}

/// Moving relative RMSD of one joint in one cycle, with the cycle's own parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CycleRmsd {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// The joint.
    pub joint: JointIndex,
    /// RMSD as a fraction of the measured torque's RMS.
    pub relative_rmsd: f64,
}

/// Noise of the torque channel of one joint in one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleNoise {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// The joint.
    pub joint: JointIndex,
    /// Noise as a fraction of the torque's RMS ([`super::TorqueNoise::relative`]).
    pub relative_noise: f64,
    /// That RMS, Nm (N).
    pub torque_rms: f64,
}

/// Values with the numbers of their cycles, in the order of cycles.
pub type ByCycle = Vec<(u32, f64)>;

impl RunMeasurements {
    /// Values of each parameter by cycle.
    #[must_use]
    pub fn by_parameter(&self) -> Vec<(ParameterId, ByCycle)> {
        let mut found: Vec<(ParameterId, ByCycle)> = Vec::new();
        for of in &self.parameters {
            for (place, parameter) in of.parameters.iter().filter(|of| of.is_shown()).enumerate() {
                // cycles have the same parameters in the same order, unless their motion does not determine one
                let is_it = |(id, _): &(ParameterId, ByCycle)| *id == parameter.id;
                let place = found.get(place).filter(|of| is_it(of)).map(|_| place);
                match place.or_else(|| found.iter().position(is_it)) {
                    Some(place) => found[place].1.push((of.cycle, parameter.value)),
                    None => found.push((parameter.id, vec![(of.cycle, parameter.value)])),
                }
            }
        }
        found
    }

    /// Noise of a joint's torque channel in each cycle.
    #[must_use]
    pub fn noise_of(&self, joint: JointIndex) -> Vec<f64> {
        self.torque_noise.iter().filter(|of| of.joint == joint).map(|of| of.relative_noise).collect()
    }

    /// RMS of a joint's torque while it moves in the excitation, in each cycle, Nm (N).
    #[must_use]
    pub fn torque_of(&self, joint: JointIndex) -> Vec<f64> {
        let of_joint = self.torque_noise.iter().filter(|of| of.joint == joint).map(|of| of.torque_rms);
        of_joint.filter(|rms| rms.is_finite()).collect()
    }

    /// Moving relative RMSD of the excitation stage of each joint by cycle.
    #[must_use]
    pub fn rmsd_by_joint(&self) -> Vec<(JointIndex, ByCycle)> {
        let mut found: Vec<(JointIndex, ByCycle)> = Vec::new();
        for of in &self.relative_rmsd {
            match found.iter_mut().find(|(joint, _)| *joint == of.joint) {
                Some((_, values)) => values.push((of.cycle, of.relative_rmsd)),
                None => found.push((of.joint, vec![(of.cycle, of.relative_rmsd)])),
            }
        }
        found
    }
}
