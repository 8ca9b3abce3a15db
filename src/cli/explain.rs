//! `armwatch explain`: how exports would be treated, without storing anything.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use jiff::Unit;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, runtime};
use super::shared::{output, paths};
use crate::pipeline::look::explain::{
    CycleSketch, Explainer, Explanation, ExportReading, Ledger, NextAction, RecognisedAs,
};
use armwatch_config::{Config, Layout, PartMatch, layout_units};
use armwatch_ingest::bytes::parts::RecordingParts;
use armwatch_ingest::find::join::join_paths;
use armwatch_ingest::table::column_map::{ColumnMap, Role};
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::slower::Slower;
use armwatch_model::run::{RunKind, Stage};
use armwatch_model::text;
use armwatch_store::time_in_views;

/// Most names of ignored columns that are listed.
const LISTED_COLUMNS: usize = 12;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch explain R00_20260105_0847_Col23_20s_cycle5.csv.gz
  armwatch explain new.csv --config trial.toml --quick
  armwatch explain inbox/*.csv --json | \\
      jq 'select(.next != \"nothing\") | .problems'

For each export, the command prints the robot and how it was recognised, the reading of the columns, the stages
and cycles, and the findings of the analysis. It also prints if the content is already stored, and the action that
`armwatch run` would take. It reads and analyses the export exactly as `armwatch ingest` does, but writes nothing
and only reads the database. Exit status 1 if an export would be quarantined.")]
pub(super) struct ExplainArgs {
    /// Exports
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Read the export and find its cycles, but do not analyse them
    #[arg(long)]
    quick: bool,
}

pub(super) fn explain(global: &Global, args: &ExplainArgs) -> Result<u8, CliError> {
    let config = Arc::new(global.read_config()?);
    runtime()?.block_on(async {
        let mut explainer = Explainer::new(Arc::clone(&config)).await;
        let mut code = EXIT_DONE;
        for path in &args.files {
            if paths::metadata(path)?.is_dir() {
                return Err(CliError::Usage(format!(
                    "{0}: is a folder; name exports, such as {0}/*.csv",
                    text::of_path(path)
                )));
            }
        }
        let exports = join_paths(args.files.clone(), |name| config.part_of(name));
        for (number, path) in exports.iter().enumerate() {
            let explanation = explainer.explain(path, args.quick).await?;
            if explanation.next == NextAction::Quarantine {
                code = EXIT_FOUND;
            }
            if global.json {
                output::json(&as_value(&explanation));
            } else {
                if number > 0 {
                    output::line("");
                }
                as_lines(&config, &explanation).iter().for_each(|line| output::line(line));
            }
        }
        Ok(code)
    })
}

fn as_lines(config: &Config, of: &Explanation) -> Vec<String> {
    let mut lines = vec![format!("{} ({})", text::of_path(&of.path), size(of.bytes))];
    if let Some(recognised) = &of.recognised {
        lines.extend(recognised_lines(recognised));
        lines.extend(parts_text(of, &recognised.entry.layout).map(|text| topic("parts", &text)));
        if let Some(reading) = &of.reading {
            lines.extend(reading_lines(&recognised.entry.layout, &recognised.entry.description, reading));
        }
    }
    let problems = of.problems();
    let listed = problems.iter().map(|problem| topic("problem", problem));
    lines.extend(listed);
    if problems.is_empty() {
        lines.push(topic("problems", "none"));
    }
    lines.extend(of.remarks().iter().map(|remark| topic("remark", remark)));
    lines.push(topic("ledger", &ledger_text(&of.ledger)));
    lines.push(topic("next", &next_text(config, of)));
    lines
}

fn topic(name: &str, text: &str) -> String {
    format!("  {name:<11} {text}")
}

fn recognised_lines(of: &RecognisedAs) -> Vec<String> {
    let from = match &of.entry.layout.start {
        Some(start) => format!("from column {} of its first row", start.column),
        None if of.named_start => "from the file's name".to_owned(),
        None => "the time of the file, because its name has none".to_owned(),
    };
    let by = match &of.pattern {
        Some(pattern) => format!("by recognition.file_name '{pattern}'"),
        None => "the name of the file: recognition.file_name does not match it".to_owned(),
    };
    // the time of a file has meaningless digits
    let started_at = of.started_at.round(Unit::Millisecond).unwrap_or(of.started_at);
    vec![
        topic("robot", &format!("{}, {by}", of.robot)),
        topic(
            "description",
            &format!("{}, of the entry [[robot]] name = \"{}\"", of.entry.description.model, of.entry.robots),
        ),
        topic("start", &format!("{started_at}, {from}")),
    ]
}

/// The parts of a recording in several files.
fn parts_text(of: &Explanation, layout: &Layout) -> Option<String> {
    let files = RecordingParts::of(&of.path)?.files();
    let how = match layout.parts.as_ref().map_or(PartMatch::After, |rule| rule.matching) {
        PartMatch::Row => "joined by row number",
        PartMatch::Time => "joined by time",
        PartMatch::After => "one after the other",
    };
    let names: Vec<String> = files.iter().map(|(_, file)| text::of_file_name(file)).collect();
    Some(format!("{} parts, {how}: {}", names.len(), names.join(", ")))
}

/// The rates of slower channels, and the delay of their values.
fn slower_texts(layout: &Layout, of: &ExportReading) -> Vec<String> {
    let (filled, step) = (of.filled, 1.0 / of.sample_rate);
    let channels = [
        ("torque", layout.slower.torque, filled.torques),
        ("velocity", layout.slower.velocity, filled.velocities),
    ];
    let text = |(name, how, count): (&str, Option<Slower>, usize)| {
        let (how, period) = (how?, step * filled.rows as f64 / count.max(1) as f64);
        if filled.rows == 0 || count == filled.rows || !period.is_finite() {
            return None;
        }
        let then = match how {
            Slower::Hold => format!(
                "the last value is held, so it is {:.1} ms late on average; delay_s corrects this",
                500.0 * (period - step)
            ),
            Slower::Resample => {
                "rows between are interpolated linearly, without a delay; faster changes are lost".to_owned()
            }
        };
        Some(format!("{name} has a value in {count} of {} rows, {:.1} Hz: {then}", filled.rows, 1.0 / period))
    };
    channels.into_iter().filter_map(text).collect()
}

fn reading_lines(layout: &Layout, robot: &Robot, of: &ExportReading) -> Vec<String> {
    let mut lines = vec![topic("layout", &layout.name)];
    if let Some(map) = &of.columns {
        lines.extend(column_lines(layout, map));
    }
    if of.rows > 0 {
        // clocks of milliseconds leave meaningless digits
        let hertz = (of.sample_rate * 1e3).round() / 1e3;
        let rate = if hertz > 0.0 { format!(", {hertz} Hz") } else { String::new() };
        lines.push(topic("recording", &format!("{} rows, {:.1} s{rate}", of.rows, of.duration)));
    }
    lines.extend(slower_texts(layout, of).iter().map(|text| topic("rate", text)));
    if layout.stage.kind().run_kind() == RunKind::Production {
        lines.push(topic("kind", "production: no stages, compared with the parameters of the robot's tests"));
    }
    if !of.cycles.is_empty() {
        lines.push(topic("cycles", &of.cycles.len().to_string()));
        lines.extend(stage_table(&of.cycles).lines().map(|line| format!("              {line}")));
        lines.extend(friction_text(robot, &of.cycles).map(|text| topic("friction", &text)));
    }
    lines
}

fn column_lines(layout: &Layout, map: &ColumnMap) -> Vec<String> {
    let units = layout_units(layout);
    let side = |motor: bool| if motor { ", at the motor" } else { "" };
    let named = |wanted: &dyn Fn(Role) -> bool| -> String {
        let found = map.roles.iter().zip(&map.names).filter(|(role, _)| wanted(**role));
        found.map(|(_, name)| name.as_str()).collect::<Vec<_>>().join(", ")
    };
    let mut lines = Vec::new();
    let mut add = |what: &str, names: String, unit: String| {
        if !names.is_empty() {
            lines.push(topic("column", &format!("{what}: {names}{unit}")));
        }
    };
    let unit = |unit: &str| format!(" ({unit})");
    let motor = layout.motor_side;
    add("time", named(&|role| role == Role::Time), units.time.map(unit).unwrap_or_default());
    add(
        "position",
        named(&|role| matches!(role, Role::Position(_))),
        format!(" ({}{})", units.position, side(motor.position)),
    );
    add(
        "velocity",
        named(&|role| matches!(role, Role::Velocity(_))),
        format!(" ({}{})", units.velocity.unwrap_or("rad/s"), side(motor.position)),
    );
    add(
        "torque",
        named(&|role| matches!(role, Role::Torque(_))),
        format!(" ({}{})", units.torque, side(motor.torque)),
    );
    let motor_unit = layout.motor_temperature.as_ref().map(|motor| unit(motor.unit.name()));
    let ambient_unit = layout.ambient_temperature.as_ref().map(|ambient| unit(ambient.unit.name()));
    add(
        "motor temperature",
        named(&|role| matches!(role, Role::MotorTemperature(..))),
        motor_unit.unwrap_or_default(),
    );
    add(
        "ambient temperature",
        named(&|role| matches!(role, Role::AmbientTemperature(_))),
        ambient_unit.unwrap_or_default(),
    );
    add("stage", named(&|role| matches!(role, Role::Stage(_))), String::new());
    add("cycle", named(&|role| role == Role::Cycle), String::new());
    add("friction", named(&|role| matches!(role, Role::FrictionJoint | Role::FrictionLevel)), String::new());
    let ignored: Vec<&str> = ignored(map);
    let more = ignored.len().saturating_sub(LISTED_COLUMNS);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    add("ignored", ignored.iter().take(LISTED_COLUMNS).copied().collect::<Vec<_>>().join(", "), more);
    if map.velocity.is_none() {
        lines.push(topic("column", "velocity: none, derived from positions"));
    }
    lines
}

fn ignored(map: &ColumnMap) -> Vec<&str> {
    let unused = map.roles.iter().zip(&map.names).filter(|(role, _)| **role == Role::Ignored);
    unused.map(|(_, name)| if name.is_empty() { "(no name)" } else { name.as_str() }).collect()
}

fn stage_table(cycles: &[CycleSketch]) -> String {
    let header = ["cycle", "start_s", "rows", "between", "excitation", "friction", "warming", "analysis"];
    let rows: Vec<Vec<String>> = cycles
        .iter()
        .map(|cycle| {
            let mut row =
                vec![cycle.cycle.to_string(), format!("{:.1}", cycle.start), cycle.rows.to_string()];
            row.extend(cycle.stages.iter().map(|part| match part.rows {
                0 => "-".to_owned(),
                rows => format!("{rows} ({:.1} s)", part.seconds),
            }));
            row.push(match &cycle.analysis {
                None => "not made".into(),
                Some(analysis) => match (&analysis.identification, analysis.refusal()) {
                    (Ok(found), _) => {
                        let shown = found.parameters.iter().filter(|of| of.is_shown()).count();
                        let doubtful = if analysis.is_doubtful() { ", doubtful" } else { "" };
                        format!("{shown} parameters{doubtful}")
                    }
                    (Err(_), Some(_)) => "refused".into(),
                    (Err(_), None) => "compared with a test".into(),
                },
            });
            row
        })
        .collect();
    output::table(&header, &rows)
}

/// Levels of measured friction in all cycles, by joint; `None` if nothing was analysed.
fn levels_seen(cycles: &[CycleSketch]) -> Option<BTreeMap<JointIndex, Vec<f64>>> {
    let mut seen: BTreeMap<JointIndex, Vec<f64>> = BTreeMap::new();
    for analysis in cycles.iter().filter_map(|cycle| cycle.analysis.as_ref()) {
        for point in &analysis.friction_points {
            let of_joint = seen.entry(point.joint).or_default();
            if !of_joint.iter().any(|known| same_level(*known, point.speed_fraction)) {
                of_joint.push(point.speed_fraction);
            }
        }
    }
    seen.values_mut().for_each(|levels| levels.sort_by(f64::total_cmp));
    cycles.iter().any(|cycle| cycle.analysis.is_some()).then_some(seen)
}

/// Levels differ by some percent.
fn same_level(a: f64, b: f64) -> bool {
    (a - b).abs() < 1e-9
}

fn friction_text(robot: &Robot, cycles: &[CycleSketch]) -> impl Iterator<Item = String> {
    let has_stage = cycles.iter().any(|cycle| cycle.stages[Stage::Friction as usize].rows > 0);
    let seen = levels_seen(cycles).filter(|_| has_stage);
    let percent = |levels: &[f64]| {
        let shown: Vec<String> = levels.iter().map(|level| format!("{:.0}", 100.0 * level)).collect();
        format!("{} %", shown.join(", "))
    };
    let lines: Vec<String> = seen.map_or_else(Vec::new, |seen| {
        let line = |joint: JointIndex| {
            let found = seen.get(&joint).map(Vec::as_slice).unwrap_or_default();
            let missing: Vec<f64> = robot
                .speed_levels
                .iter()
                .copied()
                .filter(|level| !found.iter().any(|known| same_level(*known, *level)))
                .collect();
            match (found.is_empty(), missing.is_empty()) {
                (true, _) => format!("joint {joint}: no level found"),
                (false, true) => format!("joint {joint}: {}", percent(found)),
                (false, false) => format!("joint {joint}: {}; missing {}", percent(found), percent(&missing)),
            }
        };
        robot.joint_indices().map(line).collect()
    });
    lines.into_iter()
}

fn ledger_text(of: &Ledger) -> String {
    match of {
        Ledger::NoDatabase => "there is no database yet".into(),
        Ledger::Unreadable(reason) => format!("not checked: {reason}"),
        Ledger::Unknown => "this content is not stored".into(),
        Ledger::Known(run) => {
            let reason = run.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
            format!(
                "stored as run {}, {}, {}{reason}",
                run.run_id,
                run.status.name(),
                output::counted(run.cycles_stored, "cycle")
            )
        }
    }
}

fn next_text(config: &Config, of: &Explanation) -> String {
    let settle = config.watch.settle.as_secs_f64();
    let wait = match of.age_s {
        Some(age) if age < settle => format!(
            "written {age:.1} s ago; a plain file is read cycle by cycle as it grows, and is complete after \
            {settle} s without a change: "
        ),
        _ => String::new(),
    };
    let then = match &of.next {
        NextAction::Nothing { run_id } => format!("nothing: the content is run {run_id}"),
        NextAction::Quarantine => {
            "quarantined because of the first problem; complete cycles before it are stored".into()
        }
        NextAction::Store { continues, replaces } => {
            let continues = continues.map(|run| format!(", continuing run {run}")).unwrap_or_default();
            let instead = replaces.map(|run| format!(", superseding run {run}")).unwrap_or_default();
            format!("stored{continues}{instead}")
        }
    };
    format!("{wait}{then}")
}

fn size(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} bytes"),
        10_000..10_000_000 => format!("{:.0} kB", bytes as f64 / 1e3),
        _ => format!("{:.0} MB", bytes as f64 / 1e6),
    }
}

fn as_value(of: &Explanation) -> serde_json::Value {
    let (next, run_id, supersedes) = match &of.next {
        NextAction::Store { continues, replaces } => ("store", *continues, *replaces),
        NextAction::Nothing { run_id } => ("nothing", Some(*run_id), None),
        NextAction::Quarantine => ("quarantine", None, None),
    };
    let mut value = json!({
        "file": text::of_path(&of.path),
        "bytes": of.bytes,
        "age_s": of.age_s,
        "next": next,
        "run_id": run_id,
        "supersedes_run_id": supersedes,
        "ledger": ledger_text(&of.ledger),
        "problems": of.problems(),
        "remarks": of.remarks(),
        "rejection": of.rejection.as_ref().map(|rejection| json!({
            "line": rejection.line, "column": rejection.column, "value": rejection.value,
            "reason": rejection.reason, "remedy": rejection.remedy,
        })),
    });
    if let Some(parts) = RecordingParts::of(&of.path) {
        let files = parts.files();
        value["parts"] = files.iter().map(|(_, file)| json!(text::of_path(file))).collect();
    }
    if let Some(recognised) = &of.recognised {
        value["robot"] = json!(recognised.robot);
        value["started_at"] = json!(time_in_views(recognised.started_at));
        value["start_from_name"] = json!(recognised.named_start && recognised.entry.layout.start.is_none());
        value["model"] = json!(recognised.entry.description.model);
        value["layout"] = json!(recognised.entry.layout.name);
        value["kind"] = json!(recognised.entry.layout.stage.kind().run_kind().name());
    }
    if let Some(reading) = &of.reading {
        value["rows"] = json!(reading.rows);
        value["duration_s"] = json!(reading.duration);
        value["sample_rate_hz"] = json!(reading.sample_rate);
        value["content_hash"] = json!(reading.content.map(|hash| hash.to_string()));
        value["ignored_columns"] = json!(reading.columns.as_ref().map(ignored));
        value["cycles"] = reading.cycles.iter().map(cycle_value).collect();
        value["friction_levels"] = json!(levels_seen(&reading.cycles).map(|seen| {
            seen.iter()
                .map(|(joint, levels)| json!({"joint": joint.number(), "speed_fractions": levels}))
                .collect::<Vec<_>>()
        }));
    }
    value
}

fn cycle_value(of: &CycleSketch) -> serde_json::Value {
    let stages: Vec<serde_json::Value> = of
        .stages
        .iter()
        .map(|part| json!({"stage": part.stage.name(), "rows": part.rows, "seconds": part.seconds}))
        .collect();
    json!({
        "cycle": of.cycle,
        "start_s": of.start,
        "duration_s": of.duration,
        "rows": of.rows,
        "stages": stages,
        "identified": of.analysis.as_ref().map(|analysis| analysis.identification.is_ok()),
        "doubtful": of.analysis.as_ref().map(CycleAnalysis::is_doubtful),
        "reason": of.analysis.as_ref().and_then(CycleAnalysis::refusal),
        "remarks": of.analysis.as_ref().map(|analysis| &analysis.remarks),
    })
}
