//! The history of one robot: summaries of its tests, like those from the store for the detectors.

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use nalgebra::DVector;

use super::arm::{LabArm, covariance, residual_nm};
use super::draws::Draws;
use super::event::{BASELINE_RUNS, Event};
use super::friction_index::{TestFriction, friction_indices};
use super::scenario::Scenario;
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::analysis::measurements::CycleRmsd;
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse};
use armwatch_model::analysis::{Estimate, JointSummary, RmsdSwing, WarmFriction};
use armwatch_model::anomaly::{CycleSeries, RunParameter, RunSummary};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};

/// Days of a year.
const YEAR_DAYS: f64 = 365.25;
/// Share of planned tests that are omitted.
const LEFT_OUT: f64 = 0.05;
/// Standard deviation of the logarithm of a recorded rest.
const REST_ERROR: f64 = 0.1;
/// Standard deviation of the logarithm of a channel's noise from run to run.
const NOISE_WALK: f64 = 0.03;
/// Fractional increase of friction per kilogram, relative to the square root of the joint's torque, Nm.
const FRICTION_OF_LOAD: f64 = 0.004;
/// Step of the derivative by a position, rad.
const POSITION_STEP: f64 = 1e-4;
/// Relative error of a test's estimate of the responses of parameters.
const RESPONSE_ERROR: f64 = 0.05;
/// Wear by the test ends at this rise of friction.
const MOST_WEAR: f64 = 0.6;
/// Share of friction in a joint's torque, for the effect of varying friction on the RMSD.
const SWING_SHARE: f64 = 0.02;

/// One robot's history and its event.
#[derive(Debug, Clone)]
pub(super) struct History {
    pub(super) runs: Vec<RunSummary>,
    pub(super) event: Event,
    pub(super) years: f64,
}

/// Rest and ambient temperature of one test.
struct TestConditions {
    day: f64,
    rest_h: f64,
    hall_k: f64,
    cycles: usize,
}

/// Draws a robot of this design, its event, and the tests of `years` years. `size` replaces the event's drawn size.
pub(super) fn history(
    mut arm: LabArm<'_>,
    scenario: Scenario,
    size: Option<f64>,
    years: f64,
    draws: &mut Draws,
) -> History {
    let weeks = years * YEAR_DAYS / 7.0;
    let planned = (weeks * arm.program.tests_a_week as f64) as usize;
    let event = Event::draw(scenario, size, &mut arm, planned.max(BASELINE_RUNS + 2), draws);
    let moments = moments(&arm, &event, years, draws);
    let tests: Vec<TestFriction> = frictions(&arm, &event, &moments, draws);
    let indices = friction_indices(&tests, &arm.joints, arm.hall.levels_k);
    let base = ids(&arm);
    let response = Arc::new(response(&arm, draws));
    let ids = Identified { terms: base, changed: changed_covariance(&arm, &event), response };
    let runs = moments
        .iter()
        .zip(&tests)
        .zip(&indices)
        .enumerate()
        .map(|(run, ((moment, test), indices))| {
            summary(&arm, &event, run, moment, test, indices, &ids, draws)
        })
        .collect();
    History { runs, event, years }
}

fn moments(arm: &LabArm<'_>, event: &Event, years: f64, draws: &mut Draws) -> Vec<TestConditions> {
    let gap = 7.0 / arm.program.tests_a_week as f64;
    let mut found: Vec<TestConditions> = Vec::new();
    let (mut daily, mut regime, mut day) = (0.0, 0.0, 0.0);
    let until = years * YEAR_DAYS;
    while day < until {
        let season = arm.hall.season_k * (std::f64::consts::TAU * day / YEAR_DAYS + arm.hall.phase).sin();
        daily = 0.5 * daily + 0.75_f64.sqrt() * arm.hall.daily_k * draws.normal();
        if event.scenario == Scenario::Hall && draws.happens(6.0 * gap / YEAR_DAYS) {
            regime = draws.between(-event.size, event.size);
        }
        let usual = arm.program.rest_h * (arm.program.rest_spread * draws.normal()).exp();
        let weekend = event.scenario == Scenario::Weekend;
        let rest_h = match () {
            () if weekend && day.rem_euclid(7.0) < gap => draws.between(40.0, 64.0),
            () if weekend && draws.happens(0.3) => draws.log_between(0.1, 2.0),
            () => usual,
        };
        let cut = draws.happens(arm.broken_off);
        let whole = if cut { draws.whole(2, arm.program.cycles) } else { arm.program.cycles };
        let cycles = if event.scenario.is_check(found.len()) { 1 } else { whole };
        if !draws.happens(LEFT_OUT) {
            found.push(TestConditions { day, rest_h, hall_k: season + daily + regime, cycles });
        }
        day += gap;
    }
    found
}

/// Friction of every cycle, as logarithms relative to the warm joint.
fn frictions(
    arm: &LabArm<'_>,
    event: &Event,
    moments: &[TestConditions],
    draws: &mut Draws,
) -> Vec<TestFriction> {
    let n = arm.joints.len();
    let mut walks = vec![0.0; n];
    let last = moments.len();
    let replaced = moments.get(event.onset).map_or(f64::INFINITY, |moment| moment.day);
    let mut found = Vec::with_capacity(last);
    for (run, moment) in moments.iter().enumerate() {
        let minutes: Vec<f64> =
            (0..moment.cycles).map(|k| (k as f64 + 0.5) * arm.program.cycle_min).collect();
        let repaired = event.scenario == Scenario::Repair && run >= event.onset;
        let mut apart = draws.aside();
        let swing: Vec<f64> = minutes.iter().map(|_| event.size * apart.normal()).collect();
        let mut ln_ratio = Vec::with_capacity(n);
        for (j, joint) in arm.joints.iter().enumerate() {
            let correlation = joint.walk_correlation;
            walks[j] = correlation * walks[j]
                + (1.0 - correlation * correlation).sqrt() * joint.walk * draws.noise(arm.tails);
            let is_own = j == event.joint;
            let since = if repaired && is_own { moment.day - replaced } else { moment.day };
            let run_in = if repaired && is_own { 0.05 } else { joint.run_in.0 };
            let level = walks[j] + run_in * (-since / joint.run_in.1).exp() + event.level(arm, j, run, last);
            let cold = joint.coldness(moment.rest_h);
            let of = |k: usize, draws: &mut Draws| {
                let holds = is_own && event.holds(run, k);
                let is_slow = match event.scenario {
                    Scenario::WarmUp => holds,
                    Scenario::Lubricant => event.holds(run, k),
                    _ => false,
                };
                let slow = if is_slow { event.size } else { 1.0 };
                let scatter = event.scatter(joint, holds);
                let jumps = matches!(
                    event.scenario,
                    Scenario::StepBetween | Scenario::StepInside | Scenario::StepInBaseline
                );
                let step = if holds && jumps { event.size.ln_1p() } else { 0.0 };
                joint.ln_friction(moment.hall_k, &cold, slow, minutes[k])
                    + level
                    + step
                    + event.share_of_swing(j, run) * swing[k]
                    + scatter * draws.noise(arm.tails)
            };
            ln_ratio.push((0..minutes.len()).map(|k| of(k, draws)).collect());
        }
        let epochs = (0..n).map(|j| u32::from(repaired && j == event.joint)).collect();
        found.push(TestFriction {
            ln_ratio,
            rest_h: moment.rest_h * (REST_ERROR * draws.normal()).exp(),
            hall_seen_k: moment.hall_k + arm.hall.levels_k * draws.normal(),
            minutes,
            epochs,
        });
    }
    found
}

impl Event {
    /// Contribution of the event to the logarithm of a joint's friction in a whole run, of `last` runs.
    fn level(&self, arm: &LabArm<'_>, joint: usize, run: usize, last: usize) -> f64 {
        if run < self.onset && self.scenario != Scenario::ToolPlan {
            return 0.0;
        }
        match self.scenario {
            Scenario::Wear if joint == self.joint => {
                let part = (run + 1 - self.onset) as f64 / (last.saturating_sub(self.onset)).max(1) as f64;
                (self.size * part.powf(self.bend)).ln_1p()
            }
            Scenario::WearByTest if joint == self.joint => {
                (self.size * (run + 1 - self.onset) as f64).min(MOST_WEAR).ln_1p()
            }
            Scenario::Repair if joint == self.joint => self.size.ln(),
            // a larger gain of the torque increases its friction too
            Scenario::TorqueGain if joint == self.joint => self.size.ln_1p(),
            Scenario::Payload | Scenario::ToolPlan => {
                FRICTION_OF_LOAD
                    * self.part(run)
                    * self.size
                    * arm.joints[joint].torque_nm.max(1.0).sqrt().recip()
            }
            _ => 0.0,
        }
    }

    /// A joint's share of a common variation.
    fn share_of_swing(&self, joint: usize, run: usize) -> f64 {
        match self.scenario {
            Scenario::CoupledJitter if run >= self.onset && joint == self.joint => 1.0,
            Scenario::CoupledJitter if run >= self.onset && joint == self.other.0 => self.other.1,
            _ => 0.0,
        }
    }

    /// Standard deviation of the friction of one cycle.
    fn scatter(&self, joint: &super::arm::JointTraits, holds: bool) -> f64 {
        match self.scenario {
            Scenario::Jitter if holds => joint.scatter.hypot(self.size),
            Scenario::TorqueNoise if holds => joint.scatter.hypot(self.noise_of_friction(joint)),
            _ => joint.scatter,
        }
    }

    /// Effect of more channel noise on the friction of one cycle, which is a mean of some two hundred independent rows.
    fn noise_of_friction(&self, joint: &super::arm::JointTraits) -> f64 {
        let more = (self.size * self.size - 1.0).max(0.0).sqrt();
        more * joint.channel_noise_nm() / joint.warm_nm / 14.0
    }
}

/// A kept inertial parameter: its index, its identity, and the standard parameters that it combines.
type InertialTerm = (usize, ParameterId, Vec<(f64, ParameterId)>);

/// The identified parameters: the kept inertial ones with their indices and terms, and the covariance since the event.
struct Identified {
    terms: Vec<InertialTerm>,
    changed: Option<nalgebra::DMatrix<f64>>,
    /// Response of the parameters to faults of channels, as estimated from a test.
    response: Arc<ChannelResponse>,
}

/// Responses of the parameters to faults of channels, by the least squares of [`Event`], each number with an error of
/// some percent: a program derives them from recorded positions and identified parameters.
fn response(arm: &LabArm<'_>, draws: &mut Draws) -> ChannelResponse {
    let design = arm.design;
    let n = arm.joints.len();
    let deviations: Vec<f64> = arm.joints.iter().map(residual_nm).collect();
    let covariance = covariance(design, &deviations);
    let rows = design.rows();
    let mut faults = Vec::new();
    for fault in ChannelFault::ALL {
        for j in 0..n {
            let torque: Vec<DVector<f64>> = match fault {
                ChannelFault::TorqueGain => only(&rows, j, &rows[j] * &arm.theta),
                ChannelFault::TorqueOffset => only(&rows, j, DVector::from_element(rows[j].nrows(), 1.0)),
                // the recorded position is more than the true one
                ChannelFault::PositionOffset => design
                    .misread(&arm.theta, j, -POSITION_STEP)
                    .into_iter()
                    .map(|of| of / POSITION_STEP)
                    .collect(),
            };
            let mut right = DVector::zeros(arm.theta.len());
            for i in 0..n {
                right += deviations[i].powi(-2) * rows[i].transpose() * &torque[i];
            }
            let change = &covariance * right;
            let left = |i: usize| {
                let rest = &rows[i] * &change - &torque[i];
                rest.norm() / (rest.len() as f64).sqrt() / arm.joints[i].torque_nm
            };
            faults.push(FaultResponse {
                joint: JointIndex::new(j),
                fault,
                // the drawn weights do not respond to faults
                strength: 0,
                shift: Vec::new(),
                unexplained: (0..n).map(left).collect(),
                change: change.iter().map(|of| of * (1.0 + RESPONSE_ERROR * draws.normal())).collect(),
            });
        }
    }
    ChannelResponse { parameters: arm.design.base.kept.clone(), faults }
}

/// A torque in one joint's rows, and zero in the others.
fn only(rows: &[nalgebra::DMatrix<f64>], joint: usize, torque: DVector<f64>) -> Vec<DVector<f64>> {
    let mut all: Vec<DVector<f64>> = rows.iter().map(|of| DVector::zeros(of.nrows())).collect();
    all[joint] = torque;
    all
}

fn ids(arm: &LabArm<'_>) -> Vec<InertialTerm> {
    let base = &arm.design.base;
    base.kept
        .iter()
        .zip(&base.grouping)
        .enumerate()
        .filter(|(_, (id, _))| matches!(id.kind, ParameterKind::Inertial(_)))
        .map(|(place, (id, grouped))| {
            let rest = grouped.iter().map(|of| (of.coefficient, of.id));
            (place, *id, std::iter::once((1.0, *id)).chain(rest).collect())
        })
        .collect()
}

fn changed_covariance(arm: &LabArm<'_>, event: &Event) -> Option<nalgebra::DMatrix<f64>> {
    let is_noisy = event.scenario == Scenario::TorqueNoise;
    is_noisy.then(|| {
        let deviations: Vec<f64> = arm
            .joints
            .iter()
            .zip(&event.unexplained_nm)
            .map(|(joint, more)| residual_nm(joint).hypot(*more))
            .collect();
        covariance(arm.design, &deviations)
    })
}

#[expect(clippy::too_many_arguments, reason = "one robot's parts, each drawn once for all runs")]
fn summary(
    arm: &LabArm<'_>,
    event: &Event,
    run: usize,
    moment: &TestConditions,
    test: &TestFriction,
    indices: &[Estimate],
    identified: &Identified,
    draws: &mut Draws,
) -> RunSummary {
    let n = arm.joints.len();
    let has = event.scenario.kind().is_some() && run >= event.onset;
    let mut cycle_friction = Vec::with_capacity(n * test.minutes.len());
    let mut run_offsets = vec![0.0; n];
    for (j, joint) in arm.joints.iter().enumerate() {
        let [usual, walk, _] = joint.offset_nm;
        run_offsets[j] = usual + walk * draws.noise(arm.tails);
        if has && j == event.joint && event.scenario == Scenario::TorqueOffset {
            run_offsets[j] += event.size * joint.channel_noise_nm();
        }
    }
    for (k, &minute) in test.minutes.iter().enumerate() {
        for (j, joint) in arm.joints.iter().enumerate() {
            let noisy = has && j == event.joint && event.scenario == Scenario::TorqueNoise;
            let more = if noisy { event.noise_of_friction(joint) * joint.warm_nm } else { 0.0 };
            let scatter = joint.offset_nm[2].hypot(more);
            let friction = CycleFriction {
                joint: JointIndex::new(j),
                minute,
                ln_torque: joint.warm_nm.ln() + test.ln_ratio[j][k],
                offset: run_offsets[j] + scatter * draws.noise(arm.tails),
                levels: 4,
                speed_fraction: 0.5,
            };
            cycle_friction.push(CycleSeries { cycle: u32::try_from(k + 1).unwrap_or(u32::MAX), friction });
        }
    }
    let seconds = SignedDuration::from_secs((86_400.0 * moment.day) as i64);
    let cycles = u32::try_from(test.minutes.len()).unwrap_or(u32::MAX);
    RunSummary {
        run_id: i64::try_from(run + 1).unwrap_or(i64::MAX),
        started_at: Timestamp::UNIX_EPOCH + seconds,
        cycles,
        refused_cycles: 0,
        refusals: Vec::new(),
        joints: (0..n).map(|j| joint_summary(arm, event, has, j, test, indices[j], draws)).collect(),
        cycle_friction,
        whole_cycle_rmsd: whole_cycles(arm, event, run, moment, test, draws.aside()),
        parameters: parameters(arm, event, run, test, identified, draws),
        response: Some(Arc::clone(&identified.response)),
        epochs: test.epochs.clone(),
    }
}

/// Share of a friction change within a cycle that the cycle's own parameters do not absorb: smallest and largest.
const LEFT_OF_WARMING: [f64; 2] = [0.3, 1.5];

/// RMSD of each cycle as a whole. A cycle has one set of parameters, so that its fit is worse the faster its friction
/// changes during the cycle: worst for a cold joint. Friction that varies from one cycle to the next is in the
/// parameters of each. A push adds to one cycle.
fn whole_cycles(
    arm: &LabArm<'_>,
    event: &Event,
    run: usize,
    moment: &TestConditions,
    test: &TestFriction,
    mut draws: Draws,
) -> Vec<CycleRmsd> {
    let last = test.minutes.len().saturating_sub(1);
    let mut found = Vec::with_capacity(arm.joints.len() * test.minutes.len());
    for (j, joint) in arm.joints.iter().enumerate() {
        let is_pushed = event.scenario == Scenario::Contact && j == event.joint && run == event.onset;
        let left =
            draws.log_between(LEFT_OF_WARMING[0], LEFT_OF_WARMING[1]) * joint.warm_nm / joint.torque_nm;
        let cold = joint.coldness(moment.rest_h);
        let friction = |k: usize| joint.ln_friction(moment.hall_k, &cold, 1.0, test.minutes[k]).exp();
        let level = joint.unexplained * (joint.unexplained_walk * draws.normal()).exp();
        for k in 0..=last {
            let warming = left * (friction(k.min(last.saturating_sub(1))) - friction((k + 1).min(last)));
            let own = (level + joint.swing * draws.noise(arm.tails)).max(0.2 * level);
            let push = if is_pushed && k == event.cycle { event.size } else { 0.0 };
            found.push(CycleRmsd {
                cycle: u32::try_from(k + 1).unwrap_or(u32::MAX),
                joint: JointIndex::new(j),
                relative_rmsd: own.hypot(warming).hypot(push),
            });
        }
    }
    found.sort_by_key(|of| (of.cycle, of.joint));
    found
}

fn joint_summary(
    arm: &LabArm<'_>,
    event: &Event,
    has: bool,
    j: usize,
    test: &TestFriction,
    index: Estimate,
    draws: &mut Draws,
) -> JointSummary {
    let joint = &arm.joints[j];
    let cycles = test.minutes.len();
    let from = cycles - cycles.div_ceil(3);
    let count = (cycles - from) as f64;
    let warm = test.ln_ratio[j][from..].iter().map(|of| of.exp()).sum::<f64>() / count * joint.warm_nm;
    let minute = test.minutes[from..].iter().sum::<f64>() / count;
    let usual_nm = residual_nm(joint) * (joint.unexplained_walk * draws.noise(arm.tails)).exp();
    let more_nm = if has { event.unexplained_nm[j] } else { 0.0 };
    let is_own = has && j == event.joint;
    let usual_noise_nm = joint.channel_noise_nm() * (NOISE_WALK * draws.aside().normal()).exp();
    let noise_nm = match event.scenario {
        Scenario::TorqueNoise if is_own => event.size * usual_noise_nm,
        _ => usual_noise_nm,
    };
    let swing = match event.scenario {
        Scenario::TorqueNoise if is_own => joint.swing * event.size,
        Scenario::Jitter if is_own => joint.swing.hypot(SWING_SHARE * event.size),
        _ => joint.swing,
    };
    let freedom = (2.0 * (cycles as f64 - 1.0).max(1.0)).sqrt();
    JointSummary {
        joint: JointIndex::new(j),
        warm_friction: Some(WarmFriction {
            torque: warm,
            std_error: warm * joint.scatter / count.sqrt(),
            minute,
            speed_fraction: 0.5,
        }),
        excitation_friction: None,
        half_speed_friction: None,
        friction_index: Some(index),
        relative_rmsd: Some(usual_nm.hypot(more_nm) / joint.torque_nm),
        rmsd_swing: (cycles > 2)
            .then(|| RmsdSwing { value: swing * (1.0 + draws.normal() / freedom).max(0.1), cycles }),
        relative_noise: Some(noise_nm / joint.torque_nm),
        torque_rms: Some(joint.torque_nm),
    }
}

fn parameters(
    arm: &LabArm<'_>,
    event: &Event,
    run: usize,
    test: &TestFriction,
    identified: &Identified,
    draws: &mut Draws,
) -> Vec<RunParameter> {
    let cycles = test.minutes.len() as f64;
    let part = event.part(run);
    let covariance = identified.changed.as_ref().filter(|_| part > 0.0).unwrap_or(&arm.covariance);
    let b = arm.theta.len();
    let white = DVector::from_fn(b, |_, _| draws.noise(arm.tails));
    let noise_part = arm.joints.iter().map(|joint| joint.noise_part).sum::<f64>() / arm.joints.len() as f64;
    let scale = noise_part * (1.0 + arm.parameter_walk * arm.parameter_walk).sqrt() / cycles.sqrt();
    let scatter = match covariance.clone().cholesky() {
        Some(factor) => scale * (factor.l() * white),
        None => DVector::zeros(b),
    };
    let mut theta = &arm.theta + scatter;
    theta += part * &event.parameters;
    let mut within = DVector::zeros(b);
    for (leak, of) in arm.leaks.iter().zip(&test.ln_ratio) {
        let mean = of.iter().sum::<f64>() / cycles;
        let squares: f64 = of.iter().map(|one| (one - mean).powi(2)).sum();
        theta += leak * mean;
        within += leak.map(|of| of * of) * (squares / (cycles - 1.0).max(1.0));
    }
    let freedom = (2.0 * (cycles - 1.0).max(1.0)).sqrt();
    identified
        .terms
        .iter()
        .map(|(place, id, terms)| RunParameter {
            id: *id,
            mean: theta[*place],
            std_dev: (noise_part
                * covariance[(*place, *place)].sqrt()
                * (1.0 + draws.normal() / freedom).max(0.1))
            .hypot(within[*place].sqrt()),
            cycles: test.minutes.len() as u32,
            terms: terms.clone(),
        })
        .collect()
}
