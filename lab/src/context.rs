//! Options of every command of the lab.

use std::ops::Deref;
use std::path::PathBuf;

use clap::Args;

use armwatch::cli::context::CliError;

/// Options of every command.
#[derive(Debug, Args)]
pub(crate) struct LabOptions {
    #[command(flatten)]
    shared: armwatch::cli::context::Global,
    /// The armwatch program that is measured [default: the one next to this program]
    #[arg(long, global = true, value_name = "FILE", help_heading = "Global options")]
    program: Option<PathBuf>,
}

impl Deref for LabOptions {
    type Target = armwatch::cli::context::Global;

    fn deref(&self) -> &Self::Target {
        &self.shared
    }
}

impl LabOptions {
    /// The armwatch program that is measured.
    pub(crate) fn program(&self) -> Result<PathBuf, CliError> {
        let program = match &self.program {
            Some(program) => program.clone(),
            None => own_program()?.with_file_name("armwatch"),
        };
        // children run in other folders
        std::path::absolute(&program).ok().filter(|path| path.is_file()).ok_or_else(|| {
            CliError::Usage(format!(
                "there is no program {}; build it with `cargo build --release`, or name one with --program",
                program.display()
            ))
        })
    }
}

/// This program.
pub(crate) fn own_program() -> Result<PathBuf, CliError> {
    std::env::current_exe().map_err(|error| CliError::Io(error.to_string()))
}
