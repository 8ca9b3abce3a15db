//! `armwatch trajectory plot`: a programme in a picture.

use std::path::PathBuf;

use clap::Args;

use super::arm::arm;
use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::plot::PlotFile;
use crate::cli::shared::programme::programme;
use crate::report::trajectory::trajectory_figure;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch trajectory plot er3a.json --robot er3a -o er3a.svg
  armwatch trajectory plot mine.json --robot robots/mine.toml -o mine.html

The picture has the positions, velocities and accelerations of all joints over one period, each in percent of its
limit, and the results of the starts of the search.")]
pub(in crate::cli) struct PlotArgs {
    /// Programme of `armwatch trajectory design`
    #[arg(value_name = "PROGRAMME")]
    file: PathBuf,
    /// Arm: a robot or model of the configuration, or the file of a description
    #[arg(long, value_name = "NAME")]
    robot: String,
    /// Picture to write, .svg or .html
    #[arg(short, long, value_name = "FILE", value_parser = PlotFile::parse)]
    output: PlotFile,
}

pub(in crate::cli) fn plot(global: &Global, args: &PlotArgs) -> Result<u8, CliError> {
    let robot = arm(global, &args.robot)?;
    let programme = programme(&args.file, &robot)?;
    let (starts, subtitle) = match &programme.search {
        Some(search) => (
            &search.values[..],
            format!(
                "condition number {:.3}, with scaled columns {:.3}; searched for {} of {} parameters, {}, seed {}",
                search.condition_number,
                search.scaled_condition_number,
                search.objective,
                search.parameters.len(),
                output::counted(search.starts, "start"),
                search.seed
            ),
        ),
        None => (&[][..], String::new()),
    };
    let title = format!("Test motion of {}, {} s", robot.model, 1.0 / programme.series.base_frequency);
    args.output.write(&trajectory_figure(&robot, &programme.series, starts, title, subtitle))?;
    Ok(EXIT_DONE)
}
