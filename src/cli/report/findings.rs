//! The most important findings of a page: joints, alarms, and missing results.

use std::collections::BTreeSet;

use jiff::Timestamp;

use super::cells::{change, figure, percent};
use crate::cli::alerts::anomaly_texts;
use crate::cli::shared::joints::{apart, named, reasons};
use crate::cli::shared::life::standing;
use crate::report::figure::{FigureLevel, StatusWord};
use crate::report::page::{PageBlock, PageFinding};
use armwatch_model::anomaly::Severity;
use armwatch_model::anomaly::forecast::{Crossing, Forecast, Trend};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::robot::JointIndex;
use armwatch_store::{AnomalyRow, FleetHealthRow, HealthStatus, SeriesRun};

/// Returns true if an anomaly still needs attention.
pub(super) fn is_unsettled(row: &AnomalyRow) -> bool {
    !row.state.is_closed()
}

/// Findings for the joints of a robot from the fleet's health; a reason shared by several joints comes first, once.
pub(super) fn of_joints(rows: &[FleetHealthRow]) -> Vec<PageFinding> {
    let mut findings = Vec::new();
    let mut told: BTreeSet<JointIndex> = BTreeSet::new();
    for status in HealthStatus::WORST_FIRST {
        let of_status = rows.iter().filter(|row| row.status == status);
        let said = reasons(of_status.filter_map(|row| Some((row.joint, row.reason.as_deref()?))));
        for shared in said.into_iter().filter(|of| of.joints.len() > 1) {
            findings.push(PageFinding {
                standing: standing(status),
                title: capital(&named(&shared.joints, rows.len())),
                words: vec![sentence(apart(shared.why).0)],
            });
            told.extend(shared.joints);
        }
    }
    findings.extend(rows.iter().map(|row| of_health(row, told.contains(&row.joint))));
    findings
}

/// The finding for a joint from the fleet's health; if its reason is already reported, only the earlier result.
fn of_health(row: &FleetHealthRow, is_told: bool) -> PageFinding {
    let mut words = Vec::new();
    if let Some(index) = row.friction_index {
        let quantity = match row.friction_quantity {
            Some(Quantity::WarmFriction) => "Warm friction as measured",
            Some(Quantity::ExcitationFriction) => "Friction of the excitation stage",
            _ => "Friction at equal speed and temperature",
        };
        words.push(format!(
            "{quantity}: {} against the baseline (ratio {index:.3}).",
            change(Some(index - 1.0))
        ));
    }
    if let Some(relative) = row.moving_relative_rmsd {
        words.push(format!(
            "The model leaves {} of its torque in motion unexplained (relative RMSD).",
            percent(Some(relative))
        ));
    }
    let reason = row.reason.as_deref();
    let reason = if is_told { reason.and_then(|reason| apart(reason).1) } else { reason };
    words.extend(reason.map(sentence));
    words.extend(row.forecast.as_ref().and_then(forecast));
    PageFinding { standing: standing(row.status), title: format!("Joint {}", row.joint), words }
}

/// Findings in the order of urgency; equal ones keep their order.
pub(super) fn worst_first(mut findings: Vec<PageFinding>) -> Vec<PageFinding> {
    findings.sort_by_key(|of| match of.standing.level {
        FigureLevel::Critical => 0,
        FigureLevel::Warning => 1,
        FigureLevel::Unknown => 2,
        FigureLevel::Usual => 3,
    });
    findings
}

/// The finding for a joint from one run, without a conclusion about the present.
pub(super) fn of_run(run: &SeriesRun, alarms: &[&AnomalyRow]) -> PageFinding {
    let of_joint: Vec<&&AnomalyRow> = alarms.iter().filter(|row| row.joint == Some(run.joint)).collect();
    let mut words = Vec::new();
    match (run.friction_index, run.friction_index_std_error) {
        (Some(index), error) => words.push(format!(
            "Friction at equal speed and temperature: {} against the baseline (friction index {index:.4}, standard error {}).",
            change(Some(index - 1.0)),
            figure(error)
        )),
        (None, _) => words.push(match run.warm_friction_nm {
            Some(warm) => format!("No friction index; warm friction as measured is {warm:.2} Nm."),
            None => "No friction index and no warm friction: this run does not say how its friction is.".into(),
        }),
    }
    words.push(match run.moving_relative_rmsd {
        Some(relative) => format!(
            "The model leaves {} of its torque in motion unexplained (relative RMSD).",
            percent(Some(relative))
        ),
        None => "No cycle of the run says how well the model explains its torque.".into(),
    });
    words.extend(of_joint.iter().map(|row| sentence(&row.message)));
    let worst = of_joint.iter().map(|row| row.severity).max();
    let standing = match worst {
        Some(severity) => of_severity(severity),
        None if run.friction_index.is_none() && run.moving_relative_rmsd.is_none() => {
            StatusWord::new("not known", FigureLevel::Unknown)
        }
        None => StatusWord::new("no alarm", FigureLevel::Usual),
    };
    PageFinding { standing, title: format!("Joint {}", run.joint), words }
}

/// The finding for an anomaly with its values.
pub(super) fn of_anomaly(row: &AnomalyRow) -> PageFinding {
    let mut words = vec![sentence(&row.message)];
    let figures = figures(row).map(|figures| format!(" {figures}.")).unwrap_or_default();
    words.push(format!(
        "Number {}; {}; since {}, seen last {}.{figures}",
        row.anomaly_id,
        anomaly_texts::state(row),
        anomaly_texts::minute(row.onset_at.unwrap_or(row.first_seen_at)),
        anomaly_texts::minute(row.last_seen_at),
    ));
    if !row.alternatives.is_empty() {
        let causes: Vec<&str> = row.alternatives.iter().map(|of| of.cause.as_str()).collect();
        words.push(format!("Less likely causes that were compared: {}.", causes.join(", ")));
    }
    let title = format!("{}, {}", capital(row.kind.name()), anomaly_texts::place(row));
    PageFinding { standing: of_severity(row.severity), title, words }
}

/// The values of an anomaly that has one; an anomaly of a channel or a whole recording has none.
fn figures(row: &AnomalyRow) -> Option<String> {
    let known = |value: Option<f64>| value.filter(|value| value.is_finite());
    let value = known(row.value)?;
    let usual = known(row.baseline).map(|usual| format!(" where {} is usual", figure(Some(usual))));
    let mut parts = vec![format!("{}: {}{}", row.quantity, figure(Some(value)), usual.unwrap_or_default())];
    if let Some(score) = known(row.score) {
        let limit = known(row.threshold).filter(|limit| *limit != 0.0);
        let limit = limit.map(|limit| format!(", an alarm from {}", figure(Some(limit))));
        parts.push(format!("score {}{}", figure(Some(score)), limit.unwrap_or_default()));
    }
    parts.extend(known(row.peak_value).map(|peak| format!("furthest out {}", figure(Some(peak)))));
    Some(parts.join("; "))
}

/// Alarms that need attention, the worst first, or a sentence that there are none.
pub(super) fn open_alarms(rows: &[&AnomalyRow], nothing: &str) -> PageBlock {
    let mut rows = rows.to_vec();
    rows.sort_by_key(|row| (std::cmp::Reverse(row.severity), row.anomaly_id));
    match rows.is_empty() {
        true => PageBlock::Text(nothing.to_owned()),
        false => PageBlock::Findings(rows.into_iter().map(of_anomaly).collect()),
    }
}

fn of_severity(severity: Severity) -> StatusWord {
    let level = match severity {
        Severity::Info => FigureLevel::Unknown,
        Severity::Warning => FigureLevel::Warning,
        Severity::Critical => FigureLevel::Critical,
    };
    StatusWord::new(severity.name(), level)
}

/// The time when friction reaches its limits, if there is a trend.
fn forecast(of: &Forecast) -> Option<String> {
    let trend = match of.trend {
        Trend::Rising => "rising",
        Trend::Falling => "falling",
        Trend::None => return None,
    };
    let at = |name: &str, crossing: &Option<Crossing>| {
        crossing.as_ref().map(|of| {
            let upper = of.upper.map_or_else(|| "later than can be said".to_owned(), |day| day.to_string());
            format!("{name} by {} (80 %: {} to {upper})", of.by, of.lower)
        })
    };
    let ahead: Vec<String> =
        [at("warning", &of.warning_at), at("critical", &of.critical_at)].into_iter().flatten().collect();
    (!ahead.is_empty())
        .then(|| format!("At this rate of use friction, {trend}, is expected to be {}.", ahead.join(", ")))
}

/// A message as a separate sentence.
pub(super) fn sentence(message: &str) -> String {
    let message = message.trim();
    let end = if message.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{}{end}", capital(message))
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// The line below a title: time of the page, and its program.
pub(super) fn made(now: Timestamp) -> String {
    format!("armwatch {}, {}; times are UTC", env!("CARGO_PKG_VERSION"), anomaly_texts::minute(now))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::anomaly::AnomalyKind;
    use armwatch_store::AlarmState;

    fn run(index: Option<f64>, rmsd: Option<f64>) -> SeriesRun {
        SeriesRun {
            run_id: 3,
            started_at: Timestamp::UNIX_EPOCH,
            joint: JointIndex::new(2),
            friction_index: index,
            friction_index_std_error: index.map(|_| 0.004),
            warm_friction_nm: None,
            moving_relative_rmsd: rmsd,
            rmsd_swing: None,
        }
    }

    #[test]
    fn a_run_without_figures_is_not_called_sound() {
        let known = of_run(&run(Some(1.021), Some(0.04)), &[]);
        assert_eq!((known.title.as_str(), known.standing.level), ("Joint 3", FigureLevel::Usual));
        assert!(known.words[0].contains("+2.1 % against the baseline"), "{:?}", known.words);
        let unknown = of_run(&run(None, None), &[]);
        assert_eq!(unknown.standing, StatusWord::new("not known", FigureLevel::Unknown));
        let levels: Vec<FigureLevel> =
            worst_first(vec![known, unknown]).into_iter().map(|of| of.standing.level).collect();
        assert_eq!(levels, [FigureLevel::Unknown, FigureLevel::Usual]);
    }

    fn health(number: usize, status: HealthStatus, reason: &str) -> FleetHealthRow {
        FleetHealthRow {
            robot: "R01".into(),
            joint: JointIndex::new(number - 1),
            last_run_at: Timestamp::UNIX_EPOCH,
            moving_relative_rmsd: None,
            friction_index: None,
            open_anomalies: 0,
            status,
            last_result_at: None,
            reason: Some(reason.to_owned()),
            expected_by: None,
            friction_quantity: None,
            forecast: None,
        }
    }

    #[test]
    fn a_reason_of_several_joints_is_told_once_with_what_was_known_of_each() {
        let refused = "the latest test gave no result: the torque is wrong";
        let rows = [1, 2].map(|number| {
            health(number, HealthStatus::Unknown, &format!("{refused}; known last: friction index {number}"))
        });
        let told = of_joints(&rows);
        let shown: Vec<(&str, &[String])> =
            told.iter().map(|of| (of.title.as_str(), of.words.as_slice())).collect();
        let expected: [(&str, &[String]); 3] = [
            ("All joints", &["The latest test gave no result: the torque is wrong.".to_owned()]),
            ("Joint 1", &["Known last: friction index 1.".to_owned()]),
            ("Joint 2", &["Known last: friction index 2.".to_owned()]),
        ];
        assert_eq!(shown, expected);
        // a single reason is reported with its joint
        let alone = of_joints(&rows[..1]);
        assert_eq!(alone.len(), 1);
        assert_eq!(
            alone[0].words,
            [format!("{}; known last: friction index 1.", sentence(refused).trim_end_matches('.'))]
        );
    }

    #[test]
    fn an_anomaly_without_figures_shows_none() {
        let mut row = AnomalyRow {
            anomaly_id: 1,
            robot: "R01".into(),
            run_id: Some(7),
            cycle: Some(1),
            joint: Some(JointIndex::new(3)),
            kind: AnomalyKind::Sensor,
            quantity: Quantity::TorqueNoiseRatio,
            unit: Quantity::TorqueNoiseRatio.unit(),
            severity: Severity::Warning,
            score: Some(1.0),
            threshold: Some(1.0),
            value: None,
            baseline: None,
            first_seen_at: Timestamp::UNIX_EPOCH,
            last_seen_at: Timestamp::UNIX_EPOCH,
            state: AlarmState::Open,
            message: "the torque signal stands".into(),
            last_run_id: Some(7),
            peak_value: None,
            peak_score: Some(1.0),
            onset_at: None,
            onset_run_id: None,
            onset_cycle: None,
            odds: None,
            alternatives: Vec::new(),
            shelved_until: None,
            ended: false,
            provisional: false,
            assignee: None,
        };
        let told = of_anomaly(&row);
        assert_eq!(told.words[1], "Number 1; open; since 1970-01-01 00:00Z, seen last 1970-01-01 00:00Z.");
        row.value = Some(1.2);
        assert_eq!(
            figures(&row).as_deref(),
            Some("torque_noise_ratio: 1.200; score 1.000, an alarm from 1.000")
        );
        row.baseline = Some(1.0);
        row.peak_value = Some(1.3);
        let all = "torque_noise_ratio: 1.200 where 1.000 is usual; score 1.000, an alarm from 1.000; furthest out 1.300";
        assert_eq!(figures(&row).as_deref(), Some(all));
    }

    #[test]
    fn messages_become_sentences() {
        assert_eq!(sentence("joint 3: worn"), "Joint 3: worn.");
        assert_eq!(sentence("Check it!"), "Check it!");
        assert_eq!(sentence(""), ".");
    }
}
