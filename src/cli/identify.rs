//! `armwatch identify`: one parameter set from chosen cycles, without their exports.

use clap::Args;
use serde_json::json;

use super::selection::{as_candidate, cycle_numbers, runs_of};
use super::{CliError, EXIT_DONE, Global, open_store, output, runtime};
use crate::analysis::{IdentifiedParameter, TorqueRmsd};
use crate::pipeline::stored::{Chosen, rmsd_on, unit_identification};
use crate::store::{ParameterSet, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch identify --run 3
  armwatch identify --run 3 --cycles 10,15,20
  armwatch identify --robot Left --cycles 6-24 --save left-warm
  armwatch identify --run 3 --run 4 --json | jq '.parameters[] | select(.joint == 1)'

One set of base parameters is identified on the excitation stages of all chosen cycles together, rows of
slow joints left out. What is needed of the rows was stored with the cycles: no export is read, and the
result is that of identifying on all rows at once. Units are SI. A saved set is named in
`armwatch verify --parameters`, and is shown by the views parameter_sets and parameter_set_sources.")]
pub(super) struct IdentifyArgs {
    /// Run whose cycles are taken; may be given several times
    #[arg(long = "run", value_name = "RUN", required_unless_present = "robots")]
    runs: Vec<i64>,
    /// Robot of which all complete runs are taken; may be given several times
    #[arg(long = "robot", value_name = "NAME")]
    robots: Vec<String>,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(long, value_name = "CYCLES")]
    cycles: Option<String>,
    /// Keep the parameters under this name
    #[arg(long, value_name = "NAME")]
    save: Option<String>,
}

pub(super) fn identify(global: &Global, args: &IdentifyArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let cycles = args.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
    args.save.as_deref().map_or(Ok(()), check_name)?;
    runtime()?.block_on(async {
        let store = open_store(&config).await?;
        let done = identify_stored(global, args, cycles, &store).await;
        store.close().await?;
        done
    })
}

async fn identify_stored(
    global: &Global,
    args: &IdentifyArgs,
    cycles: Option<Vec<u32>>,
    store: &Store,
) -> Result<u8, CliError> {
    let mut run_ids = args.runs.clone();
    let known = store.runs().await?;
    for robot in &args.robots {
        run_ids.extend(runs_of(&known, robot)?.iter().map(|run| run.run_id));
    }
    let chosen: Vec<Chosen> =
        run_ids.into_iter().map(|run_id| Chosen { run_id, cycles: cycles.clone() }).collect();
    let set = unit_identification(store, &chosen).await?;
    let rmsd = rmsd_on(store, &as_candidate(set.clone()), &chosen).await?;
    if let Some(name) = &args.save
        && !store.save_parameter_set(name, &set).await?
    {
        return Err(CliError::Usage(format!("there is a parameter set \"{name}\"; choose another name")));
    }
    if global.json {
        output::json(&as_value(&set, &rmsd, args.save.as_deref()));
    } else {
        output::line(&as_text(&set, &rmsd));
        if let Some(name) = &args.save {
            output::note(&format!("saved as {name}"));
        }
    }
    Ok(EXIT_DONE)
}

/// Names that `verify --parameters` would take for a run are none.
fn check_name(name: &str) -> Result<(), CliError> {
    let ambiguous = name.is_empty() || name.contains(':') || name.parse::<i64>().is_ok();
    if ambiguous {
        return Err(CliError::Usage(format!(
            "\"{name}\" cannot name a parameter set: it is empty, a number, or has a colon"
        )));
    }
    Ok(())
}

fn as_text(set: &ParameterSet, rmsd: &[TorqueRmsd]) -> String {
    let found = &set.identification;
    let parameter = |p: &IdentifiedParameter| {
        let relative = if p.value == 0.0 { f64::INFINITY } else { 100.0 * p.std_error / p.value.abs() };
        vec![
            p.id.joint.to_string(),
            p.id.name().to_string(),
            format!("{:.6}", p.value),
            format!("{:.6}", p.std_error),
            format!("{relative:.1}"),
        ]
    };
    let parameters: Vec<Vec<String>> = found.parameters.iter().map(parameter).collect();
    let runs = set.sources.iter().map(|source| source.run_id).collect::<std::collections::BTreeSet<_>>();
    format!(
        "{} cycles of {} runs, {} samples, model {}\n\
         condition number {:.1}, columns scaled {:.1}; residual {:.4} Nm\n\n{}\n\n{}",
        set.sources.len(),
        runs.len(),
        found.samples,
        set.model.name,
        found.condition_number,
        found.scaled_condition_number,
        found.residual_std,
        output::table(&["joint", "parameter", "value", "std_error", "std_error_%"], &parameters),
        output::table(
            &["joint", "stage", "rmsd_nm", "relative", "moving_rmsd_nm", "moving_relative"],
            &rows(rmsd)
        ),
    )
}

fn rows(rmsd: &[TorqueRmsd]) -> Vec<Vec<String>> {
    let figure = |samples: usize, value: f64| match samples {
        0 => "-".to_string(),
        _ => format!("{value:.4}"),
    };
    let row = |r: &TorqueRmsd| {
        vec![
            r.joint.to_string(),
            r.scope.name().to_string(),
            figure(r.all_rows.samples, r.all_rows.value),
            figure(r.all_rows.samples, r.all_rows.relative),
            figure(r.moving_rows.samples, r.moving_rows.value),
            figure(r.moving_rows.samples, r.moving_rows.relative),
        ]
    };
    rmsd.iter().map(row).collect()
}

fn as_value(set: &ParameterSet, rmsd: &[TorqueRmsd], saved: Option<&str>) -> serde_json::Value {
    let found = &set.identification;
    json!({
        "model": set.model.name,
        "parameter_set": saved,
        "sources": set.sources.iter().map(|source| json!({
            "robot": source.robot, "run_id": source.run_id, "cycle": source.cycle,
        })).collect::<Vec<_>>(),
        "samples": found.samples,
        "condition_number": found.condition_number,
        "scaled_condition_number": found.scaled_condition_number,
        "residual_std_nm": found.residual_std,
        "parameters": found.parameters.iter().map(|p| json!({
            "joint": p.id.joint.number(), "parameter": p.id.name(), "value": p.value, "std_error": p.std_error,
        })).collect::<Vec<_>>(),
        "rmsd": rmsd.iter().map(rmsd_value).collect::<Vec<_>>(),
    })
}

/// A deviation as in the view `cycle_rmsd`; figures over no rows are null.
pub(super) fn rmsd_value(rmsd: &TorqueRmsd) -> serde_json::Value {
    let known = |samples: usize, value: f64| (samples > 0).then_some(value);
    json!({
        "joint": rmsd.joint.number(),
        "stage": rmsd.scope.name(),
        "rmsd_nm": known(rmsd.all_rows.samples, rmsd.all_rows.value),
        "relative_rmsd": known(rmsd.all_rows.samples, rmsd.all_rows.relative),
        "moving_rmsd_nm": known(rmsd.moving_rows.samples, rmsd.moving_rows.value),
        "moving_relative_rmsd": known(rmsd.moving_rows.samples, rmsd.moving_rows.relative),
        "samples": rmsd.all_rows.samples,
        "moving_samples": rmsd.moving_rows.samples,
    })
}
