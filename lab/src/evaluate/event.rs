//! The drawn event of a scenario.

use nalgebra::DVector;

use super::arm::{LabArm, covariance, residual_nm};
use super::design::{STATES, body};
use super::draws::Draws;
use super::scenario::Scenario;
use armwatch_model::robot::JointIndex;

/// First tests of a robot that every detector may learn from.
pub(super) const BASELINE_RUNS: usize = 5;
/// Fewest runs before an event that is not in the baseline.
const RUNS_BEFORE: usize = 8;

/// An event.
#[derive(Debug, Clone)]
pub(super) struct Event {
    pub(super) scenario: Scenario,
    /// The joint, if the event concerns one.
    pub(super) joint: usize,
    /// First run with the event.
    pub(super) onset: usize,
    /// First cycle of that run with the event, from 0.
    pub(super) cycle: usize,
    /// Size, in the unit of [`Scenario::size`].
    pub(super) size: f64,
    /// Change of the identified parameters, and the additional unexplained torque of each joint, Nm.
    pub(super) parameters: DVector<f64>,
    pub(super) unexplained_nm: Vec<f64>,
    /// Exponent of wear over time, 1 for a line.
    pub(super) bend: f64,
    /// Another affected joint, if the scenario concerns two, and its factor.
    pub(super) other: (usize, f64),
}

/// The joint that the right alarm names; `None` if it is the whole arm or there is none.
pub(super) fn named_joint(scenario: Scenario, joint: usize) -> Option<JointIndex> {
    use Scenario as S;
    match scenario {
        S::Payload | S::CoupledJitter | S::Lubricant => None,
        of if of.kind().is_none() => None,
        _ => Some(JointIndex::new(joint)),
    }
}

/// A size in the unit of [`Scenario::size`], from undetectable ones to obvious ones.
pub(super) fn drawn_size(scenario: Scenario, draws: &mut Draws) -> f64 {
    use Scenario as S;
    match scenario {
        S::Healthy | S::Weekend | S::ShortTests | S::LongTests | S::MixedTests | S::StuckTorque => 0.0,
        S::Hall => draws.between(2.0, 6.0),
        S::Season => draws.between(3.0, 8.0),
        S::Repair => draws.between(0.85, 1.15),
        S::Wear => draws.log_between(0.05, 0.5),
        S::WearByTest => draws.log_between(0.003, 0.05),
        S::WearCoulomb | S::WearViscous | S::WearLinear => draws.log_between(0.02, 0.08),
        S::StepBetween | S::StepInside | S::StepInBaseline => draws.sign(0.25) * draws.log_between(0.04, 0.4),
        S::Payload => draws.sign(0.3) * draws.log_between(0.1, 5.0),
        S::Jitter | S::CoupledJitter => draws.log_between(0.02, 0.2),
        S::WarmUp | S::Lubricant if draws.happens(0.3) => draws.log_between(0.35, 0.75),
        S::WarmUp | S::Lubricant => draws.log_between(1.3, 3.0),
        S::TorqueOffset => draws.sign(0.5) * draws.log_between(2.0, 16.0),
        S::TorqueGain => draws.sign(0.5) * draws.log_between(0.02, 0.2),
        S::TorqueNoise => draws.log_between(1.5, 8.0),
        S::ZeroPosition => draws.sign(0.5) * draws.log_between(0.005, 0.08),
        S::Contact => draws.log_between(0.01, 0.3),
        S::Backlash => draws.log_between(0.0003, 0.01),
        S::SaturatedTorque => draws.between(0.3, 0.95),
        S::LateTorque => draws.log_between(0.002, 0.05),
        S::WideSeason => draws.between(12.0, 15.0),
        S::ToolPlan => draws.between(0.5, 2.0),
        S::Override => draws.between(0.5, 0.8),
        S::DayScatter => draws.between(0.015, 0.02),
        S::Ripple => draws.log_between(0.1, 0.3),
    }
}

impl Event {
    /// Draws the event of a scenario over `runs` runs; changes the robot's test programme if the scenario requires it.
    /// `given` replaces the drawn size.
    pub(super) fn draw(
        scenario: Scenario,
        given: Option<f64>,
        arm: &mut LabArm<'_>,
        runs: usize,
        draws: &mut Draws,
    ) -> Self {
        use Scenario as S;
        let n = arm.joints.len();
        let joint = draws.whole(0, n - 1);
        let earliest = RUNS_BEFORE.max(runs / 6).min(runs.saturating_sub(2));
        let onset = draws.whole(earliest, (runs * 6 / 10).max(earliest));
        let drawn = drawn_size(scenario, draws);
        // everything is drawn in any case: robots are the same except for the size
        let size = given.unwrap_or(drawn);
        match scenario {
            S::ShortTests => arm.program.cycles = draws.whole(3, 7),
            S::LongTests => arm.program.cycles = draws.whole(18, 24),
            S::Season | S::WideSeason => arm.hall.season_k = size,
            S::DayScatter => arm.joints.iter_mut().for_each(|joint| joint.walk = size),
            S::Weekend => arm.program.tests_a_week = draws.whole(3, 6),
            _ => {}
        }
        let cycles = arm.program.cycles;
        let mut event = Self {
            scenario,
            joint,
            onset: if scenario == S::StepInBaseline { draws.whole(1, BASELINE_RUNS - 1) } else { onset },
            cycle: match scenario {
                S::StepInside | S::StepInBaseline => draws.whole(2, cycles.saturating_sub(2)),
                S::Contact => draws.whole(1, cycles.saturating_sub(2)),
                _ => 0,
            },
            size,
            parameters: DVector::zeros(arm.theta.len()),
            unexplained_nm: vec![0.0; n],
            bend: draws.between(0.7, 2.0),
            other: (joint, 0.0),
        };
        if scenario == S::CoupledJitter {
            // the other joint varies by the same amount or by half of it, with it or against it
            let neighbour = if joint + 1 < n { joint + 1 } else { joint - 1 };
            event.other = (neighbour, draws.sign(0.5) * draws.between(0.5, 1.0));
        }
        event.change_parameters(arm, draws);
        event
    }

    /// The part of its change of the parameters that a run has.
    pub(super) fn part(&self, run: usize) -> f64 {
        match self.scenario.kind() {
            Some(_) if run >= self.onset => 1.0,
            Some(_) => 0.0,
            None => self.scenario.tool(run),
        }
    }

    /// Whether a cycle of a run has it.
    pub(super) fn holds(&self, run: usize, cycle: usize) -> bool {
        run > self.onset || (run == self.onset && cycle >= self.cycle)
    }

    /// Least squares on the changed torques.
    fn change_parameters(&mut self, arm: &LabArm<'_>, draws: &mut Draws) {
        use Scenario as S;
        let design = arm.design;
        let n = arm.joints.len();
        let deviations: Vec<f64> = arm.joints.iter().map(residual_nm).collect();
        let weight = |j: usize| deviations[j].powi(-2);
        let j = self.joint;
        match self.scenario {
            S::Payload | S::ToolPlan => {
                let load = body(self.size.abs(), draws);
                let mut phi = arm.phi.clone();
                for (of, load) in phi[10 * (n - 1)..10 * n].iter_mut().zip(load.0) {
                    *of += self.size.signum() * load;
                }
                self.parameters = DVector::from_vec(design.base.group(&phi)) - &arm.theta;
            }
            S::TorqueGain => {
                let covariance = covariance(design, &deviations);
                self.parameters = self.size * weight(j) * covariance * &design.gram[j] * &arm.theta;
                for i in 0..n {
                    let own = if i == j { self.size } else { 0.0 };
                    let rest = &self.parameters - own * &arm.theta;
                    self.unexplained_nm[i] =
                        (rest.dot(&(&design.gram[i] * &rest)) / STATES as f64).max(0.0).sqrt();
                }
            }
            S::TorqueOffset => {
                let offset = self.size * arm.joints[j].channel_noise_nm();
                let covariance = covariance(design, &deviations);
                self.parameters = offset * weight(j) * covariance * &design.sums[j];
                for i in 0..n {
                    let own = if i == j { offset } else { 0.0 };
                    let squares = self.parameters.dot(&(&design.gram[i] * &self.parameters))
                        - 2.0 * own * design.sums[i].dot(&self.parameters)
                        + own * own * STATES as f64;
                    self.unexplained_nm[i] = (squares / STATES as f64).max(0.0).sqrt();
                }
            }
            S::ZeroPosition => {
                let torque = design.misread(&arm.theta, j, self.size);
                let rows = design.rows();
                let mut right = DVector::zeros(arm.theta.len());
                for i in 0..n {
                    right += weight(i) * rows[i].transpose() * &torque[i];
                }
                self.parameters = covariance(design, &deviations) * right;
                for i in 0..n {
                    let rest = &rows[i] * &self.parameters - &torque[i];
                    self.unexplained_nm[i] = (rest.norm_squared() / STATES as f64).sqrt();
                }
            }
            S::TorqueNoise => {
                let more = (self.size * self.size - 1.0).sqrt();
                self.unexplained_nm[j] = more * arm.joints[j].channel_noise_nm();
            }
            _ => {}
        }
    }
}
