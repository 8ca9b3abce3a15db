//! Scores of detectors as tables, JSON and a picture.

use serde_json::{Value, json};

use crate::detection_figure::{DetectionCurve, DetectionPoint, detection_figure};
use crate::evaluate::fleet::DetectorScore;
use crate::evaluate::score::{ScenarioScore, rate, share_95};
use armwatch::cli::shared::output;
use armwatch::report::figure::Figure;

/// Detection over size; `fleet` describes the fleet.
pub(super) fn figure(own: &DetectorScore, fleet: String) -> Figure {
    let curve = |of: &ScenarioScore| DetectionCurve {
        fault: of.scenario.name().into(),
        size: of.scenario.size().into(),
        points: of
            .by_size
            .iter()
            .map(|bin| DetectionPoint {
                size: bin.size,
                detected: bin.detected as f64 / bin.robots as f64,
                detected_95: share_95(bin.detected, bin.robots),
                delay_tests: bin.delay_runs,
            })
            .collect(),
    };
    let faults = own.scenarios.iter().filter(|of| of.scenario.kind().is_some());
    detection_figure(
        &faults.map(curve).collect::<Vec<_>>(),
        "Detection of faults on simulated fleets".into(),
        fleet,
    )
}

pub(super) fn as_json(score: &DetectorScore, seed: u64) -> Value {
    let scenario = |of: &ScenarioScore| {
        let (rate, interval) = of.rate();
        json!({
            "scenario": of.scenario.name(), "kind": of.scenario.kind().map(|kind| kind.name()),
            "robots": of.robots, "robot_years": of.years,
            "false_alarms": of.false_alarms, "false_alarm_kinds": of.false_kinds,
            "false_alarms_a_robot_year": rate, "false_alarms_a_robot_year_95": interval,
            "detected": of.detected, "right_joint": of.right_joint, "right_kind": of.right_kind,
            "right_kind_at_first_alarm": of.right_first_kind,
            "right_figure": of.right_figure.0, "with_figure": of.right_figure.1,
            "delay_tests_of_95_percent": finite(of.most_delay_runs),
            "median_delay_tests": finite(of.delay_runs), "median_delay_days": finite(of.delay_days),
            "further_alarms_a_robot": of.further_a_robot(),
            "further_alarm_kinds": of.further_kinds, "repeated_alarms_a_robot": of.repeated_a_robot(),
            "said": of.said, "size": of.scenario.size(),
            "by_size": of.by_size.iter().map(|bin| json!({
                "size": bin.size, "robots": bin.robots, "detected": bin.detected,
                "median_delay_tests": finite(bin.delay_runs),
            })).collect::<Vec<_>>(),
        })
    };
    json!({
        "detector": score.detector.name(), "seed": seed, "macro_f1": finite(score.macro_f1),
        "scenarios": score.scenarios.iter().map(scenario).collect::<Vec<_>>(),
    })
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

pub(super) fn as_text(scores: &[DetectorScore]) -> String {
    let mut text = String::new();
    let is_event = |of: &&ScenarioScore| of.scenario.kind().is_some();
    if let Some(own) = scores.first() {
        let healthy: Vec<Vec<String>> =
            own.scenarios.iter().filter(|of| !is_event(of)).map(healthy_row).collect();
        if !healthy.is_empty() {
            text += "Robots without a fault: any alarm is a false one\n\n";
            text += &output::table(
                &["scenario", "robot-years", "alarms", "a robot-year", "95 %", "kinds"],
                &healthy,
            );
            text += "\n\n";
        }
        let events: Vec<Vec<String>> = own.scenarios.iter().filter(is_event).map(event_row).collect();
        if !events.is_empty() {
            text += "Robots with a fault\n\n";
            text += &output::table(
                &[
                    "scenario",
                    "right kind",
                    "detected",
                    "joint",
                    "kind",
                    "kind at first",
                    "figure",
                    "tests",
                    "95 %",
                    "days",
                    "again",
                    "further",
                ],
                &events,
            );
            text += "\n\nKinds of alarms: robots by their first one, and all further ones\n\n";
            let said: Vec<Vec<String>> = own.scenarios.iter().filter(is_event).map(said_row).collect();
            text += &output::table(&["scenario", "the first alarm", "further ones"], &said);
            text += "\n\n";
        }
    }
    text += "Detectors\n\n";
    text += &output::table(
        &[
            "detector",
            "false alarms a robot-year",
            "detected",
            "joint",
            "kind",
            "macro-F1",
            "median delay, tests",
        ],
        &scores.iter().map(detector_row).collect::<Vec<_>>(),
    );
    text += "\n\ndetected, joint and kind in per cent of robots with a fault; figure: the mass of a load to 15 %, the onset of a \
             step to one cycle, of alarms of the right kind; tests, days: median delay; 95 %: tests within which so many \
             robots have an alarm; again: right alarms a robot after the first; \
             further: alarms a robot of other joints or kinds";
    text
}

fn counts(of: &std::collections::BTreeMap<&'static str, usize>) -> String {
    let mut sorted: Vec<(&str, usize)> = of.iter().map(|(name, count)| (*name, *count)).collect();
    sorted.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let named: Vec<String> = sorted.iter().map(|(name, count)| format!("{name} {count}")).collect();
    if named.is_empty() { "-".into() } else { named.join(", ") }
}

fn rate_text((rate, [low, high]): (f64, [f64; 2])) -> [String; 2] {
    [format!("{rate:.3}"), format!("{low:.3} to {high:.3}")]
}

fn healthy_row(of: &ScenarioScore) -> Vec<String> {
    let [rate, interval] = rate_text(of.rate());
    vec![
        of.scenario.name().into(),
        format!("{:.0}", of.years),
        of.false_alarms.to_string(),
        rate,
        interval,
        counts(&of.false_kinds),
    ]
}

fn event_row(of: &ScenarioScore) -> Vec<String> {
    let percent = |count: usize| format!("{:.0} %", 100.0 * count as f64 / of.robots.max(1) as f64);
    let delay = |delay: f64| if delay.is_finite() { format!("{delay:.0}") } else { "-".into() };
    vec![
        of.scenario.name().into(),
        of.scenario.kind().map_or("-", |kind| kind.name()).into(),
        percent(of.detected),
        percent(of.right_joint),
        percent(of.right_kind),
        percent(of.right_first_kind),
        match of.right_figure {
            (_, 0) => "-".into(),
            (right, all) => format!("{:.0} %", 100.0 * right as f64 / all as f64),
        },
        delay(of.delay_runs),
        delay(of.most_delay_runs),
        delay(of.delay_days),
        format!("{:.2}", of.repeated_a_robot()),
        format!("{:.2}", of.further_a_robot()),
    ]
}

fn said_row(of: &ScenarioScore) -> Vec<String> {
    vec![of.scenario.name().into(), counts(&of.said), counts(&of.further_kinds)]
}

fn detector_row(score: &DetectorScore) -> Vec<String> {
    let (mut alarms, mut years) = (0, 0.0);
    let (mut robots, mut detected, mut joint, mut kind) = (0, 0, 0, 0);
    let mut delays = Vec::new();
    for of in &score.scenarios {
        if of.scenario.kind().is_none() {
            alarms += of.false_alarms;
            years += of.years;
        } else {
            robots += of.robots;
            detected += of.detected;
            joint += of.right_joint;
            kind += of.right_kind;
            delays.extend(Some(of.delay_runs).filter(|delay| delay.is_finite()));
        }
    }
    let percent = |count: usize| match robots {
        0 => "-".into(),
        _ => format!("{:.0} %", 100.0 * count as f64 / robots as f64),
    };
    delays.sort_by(f64::total_cmp);
    let delay = delays.get(delays.len() / 2).map_or("-".into(), |delay| format!("{delay:.0}"));
    let false_alarms = match years > 0.0 {
        true => rate_text(rate(alarms, years)).join(", "),
        false => "-".into(),
    };
    let f1 = if score.macro_f1.is_finite() { format!("{:.2}", score.macro_f1) } else { "-".into() };
    vec![
        score.detector.name().into(),
        false_alarms,
        percent(detected),
        percent(joint),
        percent(kind),
        f1,
        delay,
    ]
}
