//! Due time of the next test of a robot.

use jiff::{SignedDuration, Timestamp};

use crate::detect::rate::budget::usual_interval;
use armwatch_model::anomaly::RunSummary;

/// Latest expected start of the next test: `factor` times the robot's usual interval, the median of the latest ones,
/// after its latest test. `None` with too few tests.
pub(super) fn expected_by(history: &[RunSummary], factor: f64) -> Option<Timestamp> {
    let starts: Vec<Timestamp> = history.iter().map(|run| run.started_at).collect();
    let wait = SignedDuration::try_from_secs_f64(factor * usual_interval(&starts)?).ok()?;
    history.last()?.started_at.checked_add(wait).ok()
}

#[cfg(test)]
mod tests {
    use crate::detect::runs::detect;
    use crate::detect::runs::fixtures::{healthy, hours, indexed};
    use armwatch_model::anomaly::settings::DetectSettings;
    use armwatch_model::anomaly::{Findings, RunSummary};

    fn found(history: &[RunSummary]) -> Findings {
        detect(history, &DetectSettings::default())
    }

    #[test]
    fn the_next_test_is_expected_by_the_usual_interval() {
        assert_eq!(found(&healthy(3)).expected_by, None, "too few to know");
        let mut history = healthy(10);
        assert_eq!(found(&history).expected_by, Some(hours(24 * (9 + 4))));
        // a pause of a fortnight does not change the usual interval
        history.push(RunSummary { started_at: hours(24 * 23), ..indexed(10, Some(1.0)) });
        assert_eq!(found(&history).expected_by, Some(hours(24 * (23 + 4))));
    }
}
