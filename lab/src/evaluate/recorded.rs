//! Robots whose tests are exports: the random properties of each before its arm is simulated.
//!
//! This is the slow method: the event affects torques, which pass through files and the whole program to the result.

use super::draws::Draws;
use super::event::{BASELINE_RUNS, drawn_size};
use super::scenario::Scenario;

/// Streams of random numbers of these robots begin here, separate from those of [`super::fleet`].
const FIRST_ROBOT: u64 = 1 << 48;
/// Streams of their tests begin here.
const FIRST_RUN: u64 = 1 << 40;
/// Last tests that show what happened, at least.
const RUNS_AFTER: usize = 3;

/// One robot, and its event.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRobot {
    /// Its scenario.
    pub scenario: Scenario,
    /// Index of the affected joint, if the event concerns one.
    pub joint: usize,
    /// Index of the first test with the event, from 0.
    pub onset: usize,
    /// First cycle of that test with the event, from 0.
    pub cycle: usize,
    /// Size, in the unit of [`Scenario::size`].
    pub size: f64,
    /// Seed of its noise.
    pub seed: u64,
    /// Cycles of a test.
    pub cycles: usize,
    /// Rows per second, Hz.
    pub sample_rate_hz: f64,
    /// Warming in each cycle, s.
    pub warming_s: f64,
    /// Scatter of the ambient temperature from test to test, K.
    pub hall_k: f64,
    /// Standard deviation of the instants of rows, steps; 0 for an even clock.
    pub clock_jitter: f64,
    /// Scatter of each joint's friction from test to test, as a fraction.
    pub friction_day: f64,
    /// One of several forms of friction, see [`FRICTION_FORMS`].
    pub friction_form: usize,
    /// Difference of each joint of this robot from the description.
    pub units: Vec<JointUnit>,
}

/// Rates that are drawn, rows a second.
const RATES_HZ: [f64; 3] = [20.0, 50.0, 100.0];
/// Forms of friction that are drawn.
pub const FRICTION_FORMS: usize = 3;

/// Differences of a joint from the description, as factors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointUnit {
    /// Factor of all friction.
    pub friction: f64,
    /// Factor of mass, first moments and inertia of the link.
    pub inertial: f64,
    /// Factor of the growth of friction in the cold.
    pub cold: f64,
    /// Factor of both time constants of the warm-up.
    pub warm_up_time: f64,
    /// Factor of the noise of the torque signal.
    pub noise: f64,
}

impl RecordedRobot {
    /// Draws robot `unit` of a scenario, an arm of `joints` joints that is tested `tests` times. `size` replaces the
    /// drawn one. The same arguments give the same robot.
    pub fn draw(
        scenario: Scenario,
        size: Option<f64>,
        joints: usize,
        tests: usize,
        (seed, unit): (u64, usize),
    ) -> Self {
        let own = Scenario::ALL.iter().position(|of| *of == scenario).unwrap_or(0);
        let mut draws = Draws::new(seed, FIRST_ROBOT * (1 + own as u64) + unit as u64);
        let drawn = drawn_size(scenario, &mut draws);
        let last = tests.saturating_sub(RUNS_AFTER).max(BASELINE_RUNS);
        let later = draws.whole(BASELINE_RUNS + 1, last);
        let early = draws.whole(1, BASELINE_RUNS - 1);
        let cycles = match scenario {
            Scenario::ShortTests => draws.whole(3, 7),
            Scenario::LongTests => draws.whole(18, 24),
            _ => draws.whole(8, 12),
        };
        let inside = draws.whole(2, cycles.saturating_sub(2));
        let joint_unit = |draws: &mut Draws| JointUnit {
            friction: draws.log_between(0.7, 1.4),
            inertial: draws.between(0.95, 1.05),
            cold: draws.log_between(0.6, 1.5),
            warm_up_time: draws.log_between(0.7, 1.4),
            noise: draws.log_between(0.7, 1.5),
        };
        Self {
            scenario,
            joint: draws.whole(0, joints.saturating_sub(1)),
            onset: if scenario == Scenario::StepInBaseline { early } else { later },
            cycle: match scenario {
                Scenario::StepInside | Scenario::StepInBaseline | Scenario::Contact => inside,
                _ => 0,
            },
            size: size.unwrap_or(drawn),
            seed: seed.wrapping_mul(1_000_003).wrapping_add(unit as u64),
            cycles,
            sample_rate_hz: RATES_HZ[draws.whole(0, 2)],
            warming_s: draws.between(5.0, 40.0).round(),
            hall_k: if scenario == Scenario::Hall { size.unwrap_or(drawn) } else { draws.between(0.3, 1.5) },
            clock_jitter: if draws.happens(0.3) { 0.1 } else { 0.0 },
            friction_form: draws.whole(0, FRICTION_FORMS - 1),
            units: (0..joints).map(|_| joint_unit(&mut draws)).collect(),
            friction_day: match scenario {
                Scenario::DayScatter => size.unwrap_or(drawn),
                _ => draws.log_between(0.002, 0.02),
            },
        }
    }
}

impl RecordedRobot {
    /// Speed of test `run`, from 0, as a fraction of the usual one, and its rate, Hz.
    pub fn speed_and_rate(&self, run: u32) -> (f64, f64) {
        if self.scenario != Scenario::Override {
            return (1.0, self.sample_rate_hz);
        }
        let mut draws = Draws::new(self.seed, FIRST_RUN + u64::from(run));
        let speed = [1.0, 1.0, 1.0, self.size, 0.5 + 0.5 * self.size][draws.whole(0, 4)];
        (speed, RATES_HZ[draws.whole(0, 2)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_the_same_whatever_others_are_asked_for_and_its_event_is_among_its_tests() {
        for scenario in Scenario::ALL.into_iter().filter(|of| of.has_exports()) {
            for unit in 0..20 {
                let robot = RecordedRobot::draw(scenario, None, 6, 12, (7, unit));
                assert_eq!(robot, RecordedRobot::draw(scenario, None, 6, 12, (7, unit)));
                assert_ne!(robot.units, RecordedRobot::draw(scenario, None, 6, 12, (8, unit)).units);
                assert!(
                    (1..=9).contains(&robot.onset) && robot.joint < 6 && robot.cycle < robot.cycles,
                    "{robot:?}"
                );
                assert_eq!(scenario == Scenario::StepInBaseline, robot.onset < BASELINE_RUNS, "{robot:?}");
                assert!(robot.size != 0.0 || scenario.size().is_empty(), "{robot:?}");
            }
        }
        assert!((RecordedRobot::draw(Scenario::Payload, Some(0.8), 6, 12, (7, 0)).size - 0.8).abs() < 1e-15);
    }
}
