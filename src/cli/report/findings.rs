//! What one should read first: joints, alarms, and what is not known.

use jiff::Timestamp;

use super::cells::{change, figure, percent};
use crate::anomaly::Severity;
use crate::anomaly::forecast::{Crossing, Forecast, Trend};
use crate::cli::alerts::words;
use crate::cli::shared::life::standing;
use crate::report::figure::{Level, Standing};
use crate::report::page::{Block, Finding};
use crate::store::{AnomalyRow, FleetHealthRow, SeriesRun};

/// States of an anomaly that nobody has to look at any more.
const SETTLED: [&str; 2] = ["resolved", "false_alarm"];

/// Whether somebody still has to look at an anomaly.
pub(super) fn is_unsettled(row: &AnomalyRow) -> bool {
    !SETTLED.contains(&row.state.as_str())
}

/// A joint as the fleet's health has it.
pub(super) fn of_health(row: &FleetHealthRow) -> Finding {
    let mut words = Vec::new();
    if let Some(index) = row.friction_index {
        let quantity = match row.friction_quantity.as_deref() {
            Some("warm_friction_nm") => "Warm friction as measured",
            Some("excitation_friction_nm") => "Friction of the excitation stage",
            _ => "Friction at equal speed and warmth",
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
    words.extend(row.reason.as_deref().map(sentence));
    words.extend(row.forecast.as_ref().and_then(forecast));
    Finding { standing: standing(row.status), title: format!("Joint {}", row.joint), words }
}

/// Findings in the order in which one should look at them; those alike stay as they are.
pub(super) fn worst_first(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by_key(|of| match of.standing.level {
        Level::Critical => 0,
        Level::Warning => 1,
        Level::Unknown => 2,
        Level::Usual => 3,
    });
    findings
}

/// A joint as one run shows it, without a conclusion of the present.
pub(super) fn of_run(run: &SeriesRun, alarms: &[&AnomalyRow]) -> Finding {
    let of_joint: Vec<&&AnomalyRow> = alarms.iter().filter(|row| row.joint == Some(run.joint)).collect();
    let mut words = Vec::new();
    match (run.friction_index, run.friction_index_std_error) {
        (Some(index), error) => words.push(format!(
            "Friction at equal speed and warmth: {} against the baseline (friction index {index:.4}, standard error {}).",
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
            Standing::new("not known", Level::Unknown)
        }
        None => Standing::new("no alarm", Level::Usual),
    };
    Finding { standing, title: format!("Joint {}", run.joint), words }
}

/// An anomaly with its figures.
pub(super) fn of_anomaly(row: &AnomalyRow) -> Finding {
    let value = |value: Option<f64>| figure(value);
    let mut words = vec![sentence(&row.message)];
    words.push(format!(
        "Number {}; {}; since {}, seen last {}. {}: {} where {} is usual; score {}, an alarm from {}; furthest out {}.",
        row.anomaly_id,
        words::state(row),
        words::minute(row.onset_at.unwrap_or(row.first_seen_at)),
        words::minute(row.last_seen_at),
        row.quantity,
        value(row.value),
        value(row.baseline),
        value(row.score),
        value(row.threshold),
        value(row.peak_value),
    ));
    if !row.alternatives.is_empty() {
        let causes: Vec<&str> = row.alternatives.iter().map(|of| of.cause.as_str()).collect();
        words.push(format!("Less likely causes that were compared: {}.", causes.join(", ")));
    }
    let title = format!("{}, {}", capital(&row.kind), words::place(row));
    Finding { standing: of_severity(row.severity), title, words }
}

/// Alarms that somebody has to look at, the worst first, or a sentence that there are none.
pub(super) fn open_alarms(rows: &[&AnomalyRow], nothing: &str) -> Block {
    let mut rows = rows.to_vec();
    rows.sort_by_key(|row| (std::cmp::Reverse(row.severity), row.anomaly_id));
    match rows.is_empty() {
        true => Block::Text(nothing.to_owned()),
        false => Block::Findings(rows.into_iter().map(of_anomaly).collect()),
    }
}

fn of_severity(severity: Severity) -> Standing {
    let level = match severity {
        Severity::Info => Level::Unknown,
        Severity::Warning => Level::Warning,
        Severity::Critical => Level::Critical,
    };
    Standing::new(severity.name(), level)
}

/// When friction reaches its limits, where a trend can be told.
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

/// A message as a sentence of its own.
pub(super) fn sentence(message: &str) -> String {
    let message = message.trim();
    let end = if message.ends_with(['.', '!', '?']) { "" } else { "." };
    format!("{}{end}", capital(message))
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// The line below a title: when the page was made, and by what.
pub(super) fn made(now: Timestamp) -> String {
    format!("armwatch {}, {}; times are UTC", env!("CARGO_PKG_VERSION"), words::minute(now))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::JointIndex;

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
        assert_eq!((known.title.as_str(), known.standing.level), ("Joint 3", Level::Usual));
        assert!(known.words[0].contains("+2.1 % against the baseline"), "{:?}", known.words);
        let unknown = of_run(&run(None, None), &[]);
        assert_eq!(unknown.standing, Standing::new("not known", Level::Unknown));
        let levels: Vec<Level> =
            worst_first(vec![known, unknown]).into_iter().map(|of| of.standing.level).collect();
        assert_eq!(levels, [Level::Unknown, Level::Usual]);
    }

    #[test]
    fn messages_become_sentences() {
        assert_eq!(sentence("joint 3: worn"), "Joint 3: worn.");
        assert_eq!(sentence("Check it!"), "Check it!");
        assert_eq!(sentence(""), ".");
    }
}
