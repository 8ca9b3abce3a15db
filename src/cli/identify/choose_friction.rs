//! `armwatch identify --choose-friction`: which joints need friction that depends on load.

use std::collections::HashMap;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::selection::note_cycles;
use crate::pipeline::look::replay::{Replay, ReplayError};
use crate::pipeline::stored::chosen_cycles::{RunCycles, take};
use armwatch_config::Config;
use armwatch_method::analyse::friction_choice::{FrictionChoice, FrictionComparison, JointChoice, LawScore};
use armwatch_model::robot::LoadFriction;
use armwatch_store::Store;

pub(in crate::cli) async fn choose_friction(
    global: &Global,
    chosen: &[RunCycles],
    config: &Config,
    store: &Store,
) -> Result<u8, CliError> {
    let taken = take(store, chosen).await?;
    note_cycles(&taken.passed_over, &taken.in_spite);
    let mut exports: HashMap<i64, PathBuf> = HashMap::new();
    let mut comparison: Option<FrictionComparison> = None;
    for source in &taken.sources {
        let replay = Replay::find(config, store, source.run_id, source.cycle).await?;
        let export = match exports.get(&source.run_id) {
            Some(export) => export.clone(),
            None => replay.export(config, None).await?,
        };
        exports.insert(source.run_id, export.clone());
        let (settings, before) = (config.analysis, comparison.take());
        let added = tokio::task::spawn_blocking(move || {
            let cycle = replay.read(&export)?;
            let mut comparison = match before {
                Some(comparison) => comparison,
                None => FrictionComparison::new(&replay.robot, settings)?,
            };
            comparison.add(&cycle.samples)?;
            Ok::<_, ReplayError>(comparison)
        });
        comparison = Some(added.await.map_err(ReplayError::Task)??);
    }
    let Some(comparison) = comparison else {
        return Err(CliError::Usage("no cycle is chosen; choose runs with --run or --robot".to_owned()));
    };
    let found = comparison.choice().map_err(ReplayError::Numerics)?;
    if global.json {
        output::json(&as_value(&found));
    } else {
        output::block(&as_text(&found));
    }
    Ok(EXIT_DONE)
}

fn as_text(found: &FrictionChoice) -> String {
    let laws = LoadFriction::KINDS.map(|kind| kind.name);
    let header: Vec<String> =
        ["joint", "needs"].map(str::to_owned).into_iter().chain(laws.map(|law| format!("{law}_%"))).collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let row = |joint: &JointChoice| {
        let error = |name: &str| {
            let score = score_of(joint, name).map(|score| format!("{:.2}", 100.0 * score.held_out));
            score.unwrap_or_else(|| "-".to_owned())
        };
        let mut cells = vec![joint.joint.to_string(), needs(joint)];
        cells.extend(laws.map(error));
        cells
    };
    let rows: Vec<Vec<String>> = found.joints.iter().map(row).collect();
    let mut text = format!(
        "torque error on held-out rows ({}), % of the torque, by law of load\n\n{}",
        output::counted(found.held_out_sets, "set"),
        output::table(&header, &rows)
    );
    for remark in &found.remarks {
        text.push_str(&format!("\n{remark}"));
    }
    text
}

/// The chosen law with its coefficients.
fn needs(joint: &JointChoice) -> String {
    let coefficients = score_of(joint, joint.chosen.name()).map(|score| &score.coefficients[..]);
    let told = coefficients.unwrap_or_default().iter().map(|of| format!(" {} {:.4}", of.id.name(), of.value));
    format!("{}{}", joint.chosen.name(), told.collect::<String>())
}

fn score_of<'a>(joint: &'a JointChoice, name: &str) -> Option<&'a LawScore> {
    joint.scores.iter().find(|score| score.load.name() == name)
}

fn as_value(found: &FrictionChoice) -> Value {
    let score = |score: &LawScore| {
        let coefficients = score.coefficients.iter();
        json!({
            "load_friction": score.load.name(),
            "load_speed": score.load.speed(),
            "held_out_relative_rmsd": score.held_out,
            "information_criterion": score.criterion,
            "passes": score.passes,
            "coefficients": coefficients.map(|of| (of.id.name().to_owned(), json!(of.value))).collect::<serde_json::Map<_, _>>(),
        })
    };
    let joint = |joint: &JointChoice| {
        json!({
            "joint": joint.joint.number(),
            "needs": joint.chosen.name(),
            "laws": joint.scores.iter().map(score).collect::<Vec<Value>>(),
        })
    };
    json!({
        "held_out_sets": found.held_out_sets,
        "remarks": found.remarks,
        "joints": found.joints.iter().map(joint).collect::<Vec<Value>>(),
    })
}
