//! Programmes of test motions from files.

use std::path::Path;

use super::paths::{metadata, not_read};
use crate::cli::context::CliError;
use armwatch_model::robot::Robot;
use armwatch_trajectory::programme::Programme;

/// Reads a programme that fits the arm.
pub fn programme(path: &Path, robot: &Robot) -> Result<Programme, CliError> {
    let text = read(path)?;
    let problem = |problem: String| CliError::Usage(format!("{}: {problem}", path.display()));
    let programme = Programme::parse(&text).map_err(problem)?;
    programme.fits(robot).map_err(problem)?;
    Ok(programme)
}

/// The text of a named file.
///
/// # Errors
/// [`CliError::Usage`] if the file does not exist or is not text; [`CliError::Io`] if it cannot be read.
pub fn read(path: &Path) -> Result<String, CliError> {
    if metadata(path)?.is_dir() {
        return Err(CliError::Usage(format!("{}: is a folder; name a file", path.display())));
    }
    let bytes = std::fs::read(path).map_err(|error| not_read(path, &error))?;
    String::from_utf8(bytes).map_err(|error| {
        CliError::Usage(format!(
            "{}: is not UTF-8 text from byte {}; name another file, or save it as UTF-8",
            path.display(),
            error.utf8_error().valid_up_to()
        ))
    })
}
