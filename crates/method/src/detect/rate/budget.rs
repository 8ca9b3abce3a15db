//! Division of the one rate of false alarms among all checked quantities.
//!
//! A robot of `n` joints has `C = 7 n + 3` channels. Per joint: the level of friction, a step inside a test, scatter,
//! the warm-up, the swing and the size of the RMSD, and the torque signal. For the arm: a load, other changes of its
//! parameters, and a contact. Each test and channel has the probability `alpha = r / (C T)`, with `T` tests per year
//! and the rate `r`. If every channel is checked once per test, these add up to the rate under any dependence
//! (Bonferroni); positive dependence makes the rate lower. A channel that is checked in several ways may spend a
//! multiple of its share: the level (its average and a steady rise), the warm-up (one test, a sum over tests, a jump;
//! the same for the part common to all joints), and the parameters of the arm (one test and means of up to eight).
//! Fixed limits, such as that of an oscillation, are outside the budget. Production logs have a separate budget.
//! `armwatch-lab evaluate` measures the resulting rate.

use jiff::Timestamp;

use crate::statistics::descriptive::median;
use crate::statistics::distributions::{normal_quantile, student_quantile};
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::settings::DetectSettings;

/// Channels of a joint.
const CHANNELS_OF_JOINT: usize = 7;
/// Channels of the arm.
const CHANNELS_OF_ARM: usize = 3;

/// Intervals between tests whose median is the usual one: the latest ones, so that a changed habit is learnt.
const INTERVALS: usize = 20;
/// Fewest intervals for a usual one.
const FEWEST_INTERVALS: usize = 3;

/// Least degrees of freedom for the normal distribution in place of Student's.
const NEARLY_NORMAL: f64 = 300.0;

const SECONDS_PER_YEAR: f64 = 365.25 * 86_400.0;
/// Tests per year of a robot with too few intervals: daily ones.
const USUAL_TESTS_PER_YEAR: f64 = 365.25;
/// Most tests per year among which a budget is divided: one every ten minutes.
const MOST_TESTS_PER_YEAR: f64 = 52_600.0;

/// Log-likelihood that a comparison of causes needs beyond chance, since its model of the noise is not exact. A factor
/// of twenty on the likelihood covers a standard deviation that is assumed a tenth too small at five standard
/// deviations: `5² / 2 (1 - 0.9²) = 2.4`.
pub(crate) const MODEL_MARGIN: f64 = 3.0;

/// Usual interval between tests, s: the median of the latest. `None` with too few of them.
#[must_use]
pub(crate) fn usual_interval(starts: &[Timestamp]) -> Option<f64> {
    let intervals: Vec<f64> = starts
        .windows(2)
        .rev()
        .map(|pair| pair[1].duration_since(pair[0]).as_secs_f64())
        .filter(|seconds| *seconds > 0.0)
        .take(INTERVALS)
        .collect();
    median(&intervals).filter(|_| intervals.len() >= FEWEST_INTERVALS)
}

/// Share of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Budget {
    /// Set rate of false alarms per robot and year.
    pub per_robot_year: f64,
    /// Tests per year of this robot.
    pub tests_per_year: f64,
    /// Channels that share the rate.
    pub channels: usize,
}

impl Budget {
    /// The budget of a robot of `joints` joints with tests at these times, oldest first. A robot with fewer than four
    /// tests counts as tested daily.
    #[must_use]
    pub fn new(per_robot_year: f64, joints: usize, starts: &[Timestamp]) -> Self {
        let used = usual_interval(starts).map_or(USUAL_TESTS_PER_YEAR, |seconds| SECONDS_PER_YEAR / seconds);
        Self {
            per_robot_year,
            tests_per_year: used.clamp(1.0, MOST_TESTS_PER_YEAR),
            channels: CHANNELS_OF_JOINT * joints.max(1) + CHANNELS_OF_ARM,
        }
    }

    /// Probability of a false alarm per test and channel.
    #[must_use]
    pub fn alpha(&self) -> f64 {
        (self.per_robot_year / (self.tests_per_year * self.channels as f64)).clamp(1e-12, 0.5)
    }

    /// Mean number of tests between false alarms of one channel.
    #[must_use]
    pub fn run_length(&self) -> f64 {
        self.alpha().recip()
    }
}

/// Standard deviations that a value exceeds by chance with this probability, if its standard deviation is estimated
/// from `freedom` values.
#[must_use]
pub(crate) fn beyond_chance(probability: f64, freedom: f64) -> f64 {
    // far out, the search for Student's quantile needs a probability that is not too small
    let probability = probability.clamp(1e-12, 0.5);
    if freedom < NEARLY_NORMAL {
        -student_quantile(probability, freedom)
    } else {
        -normal_quantile(probability)
    }
}

/// Least log-likelihood of a cause over no change, in one test: `ln(1 / alpha)`, which chance alone exceeds with the
/// probability `alpha` at most (Ville 1939), plus a margin of 3 for the model of the noise. `history` has the robot's
/// tests until then, oldest first.
#[must_use]
pub(crate) fn advantage(settings: &DetectSettings, history: &[RunSummary]) -> f64 {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let starts: Vec<Timestamp> = history.iter().map(|run| run.started_at).collect();
    MODEL_MARGIN - Budget::new(settings.false_alarms_per_robot_year, joints, &starts).alpha().ln()
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;

    fn starts(count: i64, hours: i64) -> Vec<Timestamp> {
        (0..count).map(|of| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(of * hours)).collect()
    }

    #[test]
    fn all_channels_and_tests_together_have_the_rate() {
        for (tests, hours) in [(30, 24), (30, 168), (2, 1)] {
            let budget = Budget::new(1.5, 6, &starts(tests, hours));
            let sum = budget.alpha() * budget.channels as f64 * budget.tests_per_year;
            assert!((sum - 1.5).abs() < 1e-9, "{budget:?}");
        }
        assert!((Budget::new(1.0, 6, &starts(30, 168)).tests_per_year - 52.18).abs() < 0.01);
        // too few tests for a usual interval
        assert!((Budget::new(1.0, 6, &starts(3, 1)).tests_per_year - 365.25).abs() < 1e-9);
    }

    #[test]
    fn a_rarer_alarm_needs_more_evidence() {
        let of = |rate: f64| {
            advantage(&DetectSettings { false_alarms_per_robot_year: rate, ..DetectSettings::default() }, &[])
        };
        assert!((of(0.2) - of(20.0) - 100.0_f64.ln()).abs() < 1e-9);
        // one joint, daily tests
        assert!((of(1.0) - (10.0_f64 * 365.25).ln() - MODEL_MARGIN).abs() < 1e-9);
    }

    #[test]
    fn a_pause_or_tests_at_one_moment_do_not_change_the_habit() {
        let mut paused = starts(10, 24);
        paused.push(paused[9] + SignedDuration::from_hours(24 * 14));
        assert_eq!(usual_interval(&paused), Some(86_400.0));
        assert_eq!(usual_interval(&[Timestamp::UNIX_EPOCH; 9]), None);
    }
}
