//! `armwatch verify`: compares parameters of one recording with other recordings, without their exports.

use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_change, open_to_read, runtime};
use super::shared::output;
use super::shared::selection::{NamedCandidate, named_runs, note_cycles, runs_of};
use super::torque::StageArg;
use crate::pipeline::stored::chosen_cycles::{
    CrossVerification, NotedCycle, RunCycles, StoredError, cross_verification,
};
use armwatch_model::analysis::{Estimator, TorqueRmsd};
use armwatch_store::{RunRow, Store};

/// Smallest relative RMSD that the thesis marks: the parameters do not fit the recording.
pub(super) const MARKED_ABOVE: f64 = 0.10;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch verify --robot Left
  armwatch verify --robot Left --stage friction --rows all --store
  armwatch verify --parameters 3 --against Left
  armwatch verify --parameters 3:20 --parameters left-warm --against 4 \\
      --against 5 --json

The command prints a matrix per joint: one row per parameter set, one column per run, over all cycles of the run.
The values are the relative RMSD of the torque. A * marks values of moving rows above 10 %. RUN means the
parameters identified on all cycles of the run together by the configured estimator. RUN:CYCLES uses only some of
its cycles (3:20, 3:10,15,20). Any other word is the name of a set saved by `armwatch identify --save`. The
command skips cycles that were refused when they were read, and names them on standard error. --robot alone
verifies the parameters of each run against each run. The values are exact, and the command reads no export.

--store writes the values of each cycle into the view cycle_rmsd with verification = 'cross'; it accepts only
parameters of whole runs. --json prints all stages, with and without slow rows, in one object per set and run.")]
#[command(group(ArgGroup::new("sets").args(["parameters", "robot"]).required(true)))]
pub(super) struct VerifyArgs {
    /// Parameters: RUN, RUN:CYCLES, or the name of a saved set; may be repeated
    #[arg(long, value_name = "RUN[:CYCLES]|SET", requires = "against")]
    parameters: Vec<String>,
    /// Run, or robot with all its complete runs, to verify the parameters against; may be repeated
    #[arg(long, value_name = "RUN|ROBOT", requires = "parameters")]
    against: Vec<String>,
    /// Verify every complete run of this robot against every other one
    #[arg(long, value_name = "NAME", conflicts_with_all = ["parameters", "against"])]
    robot: Option<String>,
    /// Stage in the matrices
    #[arg(long, value_enum, default_value_t = StageArg::Excitation)]
    stage: StageArg,
    /// Rows in the matrices
    #[arg(long, value_enum, default_value_t = RowsArg::Moving)]
    rows: RowsArg,
    /// Store the values in the database
    #[arg(long)]
    store: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum RowsArg {
    /// Rows with motion of the joint
    Moving,
    /// All rows
    All,
}

pub(super) fn verify(global: &Global, args: &VerifyArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = if args.store { open_to_change(&config).await? } else { open_to_read(&config).await? };
        let done = verify_stored(global, args, config.analysis.estimator, &store).await;
        store.close().await?;
        done
    })
}

async fn verify_stored(
    global: &Global,
    args: &VerifyArgs,
    estimator: Estimator,
    store: &Store,
) -> Result<u8, CliError> {
    let known = store.runs().await?;
    let (named, runs) = chosen(args, estimator, store, &known).await?;
    let unsaved = named.iter().find(|of| of.run_id.is_none());
    if let Some(set) = unsaved.filter(|_| args.store) {
        return Err(CliError::Usage(format!(
            "--store accepts only parameters of whole runs, not {}",
            set.name
        )));
    }
    let run_ids: Vec<i64> = runs.iter().map(|run| run.run_id).collect();
    let is_named = |run: &RunRow| args.against.contains(&run.run_id.to_string());
    let chosen = runs.iter().map(|run| RunCycles { named: is_named(run), ..RunCycles::all(run.run_id) });
    let candidates = named.iter().map(|of| of.candidate.clone()).collect();
    let verified = cross_verification(store, candidates, &chosen.collect::<Vec<_>>()).await?;
    let of_all = |of_run: fn(&CrossVerification) -> &Vec<NotedCycle>| {
        let mut noted: Vec<NotedCycle> = verified.iter().flat_map(of_run).cloned().collect();
        noted.sort_by_key(|of| (of.run_id, of.cycle));
        noted.dedup();
        noted
    };
    let passed_over = of_all(|of| &of.passed_over);
    note_cycles(&passed_over, &of_all(|of| &of.in_spite));
    if verified.iter().all(|of| of.by_cycle.is_empty() && of.joined_windows == 0) && !passed_over.is_empty() {
        return Err(StoredError::PassedOver(passed_over).into());
    }
    if args.store {
        if let Some(of) = verified.iter().find(|of| of.joined_windows > 0) {
            return Err(CliError::Usage(format!(
                "--store writes values by cycle, but the factors of {} windows of run {} have expired and \
                are joined ([retention] in the configuration); omit --store, or read its export again with \
                `armwatch ingest --again {}`",
                of.joined_windows, of.run_id, of.run_id
            )));
        }
        for of in &verified {
            if let Some(reference) = named[of.candidate].run_id {
                let estimator = estimator.of_factors();
                store.store_cross_verification(of.run_id, reference, estimator, &of.by_cycle).await?;
            }
        }
    }
    if global.json {
        for of in &verified {
            output::json(&as_value(&named[of.candidate], of));
        }
    } else {
        output::block(&as_text(args, &named, &run_ids, &verified));
    }
    Ok(EXIT_DONE)
}

async fn chosen<'a>(
    args: &VerifyArgs,
    estimator: Estimator,
    store: &Store,
    known: &'a [RunRow],
) -> Result<(Vec<NamedCandidate>, Vec<&'a RunRow>), CliError> {
    let mut named = Vec::new();
    let mut runs: Vec<&RunRow> = Vec::new();
    if let Some(robot) = &args.robot {
        runs = runs_of(known, robot)?;
        for run in &runs {
            match NamedCandidate::of_run(store, run.run_id, estimator).await {
                Ok(found) => named.push(found),
                // its cycles are listed with the skipped ones
                Err(StoredError::PassedOver(_)) => {}
                Err(StoredError::Numerics(error)) => output::print_hint(&format!(
                    "run {} has no parameters and serves only as a reference: {error}",
                    run.run_id
                )),
                Err(error) => return Err(error.into()),
            }
        }
        if named.is_empty() {
            return Err(CliError::Usage(format!("no run of robot {robot} has parameters")));
        }
    }
    for word in &args.parameters {
        named.push(NamedCandidate::find(store, word, estimator).await?);
    }
    for word in &args.against {
        for run in named_runs(known, word)? {
            if !runs.contains(&run) {
                runs.push(run);
            }
        }
    }
    Ok((named, runs))
}

fn as_text(
    args: &VerifyArgs,
    named: &[NamedCandidate],
    runs: &[i64],
    verified: &[CrossVerification],
) -> String {
    let joints = verified.iter().flat_map(|of| &of.rmsd).map(|rmsd| rmsd.joint).max();
    let joints = joints.map_or(0, |joint| joint.number());
    let header: Vec<String> = std::iter::once("parameters".to_string())
        .chain(runs.iter().map(|run| format!("run {run}")))
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut marked = 0;
    let mut text = String::new();
    for joint in 1..=joints {
        let mut rows = Vec::new();
        for (candidate, named) in named.iter().enumerate() {
            let mut row = vec![named.name.clone()];
            for &run in runs {
                let found = verified.iter().find(|of| of.candidate == candidate && of.run_id == run);
                let relative = found.and_then(|of| relative(args, &of.rmsd, joint));
                let mark = args.rows == RowsArg::Moving && relative.is_some_and(is_marked);
                marked += usize::from(mark);
                row.push(cell(relative, mark));
            }
            rows.push(row);
        }
        text.push_str(&format!("joint {joint}\n{}\n\n", output::table(&header, &rows)));
    }
    let stage = args.stage.scope().name();
    let unit = format!("{text}relative RMSD of the torque, stage {stage}");
    match args.rows {
        RowsArg::Moving => format!("{unit}, moving rows; * above 10 %: {marked}"),
        RowsArg::All => format!("{unit}, all rows"),
    }
}

fn cell(relative: Option<f64>, mark: bool) -> String {
    relative.map_or_else(|| "-".to_string(), |value| format!("{value:.4}{}", if mark { "*" } else { "" }))
}

fn is_marked(relative: f64) -> bool {
    relative > MARKED_ABOVE
}

fn relative(args: &VerifyArgs, rmsd: &[TorqueRmsd], joint: usize) -> Option<f64> {
    let found = rmsd.iter().find(|r| r.joint.number() == joint && r.scope == args.stage.scope())?;
    let rows = if args.rows == RowsArg::Moving { found.moving_rows } else { found.all_rows };
    (rows.samples > 0).then_some(rows.relative)
}

fn as_value(named: &NamedCandidate, verified: &CrossVerification) -> serde_json::Value {
    let rmsd: Vec<serde_json::Value> = verified
        .rmsd
        .iter()
        .map(|of| {
            let mut value = json!(of);
            value["marked"] = json!(of.moving_rows.samples > 0 && is_marked(of.moving_rows.relative));
            value
        })
        .collect();
    json!({
        "parameters": named.name,
        "reference_run_id": named.run_id,
        "run_id": verified.run_id,
        "cycles": verified.by_cycle.len() + verified.joined_windows,
        "passed_over": verified.passed_over,
        "rmsd": rmsd,
    })
}
