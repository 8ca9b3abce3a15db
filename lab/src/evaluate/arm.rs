//! One robot: an individual arm of a design with its own friction, temperature, noise and test programme.
//!
//! Friction of a joint is `F (1 - v + v exp(-k (T - T_w)))`: the viscous share `v` falls exponentially with the
//! temperature of the lubricant. The temperature is the ambient temperature plus the rises of two or three heat
//! capacities, each with its time constant. No detector uses this form.

use nalgebra::{DMatrix, DVector};

use super::design::{Design, STATES};
use super::draws::Draws;

/// Friction and other properties of one joint.
#[derive(Debug, Clone)]
pub(super) struct JointTraits {
    /// Friction of the warm joint at the usual ambient temperature, Nm.
    pub(super) warm_nm: f64,
    /// Viscous share of it.
    viscous: f64,
    /// Fall of the viscous part with temperature, 1/K.
    fall_per_k: f64,
    /// Temperature rise of the warm joint above ambient, K.
    rise_k: f64,
    /// Share in the rise and time constant, min, of each heat capacity, the fast one first.
    heat: Vec<(f64, f64)>,
    /// Ratio of cooling time to warming time.
    cooling: f64,
    /// Standard deviation of the friction of one cycle, fraction.
    pub(super) scatter: f64,
    /// Standard deviation of friction from run to run, fraction, and its correlation with the run before.
    pub(super) walk: f64,
    pub(super) walk_correlation: f64,
    /// Additional friction during running-in over the first weeks, fraction, and its time constant, days.
    pub(super) run_in: (f64, f64),
    /// Root-mean-square torque of the test motion, Nm.
    pub(super) torque_nm: f64,
    /// Fraction of it that the model does not explain, and the fraction of that which is noise.
    pub(super) unexplained: f64,
    pub(super) noise_part: f64,
    /// Standard deviation of its logarithm from run to run.
    pub(super) unexplained_walk: f64,
    /// Variation of it from cycle to cycle.
    pub(super) swing: f64,
    /// Half the sum of friction of both directions, Nm; its standard deviations from run to run and cycle to cycle.
    pub(super) offset_nm: [f64; 3],
    /// Dependence of friction on temperature in the joint's map, as a multiple of the true one.
    pub(super) map_error: f64,
}

impl JointTraits {
    fn draw(draws: &mut Draws, warm_nm: f64, torque_nm: f64) -> Self {
        let fast = (draws.between(0.1, 0.5), draws.log_between(1.5, 11.0));
        let slow = draws.log_between(14.0, 95.0);
        let third = if draws.happens(0.5) { draws.between(0.05, 0.25) } else { 0.0 };
        let heat = vec![fast, (1.0 - fast.0 - third, slow), (third, draws.log_between(110.0, 400.0))];
        let runs_in = draws.happens(0.3);
        Self {
            warm_nm,
            viscous: draws.between(0.25, 0.7),
            fall_per_k: draws.log_between(0.012, 0.035),
            rise_k: draws.between(6.0, 28.0),
            heat: heat.into_iter().filter(|(share, _)| *share > 0.0).collect(),
            cooling: draws.between(1.2, 3.5),
            scatter: draws.log_between(0.001, 0.01),
            walk: draws.log_between(0.002, 0.01),
            walk_correlation: draws.between(0.0, 0.8),
            run_in: (if runs_in { draws.between(0.005, 0.03) } else { 0.0 }, draws.between(15.0, 60.0)),
            torque_nm,
            unexplained: draws.log_between(0.015, 0.075),
            noise_part: draws.between(0.2, 0.8),
            unexplained_walk: draws.log_between(0.008, 0.05),
            swing: draws.log_between(0.0005, 0.0025),
            offset_nm: {
                let of = [
                    draws.between(-0.1, 0.1),
                    draws.log_between(0.001, 0.01),
                    draws.log_between(0.002, 0.02),
                ];
                of.map(|part| part * warm_nm)
            },
            map_error: 1.0 + 0.1 * draws.normal(),
        }
    }

    /// Coldness of each heat capacity after a rest of `hours` that followed long motion, 0 to 1.
    pub(super) fn coldness(&self, hours: f64) -> Vec<f64> {
        self.heat.iter().map(|(_, minutes)| 1.0 - (-60.0 * hours / (minutes * self.cooling)).exp()).collect()
    }

    /// Natural logarithm of friction relative to the warm joint at the usual ambient temperature, `minute` after a
    /// start with these coldnesses at an ambient temperature that is `hall_k` above the usual one. The slow time
    /// constant is `slow` times the joint's own.
    pub(super) fn ln_friction(&self, hall_k: f64, coldness: &[f64], slow: f64, minute: f64) -> f64 {
        let cold: f64 = self
            .heat
            .iter()
            .zip(coldness)
            .enumerate()
            .map(|(k, ((share, constant), cold))| {
                let constant = if k == 1 { constant * slow } else { *constant };
                share * cold * (-minute / constant).exp()
            })
            .sum();
        let warmer = hall_k - self.rise_k * cold;
        (1.0 - self.viscous + self.viscous * (-self.fall_per_k * warmer).exp()).ln()
    }

    /// Standard deviation of the noise of the torque channel, Nm.
    pub(super) fn channel_noise_nm(&self) -> f64 {
        self.noise_part * self.unexplained * self.torque_nm
    }
}

/// The times and kinds of a robot's tests.
#[derive(Debug, Clone, Copy)]
pub(super) struct TestProgram {
    pub(super) cycles: usize,
    pub(super) cycle_min: f64,
    pub(super) tests_a_week: usize,
    /// Usual rest before a test, h, and the standard deviation of its logarithm.
    pub(super) rest_h: f64,
    pub(super) rest_spread: f64,
}

/// The ambient temperature of a robot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hall {
    /// Amplitude over the year, K, and phase, rad.
    pub(super) season_k: f64,
    pub(super) phase: f64,
    /// Standard deviation from test to test, K.
    pub(super) daily_k: f64,
    /// Standard error of the ambient temperature from the speed levels of a test, K.
    pub(super) levels_k: f64,
}

/// A robot.
#[derive(Debug)]
pub(super) struct LabArm<'a> {
    pub(super) design: &'a Design,
    /// Parameters in natural order, and the base parameters of these.
    pub(super) phi: Vec<f64>,
    pub(super) theta: DVector<f64>,
    pub(super) joints: Vec<JointTraits>,
    pub(super) program: TestProgram,
    pub(super) hall: Hall,
    /// Degrees of freedom of its noise, if that has heavy tails.
    pub(super) tails: Option<f64>,
    /// Share of tests that are interrupted.
    pub(super) broken_off: f64,
    /// Inverse of the information of one cycle, `[b x b]`.
    pub(super) covariance: DMatrix<f64>,
    /// Scatter of parameters from run to run beyond that of the cycles, as a multiple of it.
    pub(super) parameter_walk: f64,
    /// Change of the parameters with the logarithm of each joint's friction, `[b]`: the part of warm-up that the
    /// friction columns do not absorb.
    pub(super) leaks: Vec<DVector<f64>>,
}

impl<'a> LabArm<'a> {
    pub(super) fn draw(design: &'a Design, draws: &mut Draws) -> Self {
        let n = design.robot.joint_count();
        let spread: Vec<f64> = (0..n).map(|_| 1.0 + 0.03 * draws.normal()).collect();
        let mut phi = design.phi.clone();
        for (link, spread) in phi.chunks_exact_mut(10).zip(&spread) {
            link.iter_mut().for_each(|of| *of *= spread);
        }
        let theta = DVector::from_vec(design.base.group(&phi));
        let joints: Vec<JointTraits> = (0..n)
            .map(|j| {
                let torque = (theta.dot(&(&design.gram[j] * &theta)) / STATES as f64).sqrt();
                // two arms of one model differ by half in friction
                let warm = torque * draws.log_between(0.15, 0.6);
                JointTraits::draw(draws, warm, torque)
            })
            .collect();
        let covariance = covariance(design, &joints.iter().map(residual_nm).collect::<Vec<f64>>());
        let leaks = (0..n)
            .map(|_| {
                let strength = draws.log_between(1.0, 8.0);
                DVector::from_fn(theta.len(), |i, _| strength * covariance[(i, i)].sqrt() * draws.normal())
            })
            .collect();
        let cold = draws.happens(0.6);
        Self {
            design,
            phi,
            theta,
            joints,
            program: TestProgram {
                cycles: draws.whole(6, 24),
                cycle_min: draws.between(0.5, 3.0),
                tests_a_week: draws.whole(1, 7),
                rest_h: if cold { draws.between(6.0, 16.0) } else { draws.log_between(0.1, 1.5) },
                rest_spread: draws.between(0.1, 0.5),
            },
            hall: Hall {
                season_k: draws.log_between(0.3, 4.0),
                phase: draws.between(0.0, std::f64::consts::TAU),
                daily_k: draws.log_between(0.3, 2.0),
                levels_k: draws.between(0.7, 3.0),
            },
            tails: draws.happens(0.25).then(|| draws.between(3.0, 6.0)),
            broken_off: if draws.happens(0.3) { 0.03 } else { 0.0 },
            covariance,
            parameter_walk: draws.between(0.2, 1.5),
            leaks,
        }
    }
}

/// Residual of a joint's torque after identification, Nm.
pub(super) fn residual_nm(joint: &JointTraits) -> f64 {
    joint.unexplained * joint.torque_nm
}

/// Covariance of the parameters of one cycle whose rows have these standard deviations, Nm.
pub(super) fn covariance(design: &Design, deviations: &[f64]) -> DMatrix<f64> {
    let b = design.base.kept.len();
    let mut information = DMatrix::zeros(b, b);
    for (gram, deviation) in design.gram.iter().zip(deviations) {
        information += gram / (deviation * deviation);
    }
    match information.clone().cholesky() {
        Some(factor) => factor.inverse(),
        // no claim about unidentified directions: the diagonal alone
        None => DMatrix::from_diagonal(&information.diagonal().map(|of| of.max(f64::MIN_POSITIVE).recip())),
    }
}
