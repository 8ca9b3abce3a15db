//! `armwatch parameters`: parameter sets that `identify --save` stores.

use clap::{Args, Subcommand};
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_store, open_to_read, runtime};
use super::shared::output;
use armwatch_store::{KeptEstimate, KeptKind, ParameterSet, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch parameters list
  armwatch parameters show left-warm
  armwatch parameters delete left-warm

There are two kinds of saved results: sets (`armwatch identify --save`), and histories that were identified again
cycle by cycle (`armwatch identify --each-cycle --save`). Deleting one does not change runs and cycles.")]
pub(super) struct ParametersArgs {
    #[command(subcommand)]
    command: ParametersCommand,
}

#[derive(Debug, Subcommand)]
enum ParametersCommand {
    /// List names with their sets and histories
    #[command(after_help = "\
Examples:
  armwatch parameters list
  armwatch parameters list --json")]
    List,
    /// Show the values of a set
    #[command(after_help = "\
Examples:
  armwatch parameters show left-warm
  armwatch parameters show left-warm --json")]
    Show {
        /// Name of the set
        name: String,
    },
    /// Delete a saved set or history
    #[command(after_help = "\
Examples:
  armwatch parameters delete left-warm")]
    Delete {
        /// Name of the set or history
        name: String,
    },
}

pub(super) fn parameters(global: &Global, args: &ParametersArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = match args.command {
            ParametersCommand::Delete { .. } => open_store(&config).await?,
            _ => open_to_read(&config).await?,
        };
        let done = match &args.command {
            ParametersCommand::List => list(global, &store).await,
            ParametersCommand::Show { name } => show(global, &store, name).await,
            ParametersCommand::Delete { name } => delete(global, &store, name).await,
        };
        store.close().await?;
        done
    })
}

async fn list(global: &Global, store: &Store) -> Result<u8, CliError> {
    let kept = store.kept_estimates().await?;
    if global.json {
        kept.iter().for_each(output::json);
    } else {
        let row = |of: &KeptEstimate| {
            let cells = [&of.name, of.kind.name(), &of.model, of.estimator.name(), &of.robots];
            let mut row: Vec<String> = cells.iter().map(ToString::to_string).collect();
            row.extend([of.cycles.to_string(), of.saved_at.to_string()]);
            row
        };
        let rows: Vec<Vec<String>> = kept.iter().map(row).collect();
        let header = ["name", "kind", "model", "estimator", "robots", "cycles", "saved_at"];
        output::block(&output::table(&header, &rows));
    }
    Ok(EXIT_DONE)
}

async fn show(global: &Global, store: &Store, name: &str) -> Result<u8, CliError> {
    let Some(mut set) = store.parameter_set(name).await? else {
        let kept = store.kept_estimates().await?;
        return Err(match kept.iter().find(|of| of.name == name) {
            Some(of) if of.kind == KeptKind::EachCycle => CliError::Usage(format!(
                "{name} holds parameters of {} cycles; SELECT * FROM reestimated_parameters WHERE estimate = \
                 '{name}' shows them",
                of.cycles
            )),
            _ => unknown(name),
        });
    };
    set.identification.parameters.sort_by_key(|parameter| parameter.id);
    let units = store.model_parameters(&set.model).await?;
    let unit = |id| units.get(&id).map_or("", |of| of.unit.as_str()).to_owned();
    if global.json {
        output::json(&set_value(name, &set, unit));
        return Ok(EXIT_DONE);
    }
    let rows: Vec<Vec<String>> = set
        .identification
        .parameters
        .iter()
        .map(|p| {
            let std_error = if p.std_error.is_finite() { format!("{:.6}", p.std_error) } else { "-".into() };
            vec![
                p.id.joint.to_string(),
                p.id.name().to_string(),
                format!("{:.6}", p.value),
                std_error,
                unit(p.id),
            ]
        })
        .collect();
    output::block(&format!(
        "{}, model {}, estimator {}\n\n{}",
        output::counted(set.sources.len(), "cycle"),
        set.model.name,
        set.estimator.name(),
        output::table(&["joint", "parameter", "value", "std_error", "unit"], &rows)
    ));
    Ok(EXIT_DONE)
}

fn set_value(
    name: &str,
    set: &ParameterSet,
    unit: impl Fn(armwatch_model::robot::ParameterId) -> String,
) -> serde_json::Value {
    json!({
        "name": name,
        "model": set.model.name,
        "estimator": set.estimator.name(),
        "error_basis": set.errors.name(),
        "sources": set.sources,
        "parameters": set.identification.parameters.iter().map(|p| json!({
            "joint": p.id.joint.number(), "parameter": p.id.name(), "value": p.value,
            "std_error": p.std_error, "unit": unit(p.id),
        })).collect::<Vec<_>>(),
    })
}

async fn delete(global: &Global, store: &Store, name: &str) -> Result<u8, CliError> {
    if !store.delete_estimate(name).await? {
        return Err(unknown(name));
    }
    if global.json {
        output::json(&json!({"name": name, "outcome": "deleted"}));
    } else {
        output::line(&format!("deleted {name}"));
    }
    Ok(EXIT_DONE)
}

fn unknown(name: &str) -> CliError {
    CliError::Usage(format!("nothing is saved as \"{name}\"; `armwatch parameters list` shows the names"))
}
