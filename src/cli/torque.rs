//! `armwatch torque`: measured and estimated torque of one cycle, read again from its export.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::plot::PlotFile;
use super::shared::result_file::{refuse_source, result_file, write_lines};
use super::shared::selection::NamedCandidate;
use super::shared::{output, paths};
use crate::pipeline::look::replay::{Replay, ReplayError};
use crate::report::torque::{TorqueView, torque_figure};
use armwatch_config::Config;
use armwatch_method::identify::torque_series::{SeriesRows, TorqueSeries, peaks};
use armwatch_model::analysis::{RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, ParameterId};
use armwatch_model::run::Stage;
use armwatch_model::text;
use armwatch_store::{OfCycle, Store};

/// Largest relative difference that is rounding, between values of the same rows by another method; more means that
/// something has changed.
const SAME_FIGURE: f64 = 1e-6;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch torque --run 3 --cycle 12 > cycle12.csv
  armwatch torque --run 3 --cycle 12 --plot cycle12.svg
  armwatch torque --run 3 --cycle 12 --joint 3 --stage excitation --plot joint3.svg
  armwatch torque --run 3 --cycle 12 --stage friction --points 600 --json
  armwatch torque --run 3 --cycle 12 --parameters 2:10-20 -o cross.csv
  armwatch torque --run 3 --cycle 12 \\
      --source /archive/Left_20260105_0847.csv.gz

The database has no samples. The command therefore reads the export of the run again, up to the end of the cycle,
and filters it in the same way as before. It searches for the export at its last known place and in the watched
folders, and checks that the content is unchanged. The default parameters are those of the cycle, or those that a
production window was compared with. RUN, RUN:CYCLES and saved sets have the same meaning as in `armwatch verify`.

CSV has one line per row and joint: time_s, stage, joint, q_rad, qd_rad_s, measured_nm (after the low-pass of the
analysis), estimated_nm, residual_nm (measured minus estimated), moving (1 at the joint's low-speed threshold or
faster), counted. Counted rows are those of the view cycle_rmsd: its rmsd_nm is the root of the mean squared
residual_nm. --all-rows adds the rows between them and near gaps in time, with counted = 0. --points divides each
joint's rows into buckets and keeps the smallest and largest torques and residuals of each bucket: use it for
plots, not for sums. --json has the same data by column, in one object per joint.

A picture shows measured and estimated torque, and below them the residual on its own scale. A joint that is slow
or at rest can have any torque up to breakaway. The picture therefore has the estimate of such rows only with
--slow.")]
pub(super) struct TorqueArgs {
    /// Run of the cycle
    #[arg(help_heading = "Selection", long, value_name = "RUN")]
    run: i64,
    /// Number of the cycle
    #[arg(help_heading = "Selection", long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    cycle: u32,
    /// Parameters of the estimate: RUN, RUN:CYCLES, or the name of a saved set [default: those of the cycle]
    #[arg(help_heading = "Selection", long, value_name = "RUN[:CYCLES]|SET")]
    parameters: Option<String>,
    /// Export of the run, if it has moved
    #[arg(help_heading = "Selection", long, value_name = "FILE")]
    source: Option<PathBuf>,
    /// Rows of one stage, or of the whole cycle
    #[arg(help_heading = "Rows", long, value_enum, default_value_t = StageArg::All)]
    stage: StageArg,
    /// Include rows that do not count in verification
    #[arg(help_heading = "Rows", long)]
    all_rows: bool,
    /// Approximate number of rows per joint, with all peaks
    #[arg(help_heading = "Rows", long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..))]
    points: Option<u32>,
    /// Write the rows as CSV into this file
    #[arg(help_heading = "Files", short, long, value_name = "FILE", conflicts_with = "json", value_parser = result_file())]
    output: Option<PathBuf>,
    /// Draw only this joint, from 1
    #[arg(long, value_name = "JOINT", requires = "plot", value_parser = clap::value_parser!(u8).range(1..))]
    joint: Option<u8>,
    /// Draw the estimate also while the joint is slow or at rest
    #[arg(long, requires = "plot")]
    slow: bool,
    /// Draw the torques into this file, .svg or .html
    #[arg(help_heading = "Files", long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum StageArg {
    /// Excitation stage
    Excitation,
    /// Friction stage
    Friction,
    /// Warming stage
    Warming,
    /// Whole cycle, including rows between stages
    All,
}

impl StageArg {
    pub(super) fn scope(self) -> RmsdScope {
        match self {
            Self::Excitation => RmsdScope::Stage(Stage::Excitation),
            Self::Friction => RmsdScope::Stage(Stage::Friction),
            Self::Warming => RmsdScope::Stage(Stage::Warming),
            Self::All => RmsdScope::WholeCycle,
        }
    }
}

impl From<ReplayError> for CliError {
    fn from(error: ReplayError) -> Self {
        match error {
            ReplayError::Store(error) => Self::Store(error),
            ReplayError::Refused(reason) => Self::Usage(reason),
            ReplayError::Source(reason) => Self::Io(reason),
            ReplayError::Rejected(rejection) => Self::Io(rejection.to_string()),
            ReplayError::Numerics(error) => Self::Usage(error.to_string()),
            ReplayError::Task(error) => Self::Internal(error.to_string()),
        }
    }
}

/// Torques with their origin.
struct Replayed {
    replay: Replay,
    export: PathBuf,
    /// Origin of the parameters of the estimate.
    parameters: String,
    series: TorqueSeries,
}

pub(super) fn torque(global: &Global, args: &TorqueArgs) -> Result<u8, CliError> {
    if let Some(source) = &args.source {
        paths::metadata(source)?;
    }
    let config = global.read_config()?;
    let replayed = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = replay(args, &config, &store).await;
        store.close().await?;
        done
    })?;
    let joints = replayed.series.joints.len();
    if let Some(joint) = args.joint.filter(|joint| usize::from(*joint) > joints) {
        let robot = &replayed.replay.run.robot;
        return Err(CliError::Usage(format!("{robot} has {joints} joints, but no joint {joint}")));
    }
    if let Some(plot) = &args.plot {
        plot.write(&figure(args, &replayed))?;
    }
    if let Some(path) = &args.output {
        write_lines(path, csv_lines(args, &replayed))?;
    }
    if global.json {
        (0..replayed.series.joints.len())
            .map(JointIndex::new)
            .for_each(|joint| output::json(&as_value(args, &replayed, joint)));
    } else if args.output.is_none() && args.plot.is_none() {
        output::lines(csv_lines(args, &replayed));
    } else {
        output::block(&summary(args, &replayed));
    }
    Ok(EXIT_DONE)
}

async fn replay(args: &TorqueArgs, config: &Config, store: &Store) -> Result<Replayed, CliError> {
    let replay = Replay::find(config, store, args.run, args.cycle).await?;
    let (parameters, name) = parameters(args, config, store, &replay).await?;
    let export = replay.export(config, args.source.as_deref()).await?;
    for target in [args.output.as_deref(), args.plot.as_ref().map(PlotFile::path)] {
        refuse_source(target, &export, "the export itself")?;
    }
    let rows = if args.all_rows { SeriesRows::Filtered } else { SeriesRows::Counted };
    let series = replay.torque(&export, parameters, rows).await?;
    if args.parameters.is_none() {
        compare(&series, &store.self_rmsd(args.run).await?, args.cycle);
    }
    Ok(Replayed { replay, export, parameters: name, series })
}

/// The parameters of the estimate and their name.
async fn parameters(
    args: &TorqueArgs,
    config: &Config,
    store: &Store,
    replay: &Replay,
) -> Result<(Vec<(ParameterId, f64)>, String), CliError> {
    // a window of production has no parameters
    let checked_against = match &args.parameters {
        None => store.checked_against(args.run, args.cycle).await?.map(|run| run.to_string()),
        Some(_) => None,
    };
    let (found, name) = match args.parameters.as_ref().or(checked_against.as_ref()) {
        None => (store.cycle_parameters(args.run, args.cycle).await?, "its own parameters".to_string()),
        Some(word) => {
            let named = NamedCandidate::find(store, word, config.analysis.estimator).await?;
            let ours = replay.run.model.as_ref().map(|model| &model.description_hash);
            if ours.is_some_and(|ours| *ours != named.candidate.model.description_hash) {
                return Err(CliError::Usage(format!(
                    "{} belongs to another description than run {}: its parameters are not comparable",
                    named.name, args.run
                )));
            }
            (named.candidate.parameters, format!("parameters of {}", named.name))
        }
    };
    if found.is_empty() {
        let reason = replay.cycle.reason.as_deref().unwrap_or("none are stored");
        return Err(CliError::Usage(format!(
            "cycle {} of run {} has no parameters: {reason}; name others with --parameters",
            args.cycle, args.run
        )));
    }
    Ok((found.iter().map(|p| (p.id, p.value)).collect(), name))
}

/// Reports if the rows do not give the values that were stored with the cycle.
fn compare(series: &TorqueSeries, stored: &[OfCycle<TorqueRmsd>], cycle: u32) {
    let differs = |stored: &&OfCycle<TorqueRmsd>| {
        let found = series.rmsd(stored.value.joint, stored.value.scope).all_rows;
        let expected = stored.value.all_rows;
        let close = (found.value - expected.value).abs() <= SAME_FIGURE * expected.value.abs();
        expected.value.is_finite() && (!close || found.samples != expected.samples)
    };
    if let Some(other) = stored.iter().filter(|of| of.cycle == cycle).find(differs) {
        let found = series.rmsd(other.value.joint, other.value.scope).all_rows;
        output::print_hint(&format!(
            "the rows are no longer those that were verified: RMSD of joint {}, {}, is {:.6} Nm over {} rows, stored \
             is {:.6} Nm over {}; limits, offsets or transmission of the robot's description, the layout or the \
             program have changed since",
            other.value.joint,
            other.value.scope.name(),
            found.value,
            found.samples,
            other.value.all_rows.value,
            other.value.all_rows.samples
        ));
    }
}

/// Rows of a joint that are written.
fn chosen_rows(args: &TorqueArgs, series: &TorqueSeries, joint: JointIndex) -> Vec<usize> {
    let rows = series.rows_of(args.stage.scope());
    match (args.points, series.joints.get(joint.index())) {
        (Some(points), Some(of_joint)) => peaks(of_joint, &rows, points as usize),
        _ => rows,
    }
}

/// Lines by row and joint, one at a time: all rows of a long cycle are hundreds of megabytes of text.
fn csv_lines<'a>(args: &TorqueArgs, replayed: &'a Replayed) -> impl Iterator<Item = String> + use<'a> {
    const HEADER: &str =
        "time_s,stage,joint,q_rad,qd_rad_s,measured_nm,estimated_nm,residual_nm,moving,counted";
    let series = &replayed.series;
    let mut lines: Vec<(usize, usize)> = Vec::new();
    for j in 0..series.joints.len() {
        lines.extend(chosen_rows(args, series, JointIndex::new(j)).into_iter().map(|row| (row, j)));
    }
    lines.sort_unstable();
    let line = move |(row, j): (usize, usize)| {
        let joint = &series.joints[j];
        format!(
            "{},{},{},{},{},{},{},{},{},{}",
            series.time[row],
            series.stage[row],
            JointIndex::new(j),
            joint.q[row],
            joint.qd[row],
            joint.measured[row],
            joint.estimated[row],
            joint.residual(row),
            u8::from(joint.moving[row]),
            u8::from(series.counted[row]),
        )
    };
    std::iter::once(HEADER.to_string()).chain(lines.into_iter().map(line))
}

fn as_value(args: &TorqueArgs, replayed: &Replayed, joint: JointIndex) -> serde_json::Value {
    let Replayed { replay, export, parameters, series } = replayed;
    let of_joint = &series.joints[joint.index()];
    let rows = chosen_rows(args, series, joint);
    let column = |of: &[f64]| rows.iter().map(|&row| of[row]).collect::<Vec<f64>>();
    let rmsd = series.rmsd(joint, args.stage.scope());
    let mut value = json!(rmsd);
    value["robot"] = json!(replay.run.robot);
    value["run_id"] = json!(replay.run.run_id);
    value["cycle"] = json!(replay.cycle.cycle);
    value["parameters"] = json!(args.parameters.as_deref().unwrap_or("own"));
    value["parameters_of"] = json!(parameters);
    value["source"] = json!(text::of_path(export));
    value["cutoff_hz"] = json!(replay.cutoff);
    value["rows"] = json!({
        "time_s": column(&series.time),
        "stage": rows.iter().map(|&row| series.stage[row].name()).collect::<Vec<_>>(),
        "q_rad": column(&of_joint.q),
        "qd_rad_s": column(&of_joint.qd),
        "measured_nm": column(&of_joint.measured),
        "estimated_nm": column(&of_joint.estimated),
        "residual_nm": rows.iter().map(|&row| of_joint.residual(row)).collect::<Vec<_>>(),
        "moving": rows.iter().map(|&row| of_joint.moving[row]).collect::<Vec<_>>(),
        "counted": rows.iter().map(|&row| series.counted[row]).collect::<Vec<_>>(),
    });
    value
}

/// RMSD by joint and stage over the counted rows.
fn summary(args: &TorqueArgs, replayed: &Replayed) -> String {
    let series = &replayed.series;
    let scopes: Vec<RmsdScope> = match args.stage {
        StageArg::All => {
            let stages = Stage::ANALYSED.map(RmsdScope::Stage).into_iter();
            stages.filter(|scope| !series.rows_of(*scope).is_empty()).chain([RmsdScope::WholeCycle]).collect()
        }
        one => vec![one.scope()],
    };
    let row = |rmsd: TorqueRmsd| {
        let mut cells = vec![rmsd.joint.to_string(), rmsd.scope.name().to_string()];
        for of in [rmsd.all_rows, rmsd.moving_rows] {
            cells.extend(match of.samples {
                0 => ["-".into(), "-".into(), "0".into()],
                _ => [format!("{:.4}", of.value), format!("{:.4}", of.relative), of.samples.to_string()],
            });
        }
        cells
    };
    let joints = (0..series.joints.len()).map(JointIndex::new);
    let rows: Vec<Vec<String>> =
        joints.flat_map(|joint| scopes.iter().map(move |scope| row(series.rmsd(joint, *scope)))).collect();
    let header = [
        "joint",
        "stage",
        "rmsd_nm",
        "relative",
        "samples",
        "moving_rmsd_nm",
        "moving_relative",
        "moving_samples",
    ];
    format!("{}\n{}", text::shown(&heading(args, replayed)), output::table(&header, &rows))
}

fn heading(args: &TorqueArgs, replayed: &Replayed) -> String {
    let stage = match args.stage.scope() {
        RmsdScope::WholeCycle => "whole cycle",
        RmsdScope::Stage(stage) => stage.name(),
    };
    let run = &replayed.replay.run;
    format!("{}, run {}, cycle {}: {stage}, {}", run.robot, run.run_id, args.cycle, replayed.parameters)
}

fn figure(args: &TorqueArgs, replayed: &Replayed) -> crate::report::figure::Figure {
    let Replayed { replay, export, series, .. } = replayed;
    let subtitle = format!(
        "{}; low-pass {} Hz on both sides; RMSD in per cent of the RMS of the measured torque over the same rows{}",
        text::of_file_name(export),
        replay.cutoff,
        if args.slow { "" } else { "; the estimate is drawn only while the joint moves" }
    );
    let view = TorqueView {
        scope: args.stage.scope(),
        points: args.points.map(|points| points as usize),
        joint: args.joint.map(usize::from).and_then(JointIndex::from_number),
        slow: args.slow,
    };
    torque_figure(&replay.robot, series, view, heading(args, replayed), subtitle)
}
