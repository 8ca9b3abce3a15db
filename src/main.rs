//! Parse, run, map the error to an exit code.

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    armwatch::cli::run(armwatch::cli::Cli::parse())
}
