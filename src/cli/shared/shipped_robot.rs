//! The robot of the shipped configuration.

use crate::cli::context::CliError;
use armwatch_config::Config;
use armwatch_model::robot::Robot;

/// The arm of the shipped configuration.
///
/// # Errors
/// [`CliError::Internal`] if there is none.
pub fn shipped_robot() -> Result<Robot, CliError> {
    let shipped = Config::shipped()?;
    let entry = shipped.fleet.first();
    entry
        .map(|entry| Robot::clone(&entry.description))
        .ok_or_else(|| CliError::Internal("the shipped configuration describes no robot".into()))
}
