//! Programmes of test motions from files.

use std::path::Path;

use crate::cli::context::CliError;
use crate::design::programme::Programme;
use crate::robot::Robot;

/// Reads a programme that fits the arm.
pub(in crate::cli) fn programme(path: &Path, robot: &Robot) -> Result<Programme, CliError> {
    let text = read(path)?;
    let problem = |problem: String| CliError::Usage(format!("{}: {problem}", path.display()));
    let programme = Programme::parse(&text).map_err(problem)?;
    programme.fits(robot).map_err(problem)?;
    Ok(programme)
}

/// The text of a file.
pub(in crate::cli) fn read(path: &Path) -> Result<String, CliError> {
    std::fs::read_to_string(path)
        .map_err(|error| CliError::Io(format!("cannot read {}: {error}", path.display())))
}
