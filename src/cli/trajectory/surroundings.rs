//! Surroundings of an arm from the command line.

use std::path::PathBuf;

use clap::Args;

use crate::cli::context::CliError;
use armwatch_config::read_cell;
use armwatch_model::robot::{Cell, Robot};
use armwatch_trajectory::clearance::{Clearance, ClearanceLimit};

#[derive(Debug, Clone, Args)]
pub(super) struct SurroundingsArgs {
    /// Surroundings of the arm: a TOML file of planes, boxes and cylinders
    #[arg(help_heading = "Surroundings", long, value_name = "FILE")]
    cell: Option<PathBuf>,
    /// Smallest allowed distance of the description's capsules from each other and from the cell, m
    #[arg(help_heading = "Surroundings", long, default_value_t = 0.02, value_name = "M")]
    clearance_m: f64,
}

impl SurroundingsArgs {
    /// Distances that a motion of the arm must keep; `None` if there are none.
    pub fn limit(&self, robot: &Robot) -> Result<Option<ClearanceLimit>, CliError> {
        if !(0.0..=10.0).contains(&self.clearance_m) {
            return Err(CliError::Usage(format!(
                "--clearance-m {}: 0 to 10 m is possible",
                self.clearance_m
            )));
        }
        let cell = match &self.cell {
            Some(path) => read_cell(path)?,
            None => Cell::default(),
        };
        if self.cell.is_some() && robot.shape.capsules.iter().all(|capsule| capsule.link == 0) {
            return Err(CliError::Usage(
                "--cell: the description has no [[capsule]] of a link that moves, so no clearance from the \
                cell can be checked; docs/trajectories.md shows how to give links a shape"
                    .into(),
            ));
        }
        let clearance = Clearance::new(robot, &cell);
        Ok((!clearance.is_empty()).then_some(ClearanceLimit { clearance, distance: self.clearance_m }))
    }
}
