//! Selection of runs, cycles and parameters on the command line.

use std::collections::BTreeSet;

use super::output;
use crate::cli::context::CliError;
use crate::pipeline::stored::chosen_cycles::{
    NotedCycle, ParameterCandidate, RunCycles, StoredError, identify_taken, in_ranges, take, told,
};
use armwatch_model::analysis::Estimator;
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_store::{ParameterSet, RunRow, Store};

/// Most cycles in a range: a test of a week at five minutes per cycle.
const MAX_CYCLES: u32 = 2016;

impl From<StoredError> for CliError {
    fn from(error: StoredError) -> Self {
        match error {
            StoredError::Store(error) => Self::Store(error),
            StoredError::Numerics(error) => Self::Usage(error.to_string()),
            StoredError::Refused(reason) => Self::Usage(reason),
            StoredError::PassedOver(_) => Self::Usage(error.to_string()),
            StoredError::Task(error) => Self::Internal(error.to_string()),
        }
    }
}

/// Reports excluded cycles of the chosen runs and those that are included despite a finding, with reasons.
pub(in crate::cli) fn note_cycles(passed_over: &[NotedCycle], in_spite: &[NotedCycle]) {
    if !in_spite.is_empty() {
        output::print_hint(&format!("used in spite of findings: {}", told(in_spite)));
    }
    if !passed_over.is_empty() {
        output::print_hint(&format!("skipped: {}", told(passed_over)));
    }
}

/// Reads `10,15,20` or `6-24` or both mixed.
pub(in crate::cli) fn cycle_numbers(text: &str) -> Result<Vec<u32>, String> {
    let mut numbers = BTreeSet::new();
    for part in text.split(',').map(str::trim) {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        let number = |text: &str| text.trim().parse::<u32>().ok().filter(|n| *n >= 1);
        let (Some(first), Some(last)) = (number(first), number(last)) else {
            return Err(format!(
                "\"{part}\" is not a cycle; write numbers from 1 and ranges, such as 3,10-15"
            ));
        };
        if first > last || last - first >= MAX_CYCLES {
            return Err(format!("\"{part}\" is not a range of at most {MAX_CYCLES} cycles; write 6-24"));
        }
        numbers.extend(first..=last);
    }
    Ok(numbers.into_iter().collect())
}

/// Complete tests of a robot, oldest first.
pub(in crate::cli) fn runs_of<'a>(runs: &'a [RunRow], robot: &str) -> Result<Vec<&'a RunRow>, CliError> {
    let is_test = |run: &&RunRow| run.status == RunStatus::Complete && run.kind == RunKind::Test;
    let of_robot: Vec<&RunRow> = runs.iter().filter(|run| run.robot == robot).filter(is_test).collect();
    if !of_robot.is_empty() {
        return Ok(of_robot);
    }
    let mut known: Vec<&str> = runs.iter().map(|run| run.robot.as_str()).collect();
    known.dedup();
    Err(CliError::Usage(format!("no complete run of robot {robot}; there are runs of: {}", known.join(", "))))
}

/// Runs selected by a word: the number of a run, or the name of a robot for all its complete runs.
pub(in crate::cli) fn named_runs<'a>(runs: &'a [RunRow], word: &str) -> Result<Vec<&'a RunRow>, CliError> {
    match word.parse::<i64>() {
        Ok(run_id) => runs
            .iter()
            .find(|run| run.run_id == run_id)
            .map(|run| vec![run])
            .ok_or_else(|| no_run(runs, run_id)),
        Err(_) => runs_of(runs, word),
    }
}

/// The error of a command for a run that does not exist, with the existing ones.
pub(in crate::cli) fn no_run(runs: &[RunRow], run_id: i64) -> CliError {
    let known = in_ranges(runs.iter().map(|run| run.run_id));
    CliError::Usage(format!("there is no run {run_id}; runs known: {known}; `armwatch runs` lists them"))
}

/// Parameters with their selecting words and, if they belong to a whole run, the run.
#[derive(Debug)]
pub(in crate::cli) struct NamedCandidate {
    pub(in crate::cli) name: String,
    pub(in crate::cli) run_id: Option<i64>,
    pub(in crate::cli) candidate: ParameterCandidate,
}

impl NamedCandidate {
    /// Unit parameters of a whole run, by the configured estimator.
    pub(in crate::cli) async fn of_run(
        store: &Store,
        run_id: i64,
        estimator: Estimator,
    ) -> Result<Self, StoredError> {
        let set = identified(store, RunCycles::all(run_id), estimator).await?;
        Ok(Self { name: format!("run {run_id}"), run_id: Some(run_id), candidate: as_candidate(set) })
    }

    /// Finds parameters by `RUN`, `RUN:CYCLES` or the name of a saved set; `estimator` applies to runs and cycles.
    pub(in crate::cli) async fn find(
        store: &Store,
        word: &str,
        estimator: Estimator,
    ) -> Result<Self, CliError> {
        let set = find_set(store, word, estimator).await?;
        let run_id = word.parse::<i64>().ok();
        let name = run_id.map_or_else(|| word.to_owned(), |run_id| format!("run {run_id}"));
        Ok(Self { name, run_id, candidate: as_candidate(set) })
    }
}

/// Finds the parameter set of `RUN`, `RUN:CYCLES` or the name of a saved set; `estimator` applies to runs and cycles.
pub(in crate::cli) async fn find_set(
    store: &Store,
    word: &str,
    estimator: Estimator,
) -> Result<ParameterSet, CliError> {
    let (run, cycles) = word.split_once(':').map_or((word, None), |(run, cycles)| (run, Some(cycles)));
    if let Ok(run_id) = run.parse::<i64>() {
        let cycles = cycles.map(cycle_numbers).transpose().map_err(CliError::Usage)?;
        return Ok(identified(store, RunCycles { run_id, cycles, named: true }, estimator).await?);
    }
    store.parameter_set(word).await?.ok_or_else(|| {
        CliError::Usage(format!(
            "\"{word}\" is neither a run, nor RUN:CYCLES, nor a saved parameter set; `armwatch identify \
            --save {word}` creates one"
        ))
    })
}

async fn identified(
    store: &Store,
    chosen: RunCycles,
    estimator: Estimator,
) -> Result<ParameterSet, StoredError> {
    let run_id = chosen.run_id;
    let taken = take(store, &[chosen]).await?;
    note_cycles(&[], &taken.in_spite);
    let set = identify_taken(taken, estimator).await?;
    let unshown = set.identification.parameters.iter().filter(|of| !of.is_shown());
    let unshown: Vec<String> = unshown.map(|of| of.id.to_string()).collect();
    if !unshown.is_empty() {
        output::print_hint(&format!(
            "the motion of run {run_id} does not show {} separately: the torque of other motion is not predicted",
            unshown.join(", ")
        ));
    }
    Ok(set)
}

fn as_candidate(set: ParameterSet) -> ParameterCandidate {
    ParameterCandidate { model: set.model, parameters: set.identification.parameters }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_ranges_mix() {
        assert_eq!(cycle_numbers("10,15,20"), Ok(vec![10, 15, 20]));
        assert_eq!(cycle_numbers("3, 6-8,7"), Ok(vec![3, 6, 7, 8]));
        for wrong in ["", "0", "a", "5-3", "1-", "-2", "1,,2", "1-4000000000", "1.5"] {
            assert!(cycle_numbers(wrong).is_err(), "{wrong}");
        }
    }
}
