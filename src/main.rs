//! Parse, run, map the error to an exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    armwatch::cli::run(armwatch::cli::Cli::of_process())
}
