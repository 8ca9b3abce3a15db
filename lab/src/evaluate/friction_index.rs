//! Friction indices like those of a robot's maps, from the friction of each cycle.
//!
//! A map contains the joint's curve at the ambient temperature of its tests, and the dependence of the curve on ambient
//! temperature and coldness, except for an error. For each test, least squares give one factor per joint, the ambient
//! temperature and the coldness at the start; the latter two are random effects, whose scales are those of the map's
//! own tests. So an index has the errors of a real one: an ambient temperature outside the earlier range changes it.

use nalgebra::{DMatrix, DVector};

use super::arm::JointTraits;
use super::event::BASELINE_RUNS;
use armwatch_model::analysis::Estimate;

/// Prior standard deviation of a joint's own factor: wide, so that it is not shrunk.
const OWN_PRIOR: f64 = 0.5;
/// Least scales of the ambient temperature, K, and of the coldness at the start.
const LEAST_HALL_K: f64 = 0.7;
const START_PRIOR: f64 = 0.15;
/// Most tests that a map is fitted to.
const MOST_RUNS: usize = 36;
/// Step of the numerical derivatives: K, and coldness.
const STEP_K: f64 = 0.5;

/// Friction of all joints in one test, and the information about its temperature.
#[derive(Debug, Clone)]
pub(super) struct TestFriction {
    /// Minute of each cycle.
    pub(super) minutes: Vec<f64>,
    /// Logarithm of friction over that of the warm joint, by joint and cycle.
    pub(super) ln_ratio: Vec<Vec<f64>>,
    /// Rest before it as recorded, h.
    pub(super) rest_h: f64,
    /// Ambient temperature from its speed levels, K above the usual.
    pub(super) hall_seen_k: f64,
    /// Epoch of each joint.
    pub(super) epochs: Vec<u32>,
}

/// Index of each joint in each test, by test and joint. `levels_k` is the standard error of
/// [`TestFriction::hall_seen_k`].
pub(super) fn friction_indices(
    tests: &[TestFriction],
    joints: &[JointTraits],
    levels_k: f64,
) -> Vec<Vec<Estimate>> {
    let mut found: Vec<Vec<Estimate>> = Vec::with_capacity(tests.len());
    let mut size = BASELINE_RUNS.min(tests.len());
    let mut start = 0;
    while start < tests.len() {
        let end = (2 * size).min(tests.len());
        let learnt = &tests[..size];
        let chosen: Vec<f64> =
            learnt.iter().step_by(size.div_ceil(MOST_RUNS)).map(|test| test.hall_seen_k).collect();
        let count = chosen.len() as f64;
        let usual_k = chosen.iter().sum::<f64>() / count;
        let variance = chosen.iter().map(|k| (k - usual_k).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        // excludes the scatter of the estimate from speed levels
        let hall_k = (variance - levels_k * levels_k).max(0.0).sqrt().max(LEAST_HALL_K);
        let map = Map { joints, usual_k, hall_k, levels_k };
        let of: Vec<Vec<Estimate>> = tests[..end].iter().map(|test| map.factors(test)).collect();
        for run in start..end {
            found.push((0..joints.len()).map(|j| map.index(tests, &of, run, j)).collect());
        }
        start = end;
        size = end;
    }
    found
}

/// The maps of all joints of a robot.
struct Map<'a> {
    joints: &'a [JointTraits],
    /// Mean ambient temperature of the tests that they were fitted to, and its standard deviation, K.
    usual_k: f64,
    hall_k: f64,
    levels_k: f64,
}

impl Map<'_> {
    /// Logarithm of each joint's friction relative to the map.
    fn factors(&self, test: &TestFriction) -> Vec<Estimate> {
        let n = self.joints.len();
        let mut normal = DMatrix::zeros(n + 2, n + 2);
        let mut right = DVector::zeros(n + 2);
        for (j, joint) in self.joints.iter().enumerate() {
            normal[(j, j)] += OWN_PRIOR.powi(-2);
            let cold = joint.coldness(test.rest_h);
            let warmer: Vec<f64> = cold.iter().map(|of| of * (1.0 - STEP_K / 5.0)).collect();
            let weight = joint.scatter.max(0.002).powi(-2);
            for (&minute, &seen) in test.minutes.iter().zip(&test.ln_ratio[j]) {
                let usual = joint.ln_friction(self.usual_k, &cold, 1.0, minute);
                let hall = joint.ln_friction(self.usual_k + STEP_K, &cold, 1.0, minute) - usual;
                let start = usual - joint.ln_friction(self.usual_k, &warmer, 1.0, minute);
                let columns = [
                    (j, 1.0),
                    (n, joint.map_error * hall / STEP_K),
                    (n + 1, joint.map_error * start / (STEP_K / 5.0)),
                ];
                for (a, of_a) in columns {
                    right[a] += weight * of_a * (seen - usual);
                    for (b, of_b) in columns {
                        normal[(a, b)] += weight * of_a * of_b;
                    }
                }
            }
        }
        normal[(n, n)] += self.hall_k.powi(-2) + self.levels_k.powi(-2);
        right[n] += self.levels_k.powi(-2) * (test.hall_seen_k - self.usual_k);
        normal[(n + 1, n + 1)] += START_PRIOR.powi(-2);
        let Some(factor) = normal.cholesky() else {
            return vec![Estimate { value: 0.0, std_error: f64::NAN }; n];
        };
        let (solved, covariance) = (factor.solve(&right), factor.inverse());
        (0..n).map(|j| Estimate { value: solved[j], std_error: covariance[(j, j)].sqrt() }).collect()
    }

    /// The index of a joint: its factor divided by the mean factor of its baseline.
    fn index(&self, tests: &[TestFriction], factors: &[Vec<Estimate>], run: usize, joint: usize) -> Estimate {
        let own = tests[run].epochs[joint];
        let baseline: Vec<Estimate> = tests
            .iter()
            .zip(factors)
            .filter(|(test, _)| test.epochs[joint] == own)
            .take(BASELINE_RUNS)
            .map(|(_, of)| of[joint])
            .collect();
        let count = baseline.len().max(1) as f64;
        let mean = baseline.iter().map(|of| of.value).sum::<f64>() / count;
        let variance = baseline.iter().map(|of| of.std_error * of.std_error).sum::<f64>() / (count * count);
        let of = factors[run][joint];
        let value = (of.value - mean).exp();
        Estimate { value, std_error: value * (of.std_error * of.std_error + variance).sqrt() }
    }
}
