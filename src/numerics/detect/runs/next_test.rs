//! When the next test of a robot is due.

use jiff::{SignedDuration, Timestamp};

use crate::anomaly::RunSummary;
use crate::numerics::statistics::descriptive::median;

/// Intervals between tests that the usual one is taken from: the latest ones, so that a changed habit is
/// learnt.
const INTERVALS: usize = 20;
/// Fewest intervals that are a habit.
const FEWEST_INTERVALS: usize = 3;

/// When the next test should have begun at the latest: `factor` times the robot's usual interval, the median
/// of the latest ones, after its latest test. `None` with too few tests.
pub(super) fn expected_by(history: &[RunSummary], factor: f64) -> Option<Timestamp> {
    let intervals: Vec<f64> = history
        .windows(2)
        .rev()
        .map(|pair| pair[1].started_at.duration_since(pair[0].started_at).as_secs_f64())
        .filter(|seconds| *seconds > 0.0)
        .take(INTERVALS)
        .collect();
    let usual = median(&intervals).filter(|_| intervals.len() >= FEWEST_INTERVALS)?;
    let wait = SignedDuration::try_from_secs_f64(factor * usual).ok()?;
    history.last()?.started_at.checked_add(wait).ok()
}

#[cfg(test)]
mod tests {
    use crate::anomaly::{Findings, RunSummary};
    use crate::numerics::detect::runs::detect;
    use crate::numerics::detect::runs::fixtures::{healthy, hours, indexed};
    use crate::numerics::detect::verdict::DetectSettings;

    fn found(history: &[RunSummary]) -> Findings {
        detect(history, &DetectSettings::default())
    }

    #[test]
    fn the_next_test_is_expected_by_the_usual_interval() {
        assert_eq!(found(&healthy(3)).expected_by, None, "too few to know");
        let mut history = healthy(10);
        assert_eq!(found(&history).expected_by, Some(hours(24 * (9 + 4))));
        // a fortnight's pause does not change what is usual
        history.push(RunSummary { started_at: hours(24 * 23), ..indexed(10, Some(1.0)) });
        assert_eq!(found(&history).expected_by, Some(hours(24 * (23 + 4))));
    }
}
