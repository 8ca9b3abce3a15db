//! Tests a proposed layout on the export that it was proposed for.

use std::path::Path;

use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use crate::cli::shared::shipped_robot::shipped_robot;
use crate::pipeline::look::explain::{ExportReading, try_layout};
use armwatch_config::{Layout, parse_layout};
use armwatch_ingest::infer::proposal::Proposed;
use armwatch_ingest::rejection::Rejection;
use armwatch_model::robot::{Joint, JointLimits, Robot};
use armwatch_model::run::Stage;
use armwatch_model::text;

/// Most findings and remarks that are written above a layout; `armwatch explain` shows all.
const MOST_FINDINGS: usize = 6;

/// Largest position, speed and acceleration of an unknown joint: beyond those of any motor.
const NO_LIMIT: f64 = 1e6;

/// Result of a test.
pub(super) struct Trial {
    /// Sentences for the head of the layout, the most important first.
    pub(super) sentences: Vec<String>,
    /// The fault that makes the layout unfit for its own file.
    pub(super) fault: Option<String>,
    /// The same for scripts.
    pub(super) value: Value,
}

impl Trial {
    fn not_made(reason: &str) -> Self {
        Self {
            sentences: vec![format!("Not tried on its file: {reason}.")],
            fault: None,
            value: json!({"tried": false, "reason": reason}),
        }
    }
}

/// Reads the whole export with the proposed layout, with likely answers to its questions, and analyses it if the arm's
/// description is known.
pub(super) fn run(path: &Path, proposed: &Proposed, description: Option<&Robot>) -> Result<Trial, CliError> {
    let Some(answered) = &proposed.answered else {
        return Ok(Trial::not_made("a question has no likely answer; answer it and run `armwatch explain`"));
    };
    let layout = match parse_layout("proposal", answered) {
        Ok(layout) => layout,
        Err(errors) => {
            let problems: Vec<String> =
                errors.0.iter().map(|one| format!("{}: {}", one.key, one.problem)).collect();
            return Ok(failed(format!("this layout does not load: {}", problems.join("; ")), proposed));
        }
    };
    // currents may need gains that the description does not have yet; reading is then tested without it
    let (misfit, robot) = match description.map(|robot| (layout.factors(robot), robot)) {
        Some((Ok(_), robot)) => (None, Some(robot)),
        Some((Err(misfit), _)) => (Some(format!("{}; {}", misfit.problem, misfit.remedy)), None),
        None => (None, None),
    };
    let stand_in;
    let arm = match robot {
        Some(robot) => robot,
        None if proposed.joints == 0 => {
            return Ok(Trial::not_made("the number of joints is unknown"));
        }
        None => {
            stand_in = unknown_arm(proposed.joints)?;
            &stand_in
        }
    };
    let (reading, rejection) = try_layout(path, &layout, arm, robot.is_some());
    Ok(of_reading(path, proposed, &layout, &reading, rejection.as_ref(), misfit))
}

fn failed(fault: String, proposed: &Proposed) -> Trial {
    Trial {
        sentences: vec![format!("THE TRIAL FAILED: {fault}")],
        value: json!({
            "tried": true, "sound": false, "fault": fault, "with_likely_answers": proposed.questions > 0,
        }),
        fault: Some(fault),
    }
}

fn of_reading(
    path: &Path,
    proposed: &Proposed,
    layout: &Layout,
    reading: &ExportReading,
    rejection: Option<&Rejection>,
    misfit: Option<String>,
) -> Trial {
    let analyses: Vec<_> = reading.cycles.iter().filter_map(|cycle| cycle.analysis.as_ref()).collect();
    let refused = reading.refusals();
    let has_positions = layout.position.columns != armwatch_config::JointColumns::NotRecorded;
    let none_is_taken =
        has_positions && !analyses.is_empty() && analyses.iter().all(|analysis| analysis.refusal().is_some());
    let fault = match rejection {
        Some(rejection) => Some(format!("this layout does not read its own file: {}", rejection.sentence())),
        None if reading.cycles.is_empty() => Some("this layout finds no cycle in its own file".to_owned()),
        None => none_is_taken.then(|| "every cycle of its own file is refused with this layout".to_owned()),
    };
    let stages = [Stage::Excitation, Stage::Friction, Stage::Warming].map(|stage| {
        let parts = reading.cycles.iter().map(|cycle| cycle.stages[stage as usize]);
        let parts: Vec<_> = parts.filter(|part| part.rows > 0).collect();
        (stage.name(), parts.len(), parts.iter().map(|part| part.rows).sum::<usize>())
    });
    let answered = if proposed.questions > 0 { ", with the likely answers to its questions" } else { "" };
    let staged: Vec<String> = stages
        .iter()
        .filter(|(_, count, _)| *count > 0)
        .map(|(name, count, rows)| {
            format!("{} ({rows} rows)", output::counted(*count, &format!("{name} stage")))
        })
        .collect();
    let staged = if staged.is_empty() { "no stage".to_owned() } else { staged.join(", ") };
    let rate = (reading.sample_rate * 1e3).round() / 1e3;
    let tried = format!(
        "Tried on {}{answered}: {} read, {rate} Hz, {}, {staged}.",
        text::of_file_name(path),
        output::counted(reading.rows, "row"),
        output::counted(reading.cycles.len(), "cycle"),
    );
    let mut sentences: Vec<String> = fault.iter().map(|fault| format!("THE TRIAL FAILED: {fault}")).collect();
    sentences.push(tried);
    let remarks = reading.remarks();
    let findings: Vec<&String> = refused.iter().chain(&remarks).collect();
    sentences.extend(findings.iter().take(MOST_FINDINGS).map(|finding| format!("Finding: {finding}")));
    if findings.len() > MOST_FINDINGS {
        let more = findings.len() - MOST_FINDINGS;
        sentences.push(format!("{} more: see `armwatch explain`.", output::counted(more, "finding")));
    }
    sentences.push(match (&misfit, analyses.is_empty()) {
        (Some(misfit), _) => format!("Not identified: the description does not fit: {misfit}"),
        (None, true) => "Not identified: this needs a description (--description or --robot).".to_owned(),
        (None, false) if findings.is_empty() => "Findings: none.".to_owned(),
        (None, false) => String::new(),
    });
    sentences.retain(|sentence| !sentence.is_empty());
    let by_stage: Vec<Value> = stages
        .iter()
        .map(|(name, count, rows)| json!({"stage": name, "count": count, "rows": rows}))
        .collect();
    Trial {
        value: json!({
            "tried": true,
            "sound": fault.is_none(),
            "fault": fault,
            "with_likely_answers": proposed.questions > 0,
            "rows": reading.rows,
            "sample_rate_hz": reading.sample_rate,
            "cycles": reading.cycles.len(),
            "stages": by_stage,
            "identified": !analyses.is_empty(),
            "refusals": refused,
            "remarks": remarks,
            "misfit": misfit,
        }),
        fault,
        sentences,
    }
}

/// An arm with a number of joints and no other properties: enough to read an export in any unit.
fn unknown_arm(joints: usize) -> Result<Robot, CliError> {
    let shipped = shipped_robot()?;
    let joint =
        shipped.joints.first().ok_or_else(|| CliError::Internal("the shipped arm has no joint".into()))?;
    let limits = JointLimits {
        position_min: -NO_LIMIT,
        position_max: NO_LIMIT,
        velocity: NO_LIMIT,
        acceleration: NO_LIMIT,
        jerk: None,
    };
    let joint = Joint {
        name: None,
        limits,
        gear_ratio: 1.0,
        drive_gain: Some(1.0),
        motor_torque_constant: Some(1.0),
        rated_motor_torque: Some(1.0),
        rated_torque: Some(1.0),
        ..joint.clone()
    };
    let joints = vec![joint; joints];
    Ok(Robot {
        model: "unknown".into(),
        transmission: Robot::uncoupled_transmission(&joints),
        couplings: Vec::new(),
        springs: Vec::new(),
        parallelograms: Vec::new(),
        excitation: None,
        joints,
        ..shipped
    })
}
