//! What was planted against what was found.

use std::collections::HashMap;

use jiff::Timestamp;
use serde_json::{Value, json};

use super::fleet::{Arm, Planted};
use crate::anomaly::Severity;
use crate::cli::shared::output;
use crate::robot::JointIndex;
use crate::store::AnomalyRow;

/// What became of a planted fault.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Answer {
    arm: Arm,
    planted: Planted,
    /// Tests with the fault that are stored.
    tests_with_it: u32,
    /// The alarm on its arm and joint since it was planted: of the right kind, else the first one.
    alarm: Option<AnomalyRow>,
}

/// All planted faults and all alarms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Verdict {
    answers: Vec<Answer>,
    /// Alarms where nothing was planted.
    further: Vec<AnomalyRow>,
}

/// Whether an anomaly is an alarm; `info` is worth knowing only.
pub(super) fn is_alarm(row: &AnomalyRow) -> bool {
    row.severity >= Severity::Warning
}

/// The fault that an anomaly can come from: planted in its arm and joint, and not after it.
pub(super) fn planted_in<'f>(fleet: &'f [Arm], row: &AnomalyRow) -> Option<(&'f Arm, &'f Planted)> {
    let arm = fleet.iter().find(|arm| arm.name == row.robot)?;
    let planted = arm.planted.as_ref()?;
    let since = arm.start(planted.test())?;
    (planted.fault.joint == row.joint && row.first_seen_at >= since).then_some((arm, planted))
}

impl Verdict {
    /// Compares `fleet` with `anomalies`; `stored` counts the stored tests of each arm.
    pub(super) fn new(fleet: &[Arm], anomalies: &[AnomalyRow], stored: &HashMap<String, u32>) -> Self {
        let alarms: Vec<&AnomalyRow> = anomalies.iter().filter(|row| is_alarm(row)).collect();
        let answer = |arm: &Arm| {
            let planted = arm.planted?;
            let of_arm = alarms.iter().filter(|row| {
                row.robot == arm.name && planted_in(fleet, row).is_some_and(|(_, of)| *of == planted)
            });
            let alarm = of_arm.min_by_key(|row| (row.kind != planted.kind.name(), row.first_seen_at));
            let tests_with_it = stored.get(arm.name).map_or(0, |count| (count + 1).saturating_sub(planted.test()));
            Some(Answer { arm: arm.clone(), planted, tests_with_it, alarm: alarm.copied().cloned() })
        };
        let answers: Vec<Answer> = fleet.iter().filter_map(answer).collect();
        let known = |row: &AnomalyRow| {
            answers
                .iter()
                .any(|answer| answer.alarm.as_ref().is_some_and(|alarm| alarm.anomaly_id == row.anomaly_id))
        };
        let further = alarms.iter().filter(|row| !known(row)).map(|row| (*row).clone()).collect();
        Self { answers, further }
    }

    /// Whether every fault was found with its joint and kind, and nothing else.
    pub(super) fn is_right(&self) -> bool {
        self.further.is_empty() && self.answers.iter().all(Answer::is_right)
    }

    /// Number of an alarm to look at.
    pub(super) fn example(&self) -> Option<i64> {
        self.answers.iter().find_map(|answer| Some(answer.alarm.as_ref()?.anomaly_id))
    }

    pub(super) fn print(&self) {
        let header = ["robot", "joint", "planted", "from test", "found", "joint", "severity", "test", "tests later"];
        let rows: Vec<Vec<String>> = self.answers.iter().map(Answer::cells).collect();
        output::line(&format!("\n{}\n", output::table(&header, &rows)));
        for answer in self.answers.iter().filter(|answer| !answer.is_right()) {
            output::line(&answer.excuse());
        }
        for row in &self.further {
            output::line(&format!(
                "nothing was planted there, a false alarm: {} {} on {}, since {}: {}",
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
            true => format!("{found} of {planted} faults were found, each with its joint and kind; no false alarm"),
            false => format!(
                "{found} of {planted} faults were found with joint and kind; false alarms: {}",
                self.further.len()
            ),
        });
    }

    pub(super) fn as_value(&self) -> Value {
        let answers: Vec<Value> = self.answers.iter().map(Answer::as_value).collect();
        let further: Vec<Value> = self.further.iter().map(alarm_value).collect();
        json!({"event": "verdict", "as_planted": self.is_right(), "faults": answers, "false_alarms": further})
    }
}

impl Answer {
    fn is_right(&self) -> bool {
        self.alarm.as_ref().is_some_and(|alarm| alarm.kind == self.planted.kind.name())
    }

    /// The test with which the alarm began.
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
                alarm.kind.clone(),
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
                format!("{name}: the alarm says {}, which should be {planted_kind}: {}", alarm.kind, alarm.message)
            }
            None if *tests_with_it == 0 => {
                format!("{name}: no test with the fault is stored yet, so nothing can be said of it")
            }
            None => format!("{name}: no alarm of joint {} in {tests_with_it} tests with the fault", joint(planted.fault.joint)),
        }
    }

    fn as_value(&self) -> Value {
        let Self { arm, planted, tests_with_it, alarm } = self;
        json!({
            "robot": arm.name, "joint": planted.fault.joint.map(JointIndex::number), "fault": planted.fault.to_string(),
            "kind": planted.kind.name(), "test": planted.test(), "started_at": arm.start(planted.test()).map(text),
            "tests_with_fault": tests_with_it, "as_planted": self.is_right(),
            "alarm": alarm.as_ref().map(alarm_value), "found_in_test": self.found_in(),
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

/// An alarm as JSON.
pub(super) fn alarm_value(row: &AnomalyRow) -> Value {
    json!({
        "anomaly_id": row.anomaly_id, "robot": row.robot, "joint": row.joint.map(JointIndex::number),
        "kind": row.kind, "severity": row.severity.name(), "first_seen_at": text(row.first_seen_at),
        "message": row.message,
    })
}
