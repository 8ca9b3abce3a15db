//! The arm that a trajectory is for.

use std::path::Path;

use crate::cli::context::{CliError, Global};
use armwatch_config::read_robot;
use armwatch_model::robot::Robot;

/// The arm called `name`: a description's file, or a robot or model of the configuration.
pub(super) fn arm(global: &Global, name: &str) -> Result<Robot, CliError> {
    let path = Path::new(name);
    let is_file =
        path.extension().is_some_and(|ending| ["toml", "urdf"].iter().any(|known| ending == *known));
    if is_file || path.is_file() {
        return Ok(read_robot(path)?);
    }
    let config = global.read_config()?;
    let by_model = config.arms().find(|robot| robot.model == name);
    if let Some(robot) = by_model {
        return Ok(Robot::clone(robot));
    }
    let models: Vec<&str> = config.arms().map(|robot| robot.model.as_str()).collect();
    let file = "or name the file of a description, such as config/robots/er3a.toml";
    match config.robot_entry(name) {
        // this pattern would take a mistyped model for another arm
        Some(entry) if entry.robots == "*" => Err(CliError::Usage(format!(
            "--robot {name}: neither a model of the configuration nor a robot that a pattern other than \"*\" matches; if it is a \
             robot of the entry name = \"*\", write its model, --robot {}; {file}",
            entry.description.model
        ))),
        Some(entry) => Ok(Robot::clone(&entry.description)),
        None => Err(CliError::Usage(format!(
            "--robot {name}: neither a robot nor a model of the configuration, which has {}; {file}",
            if models.is_empty() { "none".to_owned() } else { models.join(", ") }
        ))),
    }
}
