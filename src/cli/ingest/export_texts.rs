//! Texts about an export and about conclusions from its robot's history.

use std::path::Path;
use std::time::Duration;

use serde_json::json;

use crate::cli::shared::output;
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::context::Outcome;
use armwatch_model::robot::JointIndex;
use armwatch_model::text;
use armwatch_store::{EventKind, RunResult};

/// `34 s`, `2 min 5 s`, `1 h 12 min`.
pub(super) fn lasting(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..60 => format!("{seconds} s"),
        seconds @ 60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        seconds => format!("{} h {} min", seconds / 3600, seconds % 3600 / 60),
    }
}

/// Text about an export that another program reads at the same time.
pub(super) fn elsewhere(path: &Path) -> String {
    format!("{}: another program is reading it; checked again at the end", text::of_path(path))
}

/// Prints the outcome of an export: `known_robot` is the robot of a run that was stored before, `empty` is the note
/// about a run without result.
pub(super) fn print(
    path: &Path,
    outcome: &Outcome,
    known_robot: Option<&str>,
    empty: Option<&RunResult>,
    as_json: bool,
) {
    if as_json {
        let mut value = as_value(path, outcome, known_robot);
        if matches!(outcome, Outcome::Stored(_) | Outcome::AlreadyStored { .. }) {
            value["without_result"] = empty.is_some().into();
        }
        output::json(&value);
        return;
    }
    let text = as_text(path, outcome, known_robot);
    let (said, rest) = text.split_once(' ').unwrap_or((&text, ""));
    output::line(&format!("{} {rest}", output::coloured(said)));
    if let Outcome::Stored(run) = outcome {
        // a faulty channel mostly affects every cycle
        for (cycles, reason) in run.refusals() {
            output::line(&format!("             {cycles} without parameters: {reason}"));
        }
    }
    if let Some(result) = empty {
        output::line(&format!("             {}", no_result(result, matches!(outcome, Outcome::Stored(_)))));
    }
}

/// Why an export gave no result; if it was just read, the reason itself is printed above.
fn no_result(result: &RunResult, is_read_now: bool) -> String {
    let reason = result.reason.as_deref().filter(|_| !is_read_now);
    match (result.refused, reason) {
        (0, _) => "no result: it has no usable cycle".into(),
        (refused, reason) => format!(
            "no result: {refused} of {} were refused{}",
            output::counted(result.cycles, "cycle"),
            reason.map_or_else(String::new, |reason| format!(": {reason}"))
        ),
    }
}

/// Prints conclusions from a robot's history with the new runs, if there are new ones.
pub(super) fn print_conclusions(concluded: &Concluded, as_json: bool) {
    for event in &concluded.events {
        let what = event.what.name();
        if as_json {
            // only events that need attention count as anomalies
            let outcome = if event.what.calls() { "anomaly" } else { "anomaly_event" };
            output::json(&json!({
                "outcome": outcome, "event": what, "robot": concluded.robot,
                "joint": event.joint.map(JointIndex::number), "anomaly_id": event.anomaly_id, "kind": event.kind,
                "severity": event.severity.name(), "message": event.message,
            }));
        } else {
            let (said, more) = match event.what {
                EventKind::Opened => (event.severity.name(), String::new()),
                _ if event.what.calls() => (event.severity.name(), format!(" ({what})")),
                _ => (what, String::new()),
            };
            let said = output::padded(&output::coloured(said), 12);
            output::line(&format!("{said} {} {}{more}: {}", concluded.robot, event.kind, event.message));
        }
    }
}

fn as_text(path: &Path, outcome: &Outcome, known_robot: Option<&str>) -> String {
    let file = text::of_path(path);
    match outcome {
        Outcome::Stored(run) => format!(
            "stored       {file}: robot {}, run {}, {}, {} rows",
            run.robot,
            run.run_id,
            output::counted(run.cycles, "cycle"),
            run.rows
        ),
        Outcome::AlreadyStored { run_id } => {
            let robot = known_robot.map(|robot| format!(" of robot {robot}")).unwrap_or_default();
            format!("known        {file}: stored as run {run_id}{robot}")
        }
        Outcome::Quarantined { rejection, cycles, .. } => {
            let kept = match cycles {
                0 => String::new(),
                1 => " (1 cycle before it is stored)".into(),
                _ => format!(" ({cycles} cycles before it are stored)"),
            };
            format!("quarantined  {rejection}{kept}")
        }
        Outcome::Unreadable { rejection } => format!("unreadable   {rejection}; then run again"),
        Outcome::Interrupted => format!("interrupted  {file}: run again to continue"),
        Outcome::InWork { run_id: Some(run_id) } => {
            format!("in work      {file}: another program is reading it as run {run_id}; run again")
        }
        Outcome::InWork { run_id: None } => {
            format!("in work      {file}: another program is reading it; run again")
        }
        Outcome::Changed => format!("changed      {file}: changed or vanished while it was read; run again"),
    }
}

fn as_value(path: &Path, outcome: &Outcome, known_robot: Option<&str>) -> serde_json::Value {
    let file = text::of_path(path);
    match outcome {
        Outcome::Stored(run) => json!({
            "file": file, "outcome": "stored", "run_id": run.run_id, "robot": run.robot,
            "cycles": run.cycles, "rows": run.rows,
            "refused": run.refused.iter().map(|(cycle, reason)| json!({"cycle": cycle, "reason": reason})).collect::<Vec<_>>(),
        }),
        Outcome::AlreadyStored { run_id } => {
            json!({"file": file, "outcome": "known", "run_id": run_id, "robot": known_robot})
        }
        Outcome::Quarantined { run_id, rejection, cycles, .. } => json!({
            "file": file, "outcome": "quarantined", "run_id": run_id, "reason": rejection.sentence(),
            "line": rejection.line, "column": rejection.column, "value": rejection.value,
            "remedy": rejection.remedy, "cycles": cycles,
        }),
        Outcome::Unreadable { rejection } => json!({
            "file": file, "outcome": "unreadable", "reason": rejection.sentence(), "remedy": rejection.remedy,
        }),
        Outcome::Interrupted => json!({"file": file, "outcome": "interrupted"}),
        Outcome::Changed => json!({"file": file, "outcome": "changed"}),
        Outcome::InWork { run_id } => json!({"file": file, "outcome": "in_work", "run_id": run_id}),
    }
}
