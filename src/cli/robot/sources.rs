//! Description and recordings behind a model, in words.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;

use crate::cli::context::CliError;
use armwatch_config::Config;
use armwatch_model::robot::Robot;
use armwatch_store::{SourceCycle, Store, StoredModel};

/// The configured description that the cycles were analysed with.
pub(super) fn described(config: &Config, model: &StoredModel) -> Result<Arc<Robot>, CliError> {
    let fitting = config.arms().find(|robot| model.describes(robot));
    fitting.map(Arc::clone).ok_or_else(|| {
        CliError::Usage(format!(
            "the configuration has no description of model {}, which was used for the analysis of the \
            cycles; give it with --description",
            model.name
        ))
    })
}

/// Start of the recording of each run with chosen cycles.
pub(super) async fn recorded(
    store: &Store,
    sources: &[SourceCycle],
) -> Result<BTreeMap<i64, Timestamp>, CliError> {
    let runs = store.runs().await?;
    let used = |run_id: i64| sources.iter().any(|source| source.run_id == run_id);
    Ok(runs.iter().filter(|run| used(run.run_id)).map(|run| (run.run_id, run.started_at)).collect())
}

/// Robot, run, time of recording and cycles: one line per run.
pub(super) fn source_lines(sources: &[SourceCycle], recorded: &BTreeMap<i64, Timestamp>) -> Vec<String> {
    let mut by_run: BTreeMap<i64, (&str, Vec<u32>)> = BTreeMap::new();
    for source in sources {
        by_run.entry(source.run_id).or_insert((&source.robot, Vec::new())).1.push(source.cycle);
    }
    let line = |(run_id, (robot, cycles)): (&i64, &(&str, Vec<u32>))| {
        let recorded =
            recorded.get(run_id).map_or_else(|| "at an unknown time".to_owned(), Timestamp::to_string);
        format!("robot {robot}, run {run_id}, recorded {recorded}, cycles {}", listed(cycles))
    };
    by_run.iter().map(line).collect()
}

/// `1-3, 7`.
fn listed(cycles: &[u32]) -> String {
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for &cycle in cycles {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == cycle => *last = cycle,
            _ => ranges.push((cycle, cycle)),
        }
    }
    let shown = ranges.iter().map(|(first, last)| match first == last {
        true => first.to_string(),
        false => format!("{first}-{last}"),
    });
    shown.collect::<Vec<_>>().join(", ")
}
