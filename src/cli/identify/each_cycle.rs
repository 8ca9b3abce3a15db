//! `armwatch identify --each-cycle`: a history identified again, cycle by cycle.

use std::collections::HashMap;
use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use super::args::{IdentifyArgs, name_taken};
use super::output::parameter_value;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::selection::note_cycles;
use crate::pipeline::stored::chosen_cycles::RunCycles;
use crate::pipeline::stored::reestimate::{EstimatorChoice, reestimate};
use armwatch_model::robot::ParameterId;
use armwatch_model::text;
use armwatch_store::{
    CycleView, ModelParameter, Reestimate, ReestimatedCycle, ReestimatedStatistics, RunRow, Store,
};

pub(in crate::cli) async fn each_cycle(
    global: &Global,
    args: &IdentifyArgs,
    chosen: &[RunCycles],
    choice: &EstimatorChoice,
    expected: u64,
    store: &Store,
) -> Result<u8, CliError> {
    let bar = progress_bar(expected);
    let found = reestimate(store, chosen, choice, &mut |done| bar.set_position(done as u64)).await;
    bar.finish_and_clear();
    let (found, notes) = found?;
    note_cycles(&notes.passed_over, &notes.in_spite);
    if let Some(name) = &args.save
        && !store.save_reestimate(name, &found).await?
    {
        return Err(name_taken(name));
    }
    let parameters = store.model_parameters(&found.model).await?;
    if global.json {
        print_json(&found, &parameters);
    } else {
        output::block(&as_text(&found));
        if let Some(name) = &args.save {
            output::print_hint(&format!("saved as {name}"));
        }
    }
    let complete = notes.passed_over.is_empty() && found.cycles.iter().all(|cycle| cycle.reason.is_none());
    Ok(if complete { EXIT_DONE } else { EXIT_FOUND })
}

/// Number of cycles to process; cycles without factors count too.
pub(in crate::cli) fn expected(known: &[RunRow], chosen: &[RunCycles]) -> u64 {
    let of = |chosen: &RunCycles| match &chosen.cycles {
        Some(cycles) => cycles.len() as u64,
        None => known.iter().find(|run| run.run_id == chosen.run_id).map_or(0, |run| u64::from(run.cycles)),
    };
    chosen.iter().map(of).sum()
}

fn progress_bar(cycles: u64) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(cycles);
    if let Ok(style) = ProgressStyle::with_template("cycles [{bar:30}] {pos}/{len} {per_sec} eta {eta}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

fn as_text(found: &Reestimate) -> String {
    let mut rows = Vec::new();
    let mut reasons = String::new();
    for cycle in &found.cycles {
        rows.extend(cycle.views.iter().flat_map(|view| cycle_rows(cycle, view)));
        if let Some(reason) = &cycle.reason {
            let of = &cycle.source;
            reasons.push_str(&format!("run {} cycle {}: {}\n", of.run_id, of.cycle, text::shown(reason)));
        }
    }
    let statistics: Vec<Vec<String>> = found.statistics.iter().map(statistics_row).collect();
    format!(
        "{}, model {}, estimator {}, each alone\n{reasons}\n{}\n\n{}",
        output::counted(found.cycles.len(), "cycle"),
        found.model.name,
        found.estimator.name(),
        output::table(
            &["run", "cycle", "seen_by", "joint", "parameter", "value", "std_error", "low_95", "high_95"],
            &rows
        ),
        output::table(
            &[
                "run",
                "seen_by",
                "joint",
                "parameter",
                "window",
                "mean",
                "min",
                "max",
                "d_mm",
                "d_se",
                "sdv",
                "cycles"
            ],
            &statistics
        ),
    )
}

fn cycle_rows(cycle: &ReestimatedCycle, view: &CycleView) -> Vec<Vec<String>> {
    let seen_by = view.seen_by.map_or_else(|| "all".to_owned(), |joint| joint.to_string());
    let parameters = view.identification.parameters.iter().zip(&view.half_width);
    parameters
        .filter(|(p, _)| p.is_shown())
        .map(|(p, half)| {
            vec![
                cycle.source.run_id.to_string(),
                cycle.source.cycle.to_string(),
                seen_by.clone(),
                p.id.joint.to_string(),
                p.id.name().to_owned(),
                format!("{:.6}", p.value),
                format!("{:.6}", p.std_error),
                format!("{:.6}", p.value - half),
                format!("{:.6}", p.value + half),
            ]
        })
        .collect()
}

fn statistics_row(of: &ReestimatedStatistics) -> Vec<String> {
    let figures = &of.statistics;
    let known = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
    vec![
        of.run_id.to_string(),
        of.seen_by.map_or_else(|| "all".to_owned(), |joint| joint.to_string()),
        figures.id.joint.to_string(),
        figures.id.name().to_owned(),
        figures.window.name().to_owned(),
        format!("{:.6}", figures.mean),
        format!("{:.6}", figures.min),
        format!("{:.6}", figures.max),
        known(figures.d_mm),
        known(figures.d_se),
        figures.sdv.map_or_else(|| "-".to_owned(), |value| format!("{value:.6}")),
        figures.cycles.to_string(),
    ]
}

/// Prints one object per cycle, then one per run with its statistics.
fn print_json(found: &Reestimate, parameters: &HashMap<ParameterId, ModelParameter>) {
    for cycle in &found.cycles {
        output::json(&json!({
            "kind": "cycle",
            "robot": cycle.source.robot,
            "run_id": cycle.source.run_id,
            "cycle": cycle.source.cycle,
            "estimator": found.estimator.name(),
            "reason": cycle.reason,
            "parameters": cycle.views.iter().flat_map(|view| view_values(view, parameters)).collect::<Vec<_>>(),
        }));
    }
    for of_run in found.statistics.chunk_by(|a, b| a.run_id == b.run_id) {
        output::json(&json!({
            "kind": "statistics",
            "robot": of_run[0].robot,
            "run_id": of_run[0].run_id,
            "estimator": found.estimator.name(),
            "statistics": of_run.iter().map(statistics_value).collect::<Vec<_>>(),
        }));
    }
}

fn view_values(view: &CycleView, parameters: &HashMap<ParameterId, ModelParameter>) -> Vec<Value> {
    let listed = view.identification.parameters.iter().zip(&view.half_width).enumerate();
    listed
        .filter(|(_, (parameter, _))| parameter.is_shown())
        .map(|(k, (parameter, half))| {
            let mut value = parameter_value(parameter, *half, parameters);
            value["seen_by_joint"] = json!(view.seen_by.map(|joint| joint.number()));
            if let Some(share) = &view.data_share {
                value["data_share"] = json!(share[k]);
            }
            value
        })
        .collect()
}

fn statistics_value(of: &ReestimatedStatistics) -> Value {
    let figures = &of.statistics;
    json!({
        "seen_by_joint": of.seen_by.map(|joint| joint.number()),
        "joint": figures.id.joint.number(), "parameter": figures.id.name(), "window": figures.window.name(),
        "mean": figures.mean, "min": figures.min, "max": figures.max, "d_mm": figures.d_mm,
        "d_se": figures.d_se, "sdv": figures.sdv, "cycles": figures.cycles,
    })
}
