//! `armwatch rmsd`: how well each cycle's parameters fit its stages, the whole cycle, and the two ends of
//! warming.

use clap::{Args, ValueEnum};
use serde_json::json;

use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::output;
use super::shared::plot::{PlotFile, rmsd_limits};
use super::shared::verification::verified_cycles;
use super::verify::MARKED_ABOVE;
use crate::report::rmsd::{CycleVerification, rmsd_figure};
use armwatch_method::statistics::descriptive::{mean, standard_deviation};
use armwatch_model::analysis::{Rmsd, RmsdPair, RmsdScope};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::Stage;
use armwatch_model::text;
use armwatch_store::{RunSource, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch rmsd --run 3
  armwatch rmsd --run 3 --joint 5 --figure nm
  armwatch rmsd --run 3 --plot rmsd.svg
  armwatch rmsd --run 3 --json | jq '.rmsd[] | select(.stage == \"all\")'

The command prints one line per joint and cycle: the RMSD between estimated and measured torque. The parameters
are those of the cycle, identified on its excitation stage. The columns are the excitation, friction and warming
stages, the whole cycle, and the first and the last third of warming. Columns with moving_ omit the rows in which
the joint is slower than its low-speed threshold; the others contain all rows. relative divides by the RMS of the
measured torque over the same rows. A * marks values of moving rows above 10 %. Friction falls inside a cycle, so
that the start and the end of warming differ most in cold cycles. The views cycle_rmsd and warming_contrast have
the same values.")]
pub(super) struct RmsdArgs {
    /// Number of the run
    #[arg(long, value_name = "RUN")]
    run: i64,
    /// Use only this joint, from 1
    #[arg(long, value_name = "JOINT", value_parser = clap::value_parser!(u8).range(1..))]
    joint: Option<u8>,
    /// Unit of the values in the table
    #[arg(long, value_enum, default_value_t = FigureArg::Relative)]
    figure: FigureArg,
    /// Draw the moving relative RMSD by cycle into this file, .svg or .html
    #[arg(long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FigureArg {
    /// Fraction of the RMS of the measured torque
    Relative,
    /// Nm
    Nm,
}

/// Columns of the table, each over all rows and over the moving ones.
const SCOPES: [RmsdScope; 4] = [
    RmsdScope::Stage(Stage::Excitation),
    RmsdScope::Stage(Stage::Friction),
    RmsdScope::Stage(Stage::Warming),
    RmsdScope::WholeCycle,
];

pub(super) fn rmsd(global: &Global, args: &RmsdArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let (run, cycles) = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = run_and_cycles(args, &store).await;
        store.close().await?;
        done
    })?;
    let shown = shown_joints(args, &run, &cycles)?;
    if let Some(plot) = &args.plot {
        let title = format!("{}, run {}: RMSD by cycle", run.robot, run.run_id);
        let subtitle = "estimated against measured torque with each cycle's own parameters, rows in which the \
                        joint moves, as a fraction of the measured torque's RMS; logarithmic scale";
        plot.write(&rmsd_figure(&of_joints(&cycles, &shown), rmsd_limits(&config), title, subtitle.into()))?;
    }
    if global.json {
        cycles.iter().for_each(|of| output::json(&as_value(&run, of, &shown)));
    } else {
        output::block(&as_text(args, &run, &cycles, &shown));
    }
    Ok(EXIT_DONE)
}

async fn run_and_cycles(
    args: &RmsdArgs,
    store: &Store,
) -> Result<(RunSource, Vec<CycleVerification>), CliError> {
    let run = store.run_source(args.run).await?;
    let run = run.ok_or_else(|| CliError::Usage(format!("there is no run {}", args.run)))?;
    Ok((run, verified_cycles(store, args.run).await?))
}

fn shown_joints(
    args: &RmsdArgs,
    run: &RunSource,
    cycles: &[CycleVerification],
) -> Result<Vec<JointIndex>, CliError> {
    let joints = cycles.iter().flat_map(|of| &of.rmsd).map(|rmsd| rmsd.joint.number()).max();
    let Some(joints) = joints else {
        let reason = cycles.iter().find_map(|of| of.reason.as_deref()).unwrap_or("it has no cycles");
        return Err(CliError::Usage(format!("no cycle of run {} has parameters: {reason}", run.run_id)));
    };
    match args.joint.map(usize::from) {
        Some(number) if number > joints => {
            Err(CliError::Usage(format!("{} has {joints} joints, but no joint {number}", run.robot)))
        }
        Some(number) => Ok(JointIndex::from_number(number).into_iter().collect()),
        None => Ok((0..joints).map(JointIndex::new).collect()),
    }
}

fn of_joints(cycles: &[CycleVerification], shown: &[JointIndex]) -> Vec<CycleVerification> {
    let mut cycles = cycles.to_vec();
    for of in &mut cycles {
        of.rmsd.retain(|rmsd| shown.contains(&rmsd.joint));
        of.contrast.retain(|contrast| shown.contains(&contrast.joint));
    }
    cycles
}

fn as_text(args: &RmsdArgs, run: &RunSource, cycles: &[CycleVerification], shown: &[JointIndex]) -> String {
    let mut header = vec!["cycle".to_string()];
    for prefix in ["moving_", ""] {
        let columns = SCOPES.iter().map(|scope| scope.name()).chain(["warming_start", "warming_end"]);
        header.extend(columns.map(|name| format!("{prefix}{name}")));
    }
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut text = String::new();
    for &joint in shown {
        let figures: Vec<Vec<Option<f64>>> =
            cycles.iter().map(|of| figures(of, joint, args.figure)).collect();
        let mut rows: Vec<Vec<String>> = cycles
            .iter()
            .zip(&figures)
            .map(|(of, figures)| cells(&of.cycle.to_string(), figures, args.figure))
            .collect();
        for (name, statistic) in
            [("mean", mean as fn(&[f64]) -> Option<f64>), ("deviation", standard_deviation)]
        {
            let over_cycles =
                |column: usize| statistic(&figures.iter().filter_map(|of| of[column]).collect::<Vec<f64>>());
            let figures: Vec<Option<f64>> = (0..header.len() - 1).map(over_cycles).collect();
            rows.push(cells(name, &figures, FigureArg::Nm));
        }
        text.push_str(&format!("joint {joint}\n{}\n\n", output::table(&header, &rows)));
    }
    for of in cycles {
        if let Some(reason) = &of.reason {
            text.push_str(&format!("cycle {} has no parameters: {}\n", of.cycle, text::shown(reason)));
        }
    }
    let unit = match args.figure {
        FigureArg::Relative => "relative RMSD of the torque; * moving rows above 10 %",
        FigureArg::Nm => "RMSD of the torque, Nm",
    };
    format!("{text}{}, run {}: {unit}", text::shown(&run.robot), run.run_id)
}

/// Values of one line of the table, in the order of its columns: moving rows first, then all rows.
fn figures(of: &CycleVerification, joint: JointIndex, figure: FigureArg) -> Vec<Option<f64>> {
    let contrast = of.contrast.iter().find(|found| found.joint == joint);
    let pairs: Vec<Option<RmsdPair>> = SCOPES
        .iter()
        .map(|scope| {
            let found = of.rmsd.iter().find(|rmsd| rmsd.joint == joint && rmsd.scope == *scope)?;
            Some(RmsdPair { all_rows: found.all_rows, moving_rows: found.moving_rows })
        })
        .chain([contrast.map(|found| found.start), contrast.map(|found| found.end)])
        .collect();
    let value = |rmsd: Rmsd| {
        let value = if figure == FigureArg::Relative { rmsd.relative } else { rmsd.value };
        (rmsd.samples > 0 && value.is_finite()).then_some(value)
    };
    let all = pairs.iter().map(|pair| pair.and_then(|pair| value(pair.all_rows)));
    let moving = pairs.iter().map(|pair| pair.and_then(|pair| value(pair.moving_rows)));
    moving.chain(all).collect()
}

fn cells(name: &str, figures: &[Option<f64>], figure: FigureArg) -> Vec<String> {
    // the model is inaccurate at rest, so that values of all rows are high in sound recordings too
    let is_marked = |place: usize, value: f64| {
        figure == FigureArg::Relative && place < figures.len() / 2 && value > MARKED_ABOVE
    };
    let cell = |(place, value): (usize, &Option<f64>)| {
        value.map_or_else(
            || "-".to_string(),
            |value| format!("{value:.4}{}", if is_marked(place, value) { "*" } else { "" }),
        )
    };
    std::iter::once(name.to_string()).chain(figures.iter().enumerate().map(cell)).collect()
}

fn as_value(run: &RunSource, of: &CycleVerification, shown: &[JointIndex]) -> serde_json::Value {
    let rmsd: Vec<_> = of.rmsd.iter().filter(|rmsd| shown.contains(&rmsd.joint)).collect();
    let contrasts: Vec<_> = of.contrast.iter().filter(|found| shown.contains(&found.joint)).collect();
    json!({
        "robot": run.robot,
        "run_id": run.run_id,
        "cycle": of.cycle,
        "reason": of.reason,
        "rmsd": rmsd,
        "warming_contrast": contrasts,
    })
}
