//! How a controller follows its plan: with a dead time, and with a lag.
//!
//! A joint under position control with speed pre-control behaves approximately like a critically damped filter of
//! second order, whose impulse response is `t / T² exp(-t / T)`: at constant speed it is `2 T` behind the plan. Its
//! motion is the mean of the past plan with this weight. The integral is computed by Gauss-Laguerre quadrature (Golub &
//! Welsch 1969): a sum of shifted plans, whose velocity and acceleration are exact derivatives of its position.

use nalgebra::DMatrix;

use crate::plan::motion::MotionState;
use crate::plan::trajectory::{CyclePlan, Segment};
use armwatch_model::robot::MAX_JOINTS;

/// Points of the quadrature, which integrates polynomials in time of degree 15 exactly.
const POINTS: usize = 8;
/// Number of lags after which 0.3 % of the weight is on the earlier motion: 9 exp(-8).
const SETTLED_LAGS: f64 = 4.0;

/// Delays of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ServoSettings {
    /// Delay of a joint at constant speed behind its plan, s.
    pub lag_s: f64,
    /// Time from the plan, and from the stage signals, to the motion, s.
    pub delay_s: f64,
}

/// A controller that follows plans.
#[derive(Debug, Clone, PartialEq)]
pub struct Servo {
    settings: ServoSettings,
    /// Delay, s, and weight of each shifted plan; empty if the motion equals the plan.
    past: Vec<[f64; 2]>,
}

impl ServoSettings {
    /// Time after which the motion has reached the plan, s.
    pub fn settled_after(&self) -> f64 {
        self.delay_s + SETTLED_LAGS * self.lag_s
    }
}

impl Servo {
    /// Creates a servo with these delays.
    pub fn new(settings: ServoSettings) -> Self {
        let ServoSettings { lag_s, delay_s } = settings;
        let past = match (lag_s > 0.0, delay_s > 0.0) {
            (false, false) => Vec::new(),
            (false, true) => vec![[delay_s, 1.0]],
            (true, _) => laguerre().map(|[x, weight]| [delay_s + 0.5 * lag_s * x, weight]).collect(),
        };
        Self { settings, past }
    }

    /// The motion at `t`, s, within a cycle whose plan is in `segment` then.
    pub fn state_at(&self, plan: &CyclePlan, segment: &Segment, t: f64) -> MotionState {
        if self.past.is_empty() {
            return segment.state_at(t);
        }
        let mut sum = MotionState::default();
        for &[ago, weight] in &self.past {
            let state = plan.state_at(t - ago);
            for j in 0..MAX_JOINTS {
                sum.position[j] += weight * state.position[j];
                sum.velocity[j] += weight * state.velocity[j];
                sum.acceleration[j] += weight * state.acceleration[j];
            }
        }
        sum
    }

    /// Time after which the motion has reached the plan, s.
    pub fn settled_after(&self) -> f64 {
        self.settings.settled_after()
    }
}

/// Points and weights for the weight `x exp(-x)` from 0 on; the weights sum to 1.
fn laguerre() -> impl Iterator<Item = [f64; 2]> {
    let jacobi = DMatrix::from_fn(POINTS, POINTS, |i, k| match i.abs_diff(k) {
        0 => 2.0 * i as f64 + 2.0,
        1 => {
            let least = i.max(k) as f64;
            (least * (least + 1.0)).sqrt()
        }
        _ => 0.0,
    });
    let eigen = jacobi.symmetric_eigen();
    let points: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
    points.into_iter().enumerate().map(move |(k, x)| [x, eigen.eigenvectors[(0, k)].powi(2)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::trajectory::{PlanSettings, plan_cycle};
    use crate::test_arms::er3a_with_excitation;

    #[test]
    fn the_quadrature_has_the_moments_of_its_weight() {
        // the integral of x^(k + 1) exp(-x), for the moment of x^k, is (k + 1)!
        let mut factorial = 1.0;
        for k in 0..=9 {
            factorial *= f64::from(k + 1);
            let sum: f64 = laguerre().map(|[x, weight]| weight * x.powi(k)).sum();
            assert!((sum / factorial - 1.0).abs() < 1e-9, "{k}: {sum}");
        }
    }

    #[test]
    fn a_motion_is_behind_its_plan_by_lag_and_delay_and_consistent_in_itself() {
        let plan = plan_cycle(&er3a_with_excitation(), &PlanSettings::default()).unwrap();
        let settings = ServoSettings { lag_s: 0.02, delay_s: 0.008 };
        let servo = Servo::new(settings);
        let at = |t: f64| servo.state_at(&plan, &plan.segments[2], t);
        let series = &plan.segments[2];
        let mut behind: f64 = 0.0;
        for k in 1..200 {
            let t = series.start + 0.5 + f64::from(k) / 200.0 * (series.duration - 1.0);
            let (now, planned) = (at(t), plan.state_at(t - 0.028));
            let (before, after) = (at(t - 1e-4), at(t + 1e-4));
            for j in 0..6 {
                // a motion of some hertz at most: the deviation is of second order in the lag
                assert!((now.position[j] - planned.position[j]).abs() < 2e-3);
                let velocity = (after.position[j] - before.position[j]) / 2e-4;
                let acceleration = (after.velocity[j] - before.velocity[j]) / 2e-4;
                assert!((velocity - now.velocity[j]).abs() < 1e-6);
                assert!((acceleration - now.acceleration[j]).abs() < 1e-4);
                behind = behind.max((now.position[j] - plan.state_at(t).position[j]).abs());
            }
        }
        assert!(behind > 0.02, "a joint at 1 to 3 rad/s is 28 ms behind: {behind}");
        let ideal = Servo::new(ServoSettings::default());
        let t = series.start + 1.234;
        assert_eq!(ideal.state_at(&plan, series, t), series.state_at(t));
    }
}
