//! Compares planted faults with the findings.

use std::collections::HashMap;

use jiff::Timestamp;
use serde::Serialize;
use serde_json::{Value, json};

use super::fleet::{DemoArm, Planted};
use crate::cli::shared::output;
use armwatch_model::anomaly::{AnomalyKind, Severity};
use armwatch_model::robot::JointIndex;
use armwatch_store::AnomalyRow;

/// The data of an anomaly that the comparison needs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct FoundAlarm {
    pub(super) anomaly_id: i64,
    pub(super) robot: String,
    /// `None` for a cause of the whole arm.
    pub(super) joint: Option<JointIndex>,
    pub(super) kind: AnomalyKind,
    pub(super) severity: Severity,
    /// Start of the first test that showed it.
    pub(super) first_seen_at: Timestamp,
    pub(super) message: String,
}

impl From<&AnomalyRow> for FoundAlarm {
    fn from(row: &AnomalyRow) -> Self {
        Self {
            anomaly_id: row.anomaly_id,
            robot: row.robot.clone(),
            joint: row.joint,
            kind: row.kind,
            severity: row.severity,
            first_seen_at: row.first_seen_at,
            message: row.message.clone(),
        }
    }
}

impl FoundAlarm {
    /// Returns true if it needs attention: `info` is information only.
    pub(super) fn is_alarm(&self) -> bool {
        self.severity >= Severity::Warning
    }
}

/// Result for a planted fault.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlantedOutcome {
    arm: DemoArm,
    planted: Planted,
    /// Stored tests with the fault.
    tests_with_it: u32,
    /// The alarm on its arm and joint since it was planted: one of the right kind, otherwise the first one.
    alarm: Option<FoundAlarm>,
}

/// Results for all planted faults, and all alarms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DemoVerdict {
    answers: Vec<PlantedOutcome>,
    /// Alarms without a planted fault.
    further: Vec<FoundAlarm>,
}

/// The fault that may be the cause of an anomaly: planted in its arm and joint, and not after it.
pub(super) fn planted_in<'f>(fleet: &'f [DemoArm], row: &FoundAlarm) -> Option<(&'f DemoArm, &'f Planted)> {
    let arm = fleet.iter().find(|arm| arm.name == row.robot)?;
    let planted = arm.planted.as_ref()?;
    let since = arm.start(planted.test())?;
    (planted.fault.joint == row.joint && row.first_seen_at >= since).then_some((arm, planted))
}

impl DemoVerdict {
    /// Compares `fleet` with `anomalies`; `stored` counts the stored tests of each arm.
    pub(super) fn new(fleet: &[DemoArm], anomalies: &[FoundAlarm], stored: &HashMap<String, u32>) -> Self {
        let alarms: Vec<&FoundAlarm> = anomalies.iter().filter(|alarm| alarm.is_alarm()).collect();
        let answer = |arm: &DemoArm| {
            let planted = arm.planted?;
            let of_arm = alarms.iter().filter(|row| {
                row.robot == arm.name && planted_in(fleet, row).is_some_and(|(_, of)| *of == planted)
            });
            let alarm = of_arm.min_by_key(|row| (row.kind != planted.kind, row.first_seen_at));
            let tests_with_it =
                stored.get(arm.name).map_or(0, |count| (count + 1).saturating_sub(planted.test()));
            Some(PlantedOutcome { arm: arm.clone(), planted, tests_with_it, alarm: alarm.copied().cloned() })
        };
        let answers: Vec<PlantedOutcome> = fleet.iter().filter_map(answer).collect();
        let known = |row: &FoundAlarm| {
            answers
                .iter()
                .any(|answer| answer.alarm.as_ref().is_some_and(|alarm| alarm.anomaly_id == row.anomaly_id))
        };
        let further = alarms.iter().filter(|row| !known(row)).map(|row| (*row).clone()).collect();
        Self { answers, further }
    }

    /// Returns true if every fault was found with its joint and kind, and nothing else.
    pub(super) fn is_right(&self) -> bool {
        self.further.is_empty() && self.answers.iter().all(PlantedOutcome::is_right)
    }

    /// Number of an alarm to show as an example.
    pub(super) fn example(&self) -> Option<i64> {
        self.answers.iter().find_map(|answer| Some(answer.alarm.as_ref()?.anomaly_id))
    }

    pub(super) fn print(&self) {
        let header =
            ["robot", "joint", "planted", "from test", "found", "joint", "severity", "test", "tests later"];
        let rows: Vec<Vec<String>> = self.answers.iter().map(PlantedOutcome::cells).collect();
        output::block(&format!("\n{}\n", output::table(&header, &rows)));
        for answer in self.answers.iter().filter(|answer| !answer.is_right()) {
            output::line(&answer.excuse());
        }
        for row in &self.further {
            output::line(&format!(
                "no fault was simulated there, a false alarm: {} {} on {}, since {}: {}",
                row.severity,
                row.kind,
                row.robot,
                day(row.first_seen_at),
                row.message
            ));
        }
        let (found, planted) =
            (self.answers.iter().filter(|answer| answer.is_right()).count(), self.answers.len());
        output::line(&match self.is_right() {
            true => format!(
                "{found} of {planted} faults were found, each with its joint and kind; no false alarm"
            ),
            false => format!(
                "{found} of {planted} faults were found with joint and kind; false alarms: {}",
                self.further.len()
            ),
        });
    }

    pub(super) fn as_value(&self) -> Value {
        let answers: Vec<Value> = self.answers.iter().map(PlantedOutcome::as_value).collect();
        json!({"event": "verdict", "as_planted": self.is_right(), "faults": answers, "false_alarms": self.further})
    }
}

impl PlantedOutcome {
    fn is_right(&self) -> bool {
        self.alarm.as_ref().is_some_and(|alarm| alarm.kind == self.planted.kind)
    }

    /// The test that started the alarm.
    fn found_in(&self) -> Option<u32> {
        self.arm.test_at(self.alarm.as_ref()?.first_seen_at)
    }

    fn cells(&self) -> Vec<String> {
        let test = |test: u32| match self.arm.start(test) {
            Some(start) => format!("{test}, {}", day(start)),
            None => test.to_string(),
        };
        let planted = [
            self.arm.name.to_owned(),
            joint(self.planted.fault.joint),
            self.planted.words(),
            test(self.planted.test()),
        ];
        let found = match &self.alarm {
            Some(alarm) => [
                alarm.kind.to_string(),
                joint(alarm.joint),
                alarm.severity.name().to_owned(),
                self.found_in().map_or_else(|| day(alarm.first_seen_at), test),
                self.found_in().map_or_else(|| "?".into(), |found| (found - self.planted.test()).to_string()),
            ],
            None if self.tests_with_it == 0 => ["not tested yet", "", "", "", ""].map(str::to_owned),
            None => ["NOT FOUND", "", "", "", ""].map(str::to_owned),
        };
        planted.into_iter().chain(found).collect()
    }

    /// Why it does not count as found.
    fn excuse(&self) -> String {
        let Self { arm, planted, tests_with_it, alarm } = self;
        let (name, planted_kind) = (arm.name, planted.kind);
        match alarm {
            Some(alarm) => {
                format!(
                    "{name}: the alarm has the kind {}, not {planted_kind}: {}",
                    alarm.kind, alarm.message
                )
            }
            None if *tests_with_it == 0 => {
                format!("{name}: no test with the fault is stored yet, so there is no result")
            }
            None => format!(
                "{name}: no alarm of joint {} in {tests_with_it} tests with the fault",
                joint(planted.fault.joint)
            ),
        }
    }

    fn as_value(&self) -> Value {
        let Self { arm, planted, tests_with_it, alarm } = self;
        json!({
            "robot": arm.name, "joint": planted.fault.joint.map(JointIndex::number), "fault": planted.fault.to_string(),
            "kind": planted.kind.name(), "test": planted.test(), "started_at": arm.start(planted.test()).map(text),
            "tests_with_fault": tests_with_it, "as_planted": self.is_right(),
            "alarm": alarm, "found_in_test": self.found_in(),
            "tests_later": self.found_in().map(|found| found - planted.test()),
        })
    }
}

/// A joint's number, or `arm` for the whole arm.
pub(super) fn joint(joint: Option<JointIndex>) -> String {
    joint.map_or_else(|| "arm".into(), |joint| joint.to_string())
}

pub(super) fn day(at: Timestamp) -> String {
    at.strftime("%Y-%m-%d").to_string()
}

fn text(at: Timestamp) -> String {
    at.to_string()
}

#[cfg(test)]
mod tests {
    use super::super::fleet;
    use super::*;

    fn arms() -> Vec<DemoArm> {
        fleet::fleet(jiff::civil::date(2026, 1, 5)).unwrap()
    }

    /// An alarm of an arm, first seen in its test `test`.
    fn alarm(robot: &str, joint: Option<usize>, kind: AnomalyKind, test: u32) -> FoundAlarm {
        let fleet = arms();
        let arm = fleet.iter().find(|arm| arm.name == robot).unwrap();
        FoundAlarm {
            anomaly_id: 1 + i64::from(test),
            robot: robot.into(),
            joint: joint.and_then(JointIndex::from_number),
            kind,
            severity: Severity::Warning,
            first_seen_at: arm.start(test).unwrap(),
            message: "said".into(),
        }
    }

    fn found() -> Vec<FoundAlarm> {
        vec![
            alarm("Middle", Some(3), AnomalyKind::Drift, 7),
            alarm("Right", None, AnomalyKind::Payload, 6),
            alarm("Front", Some(2), AnomalyKind::Step, 4),
            alarm("Rear", Some(5), AnomalyKind::Oscillation, 6),
        ]
    }

    fn verdict(alarms: &[FoundAlarm]) -> DemoVerdict {
        let stored = arms().iter().map(|arm| (arm.name.to_owned(), arm.tests())).collect();
        DemoVerdict::new(&arms(), alarms, &stored)
    }

    #[test]
    fn all_found_and_nothing_else_is_right() {
        let verdict = verdict(&found());
        assert!(verdict.is_right(), "{verdict:?}");
        let wear = &verdict.answers[0];
        assert_eq!(wear.cells()[3..], ["6, 2026-01-10", "drift", "3", "warning", "7, 2026-01-11", "1"]);
        assert_eq!(wear.as_value()["tests_later"], 1);
        assert_eq!(
            verdict.answers.iter().filter_map(PlantedOutcome::found_in).collect::<Vec<_>>(),
            [7, 6, 4, 6]
        );
    }

    #[test]
    fn a_fault_that_was_missed_is_said() {
        let verdict = verdict(&found()[1..]);
        assert!(!verdict.is_right() && verdict.further.is_empty());
        assert_eq!(verdict.answers[0].cells()[4], "NOT FOUND");
        assert_eq!(verdict.answers[0].excuse(), "Middle: no alarm of joint 3 in 3 tests with the fault");
    }

    #[test]
    fn a_fault_that_was_not_tested_is_not_called_missed() {
        let stored = HashMap::from([("Middle".to_owned(), 5)]);
        let verdict = DemoVerdict::new(&arms(), &[], &stored);
        assert!(verdict.answers.iter().all(|answer| answer.cells()[4] == "not tested yet"), "{verdict:?}");
        assert!(!verdict.is_right());
    }

    #[test]
    fn another_kind_another_joint_or_an_earlier_test_is_not_found() {
        let mut alarms = found();
        alarms[0].kind = AnomalyKind::Step;
        assert!(!verdict(&alarms).is_right());
        assert!(verdict(&alarms).answers[0].excuse().contains("has the kind step, not drift"));
        for wrong in
            [alarm("Middle", Some(2), AnomalyKind::Drift, 7), alarm("Middle", Some(3), AnomalyKind::Drift, 5)]
        {
            alarms[0] = wrong.clone();
            let verdict = verdict(&alarms);
            assert_eq!((verdict.is_right(), &verdict.further), (false, &vec![wrong]));
        }
    }

    #[test]
    fn what_is_worth_knowing_is_no_alarm_and_a_second_alarm_is() {
        let mut alarms = found();
        alarms.push(FoundAlarm {
            severity: Severity::Info,
            anomaly_id: 90,
            ..alarm("Left", Some(1), AnomalyKind::Fleet, 6)
        });
        assert!(verdict(&alarms).is_right());
        alarms.push(FoundAlarm { anomaly_id: 91, ..alarm("Left", Some(1), AnomalyKind::Fleet, 6) });
        assert_eq!(verdict(&alarms).further.len(), 1);
    }
}
