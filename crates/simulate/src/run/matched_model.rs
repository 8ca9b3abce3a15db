//! An excitation stage that matches the identifier's model except for noise: friction is the polynomial [3.10], warm
//! and steady, and the true parameters are those of the description.
//!
//! For checks of estimators and their errors; exports come from [`crate::simulate_run`].

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::recording::SensorSettings;
use crate::arm::dynamics::{joint_torque, rigid_chain};
use crate::error::SimulateError;
use crate::plan::trajectory::{ExcitationParts, PlanSettings, plan_cycle};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{Samples, Stage};

/// Duration of the rows after the excitation stage, s: the low-pass needs rows around it.
const TAIL_S: f64 = 0.5;

/// Settings of the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExactSettings {
    /// Seed of the noise.
    pub seed: u64,
    /// Rows per second, Hz.
    pub sample_rate_hz: f64,
    /// Torque noise relative to the description's.
    pub torque_noise_scale: f64,
    /// Correlation of the torque noise from one row to the next; 0 for white noise. The standard deviation is
    /// unaffected.
    pub torque_noise_correlation: f64,
    /// Noise of position and velocity.
    pub sensors: SensorSettings,
    /// True if the motion over the ranges near full speed follows the series.
    pub additional: bool,
}

impl Default for ExactSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            sample_rate_hz: 100.0,
            torque_noise_scale: 1.0,
            torque_noise_correlation: 0.0,
            sensors: SensorSettings::default(),
            additional: true,
        }
    }
}

/// Records one excitation stage with its approach and half a second after it.
///
/// # Errors
/// Those of [`plan_cycle`] and of a description without nominal parameters.
pub fn record_excitation(robot: &Robot, settings: &ExactSettings) -> Result<Samples, SimulateError> {
    let excitation = ExcitationParts { additional: settings.additional, ..ExcitationParts::default() };
    let plan = plan_cycle(robot, &PlanSettings { excitation, ..PlanSettings::default() })?;
    let chain = rigid_chain(robot)?;
    let n = robot.joint_count();
    let excitation = plan.segments.iter().filter(|segment| segment.stage == Stage::Excitation);
    let end = excitation.map(|segment| segment.start + segment.duration).fold(0.0, f64::max) + TAIL_S;
    let mut samples = Samples {
        position: vec![Vec::new(); n],
        velocity: Some(vec![Vec::new(); n]),
        torque: vec![Vec::new(); n],
        ..Samples::default()
    };
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut coloured = vec![0.0; n];
    let rho = settings.torque_noise_correlation;
    for (j, state) in coloured.iter_mut().enumerate() {
        *state = torque_noise(robot, j, settings)? * rng.sample::<f64, _>(StandardNormal);
    }
    let rows = (end * settings.sample_rate_hz) as u32;
    let mut current = 0;
    for row in 0..rows {
        let t = f64::from(row) / settings.sample_rate_hz;
        while current + 1 < plan.segments.len() && t >= plan.segments[current + 1].start {
            current += 1;
        }
        let state = plan.segments[current].state_at(t);
        let torque = joint_torque(&chain, &state);
        samples.time.push(t);
        samples.stage.push(plan.segments[current].stage);
        for j in 0..n {
            let mut noise = || rng.sample::<f64, _>(StandardNormal);
            let (q, qd) = (state.position[j], state.velocity[j]);
            let fresh = torque_noise(robot, j, settings)? * noise();
            coloured[j] = rho * coloured[j] + (1.0 - rho * rho).sqrt() * fresh;
            samples.position[j].push(q + settings.sensors.position_noise * noise());
            if let Some(velocity) = &mut samples.velocity {
                velocity[j].push(qd + settings.sensors.velocity_noise * noise());
            }
            samples.torque[j].push(torque[j] + polynomial_friction(robot, j, qd)? + coloured[j]);
        }
    }
    Ok(samples)
}

fn torque_noise(robot: &Robot, joint: usize, settings: &ExactSettings) -> Result<f64, SimulateError> {
    let nominal =
        robot.joints[joint].nominal.ok_or(SimulateError::NoNominal { joint: JointIndex::new(joint) })?;
    Ok(settings.torque_noise_scale * nominal.torque_noise)
}

/// Friction by [3.10], Nm.
fn polynomial_friction(robot: &Robot, joint: usize, qd: f64) -> Result<f64, SimulateError> {
    let nominal =
        robot.joints[joint].nominal.ok_or(SimulateError::NoNominal { joint: JointIndex::new(joint) })?;
    let [f1, f2, f3, f4] = nominal.friction;
    let sign = if qd == 0.0 { 0.0 } else { qd.signum() };
    Ok(sign * (f1 + f3 * qd * qd) + f2 * qd + f4 * qd.powi(3))
}
